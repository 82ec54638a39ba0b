"""The search stays within the joints, is reproducible, and makes a quadruped walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mfg.description import Description
from sim.actor import Gait
from sim.gaits import (
    BANDS,
    GREATEST_AMPLITUDE,
    Band,
    GaitBudget,
    GaitResult,
    band_of,
    decode,
    encode,
    random_points,
    refine,
    score,
    search_gait,
)
from sim.model import Drive, compile_model
from sim.rollout import Behaviour, Diverged, simulate

TINY = GaitBudget(
    random=8, random_seconds=1.0, generations=2, population=4, seconds=1.0, finalists=2, final_seconds=2.0
)
SMALL = GaitBudget(random=16, random_seconds=2.0, generations=3, population=8, seconds=3.0)
DRIVE = Drive(("a", "b"), np.array([7, 8]), np.array([6, 7]), np.array([[-0.3, 1.2], [-0.8, 0.1]]), np.ones(2))
BEHAVIOUR = Behaviour(10.0, 2.0, 0.25, 0.0, 0.5, False, 1.0, 1.0, 5.0, 0.5, 1.0)


def same(one: GaitResult, two: GaitResult) -> bool:
    pair = (one.gait, two.gait)
    arrays = [[g.amplitude.tobytes(), g.phase.tobytes(), g.offset.tobytes(), g.frequency] for g in pair]
    return arrays[0] == arrays[1] and one.score == two.score and one.distance == two.distance


@given(st.lists(st.floats(-5, 5), min_size=7, max_size=7), st.sampled_from(BANDS))
def test_every_point_is_a_gait_within_the_ranges(numbers: list[float], band: Band) -> None:
    gait = decode(DRIVE, np.array(numbers), band)
    low, high = DRIVE.range.T
    assert band[0] - 1e-9 <= gait.frequency <= band[1] + 1e-9
    assert (gait.amplitude >= 0).all()
    assert (gait.amplitude <= GREATEST_AMPLITUDE).all()
    assert (gait.offset - gait.amplitude > low).all()
    assert (gait.offset + gait.amplitude < high).all()


@given(st.lists(st.floats(0.01, 0.99), min_size=7, max_size=7), st.sampled_from(BANDS))
def test_encoding_is_the_inverse_of_decoding(numbers: list[float], band: Band) -> None:
    gait = decode(DRIVE, np.array(numbers), band)
    assert band_of(gait) == band
    again = decode(DRIVE, encode(DRIVE, gait, band), band)
    for field in ("frequency", "amplitude", "phase", "offset"):
        assert_allclose(getattr(again, field), getattr(gait, field), atol=1e-6)


def test_random_gaits_are_about_the_pose_at_rest() -> None:
    points = random_points(DRIVE, 400, np.random.default_rng(0))
    offsets = np.array([decode(DRIVE, point).offset for point in points])
    assert (np.abs(np.median(offsets, axis=0)) < 0.05).all()


def test_a_score_is_a_speed_unless_the_robot_falls_or_overheats() -> None:
    assert score(BEHAVIOUR) == pytest.approx((0.2 + 0.25) / 2)
    assert score(replace(BEHAVIOUR, overload=2.0)) == pytest.approx(score(BEHAVIOUR) / 2)
    late, early = (replace(BEHAVIOUR, fell=True, upright=share) for share in (0.9, 0.1))
    assert score(early) < score(late) < score(BEHAVIOUR) / 2


@pytest.mark.parametrize("bad", [{"random": 0}, {"population": 3}, {"seconds": 0.0}, {"final_seconds": 1e9}])
def test_a_budget_out_of_bounds_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"gait budget: {next(iter(bad))}"):
        replace(TINY, **bad)  # type: ignore[arg-type]


def test_the_same_seed_gives_the_same_bytes_and_leaves_the_global_generator_alone(quadruped: Description) -> None:
    before = np.random.get_state()[1].tobytes()  # type: ignore[index, union-attr]  # noqa: NPY002
    one = search_gait(quadruped, np.random.default_rng(3), TINY)
    two = search_gait(compile_model(quadruped), np.random.default_rng(3), TINY)
    other = search_gait(quadruped, np.random.default_rng(4), TINY)
    assert same(one, two)
    assert not same(one, other)
    assert np.random.get_state()[1].tobytes() == before  # type: ignore[index, union-attr]  # noqa: NPY002


def test_a_small_search_makes_a_quadruped_walk_a_body_length_in_ten_seconds(quadruped: Description) -> None:
    found = search_gait(quadruped, np.random.default_rng(0), SMALL)
    assert found.behaviour.seconds == pytest.approx(10.0)
    assert found.distance > found.behaviour.body_length
    assert not found.behaviour.fell
    # What is reported is what anyone measures who plays the gait again.
    assert simulate(quadruped, found.gait, 10.0).distance == found.distance


def test_refining_never_ends_below_where_it_began(quadruped: Description) -> None:
    known = search_gait(quadruped, np.random.default_rng(0), TINY)
    heavier = replace(quadruped, links=(replace(quadruped.links[0], mass=3.5), *quadruped.links[1:]))
    before = score(simulate(heavier, known.gait, TINY.final_seconds))
    refined = refine(heavier, known.gait, np.random.default_rng(1), TINY)
    assert refined.score >= before - 1e-3  # the gait is stored once more as a point, to rounding


def test_a_hopeless_body_costs_only_the_random_gaits(quadruped: Description) -> None:
    stiff = replace(quadruped, joints=tuple(replace(j, range=np.array([-0.001, 0.001])) for j in quadruped.joints))
    found = search_gait(stiff, np.random.default_rng(0), TINY)
    assert found.rollouts == TINY.random + TINY.finalists
    assert found.distance < 0.02


def test_a_robot_that_explodes_under_every_gait_is_an_error(
    quadruped: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.rollout.SPEED_BOUND", 1e-3)
    with pytest.raises(Diverged, match="quadruped explodes under each of"):
        search_gait(quadruped, np.random.default_rng(0), TINY)


def test_a_gait_of_another_robot_cannot_be_refined(quadruped: Description) -> None:
    with pytest.raises(ValueError, match="the gait drives 2 joints, robot quadruped has 4"):
        refine(quadruped, Gait(1.0, np.zeros(2), np.zeros(2), np.zeros(2)), np.random.default_rng(0), TINY)
