"""The pipeline: the fast path's verdict and scores are those of the full path, and the same design gives the same."""

from __future__ import annotations

import numpy as np
import pytest

from decoder.design import VoxelDesign
from decoder.latent import make_decoder, sample_latents
from mfg.outcome import Failure
from mfg.pipeline import BODIES, BUILDING, DEFAULT, RULES, SCORING, Rules, build, score, scoring


@pytest.fixture(scope="module")
def designs() -> list[VoxelDesign]:
    return make_decoder("genome").decode(sample_latents(8, np.random.default_rng(77)))


@pytest.mark.parametrize("rules", RULES)
def test_score_and_build_agree(designs: list[VoxelDesign], rules: Rules) -> None:
    passed = 0
    for design in designs:
        fast, full = score(design, rules=rules), build(design, rules=rules)
        assert fast.ok == full.ok, (fast.failure, full.failure)
        if not fast.ok:
            assert fast.failure == full.failure
            continue
        passed += 1
        for quick, exact in zip(fast.scores.values(), full.scores.values(), strict=True):
            assert quick is not None
            assert exact is not None
            assert 0.0 <= exact <= 1.0
            assert quick == pytest.approx(exact, abs=0.05)
    assert passed >= 3


def test_scoring_twice_gives_the_same(designs: list[VoxelDesign]) -> None:
    first, second = score(designs[1]), score(designs[1])
    assert first.scores == second.scores
    assert first.failure == second.failure


def test_a_failed_design_keeps_what_it_scored(designs: list[VoxelDesign]) -> None:
    for design in designs:
        outcome = score(design)
        ran = list(outcome.seconds)
        assert len(ran) == len(scoring(DEFAULT)) if outcome.ok else len(ran) <= len(scoring(DEFAULT))
        document = outcome.to_json()
        assert document["design"] == design.key
        assert document["ok"] is outcome.ok
        assert (document["failure"] is None) is outcome.ok
        if isinstance(outcome.failure, Failure) and outcome.failure.stage == "electronics":
            assert document["scores"]["motor"] is not None
            assert document["scores"]["cable"] is None
        assert document["scores"]["total"] == pytest.approx(outcome.scores.total)


def test_building_is_scoring_and_then_solids() -> None:
    assert BUILDING[: len(SCORING)] == SCORING == scoring("paper")
    assert len(BUILDING) == len(SCORING) + 1
    for rules, solvers in RULES.items():
        assert solvers[:-1] == scoring(rules)
        assert solvers[: len(BODIES)] == BODIES


def test_who_names_no_rules_gets_the_search(designs: list[VoxelDesign]) -> None:
    assert DEFAULT == "search"
    refused = {rules: [score(design, rules=rules).failure for design in designs] for rules in RULES}
    assert refused["paper"] != refused["search"]
    assert [score(design).failure for design in designs] == refused["search"]
    built = next(build(design) for design in designs if score(design).ok)
    assert built.blueprint.lids or any("lid" in note for note in built.blueprint.notes)  # the paper's rules know none
