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
from sim.gaits import BRISK, FREQUENCY, Band, band_of, decode, encode, strategy_about
from sim.model import Model, drive_of
from sim.observation import ActionMap, ObservationLayout
from sim.randomisation import EXACT, WIDE, Draws, Randomisation, at_end, draw, joined
from sim.rollout import Behaviour, measure, settle
from sim.surfaces import body_length

Array = NDArray[np.float64]
Walks = list[Behaviour | None]  # None where the physics exploded
Robots = tuple[Model, Array, Draws]  # a model, its settled state, and one row for each robot that is drawn of it

STURDY = 5  # purpose of randomness beside those of `sim.training`, `sim.race` and the commands that train
SPREAD = 0.15  # the first standard deviation of the CMA-ES, as a share of each parameter's range
HEAT = 1 / 6  # share of the generations after which only one search about slow gaits goes on
BRIEF = 0.4  # share of the generations that are tried in brief
FINALISTS, LEFT = 4, 2  # the best of as many generations walk once more; and how many of those are left
DRAWN = 4  # walks of a gait with everything drawn, the same robots on every model, and with pushes ...
PUSH_EVERY = 2.0  # ... about so often, since walks are short [s]
FEW = 3  # walks on the model that every gait makes: as it is, and at both ends of friction
BEHIND = 1e-6  # what tells a gait that was tried on a few robots from the last that was tried on all [m/s]
FALLEN = 0.5  # what is left of the speed of a walk that falls at the very end


@dataclass(frozen=True, eq=False, slots=True)
class Course:
    """Robots that a gait is tried on; it can be sent to another process.

    Attributes:
        model: of the robot, made by `sim.herd.with_latency_room`.
        others: the same robot modelled otherwise, on each of which gaits walk as it is, at both ends of its stiffness,
            and with everything drawn.
        pace: how fast it is to be [m/s].
        generations: of the CMA-ES. In the first two fifths gaits walk on a few of the robots only, then the better half
            of each generation on all.
        ranges: what the robots may differ in.
        seed: of all that is drawn.
        seconds: of each walk.
        population: gaits of each.
    """

    model: Model
    others: tuple[Model, ...]
    pace: float
    generations: int
    ranges: Randomisation = WIDE
    seed: int = 0
    seconds: float = 4.0
    population: int = 10

    def __call__(self, gaits: Sequence[Gait]) -> tuple[Trial, ...]:
        """The best two of a search about one of some gaits, which is itself among the finalists; the best comes first.

        All gaits are of one band of frequencies. Of slow ones, about each a search begins, and only the one that has
        come farthest after a sixth of the generations goes on; of quick ones, the best on all robots is searched about.
        Finalists walk for twice as long, on other robots than those of the search and under other pushes.

        Raises:
            ValueError: if gaits are of different bands.
        """
        band, *more = {band_of(gait) for gait in gaits}
        if more:
            raise ValueError(f"a course takes gaits of one band of frequencies, these are of {1 + len(more)}")
        walker, final = _Walker(self, 0, band), _Walker(replace(self, seconds=2 * self.seconds), 1, band)
        searches = [_Search(walker, gait, self) for gait in gaits]
        # A heat on few robots misjudges quick gaits (docs/learning.md).
        best = _best_given(searches) if band == BRISK else _best_of_heat(searches)
        while best.done < self.generations:
            best.advance()
        tried = final.trials(best.finalists())
        return tuple(sorted(tried, key=lambda trial: -trial.score)[:LEFT])


@dataclass(frozen=True, eq=False, slots=True)
class Trial:
    """A gait and how it did on a course.

    Attributes:
        gait: tried.
        heading: its direction on the model as it is [rad].
        score: mean of the worth of all its walks, see `worth`, and of the least [m/s]; no more than minus the pace
            where the physics of the model itself exploded.
        least: of the worths of walks without pushes, and of the mean of those with them, where falls are chance [m/s].
    """

    gait: Gait
    heading: float
    score: float
    least: float


class _Search:
    """A CMA-ES about a gait."""

    def __init__(self, walker: _Walker, gait: Gait, course: Course) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(course.seed, spawn_key=(STURDY, 0)))
        self.walker, self.given = walker, encode(walker.drive, gait, walker.band)
        self.strategy = strategy_about(self.given, SPREAD, course.population, rng)
        self.generations, self.done = course.generations, 0
        self.top = -np.inf  # best score of the last generation [m/s]
        self._found: list[tuple[float, Array]] = []

    def advance(self) -> None:
        """One generation, on a few robots or on all; the best of the latter may become finalists."""
        brief = self.done < BRIEF * self.generations
        points = self.strategy.ask()
        trials = self.walker.brief(points) if brief else self.walker.halved(points)
        self.strategy.tell(points, [-trial.score for trial in trials])
        self.done += 1
        top = max(range(len(trials)), key=lambda k: trials[k].score)
        self.top = trials[top].score
        if not brief:
            self._found.append((self.top, points[top]))

    def finalists(self) -> list[Array]:
        """What was given, the best of the best generations, and what the search believes in."""
        best = sorted(self._found, key=lambda pair: -pair[0])[:FINALISTS]
        return [self.given, *(point for _, point in best), self.strategy.mean]


def _best_of_heat(searches: Sequence[_Search]) -> _Search:
    """The one that has come farthest after the first generations."""
    for search in searches:
        for _ in range(min(search.generations, max(1, round(HEAT * search.generations)))):
            search.advance()
    return max(searches, key=lambda search: search.top)


def _best_given(searches: Sequence[_Search]) -> _Search:
    """The one about the gait that does best on all robots; each is tried alone, so that all meet the same pushes."""
    return max(searches, key=lambda search: search.walker.trials([search.given])[0].score)


class _Walker:
    """A course with the robots settled and drawn; every gait meets the same ones, but its own pushes and noise."""

    def __init__(self, course: Course, number: int, band: Band = FREQUENCY) -> None:
        """Draw the robots of the course for gaits of a band of frequencies [Hz]; another number draws others."""
        model = course.model
        self.course, self._number, self.band = course, number, band
        self.drive, self._length = drive_of(model), body_length(model)
        start, ends = settle(model), _ends(course.ranges)
        others = [(other, settle(other)) for other in course.others]
        skins = [at_end(course.ranges, end, "skin") for end in (0, 1)]
        kinds = [(model, start), *others]
        pushed = [replace(course.ranges, push_every=PUSH_EVERY)] * max(1, DRAWN // len(kinds))
        self._few = [(model, start, self._drawn(model, *ends[:FEW]))]
        self._few += [(*other, self._drawn(other[0], EXACT)) for other in others]
        self._pushed = [(*kind, self._drawn(kind[0], *pushed)) for kind in kinds]
        self._rest = [(model, start, self._drawn(model, *ends[FEW:]))]
        self._rest += [(*other, self._drawn(other[0], *skins)) for other in others]

    def _rng(self, purpose: int) -> np.random.Generator:
        key = (STURDY, 1 + self._number, purpose)
        return np.random.default_rng(np.random.SeedSequence(self.course.seed, spawn_key=key))

    def _drawn(self, robot: Model, *places: Randomisation) -> Draws:
        rng = self._rng(0)
        return joined([draw(place, rng, 1, robot.nu, robot.nbody - 1) for place in places])

    def trials(self, points: Sequence[Array]) -> list[Trial]:
        """How the gaits that points stand for do on all robots."""
        return self._tried(points, self._walked(points, [*self._few, *self._rest]), self._walked(points, self._pushed))

    def brief(self, points: Sequence[Array]) -> list[Trial]:
        """The same on a few of the robots."""
        return self._tried(points, self._walked(points, self._few))

    def halved(self, points: Sequence[Array]) -> list[Trial]:
        """The same on all robots for the half that does better on a few; the others come behind, as those few say."""
        few = self._walked(points, self._few)
        brief = self._tried(points, few)
        order = sorted(range(len(points)), key=lambda k: -brief[k].score)
        half = (len(order) + 1) // 2
        better, worse = order[:half], order[half:]
        chosen = [points[k] for k in better]
        rest = self._walked(chosen, self._rest)
        walks = [few[k] + more for k, more in zip(better, rest, strict=True)]
        found = self._tried(chosen, walks, self._walked(chosen, self._pushed))
        last = min(trial.score for trial in found) - brief[better[-1]].score
        trials = dict(zip(better, found, strict=True))
        trials |= {k: replace(brief[k], score=last + brief[k].score - BEHIND) for k in worse}
        return [trials[k] for k in range(len(points))]

    def _tried(
        self, points: Sequence[Array], walks: Sequence[Walks], pushed: Sequence[Walks] | None = None
    ) -> list[Trial]:  # fmt: skip
        gaits = [decode(self.drive, point, self.band) for point in points]
        pushed = [[] for _ in gaits] if pushed is None else pushed
        return [trial_of(*each, self.course.pace) for each in zip(gaits, walks, pushed, strict=True)]

    def _walked(self, points: Sequence[Array], robots: Sequence[Robots]) -> list[Walks]:
        """All walks of every gait, all gaits at once."""
        gaits = [decode(self.drive, point, self.band) for point in points]
        walks: list[Walks] = [[] for _ in gaits]
        for model, start, draws in robots:
            count = len(draws.encoder_offset)
            rollouts = roll_out_actor(
                model, _Chorus(gaits, count, action_map(model)), self.course.seconds, copies=count * len(gaits),
                draws=joined([draws] * len(gaits)), rng=self._rng(1), start=start,
            )  # fmt: skip
            found = measure(model, rollouts, self._length)
            for k, own in enumerate(walks):
                own += found[k * count : (k + 1) * count]
        return walks


def trial_of(gait: Gait, walks: Walks, pushed: Walks, pace: float) -> Trial:
    """What walks say of a gait, the first of them on the model as it is, and others with pushes."""
    if walks[0] is None:
        return Trial(gait, 0.0, -pace, -pace)
    heading = walks[0].heading
    calm, drawn = ([worth(walk, heading, pace) for walk in each] for each in (walks, pushed))
    least = min([*calm, float(np.mean(drawn))] if drawn else calm)
    return Trial(gait, heading, float(np.mean([*calm, *drawn]) + least) / 2, least)


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
