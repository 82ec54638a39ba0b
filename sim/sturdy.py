"""Open-loop gaits that hold on robots which differ from the model: what a policy that corrects them begins with.

A gait that is searched on the model alone walks by what only the model does. Here every gait of a CMA-ES walks on all
robots of a course at once, and the worst of them counts as much as all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import cma
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.actor import Gait
from sim.closed_loop import roll_out_actor
from sim.environment import action_map
from sim.gaits import decode, encode
from sim.model import Drive, Model, drive_of
from sim.observation import ActionMap, ObservationLayout
from sim.randomisation import EXACT, WIDE, Draws, Randomisation, draw, joined
from sim.rollout import Behaviour, measure, settle

Array = NDArray[np.float64]

STURDY = 5  # purpose of randomness beside those of `sim.training`, `sim.race` and the commands that train
STEP = 0.15  # the first standard deviation of the CMA-ES, as a share of each parameter's range
FEW = 3  # ends of ranges that tell most
EPISODES = 3  # walks of a gait with everything drawn, and with pushes
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
        generations: of the CMA-ES, the first half of them on the few robots that tell most.
        population: gaits of each.
    """

    model: Model
    others: tuple[Model, ...]
    pace: float
    ranges: Randomisation = WIDE
    seed: int = 0
    seconds: float = 4.0
    generations: int = 50
    population: int = 10

    def __call__(self, gait: Gait) -> Trial:
        """The best of a search about a gait; it is never worse than that gait itself, by its score on this course."""
        walker, rng = _Walker(self), np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(STURDY,)))
        start = encode(walker.drive, gait)
        best = walker.trials([start])[0]
        options = {"popsize": self.population, "randn": lambda *shape: rng.standard_normal(shape), "seed": np.nan,
                   "verbose": -9, "verb_log": 0}  # fmt: skip
        strategy = cma.CMAEvolutionStrategy(start, STEP, options)
        for generation in range(self.generations):
            points, brief = strategy.ask(), generation < self.generations // 2
            trials = walker.trials(points, brief=brief)
            strategy.tell(points, [-trial.score for trial in trials])
            if not brief:
                best = max((best, *trials), key=lambda trial: trial.score)
        return max((best, *walker.trials([strategy.mean])), key=lambda trial: trial.score)


@dataclass(frozen=True, eq=False, slots=True)
class Trial:
    """A gait and how it did on a course.

    Attributes:
        gait: tried.
        heading: its direction on the model as it is [rad].
        score: mean of the least worth of all its walks and of their mean [m/s], see `worth`.
        least: that least worth [m/s].
    """

    gait: Gait
    heading: float
    score: float
    least: float


@dataclass(eq=False)
class _Walker:
    """A course with the robots settled and drawn; every gait meets the same ones, but its own pushes and noise."""

    course: Course
    drive: Drive = field(init=False)
    grounds: list[tuple[Model, Array, Draws]] = field(init=False)
    few: list[tuple[Model, Array, Draws]] = field(init=False)

    def __post_init__(self) -> None:
        course, model = self.course, self.course.model
        self.drive = drive_of(model)
        rng = np.random.default_rng(np.random.SeedSequence(course.seed, spawn_key=(STURDY, 1)))

        def drawn(robot: Model, *places: Randomisation, count: int = 1) -> Draws:
            return joined([draw(place, rng, count, robot.nu, robot.nbody - 1) for place in places])

        start = settle(model)
        ends = _ends(course.ranges)
        others = [(other, settle(other), drawn(other, EXACT)) for other in course.others]
        everything = (model, start, drawn(model, course.ranges, count=EPISODES))
        self.grounds = [(model, start, drawn(model, *ends)), everything, *others]
        self.few = [(model, start, drawn(model, *ends[:FEW])), *others]

    def trials(self, points: Sequence[Array], *, brief: bool = False) -> list[Trial]:
        """How the gaits that points stand for do, all at once; on a few of the robots only if `brief`."""
        gaits = [decode(self.drive, point) for point in points]
        walks: list[list[Behaviour | None]] = [[] for _ in gaits]
        for model, start, draws in self.few if brief else self.grounds:
            count = len(draws.encoder_offset)
            rng = np.random.default_rng(np.random.SeedSequence(self.course.seed, spawn_key=(STURDY, 2)))
            rollouts = roll_out_actor(
                model, _Chorus(gaits, count, action_map(model)), self.course.seconds, copies=count * len(gaits),
                draws=_repeated(draws, len(gaits)), rng=rng, start=start,
            )  # fmt: skip
            found = measure(model, rollouts)
            for k, own in enumerate(walks):
                own += found[k * count : (k + 1) * count]
        return [self._trial(gait, own) for gait, own in zip(gaits, walks, strict=True)]

    def _trial(self, gait: Gait, walks: Sequence[Behaviour | None]) -> Trial:
        heading = 0.0 if walks[0] is None else walks[0].heading
        speeds = np.array([worth(walk, heading, self.course.pace) for walk in walks])
        return Trial(gait, heading, float(speeds.mean() + speeds.min()) / 2, float(speeds.min()))


def worth(walk: Behaviour | None, heading: float, pace: float) -> float:
    """Speed of a walk along a heading [rad], less what it is beyond the pace, where it fell or would overheat [m/s]."""
    if walk is None:
        return 0.0
    along = walk.speed * float(np.cos(walk.heading - heading))
    along = min(along, max(2.0 * pace - along, 0.0)) / max(1.0, walk.overload)
    return along * FALLEN * walk.upright if walk.fell and along > 0.0 else along


def _ends(ranges: Randomisation) -> tuple[Randomisation, ...]:
    """The robot as it is, and the ends of ranges that gaits mind, friction first."""
    low = {name: (getattr(ranges, name)[0],) * 2 for name in ("friction", "contact_time", "stiffness", "damping")}
    high = {name: (getattr(ranges, name)[1],) * 2 for name in ("friction", "contact_time", "latency")}
    weak: dict[str, Any] = {name: low[name] for name in ("stiffness", "damping")}
    each: list[dict[str, Any]] = [{name: end[name]} for name in ("friction", "contact_time") for end in (low, high)]
    each.append({"latency": high["latency"]})
    return (EXACT, *(replace(EXACT, **change) for change in (*each, weak)))


def _repeated(draws: Draws, times: int) -> Draws:
    """The rows of some draws so many times over."""
    arrays: dict[str, Any] = {
        f.name: np.concatenate([value] * times)
        for f in fields(draws) if isinstance(value := getattr(draws, f.name), np.ndarray)
    }  # fmt: skip
    return replace(draws, **arrays)


class _Chorus:
    """Several gaits at once, each on so many copies, followed as the rhythm of a policy that says nothing."""

    def __init__(self, gaits: Sequence[Gait], count: int, actions: ActionMap) -> None:
        self.gaits, self.count, self.actions = gaits, count, actions
        self.layout = ObservationLayout(actions.num_joints)

    @property
    def num_joints(self) -> int:
        return self.actions.num_joints

    def act(self, time: float, observation: Array) -> Array:
        centres: ArrayLike = np.repeat([gait.targets(time) for gait in self.gaits], self.count, axis=0)
        return self.actions.targets(np.zeros(self.num_joints), observation[..., self.layout.action], centres)
