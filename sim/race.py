"""A race of starts: all train for a little, or are judged as they are, and the training goes on from the winner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sim.actor import Gait
from sim.learning import Learner, Unlearnable
from sim.model import Model
from sim.plan import Training
from sim.tasks import SCALE
from sim.training import Start, environment_of, first_rate, first_spread
from sim.verdict import Stood, Verdict, evaluate, stood

Array = NDArray[np.float64]

RACE = 2  # purpose of randomness, beside those of `sim.training`
PARTS = 3  # of a heat; the last one counts


def starts(gait: Gait, heading: float, count: int) -> tuple[Start, ...]:
    """Candidates that an open-loop gait suggests: first the gait itself, corrected; then freely along headings.

    The free ones are spread evenly from the heading of the gait [rad], and begin in its posture.
    """
    free = headings(heading, max(count - 1, 0))
    return (Start(heading, gait.offset, gait), *(Start(angle, gait.offset) for angle in free))[:count]


def headings(first: float, count: int) -> tuple[float, ...]:
    """Directions of the body spread evenly from a first one, which stays as it is [rad], all within (-pi, pi]."""
    others = first + 2 * np.pi * np.arange(1, count) / max(count, 1)
    return (first, *(float(-((np.pi - angle) % (2 * np.pi) - np.pi)) for angle in others))[:count]


@dataclass(frozen=True, eq=False, slots=True)
class Runner:
    """A start and what came of it so far in a race; it can be sent to another process.

    Attributes:
        start: what it began with.
        exploring: mean speed along the heading while exploring, in the last third of its heat [m/s].
        verdict: of its policy after the heat, or of its gait without one; None where it was not asked for.
        learned: state of the learner, to go on with; empty before and without a heat, and where learning diverged.
        diverged: there is nothing to go on from.
    """

    start: Start
    exploring: float = 0.0
    verdict: Verdict | None = None
    learned: Mapping[str, Array] = field(default_factory=dict)
    diverged: bool = False

    @property
    def merit(self) -> float:
        """What decides who goes on [m/s]: the mean of the exploring speed and of the verdict's score, if there is one.

        The score alone would end free starts early: their policies stand still without exploration until the steps
        that exploration finds have been learned. The exploring speed alone would count no fall. A gait as it is does
        not explore, so its score counts alone. What is left in a corner is left out: it says nothing yet about free
        starts, which only begin to walk.
        """
        if self.diverged:
            return -np.inf
        if self.verdict is None:
            return self.exploring
        score = replace(self.verdict, kept=None).score
        return (self.exploring + score) / 2 if self.learned else score


@dataclass(frozen=True, eq=False, slots=True)
class Heat:
    """A short training of one runner, to compare it with others; it can be sent to another process.

    Attributes:
        model: of the robot.
        training: of the whole, of which a heat runs a little.
        steps: control periods.
        judged: whether the policy is evaluated after it.
    """

    model: Model
    training: Training
    steps: int
    judged: bool = True

    def __call__(self, runner: Runner) -> Runner:
        """The runner after the heat; one that could not learn stands still."""
        training, third = self.training, max(1, self.steps // PARTS)
        learner = Learner(environment_of(self.model, training, runner.start), training.ppo, training.seed)
        rate, spread = first_rate(training, runner.start), first_spread(training, runner.start)
        curves: Mapping[str, float] = {}
        for index in range(PARTS):
            rng = np.random.default_rng(np.random.SeedSequence(training.seed, spawn_key=(RACE, index)))
            try:
                curves, _ = learner.learn(third, rng, rate, spread)
            except Unlearnable:
                return Runner(runner.start, diverged=True)
        verdict = evaluate(stood(self.model), learner.exported(), training, cornered=False) if self.judged else None
        return Runner(runner.start, curves["speed"] / SCALE / 2.0, verdict, learner.state())


@dataclass(frozen=True, eq=False, slots=True)
class AsItIs:
    """The verdict of a gait without a heat: of a policy about it that says nothing; can be sent to another process.

    Attributes:
        robot: as it is modelled.
        checks: as it is modelled otherwise, to see what is kept there.
        training: of the whole.
    """

    robot: Stood
    checks: tuple[Stood, ...]
    training: Training

    def __call__(self, start: Start) -> Runner:
        """The gait as a runner."""
        environment = environment_of(self.robot.model, self.training, start)
        actor = Learner(environment, self.training.ppo, self.training.seed).exported().silenced()
        return Runner(start, verdict=evaluate(self.robot, actor, self.training, checks=self.checks))


def speed(model: Model, training: Training, steps: int, start: Start) -> float:
    """What a start reaches while exploring, at the end of a single heat of so many control periods [m/s]."""
    return Heat(model, training, steps, judged=False)(Runner(start)).exploring


def winner(runners: Sequence[Runner]) -> Runner:
    """The best; of equals, the first."""
    return max(runners, key=lambda runner: runner.merit)
