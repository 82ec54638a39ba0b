"""Training as a sequence of chunks: each is fixed by the seed and its number, so a run resumes to the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.actor import Gait, Perceptron
from sim.environment import REACH, Environment, action_map
from sim.learning import Learner
from sim.mixture import Mixture
from sim.model import Model
from sim.plan import Training
from sim.tasks import SCALE
from sim.verdict import Verdict, evaluate, shared_out, stood, verdict_of

Array = NDArray[np.float64]

CORRECTION = 0.45  # farthest that an action of 1 goes from a rhythm [rad]
LEARN = 0  # purpose of randomness; 1 is that of `sim.verdict`, 2 that of `sim.race`


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """What a training begins with.

    Attributes:
        heading: direction of the body that is to be forward [rad].
        posture: targets of an action of 0 [rad], (n,).
        rhythm: gait that the policy corrects; None where the policy makes the whole movement.
    """

    heading: float
    posture: Array
    rhythm: Gait | None = None

    def state(self) -> dict[str, Array]:
        """As named arrays, for a checkpoint."""
        found = {"heading": np.array(self.heading), "posture": self.posture}
        if self.rhythm is not None:
            gait = self.rhythm
            found["rhythm"] = np.concatenate([[gait.frequency], gait.amplitude, gait.phase, gait.offset])
        return found


def start_of(state: Mapping[str, Array]) -> Start:
    """The start out of what `Start.state` gave; a missing array is a KeyError."""
    rhythm = None
    if "rhythm" in state:
        frequency, *rest = np.split(state["rhythm"], [1, *(1 + len(state["posture"]) * np.arange(1, 3))])
        rhythm = Gait(float(frequency[0]), *rest)
    return Start(float(state["heading"]), state["posture"], rhythm)


@dataclass(frozen=True, eq=False, slots=True)
class Chunk:
    """What one chunk of training did.

    Attributes:
        index: from 0.
        steps: control periods so far.
        seconds: computing time of the learning in this chunk [s], all threads.
        exploring_speed: mean speed along the heading while exploring [m/s].
        curves: named numbers for a plot.
        verdict: of the policy after it.
    """

    index: int
    steps: int
    seconds: float
    exploring_speed: float
    curves: Mapping[str, float]
    verdict: Verdict


class Trainer:
    """One policy in the making; `advance` runs one chunk."""

    def __init__(
        self,
        model: Model,
        training: Training,
        start: Start,
        *,
        others: Sequence[Model] = (),
        checks: Sequence[Model] = (),
        nthread: int = 1,
        learned: Mapping[str, Array] | None = None,
    ) -> None:
        """Begin.

        Args:
            model: of the robot, made by `sim.herd.with_latency_room`.
            training: what to do.
            start: what it begins with.
            others: the same robot modelled otherwise; a share of the experience and of the evaluation is on them.
            checks: models of it that no experience is on, but the choice of the best asks for them, too.
            nthread: threads of the physics; it changes no result.
            learned: state of a learner that began with the same start, to go on with; None begins from nothing.
        """
        self.model, self.training, self.start, self.nthread = model, training, start, nthread
        self._stood = stood(model)
        self._others, self._checks = tuple(map(stood, others)), tuple(map(stood, checks))
        self.environment = mixture_of(model, others, training, start, nthread)
        self.learner = Learner(self.environment, training.ppo, training.seed)
        if learned:
            self.learner.restore(learned)
        self.done = 0  # chunks
        self.best: Perceptron | None = None
        self.best_verdict: Verdict | None = None

    def actor(self) -> Perceptron:
        """The policy as it is now."""
        return self.learner.exported()

    def advance(self) -> Chunk:
        """Run the next chunk and evaluate the policy after it; a rhythm as it is comes first."""
        training, index = self.training, self.done
        if self.best is None and self.start.rhythm is not None:
            self._consider(self.actor().silenced())
        progress = index / training.chunks
        # Explore widely first; a policy that leans on its own noise to move would stand still without it.
        first = first_spread(training, self.start)
        spread = first * (training.last_spread / first) ** min(1.0, progress / 0.6)
        rate = first_rate(training, self.start) * (1.0 - 0.8 * progress)
        rng = np.random.default_rng(np.random.SeedSequence(training.seed, spawn_key=(LEARN, index)))
        steps = min(training.chunk, training.steps - index * training.chunk)
        curves, seconds = self.learner.learn(steps, rng, rate, spread)
        self.done += 1
        verdict = self._consider(self.actor())
        return Chunk(
            index, training.simulated(self.done), seconds, curves.get("speed", 0.0) / SCALE / 2.0, curves, verdict
        )

    def _consider(self, actor: Perceptron) -> Verdict:
        """Judge a policy, and keep it if it is the best so far."""
        to_beat = -np.inf if self.best_verdict is None else self.best_verdict.score
        verdict = evaluate(
            self._stood, actor, self.training, self.nthread, self._others, self._checks, to_beat=to_beat
        )  # fmt: skip
        if self.best_verdict is None or verdict.score > self.best_verdict.score:
            self.best, self.best_verdict = actor, verdict
        return verdict

    def state(self) -> dict[str, Array]:
        """All that a later process needs to go on, as named arrays."""
        found = {f"learner/{name}": value for name, value in self.learner.state().items()}
        found |= self.start.state() | {"done": np.array(self.done)}
        if self.best is not None and self.best_verdict is not None:
            for index, (weight, bias) in enumerate(self.best.layers):
                found[f"best/{index}/weight"], found[f"best/{index}/bias"] = weight, bias
            found["verdict"] = self.best_verdict.array()
        return found

    def restore(self, state: Mapping[str, Array]) -> None:
        """Go on from what `state` gave.

        Raises:
            KeyError: an array is missing.
            ValueError: an array has another shape, so it is of another robot or learner.
        """
        self.learner.restore({name[8:]: value for name, value in state.items() if name.startswith("learner/")})
        self.done = int(state["done"])
        if "verdict" in state:
            actor = self.actor()
            count = len(actor.layers)
            layers = tuple((state[f"best/{k}/weight"], state[f"best/{k}/bias"]) for k in range(count))
            self.best = replace(actor, layers=layers)
            self.best_verdict = verdict_of(state["verdict"])


def environment_of(
    model: Model, training: Training, start: Start, nthread: int = 1, count: int | None = None
) -> Environment:
    """Where a training from a start takes place, with so many copies, all of the learner's by default."""
    reach = REACH if start.rhythm is None else CORRECTION
    return Environment(
        model, training.ppo.copies if count is None else count, replace(training.task, heading=start.heading),
        action_map(model, start.posture, reach), training.randomisation, training.episode, start.rhythm, nthread,
    )  # fmt: skip


def mixture_of(
    model: Model, others: Sequence[Model], training: Training, start: Start, nthread: int = 1
) -> Environment | Mixture:
    """The same on several models of the robot at once."""
    if not others:
        return environment_of(model, training, start, nthread)
    counts = shared_out(training.ppo.copies, training.share, len(others))
    models = zip((model, *others), counts, strict=True)
    return Mixture([environment_of(robot, training, start, nthread, count) for robot, count in models])


def first_rate(training: Training, start: Start) -> float:
    """Learning rate at first."""
    return training.ppo.learning_rate * (1.0 if start.rhythm is None else training.rhythm_rate)


def first_spread(training: Training, start: Start) -> float:
    """Standard deviation of what the policy says at first."""
    if start.rhythm is None:
        return training.ppo.spread
    return max(training.last_spread, training.rhythm_spread * training.ppo.spread)
