"""How good a policy is without exploration: on the model as it is, in drawn episodes, and at the ends of ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.actor import Actor, Perceptron
from sim.closed_loop import roll_out_actor
from sim.environment import Environment
from sim.model import Model
from sim.plan import Training
from sim.randomisation import EXACT, WIDE, Randomisation, corners, draw, has_pads, joined
from sim.rollout import Behaviour, measure, settle
from sim.tasks import Goal

Array = NDArray[np.float64]

EVALUATE = 1  # purpose of randomness beside those of `sim.training` and `sim.race`
EPISODES, EVALUATION_SECONDS = 20, 10.0  # randomised episodes of an evaluation, and the length of all its walks [s]
FALL_WEIGHT = 2.0  # of the share of episodes with a fall in the score: a fall ends more than its own episode
LEAST_KEPT = 0.05  # policies that keep less in some corner are still told apart by their speed
WALKS, PAD_WALKS = 4, 12  # of every corner; one walk says little about a walk that is nearly the same
HAIR = 0.004  # by which joints read wrong, so that those differ [rad]


@dataclass(frozen=True, eq=False, slots=True)
class Stood:
    """A robot, the full state in which it stands still, and how often it walks at every corner."""

    model: Model
    start: Array
    walks: int = WALKS


def stood(model: Model) -> Stood:
    """The robot once it has settled; walks on pads differ most and are cheap, so there are more of them."""
    return Stood(model, settle(model), PAD_WALKS if has_pads(model) else WALKS)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What an evaluation found: the policy without exploration, as it is exported.

    Attributes:
        speed: on the model as it is [m/s].
        robust_speed: mean over randomised episodes, of each the share that it was upright for [m/s].
        falls: of the randomised episodes.
        episodes: how many those are.
        lost: episodes in which the physics exploded.
        target: no speed beyond it counts [m/s].
        kept: share of the speed that is kept in the worst corner that was looked at; None where none was.
        reward: of a control period in randomised episodes of the task, on average; None where the task is speed.
    """

    speed: float
    robust_speed: float
    falls: int
    episodes: int
    lost: int
    target: float = np.inf
    kept: float | None = None
    reward: float | None = None

    @property
    def score(self) -> float:
        """What chooses the best so far: the task's reward, or for speed what the worst corner keeps, less falls [m/s].

        It is a share of no more than the target, so that a policy which is fast on the model alone does not pass for a
        sturdy one. Without corners it is the mean of both speeds, less falls.
        """
        if self.reward is not None:
            return self.reward
        standing = max(0.0, 1.0 - FALL_WEIGHT * self.falls / max(self.episodes, 1))
        speed, robust = min(self.speed, self.target), min(self.robust_speed, self.target)
        return standing * ((speed + robust) / 2 if self.kept is None else speed * min(max(self.kept, LEAST_KEPT), 1.0))

    def array(self) -> Array:
        """As numbers, for a checkpoint; what is None is not a number."""
        kept, reward = (np.nan if value is None else value for value in (self.kept, self.reward))
        return np.array(
            [self.speed, self.robust_speed, self.falls, self.episodes, self.lost, self.target, kept, reward]
        )


def verdict_of(array: Array) -> Verdict:
    """The verdict out of what `Verdict.array` gave; another number of numbers is a ValueError."""
    if np.shape(array) != (8,):
        raise ValueError(f"verdict has shape {np.shape(array)}, it must be (8,)")
    speed, robust, falls, episodes, lost, target, kept, reward = (float(value) for value in array)
    known = [None if np.isnan(value) else value for value in (kept, reward)]
    return Verdict(speed, robust, int(falls), int(episodes), int(lost), target, *known)


def evaluate(
    robot: Stood, actor: Perceptron, training: Training, nthread: int = 1, others: Sequence[Stood] = (),
    checks: Sequence[Stood] = (), *, cornered: bool = True, to_beat: float = -np.inf,
) -> Verdict:  # fmt: skip
    """Measure a policy without exploration: once on the model as it is, in randomised episodes, and by its task.

    The draws are the same for every policy of a training, so that verdicts differ by the policy alone. A share of the
    episodes is on `others`. Where `cornered` and the task is speed, it walks at each end of each range, and on the
    models `checks`, too, until its score cannot be better than `to_beat`. Ranges are those that are claimed, which
    training may go beyond; those of a task's reward are training's.
    """
    plain = measure(robot.model, roll_out_actor(robot.model, actor, EVALUATION_SECONDS, start=robot.start))[0]
    behaviours: list[Behaviour | None] = []
    counts = shared_out(EPISODES, training.share, len(others))
    for other, count in zip((robot, *others), counts, strict=True):
        behaviours += randomised(other.model, actor, training.claimed, training.seed, episodes=count,
                                 seconds=EVALUATION_SECONDS, start=other.start, nthread=nthread)  # fmt: skip
    alive = [b for b in behaviours if b is not None]
    fast = training.task.goal is Goal.SPEED
    verdict = Verdict(
        speed=0.0 if plain is None else plain.speed * plain.upright,
        robust_speed=float(sum(b.speed * b.upright for b in alive)) / len(behaviours),
        falls=sum(b.fell for b in alive), episodes=len(behaviours), lost=len(behaviours) - len(alive),
        target=training.task.target_speed,
        reward=None if fast else mean_reward(robot.model, actor, training, nthread),
    )  # fmt: skip
    if not (fast and cornered):
        return verdict
    speeds = cornered_speeds(robot, corners(training.claimed), actor, training.seed, nthread)
    verdict = replace(verdict, kept=share_kept(speeds))
    for check in checks:  # the costliest last
        if verdict.score <= to_beat:
            break
        more = cornered_speeds(check, (EXACT,), actor, training.seed, nthread)
        speeds = np.concatenate([speeds, more])
        verdict = replace(verdict, kept=share_kept(speeds))
    return verdict


def cornered_speeds(
    robot: Stood, places: Sequence[Randomisation], actor: Actor, seed: int, nthread: int = 1
) -> Array:  # fmt: skip
    """Mean speed of some walks at every corner, of each the share that it was upright for [m/s], (corners,)."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(EVALUATE, 1)))
    model, count = robot.model, len(places) * robot.walks
    draws = joined([draw(replace(p, encoder_offset=HAIR), rng, robot.walks, model.nu, model.nbody - 1) for p in places])
    rollouts = roll_out_actor(
        model, actor, EVALUATION_SECONDS, copies=count, draws=draws, start=robot.start, nthread=nthread
    )  # fmt: skip
    speeds = np.array([0.0 if b is None else b.speed * b.upright for b in measure(model, rollouts)])
    return speeds.reshape(len(places), robot.walks).mean(axis=1)


def share_kept(speeds: Array) -> float:
    """The least of some speeds over the first of them; 0 if that one is none."""
    return float(speeds.min() / speeds[0]) if speeds[0] > 0.0 else 0.0


def shared_out(count: int, share: float, others: int) -> list[int]:
    """How many of `count` robots are the model as it is, and how many each of its other models, at least one."""
    few = max(1, round(share * count / others)) if others else 0
    return [count - others * few, *[few] * others]


def mean_reward(model: Model, actor: Perceptron, training: Training, nthread: int = 1) -> float:
    """The reward of a control period under a policy without exploration, over randomised episodes of its task."""
    episode = replace(training.episode, seconds=EVALUATION_SECONDS, history=actor.history)
    environment = Environment(
        model, EPISODES, training.task, actor.actions, training.randomisation or WIDE, episode, actor.rhythm,
        nthread,
    )  # fmt: skip
    observation = environment.reset(np.random.default_rng(np.random.SeedSequence(training.seed, spawn_key=(EVALUATE,))))
    total = 0.0
    for _ in range(environment.length):
        step = environment.step(actor.say(observation))
        observation, total = step.observation, total + float(step.reward.mean())
    return total / environment.length


def randomised(
    model: Model, actor: Actor, ranges: Randomisation, seed: int, *, episodes: int = EPISODES,
    seconds: float = EVALUATION_SECONDS, start: Array | None = None, nthread: int = 1,
) -> list[Behaviour | None]:  # fmt: skip
    """How a policy does in episodes that draw their robot, noise and pushes; None where the physics exploded."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(EVALUATE,)))
    draws = draw(ranges, rng, episodes, model.nu, model.nbody - 1)
    rollouts = roll_out_actor(
        model, actor, seconds, copies=episodes, draws=draws, rng=rng, start=start, nthread=nthread
    )  # fmt: skip
    return measure(model, rollouts)
