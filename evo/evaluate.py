"""Measure one candidate: decode, score, and, if it can be built, find a gait; and the same again on the built twin."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from decoder.design import VoxelDesign
from decoder.latent import DEFAULT_DECODER, Decoder, make_decoder
from evo.evaluation import Candidate, Evaluation, Walk
from evo.fitness import DEFAULT_RULE, FitnessRule
from evo.judge import DEFAULT_JUDGE, Judge
from mfg.description import Description, describe
from mfg.outcome import Failure, Reason, Stage
from mfg.pipeline import Outcome
from sim.gaits import SCREENING, THOROUGH, GaitBudget, GaitResult, refine, search_gait
from sim.rollout import Diverged

SCREEN, FINAL = 1, 2  # purposes of a candidate's randomness; 0 is the optimiser's


@dataclass(frozen=True, slots=True)
class Learning:
    """The next rung of the race: short trainings of a policy, in place of the gait's score.

    It ranks bodies better than a gait does, for more than ten times the time (docs/learning.md has the figures).

    Attributes:
        steps: control periods of each training.
        starts: how many compete: the gait corrected, and free ones along headings.
        least: a body whose gait scores less does not earn it, and keeps the gait's score [m/s].
    """

    steps: int = 60_000
    starts: int = 4
    least: float = 0.02

    def speed(self, description: Description, found: GaitResult, rng: np.random.Generator) -> float:
        """The task fitness [m/s]: what the best start of the race reaches while it still explores, or the gait's."""
        if found.score < self.least:
            return found.score
        from sim.herd import with_latency_room
        from sim.model import make_spec
        from sim.plan import Training
        from sim.race import speed, starts

        model = with_latency_room(make_spec(description))
        training = Training(int(rng.integers(2**31)), self.steps, self.steps)
        candidates = starts(found.gait, found.heading, self.starts)
        return max(speed(model, training, self.steps, start) for start in candidates)


@dataclass(frozen=True, slots=True)
class Evaluate:
    """Measure a candidate cheaply; a race: only a design that passes every solver is simulated.

    The answer depends on these fields and the candidate alone, so not on who works out what, where or when.

    Attributes:
        seed: of the run.
        decoder: for `decoder.latent.make_decoder`.
        rule: how speed and manufacturability make the fitness.
        budget: of the gait search.
        judge: says whether a body can be built, by which rules and with which parts.
        learning: that follows the gait, or None.
    """

    seed: int
    decoder: str = DEFAULT_DECODER
    rule: FitnessRule = DEFAULT_RULE
    budget: GaitBudget = SCREENING
    judge: Judge = DEFAULT_JUDGE
    learning: Learning | None = None

    def __call__(self, candidate: Candidate) -> Evaluation:
        """Decode, score without exact solids, and search a gait from nothing."""
        stages: dict[str, float] = {}
        with _timed(stages, "decode"):
            design = decode(self.decoder, candidate)
        outcome = self.judge.score(design)
        stages |= outcome.seconds
        if not outcome.ok:
            return Evaluation(candidate, design.key, outcome.scores, outcome.failure, stages=stages)
        with _timed(stages, "describe"):
            description = describe(outcome.blueprint)
        rng = np.random.default_rng(candidate.seed(self.seed, SCREEN))
        with _timed(stages, "gait"):
            try:
                found = search_gait(description, rng, self.budget)
            except Diverged as error:
                return _diverged(candidate, outcome, error, stages)
        return _judged(candidate, outcome, description, found, self, rng, stages)


@dataclass(frozen=True, slots=True)
class EvaluateTwin:
    """Measure a candidate that was evaluated before, built in full, with its own gait as the start.

    Attributes:
        seed: of the run.
        decoder: for `decoder.latent.make_decoder`.
        rule: how speed and manufacturability make the fitness.
        budget: of the gait search; its last measurement decides whether the body walks.
        judge: says whether a body can be built, by which rules and with which parts.
        learning: that follows the gait, or None.
    """

    seed: int
    decoder: str = DEFAULT_DECODER
    rule: FitnessRule = DEFAULT_RULE
    budget: GaitBudget = THOROUGH
    judge: Judge = DEFAULT_JUDGE
    learning: Learning | None = None

    def __call__(self, screened: Evaluation) -> Evaluation:
        """Decode, build exact solids, and refine the gait on the twin.

        Raises:
            ValueError: if the candidate was never simulated.
        """
        candidate = screened.candidate
        if screened.walk is None:
            raise ValueError(f"candidate {candidate.index} of generation {candidate.generation} has no gait to refine")
        stages: dict[str, float] = {}
        with _timed(stages, "decode"):
            design = decode(self.decoder, candidate)
        outcome = self.judge.build(design)
        stages |= outcome.seconds
        if not outcome.ok:
            return Evaluation(candidate, design.key, outcome.scores, outcome.failure, stages=stages)
        with _timed(stages, "describe"):
            twin = describe(outcome.blueprint)
        rng = np.random.default_rng(candidate.seed(self.seed, FINAL))
        with _timed(stages, "gait"):
            try:
                found = refine(twin, screened.walk.gait, rng, self.budget)
            except Diverged as error:
                return _diverged(candidate, outcome, error, stages)
        return _judged(candidate, outcome, twin, found, self, rng, stages)


def decode(decoder: str, candidate: Candidate) -> VoxelDesign:
    """The candidate's design."""
    return _decoder(decoder).decode(candidate.latent[None])[0]


@functools.cache
def _decoder(name: str) -> Decoder:
    """Each process makes a decoder once."""
    return make_decoder(name)


def _judged(
    candidate: Candidate, outcome: Outcome, description: Description, found: GaitResult,
    by: Evaluate | EvaluateTwin, rng: np.random.Generator, stages: dict[str, float],
) -> Evaluation:  # fmt: skip
    behaviour, task = found.behaviour, found.score
    if by.learning is not None:
        with _timed(stages, "learning"):
            task = by.learning.speed(description, found, rng)
    walk = Walk(
        found.gait, task, behaviour.speed, behaviour.heading, behaviour.distance, behaviour.seconds,
        behaviour.body_length, description.mass,
    )  # fmt: skip
    fitness = by.rule.fitness(walk.task, outcome.scores)
    return Evaluation(candidate, outcome.design.key, outcome.scores, None, walk, fitness, stages)


def _diverged(candidate: Candidate, outcome: Outcome, error: Diverged, stages: Mapping[str, float]) -> Evaluation:
    """Physics that explodes says nothing about the body, so it is a lost measurement and not a slow robot."""
    failure = Failure(Stage.WORKER, Reason.CRASHED, str(error))
    return Evaluation(candidate, outcome.design.key, outcome.scores, failure, stages=stages)


@contextmanager
def _timed(stages: dict[str, float], name: str) -> Iterator[None]:
    start = time.perf_counter()
    try:
        yield
    finally:
        stages[name] = time.perf_counter() - start
