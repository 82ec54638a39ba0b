from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from decoder.latent import sample_latents
from evo import evaluate as module
from evo import sizing
from evo.evaluate import Evaluate, EvaluateTwin, Learning
from evo.evaluation import Candidate, Evaluation
from evo.fitness import FitnessRule
from evo.judge import Judge
from evo.pool import Pool
from evo.record import gait_to_json
from mfg import pipeline
from mfg.library import read_library
from mfg.outcome import Reason, Stage
from sim.gaits import GaitBudget
from sim.rollout import Diverged

BUDGET = GaitBudget(
    random=4, random_seconds=1.0, generations=1, population=4, seconds=1.0, finalists=1, final_seconds=2.0, hopeless=0.0
)
EVALUATE = Evaluate(7, "genome", budget=BUDGET)
TWIN = EvaluateTwin(7, "genome", budget=BUDGET)


def same(one: Evaluation, two: Evaluation) -> bool:
    """Equal but for wall time."""
    return _facts(one) == _facts(two)


def _facts(evaluation: Evaluation) -> tuple[object, ...]:
    walk = evaluation.walk
    moved = None if walk is None else (gait_to_json(walk.gait), *(getattr(walk, n) for n in walk.__slots__[1:]))
    return evaluation.design, evaluation.scores, evaluation.failure, evaluation.fitness, moved, evaluation.rank_key


@pytest.fixture(scope="module")
def candidates() -> list[Candidate]:
    latents = sample_latents(24, np.random.default_rng(3))
    return [Candidate(0, index, latent) for index, latent in enumerate(latents)]


@pytest.fixture(scope="module")
def evaluations(candidates: list[Candidate]) -> list[Evaluation]:
    """The first candidates, up to one that cannot be built and two that can."""
    found: list[Evaluation] = []
    for candidate in candidates:
        found.append(EVALUATE(candidate))
        passed = sum(e.passed for e in found)
        if passed >= 2 and passed < len(found):
            return found
    raise AssertionError("of 24 random bodies, two should pass and one should fail")


def test_only_what_can_be_built_is_simulated(evaluations: list[Evaluation]) -> None:
    for evaluation in evaluations:
        assert (evaluation.walk is not None) == evaluation.passed == (evaluation.fitness is not None)
        assert ("gait" in evaluation.stages) == evaluation.passed
        assert evaluation.design == module.decode("genome", evaluation.candidate).key


def test_verdict_and_scores_are_the_pipeline_s(evaluations: list[Evaluation]) -> None:
    for evaluation in evaluations:
        outcome = pipeline.score(module.decode("genome", evaluation.candidate))
        assert evaluation.failure == outcome.failure
        assert evaluation.scores == outcome.scores


def test_a_body_that_earns_it_is_judged_by_what_a_policy_learns(evaluations: list[Evaluation]) -> None:
    passed = max((e for e in evaluations if e.walk), key=lambda e: e.walk.task if e.walk else 0.0)
    assert passed.walk is not None
    learning = Learning(steps=6144, starts=2, least=passed.walk.task)
    found = replace(EVALUATE, learning=learning)(passed.candidate)
    assert found.walk is not None
    assert found.walk.task != passed.walk.task
    assert found.fitness == FitnessRule().fitness(found.walk.task, found.scores)
    assert (found.walk.speed, found.walk.heading) == (passed.walk.speed, passed.walk.heading)  # those of the gait
    assert same(found, replace(EVALUATE, learning=learning)(passed.candidate))
    unearned = replace(EVALUATE, learning=replace(learning, least=1.001 * passed.walk.task))(passed.candidate)
    assert same(unearned, passed)
    assert "learning" in found.stages


def test_the_fitness_is_the_rule_s(evaluations: list[Evaluation]) -> None:
    passed = next(e for e in evaluations if e.passed)
    assert passed.walk is not None
    assert passed.fitness == FitnessRule().fitness(passed.walk.task, passed.scores)
    speed = Evaluate(7, "genome", rule=FitnessRule("speed"), budget=BUDGET)(passed.candidate)
    assert speed.fitness == passed.walk.task


def test_an_answer_depends_on_the_candidate_alone(evaluations: list[Evaluation]) -> None:
    """Asked again, in other company and in another process, it is the same to the last bit."""
    again = [e.candidate for e in reversed(evaluations)]
    with Pool[Candidate, Evaluation](EVALUATE, 1, 120.0) as pool:
        results = {c.index: result for c, result, _ in pool.run(again)}
    for evaluation in evaluations:
        result = results[evaluation.candidate.index]
        assert isinstance(result, Evaluation)
        assert same(result, evaluation)


def test_another_seed_or_another_place_is_another_search(evaluations: list[Evaluation]) -> None:
    passed = next(e for e in evaluations if e.passed)
    moved = Candidate(1, passed.candidate.index, passed.candidate.latent)
    searches = [passed, EVALUATE(moved), Evaluate(8, "genome", budget=BUDGET)(passed.candidate)]
    assert len({gait_to_json(e.walk.gait) for e in searches if e.walk is not None}) == 3
    assert len({e.design for e in searches}) == 1


def test_the_twin_is_built_and_never_worse_than_its_start(evaluations: list[Evaluation]) -> None:
    passed = next(e for e in evaluations if e.passed)
    twin = TWIN(passed)
    assert twin.passed
    assert twin.design == passed.design
    assert "finish" in twin.stages
    assert "finish" not in passed.stages
    assert twin.walk is not None
    assert passed.walk is not None
    assert twin.walk.mass == pytest.approx(passed.walk.mass, rel=0.06)
    assert same(twin, TWIN(passed))


def test_what_was_never_simulated_has_no_twin(evaluations: list[Evaluation]) -> None:
    failed = next(e for e in evaluations if not e.passed)
    with pytest.raises(ValueError, match="has no gait to refine"):
        TWIN(failed)


def test_exploding_physics_is_a_lost_measurement(
    evaluations: list[Evaluation], monkeypatch: pytest.MonkeyPatch
) -> None:
    def explode(*_: object) -> None:
        raise Diverged("robot x explodes")

    monkeypatch.setattr(module, "search_gait", explode)
    monkeypatch.setattr(module, "refine", explode)
    passed = next(e for e in evaluations if e.passed)
    for lost in (EVALUATE(passed.candidate), TWIN(passed)):
        assert lost.failure is not None
        assert (lost.failure.stage, lost.failure.reason) == (Stage.WORKER, Reason.CRASHED)
        assert lost.fitness is None
        assert lost.scores == passed.scores or lost.scores.total > 0
        assert lost.design == passed.design


def test_parts_are_sized_to_every_candidate(monkeypatch: pytest.MonkeyPatch, evaluations: list[Evaluation]) -> None:
    passed = next(e for e in evaluations if e.passed)
    monkeypatch.setattr(sizing, "sized", functools.partial(sizing.sized, budget=BUDGET))
    judge = Judge(library=read_library(), drivers="only")
    one, two = (replace(EVALUATE, judge=judge)(passed.candidate) for _ in range(2))
    assert same(one, two)
    assert one.walk is not None and passed.walk is not None  # noqa: PT018
    assert one.design == passed.design
    assert "sizing" in one.stages
    assert one.walk.mass < passed.walk.mass  # the paper's battery is larger than this body's gait asks for
    twin = replace(TWIN, judge=judge)(one)
    assert twin.walk is not None
    assert twin.walk.mass == pytest.approx(one.walk.mass, rel=0.06)  # the walls about hardware are weighed in the twin
