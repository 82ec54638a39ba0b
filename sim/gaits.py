"""Find an open-loop gait for a body: random gaits first, then a small CMA-ES from the best of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cma
import numpy as np
from numpy.typing import NDArray

from mfg.description import Description
from sim.actor import Gait
from sim.model import Drive, Model, drive_of, model_name
from sim.rollout import Behaviour, Diverged, as_model, measure, roll_out, settle
from sim.surfaces import body_length

Band = tuple[float, float]

FREQUENCY: Band = (0.4, 2.0)  # of a gait [Hz]
BRISK: Band = (2.0, 6.0)  # short, quick steps, by which bodies go that hardly walk otherwise [Hz]
BANDS = (FREQUENCY, BRISK)
MARGIN = 0.05  # share of a joint's range that is kept free at each end: slamming into a stop breaks prints
GREATEST_AMPLITUDE = 1.0  # [rad]
SPREAD = 0.15  # standard deviation of the first offsets about the pose at rest, as a share of the range
STEP = 0.2  # the first standard deviation of the CMA-ES, as a share of each parameter's range
FALL_FACTOR = 0.5  # what is left of the score of a gait that falls at the very end


@dataclass(frozen=True, slots=True)
class GaitBudget:
    """How much computing a search may spend; about 20 rollouts of 5 s take one CPU-second.

    Attributes:
        random: gaits of the first generation.
        random_seconds: length of their rollouts [s].
        generations: of the CMA-ES.
        population: gaits per generation.
        seconds: length of their rollouts [s].
        finalists: best gaits so far that are measured once more, for `final_seconds`.
        final_seconds: length of the last measurement, the one that is reported [s].
        hopeless: give up after the random gaits if none of them scores this [m/s].
    """

    random: int = 12
    random_seconds: float = 3.0
    generations: int = 13
    population: int = 8
    seconds: float = 4.0
    finalists: int = 3
    final_seconds: float = 10.0
    hopeless: float = 0.005

    def __post_init__(self) -> None:
        """Check the bounds."""
        for name, least in (("random", 1), ("generations", 0), ("population", 4), ("finalists", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"gait budget: {name} is {getattr(self, name)}; it must be {least} or more")
        for name in ("random_seconds", "seconds", "final_seconds"):
            if not 0.1 <= getattr(self, name) <= 1000.0:
                raise ValueError(f"gait budget: {name} is {getattr(self, name)} s; it must lie in [0.1, 1000] s")


SCREENING = GaitBudget()  # for every body of an evolution
THOROUGH = GaitBudget(random=16, generations=20, population=12, seconds=6.0)  # for the one that will be built


@dataclass(frozen=True, eq=False, slots=True)
class GaitResult:
    """The best gait of a search and how it does over the budget's `final_seconds`.

    Attributes:
        gait: the best one.
        behaviour: of that gait.
        score: of that gait [m/s], see `score`.
        rollouts: how many gaits were tried.
    """

    gait: Gait
    behaviour: Behaviour
    score: float
    rollouts: int

    @property
    def speed(self) -> float:
        """Along the best heading [m/s]."""
        return self.behaviour.speed

    @property
    def distance(self) -> float:
        """Net horizontal displacement over the last measurement [m]."""
        return self.behaviour.distance

    @property
    def heading(self) -> float:
        """Best direction of the body, from the x axis it stood in [rad]."""
        return self.behaviour.heading


@dataclass(frozen=True, eq=False, slots=True)
class _Trial:
    """One point of the search, its score and the behaviour behind it (None if the physics exploded)."""

    point: NDArray[np.float64]
    score: float
    behaviour: Behaviour | None


def search_gait(
    robot: Description | Model, rng: np.random.Generator, budget: GaitBudget = SCREENING, band: Band = FREQUENCY
) -> GaitResult:
    """Search the gait that moves a robot best; the same `rng` gives the same bytes.

    A gait is 3 n + 1 numbers: one frequency within `band` [Hz], and for each joint an amplitude, a phase and an offset
    within its range.

    Raises:
        Diverged: if the physics explodes under every gait.
    """
    race = _Race(as_model(robot), band)
    points = random_points(race.drive, budget.random, rng)
    trials = race.run(points, budget.random_seconds)
    best = max(trials, key=_by_score)
    if best.score >= budget.hopeless:
        trials += _evolve(race, best.point, STEP, rng, budget)
    return _final(race, trials, budget)


def refine(
    robot: Description | Model, gait: Gait, rng: np.random.Generator, budget: GaitBudget = THOROUGH
) -> GaitResult:
    """Go on from a known gait, on another model of the same robot for example; half of the random gaits restart.

    Raises:
        Diverged: if the physics explodes under every gait.
        ValueError: if the gait is for another number of joints.
    """
    race = _Race(as_model(robot), band_of(gait))
    if gait.num_joints != race.model.nu:
        name, n = model_name(race.model), race.model.nu
        raise ValueError(f"the gait drives {gait.num_joints} joints, robot {name} has {n}")
    known = encode(race.drive, gait, race.band)
    near = known + 0.5 * STEP * rng.standard_normal((budget.random // 2, known.size))
    points = np.concatenate([known[None], near, random_points(race.drive, budget.random // 2, rng)])
    trials = race.run(points, budget.seconds)
    best = max(trials, key=_by_score)
    trials += _evolve(race, best.point, 0.5 * STEP, rng, budget)
    # The known gait is always a finalist, so that the result is never worse than what was given.
    return _final(race, trials, budget, always=trials[:1])


def score(behaviour: Behaviour) -> float:
    """What the search maximises [m/s]: the mean of net speed and speed along the body's heading, if upright and cool.

    (distance / seconds + speed) / 2, divided by the overload where the motors' root mean square torque exceeds what
    they bear for long, and halved and multiplied by the share of time upright where the robot fell.
    """
    value = (behaviour.distance / behaviour.seconds + behaviour.speed) / 2
    value /= max(1.0, behaviour.overload)
    return value * FALL_FACTOR * behaviour.upright if behaviour.fell else value


def band_of(gait: Gait) -> Band:
    """The range of frequencies in which a search goes on from a gait [Hz]; what lies in both is slow."""
    return BRISK if gait.frequency > FREQUENCY[1] else FREQUENCY


def decode(drive: Drive, point: NDArray[np.float64], band: Band = FREQUENCY) -> Gait:
    """Read a gait from a point (3 n + 1,): frequency, amplitudes, phases, offsets, each folded into its range."""
    n = len(drive.names)
    unit = np.abs((point + 1.0) % 2.0 - 1.0)  # reflects at 0 and 1, so that the search has no walls
    low, high = _limits(drive)
    offset = low + unit[1 + 2 * n :] * (high - low)
    # Rounding may put an offset beyond its limit by one part in 1e16.
    room = np.clip(np.minimum(offset - low, high - offset), 0.0, GREATEST_AMPLITUDE)
    return Gait(
        frequency=band[0] * (band[1] / band[0]) ** float(unit[0]),
        amplitude=unit[1 : 1 + n] * room,
        phase=2 * np.pi * (point[1 + n : 1 + 2 * n] % 1.0),
        offset=offset,
    )


def encode(drive: Drive, gait: Gait, band: Band = FREQUENCY) -> NDArray[np.float64]:
    """The point that `decode` reads as this gait, or as the nearest one within the ranges."""
    low, high = _limits(drive)
    offset = np.clip(gait.offset, low, high)
    room = np.minimum(np.minimum(offset - low, high - offset), GREATEST_AMPLITUDE)
    ratio = np.clip(gait.frequency, *band) / band[0]
    return np.concatenate([
        [np.log(ratio) / np.log(band[1] / band[0])],
        np.clip(gait.amplitude / np.maximum(room, 1e-9), 0.0, 1.0),
        gait.phase / (2 * np.pi) % 1.0,
        (offset - low) / (high - low),
    ])  # fmt: skip


def random_points(drive: Drive, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Gaits about the pose at rest, (count, 3 n + 1)."""
    n = len(drive.names)
    low, high = _limits(drive)
    points = rng.random((count, 3 * n + 1))
    points[:, 1 : 1 + n] = 0.3 + 0.7 * points[:, 1 : 1 + n]
    points[:, 1 + 2 * n :] = np.clip(-low / (high - low) + SPREAD * rng.standard_normal((count, n)), 0.1, 0.9)
    return points


class _Race:
    """One robot, settled once, on which many points are tried."""

    def __init__(self, model: Model, band: Band) -> None:
        self.model, self.band = model, band
        self.drive = drive_of(model)
        self.start = settle(model)
        self.length = body_length(model)
        self.rollouts = 0

    def run(self, points: NDArray[np.float64] | Sequence[NDArray[np.float64]], seconds: float) -> list[_Trial]:
        """Try every point for `seconds`."""
        gaits = [decode(self.drive, point, self.band) for point in points]
        behaviours = measure(self.model, roll_out(self.model, gaits, seconds, self.start), self.length)
        self.rollouts += len(gaits)
        return [
            _Trial(np.asarray(point), -np.inf if behaviour is None else score(behaviour), behaviour)
            for point, behaviour in zip(points, behaviours, strict=True)
        ]


def strategy_about(
    start: NDArray[np.float64], step: float, population: int, rng: np.random.Generator
) -> cma.CMAEvolutionStrategy:
    """A CMA-ES over points, with ask and tell."""
    # The library would seed numpy's global generator; it gets ours instead.
    options = {
        "popsize": population, "randn": lambda *shape: rng.standard_normal(shape), "seed": np.nan,
        "verbose": -9, "verb_log": 0,
    }  # fmt: skip
    return cma.CMAEvolutionStrategy(start, step, options)


def _evolve(
    race: _Race, start: NDArray[np.float64], step: float, rng: np.random.Generator, budget: GaitBudget
) -> list[_Trial]:
    """A few generations of CMA-ES."""
    if budget.generations == 0:
        return []
    strategy = strategy_about(start, step, budget.population, rng)
    found: list[_Trial] = []
    for _ in range(budget.generations):
        points = strategy.ask()
        trials = race.run(points, budget.seconds)
        alive = [-trial.score for trial in trials if trial.behaviour is not None]
        # An explosion ranks behind every gait of its generation; only the order matters to the strategy.
        worst = max(alive, default=0.0) + 1.0
        strategy.tell(points, [-trial.score if trial.behaviour is not None else worst for trial in trials])
        found += trials
    return [*found, *race.run([strategy.mean], budget.seconds)]


def _final(race: _Race, trials: list[_Trial], budget: GaitBudget, always: Sequence[_Trial] = ()) -> GaitResult:
    """Measure the best trials for longer and take the best of those."""
    ranked = sorted(trials, key=_by_score, reverse=True)  # stable: of equals, the first tried
    finalists = [trial.point for trial in [*ranked[: budget.finalists], *always]]
    best = max(race.run(finalists, budget.final_seconds), key=_by_score)
    if best.behaviour is None:
        raise Diverged(f"robot {model_name(race.model)} explodes under each of {race.rollouts} gaits")
    return GaitResult(decode(race.drive, best.point, race.band), best.behaviour, best.score, race.rollouts)


def _by_score(trial: _Trial) -> float:
    return trial.score


def _limits(drive: Drive) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest target of each joint: its range without the margins."""
    low, high = drive.range.T
    spare = MARGIN * (high - low)
    return low + spare, high - spare
