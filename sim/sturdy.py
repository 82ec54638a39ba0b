"""Open-loop gaits that hold on robots which differ from the model: what a policy that corrects them begins with.

A gait that is searched on the model alone walks by what only the model does. Here every gait of a CMA-ES walks on all
robots of a course at once, and the worst of them counts as much as all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.actor import Gait
from sim.closed_loop import roll_out_actor
from sim.environment import action_map
from sim.gaits import decode, encode, strategy_about
from sim.model import Model, body_length, drive_of
from sim.observation import ActionMap, ObservationLayout
from sim.randomisation import EXACT, WIDE, Draws, Randomisation, at_end, draw, joined
from sim.rollout import Behaviour, measure, settle

Array = NDArray[np.float64]

STURDY = 5  # purpose of randomness beside those of `sim.training`, `sim.race` and the commands that train
SPREAD = 0.15  # the first standard deviation of the CMA-ES, as a share of each parameter's range
DRAWN = 3  # walks of a gait with everything drawn, and with pushes
BRIEF = 3  # walks on the model in the first half of the search: as it is, and at both ends of friction
FALLEN = 0.5  # what is left of the speed of a walk that falls at the very end


@dataclass(frozen=True, eq=False, slots=True)
class Course:
    """Robots that a gait is tried on; it can be sent to another process.

    Attributes:
        model: of the robot, made by `sim.herd.with_latency_room`.
        others: the same robot modelled otherwise, on each of which it walks once.
        pace: how fast it is to be [m/s].
        ranges: what the robots may differ in.
        seed: of all that is drawn.
        seconds: of each walk.
        generations: of the CMA-ES, the first half of them on a few of the robots.
        population: gaits of each.
    """

    model: Model
    others: tuple[Model, ...]
    pace: float
    ranges: Randomisation = WIDE
    seed: int = 0
    seconds: float = 4.0
    generations: int = 36
    population: int = 10

    def __call__(self, gait: Gait) -> Trial:
        """The best of a search about a gait, which is itself among the finalists.

        Finalists walk for twice as long, on other robots than those of the search and under other pushes.
        """
        walker, rng = _Walker(self, 0), np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(STURDY,)))
        given = encode(walker.drive, gait)
        finalists, best = [given], -np.inf
        strategy = strategy_about(given, SPREAD, self.population, rng)
        for generation in range(self.generations):
            points, brief = strategy.ask(), generation < self.generations // 2
            trials = walker.trials(points, brief=brief)
            strategy.tell(points, [-trial.score for trial in trials])
            top = max(range(len(trials)), key=lambda k: trials[k].score)
            if not brief and trials[top].score > best:
                finalists, best = [given, points[top]], trials[top].score
        final = _Walker(replace(self, seconds=2 * self.seconds), 1)
        return max(final.trials([*finalists, strategy.mean]), key=lambda trial: trial.score)


@dataclass(frozen=True, eq=False, slots=True)
class Trial:
    """A gait and how it did on a course.

    Attributes:
        gait: tried.
        heading: its direction on the model as it is [rad].
        score: mean of the least worth of all its walks and of their mean [m/s], see `worth`; no more than minus the
            pace where the physics of the model itself exploded.
        least: that least worth [m/s].
    """

    gait: Gait
    heading: float
    score: float
    least: float


class _Walker:
    """A course with the robots settled and drawn; every gait meets the same ones, but its own pushes and noise."""

    def __init__(self, course: Course, number: int) -> None:
        """Draw the robots of the course; another number draws others."""
        model = course.model
        self.course, self._number = course, number
        self.drive, self._length = drive_of(model), body_length(model)
        start, ends = settle(model), _ends(course.ranges)
        others = [(other, settle(other), self._drawn(other, EXACT)) for other in course.others]
        drawn = (model, start, self._drawn(model, *[course.ranges] * DRAWN))
        self.robots = [(model, start, self._drawn(model, *ends)), drawn, *others]
        self.few = [(model, start, self._drawn(model, *ends[:BRIEF])), *others]

    def _rng(self, purpose: int) -> np.random.Generator:
        key = (STURDY, 1 + self._number, purpose)
        return np.random.default_rng(np.random.SeedSequence(self.course.seed, spawn_key=key))

    def _drawn(self, robot: Model, *places: Randomisation) -> Draws:
        rng = self._rng(0)
        return joined([draw(place, rng, 1, robot.nu, robot.nbody - 1) for place in places])

    def trials(self, points: Sequence[Array], *, brief: bool = False) -> list[Trial]:
        """How the gaits that points stand for do, all at once; on a few of the robots only if `brief`."""
        gaits = [decode(self.drive, point) for point in points]
        walks: list[list[Behaviour | None]] = [[] for _ in gaits]
        for model, start, draws in self.few if brief else self.robots:
            count = len(draws.encoder_offset)
            rollouts = roll_out_actor(
                model, _Chorus(gaits, count, action_map(model)), self.course.seconds, copies=count * len(gaits),
                draws=joined([draws] * len(gaits)), rng=self._rng(1), start=start,
            )  # fmt: skip
            found = measure(model, rollouts, self._length)
            for k, own in enumerate(walks):
                own += found[k * count : (k + 1) * count]
        return [trial_of(gait, own, self.course.pace) for gait, own in zip(gaits, walks, strict=True)]


def trial_of(gait: Gait, walks: Sequence[Behaviour | None], pace: float) -> Trial:
    """What walks say of a gait, the first of them on the model as it is."""
    if walks[0] is None:
        return Trial(gait, 0.0, -pace, -pace)
    worths = np.array([worth(walk, walks[0].heading, pace) for walk in walks])
    return Trial(gait, walks[0].heading, float(worths.mean() + worths.min()) / 2, float(worths.min()))


def worth(walk: Behaviour | None, heading: float, pace: float) -> float:
    """What a walk counts [m/s]: its speed along a heading [rad], less what it is beyond the pace.

    A share of that where it fell or a motor would overheat; the pace backwards where the physics exploded.
    """
    if walk is None:
        return -pace
    along = walk.speed * float(np.cos(walk.heading - heading))
    along = min(along, max(2.0 * pace - along, 0.0))
    if along <= 0.0:
        return max(along, -pace)
    return along / max(1.0, walk.overload) * (FALLEN * walk.upright if walk.fell else 1.0)


def _ends(ranges: Randomisation) -> tuple[Randomisation, ...]:
    """The robot as it is, and the ends of ranges that gaits mind most, friction first."""
    both = (at_end(ranges, end, name) for name in ("friction", "contact_time") for end in (0, 1))
    return (EXACT, *both, at_end(ranges, 1, "latency"), at_end(ranges, 0, "stiffness", "damping"))


class _Chorus:
    """Several gaits at once, each on so many copies, followed as the rhythm of a policy that says nothing."""

    def __init__(self, gaits: Sequence[Gait], count: int, actions: ActionMap) -> None:
        self.gaits, self.count, self.actions = gaits, count, actions
        self.layout = ObservationLayout(actions.num_joints)

    @property
    def num_joints(self) -> int:
        return self.actions.num_joints

    def act(self, time: float, observation: Array) -> Array:
        centres = np.repeat([gait.targets(time) for gait in self.gaits], self.count, axis=0)
        return self.actions.targets(np.zeros(self.num_joints), observation[..., self.layout.action], centres)
