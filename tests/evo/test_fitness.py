from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evo.fitness import FitnessRule, rank_key
from mfg.outcome import Failure, Reason, Scores, Stage

FULL = Scores(1.0, 1.0, 1.0, 1.0, 1.0)
HALF = Scores(0.5, 0.5, 0.5, 0.5, 0.5)
speeds = st.floats(0, 3, allow_nan=False)
shares = st.floats(0, 1)


def failed(stage: Stage) -> Failure:
    return Failure(stage, Reason.NO_ROOM, "planted")


def test_the_penalty_is_the_weight_at_no_manufacturability_and_nothing_at_full() -> None:
    rule = FitnessRule("penalty", weight=0.3)
    assert rule.fitness(0.5, FULL) == 0.5
    assert rule.fitness(0.5, HALF) == pytest.approx(0.35)
    assert rule.fitness(0.5, Scores()) == pytest.approx(0.2)


def test_the_constraint_gives_no_fitness_below_the_bound() -> None:
    rule = FitnessRule("constraint", bound=2.5)
    assert rule.fitness(0.5, HALF) == 0.5
    assert rule.fitness(0.5, Scores(0.4, 0.5, 0.5, 0.5, 0.5)) is None


@given(speeds, shares)
def test_speed_alone_ignores_the_scores(speed: float, share: float) -> None:
    assert FitnessRule("speed").fitness(speed, Scores(share)) == speed


@given(speeds, speeds, shares, shares)
def test_the_penalty_never_rewards_a_slower_or_a_worse_body(v: float, dv: float, s: float, ds: float) -> None:
    rule = FitnessRule("penalty")
    better = rule.fitness(v + dv, Scores(max(s, ds)))
    worse = rule.fitness(v, Scores(min(s, ds)))
    assert better is not None
    assert worse is not None
    assert better >= worse


def test_the_order_of_everything_that_can_happen() -> None:
    """Best first; every neighbour differs in the one thing that must decide."""
    ladder = [
        rank_key(0.4, None, HALF),
        rank_key(-5.0, None, FULL),  # a built design beats any other, however slow.
        rank_key(None, None, FULL),
        rank_key(None, None, HALF),  # breaks the constraint by more.
        rank_key(None, failed(Stage.PRINT), HALF),
        rank_key(None, failed(Stage.WIRE), FULL),
        rank_key(None, failed(Stage.ELECTRONICS), Scores(0.9)),
        rank_key(None, failed(Stage.ELECTRONICS), Scores(0.2)),
        rank_key(None, failed(Stage.MOTOR), Scores()),
        rank_key(None, failed(Stage.SKELETON), Scores()),
        rank_key(None, failed(Stage.WORKER), FULL),
    ]
    assert all(better < worse for better, worse in itertools.pairwise(ladder))


def test_every_stage_has_a_place() -> None:
    keys = [rank_key(None, failed(stage), Scores()) for stage in Stage]
    assert len(set(keys)) == len(Stage)


def test_a_failure_never_has_a_fitness() -> None:
    with pytest.raises(ValueError, match="a failure has none"):
        rank_key(0.0, failed(Stage.MOTOR), Scores())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_fitness_is_finite(value: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        rank_key(value, None, FULL)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"mode": "magic"}, "'magic'"),
        ({"weight": -0.1}, "-0.1"),
        ({"weight": float("inf")}, "inf"),
        ({"bound": 5.1}, "5.1"),
        ({"bound": float("nan")}, "nan"),
    ],
)
def test_arguments_are_checked(options: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        FitnessRule(**options)  # type: ignore[arg-type]
