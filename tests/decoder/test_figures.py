"""Figures hold their value within their interval; goals and the choice between two sets of weights."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from decoder.figures import Bound, Figure, better, mean_of, merit, quantile_of, ratio_of, share_of

SEED = 1


@pytest.mark.parametrize(("k", "n"), [(0, 10), (3, 10), (10, 10), (851, 1000), (1, 1)])
def test_a_share_has_its_wilson_interval(k: int, n: int) -> None:
    figure = share_of([True] * k + [False] * (n - k))
    expected = binomtest(k, n).proportion_ci(method="wilson")
    assert (figure.value, figure.n) == (k / n, n)
    assert (figure.low, figure.high) == pytest.approx((expected.low, expected.high))


@settings(max_examples=25)
@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=4), min_size=1, max_size=12))
def test_an_interval_is_ordered_and_within_the_observations(groups: list[list[float]]) -> None:
    arrays = [np.array(group) for group in groups]
    everything = np.concatenate(arrays)
    for figure in (mean_of(arrays, SEED), quantile_of(arrays, 0.5, SEED), quantile_of(arrays, 0.95, SEED)):
        assert everything.min() - 1e-9 <= figure.low <= figure.high <= everything.max() + 1e-9
        assert figure.n == len(everything)
    assert mean_of(arrays, SEED).value == pytest.approx(everything.mean())
    for q in (0.05, 0.5, 0.95):
        assert quantile_of(arrays, q, SEED).value == np.quantile(everything, q, method="inverted_cdf")


def test_the_interval_of_a_mean_is_about_two_standard_errors() -> None:
    values = np.random.default_rng(0).standard_normal(400)
    figure = mean_of([np.array([v]) for v in values], SEED)
    assert figure.high - figure.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.1)


def test_observations_of_one_body_are_drawn_together() -> None:
    values = np.random.default_rng(0).standard_normal(100)
    alone = mean_of([np.array([v]) for v in values], SEED)
    repeated = mean_of([np.full(9, v) for v in values], SEED)  # Nine copies know no more than one.
    assert repeated.n == 900
    assert (repeated.low, repeated.high) == pytest.approx((alone.low, alone.high))


def test_the_same_seed_gives_the_same_interval() -> None:
    groups = [np.array([v]) for v in np.random.default_rng(0).standard_normal(50)]
    assert mean_of(groups, SEED) == mean_of(groups, SEED)
    assert mean_of(groups, SEED) != mean_of(groups, SEED + 1)


def test_a_ratio_pools_its_parts() -> None:
    figure = ratio_of([1, 3, 0], [2, 4, 0], SEED)
    assert (figure.value, figure.n) == (pytest.approx(4 / 6), 6)
    assert 0.5 <= figure.low <= figure.high <= 0.75


def test_nothing_is_no_number() -> None:
    for figure in (share_of([]), mean_of([], SEED), quantile_of([np.zeros(0)], 0.5, SEED), ratio_of([0], [0], SEED)):
        assert isinstance(figure, Figure)
        assert figure.n == 0
        assert math.isnan(figure.value)


IOU = Bound("body IoU", 0.9, "at least", 0.45, 500)
ANGLE = Bound("axis error", 10.0, "at most", 20.0, 900, "°")
SECONDS = Bound("seconds", 0.3, "at most", 0.6, 32, "s", weighed=False)


@pytest.mark.parametrize(
    ("bound", "value", "reached", "ratio"),
    [
        (IOU, 0.9, True, 1.0), (IOU, 0.45, False, 0.5), (IOU, 1.0, True, 1 / 0.9), (IOU, math.nan, False, 0.0),
        (ANGLE, 10.0, True, 1.0), (ANGLE, 20.0, False, 0.5), (ANGLE, 0.0, True, 2.0), (ANGLE, math.nan, False, 0.0),
        (ANGLE, 1.0, True, 2.0), (IOU, -1.0, False, 0.0),
    ],
)  # fmt: skip
def test_a_goal_is_reached_at_its_value(bound: Bound, value: float, reached: bool, ratio: float) -> None:
    measured = replace(bound, value=value)
    assert measured.reached is reached
    assert measured.ratio == pytest.approx(ratio)


def test_better_weighs_shortfalls_first() -> None:
    old = [IOU, ANGLE, SECONDS]  # half of either goal
    assert merit(old) == (1.0, 1.0)
    assert not better(old, old)
    assert better([replace(IOU, value=0.5), ANGLE, SECONDS], old)
    assert better([IOU, replace(ANGLE, value=19.0), SECONDS], old)
    assert not better([replace(IOU, value=0.44), ANGLE, SECONDS], old)
    # Beyond its goal a figure cannot pay for another that falls behind.
    ahead = [replace(IOU, value=0.9), replace(ANGLE, value=12.0)]
    assert not better([replace(IOU, value=1.0), replace(ANGLE, value=13.0)], ahead)
    # With all goals reached, the margin decides.
    done = [replace(IOU, value=0.91), replace(ANGLE, value=9.0)]
    assert better([replace(IOU, value=0.92), replace(ANGLE, value=9.0)], done)


def test_the_machine_does_not_choose_weights() -> None:
    assert not better([IOU, ANGLE, replace(SECONDS, value=0.1)], [IOU, ANGLE, SECONDS])
    assert not better([IOU, ANGLE], [IOU, ANGLE, SECONDS])


def test_what_was_not_measured_is_worse_than_anything() -> None:
    assert better([IOU, ANGLE], [IOU, replace(ANGLE, value=math.nan)])
    assert not better([IOU, replace(ANGLE, value=math.nan)], [IOU, ANGLE])


def test_different_goals_are_refused() -> None:
    with pytest.raises(ValueError, match=r"different goals \(axis error\); measure both alike"):
        better([IOU], [IOU, ANGLE])
