from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.passthrough import ORDER, OUTCOMES, PASSED, Paired, paired, pass_through, wilson
from mfg.outcome import Stage

outcomes = st.lists(st.sampled_from(OUTCOMES), max_size=200)


@given(outcomes)
def test_counts_add_up_and_name_every_class(given_outcomes):
    table = pass_through(given_outcomes)
    assert set(table.counts) == {"skeleton", "motor", "electronics", "wire", "print", "worker", "passed"}
    assert sum(table.counts.values()) == table.n == len(given_outcomes)
    assert all(isinstance(count, int) and count >= 0 for count in table.counts.values())


@given(outcomes)
def test_every_stage_is_counted_over_those_that_reached_it(given_outcomes):
    table = pass_through(given_outcomes)
    rows = table.rows()
    assert [row.stage for row in rows] == list(ORDER)
    for k, row in enumerate(rows):
        later = {PASSED, *ORDER[k:]}
        assert row.reached == sum(outcome in later for outcome in given_outcomes)
        assert row.failed == given_outcomes.count(row.stage)


@given(outcomes.filter(lambda found: PASSED in found))
def test_remaining_ratios_multiply_to_the_pass_rate(given_outcomes):
    table = pass_through(given_outcomes)
    assert math.isclose(math.prod(row.remaining for row in table.rows()), table.rate)


@given(outcomes, st.randoms())
def test_order_does_not_matter(given_outcomes, random):
    shuffled = list(given_outcomes)
    random.shuffle(shuffled)
    assert pass_through(shuffled) == pass_through(given_outcomes)


def test_the_papers_table_comes_out():
    failed = {"skeleton": 349, "motor": 1038, "electronics": 1908, "wire": 9}
    found = [stage for stage, number in failed.items() for _ in range(number)] + [PASSED] * 6696
    table = pass_through(found)
    remaining = {row.stage: row.remaining for row in table.rows()}
    assert remaining["motor"] == pytest.approx(0.8924, abs=1e-4)
    assert remaining["electronics"] == pytest.approx(0.7785, abs=1e-4)
    assert remaining["wire"] == pytest.approx(0.9987, abs=1e-4)
    assert table.rate == pytest.approx(0.6696)


def test_none_reached_is_no_ratio():
    rows = {row.stage: row for row in pass_through([str(Stage.SKELETON)] * 3).rows()}
    assert rows["skeleton"].remaining == 0.0
    assert rows["motor"].remaining is None
    assert pass_through([]).rate is None


def test_an_unknown_outcome_is_refused():
    with pytest.raises(ValueError, match=r"outcome is 'bogus'.*skeleton"):
        pass_through(["passed", "bogus"])


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [  # from Newcombe (1998), table I, method 3, and by hand for the extremes
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (29, 29, 1 / (1 + 3.841458820694124 / 29), 1.0),
    ],
)
def test_wilson_against_published_values(successes, n, low, high):
    assert wilson(successes, n) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(0, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_holds_the_proportion_and_mirrors(pair):
    k, n = pair
    low, high = wilson(k, n)
    assert 0.0 <= low <= high <= 1.0
    if n:
        assert low <= k / n <= high
    mirrored = wilson(n - k, n)
    assert (1 - mirrored[1], 1 - mirrored[0]) == pytest.approx((low, high), abs=1e-12)


def test_wilson_refuses_what_is_no_proportion():
    with pytest.raises(ValueError, match=r"\[0, 3\]"):
        wilson(4, 3)


@pytest.mark.parametrize(
    ("table", "low", "high"),
    [  # Newcombe (1998), "Improved confidence intervals ... based on paired data", table II, method 10, and by hand
        (Paired(both=36, second=12, first=2, neither=0), 0.0569, 0.3404),
        (Paired(both=54, second=0, first=0, neither=0), -0.0664, 0.0664),
    ],
)
def test_paired_difference_against_published_values(table, low, high):
    assert table.interval == pytest.approx((low, high), abs=5e-5)


tables = st.lists(st.integers(0, 60), min_size=4, max_size=4).map(lambda c: Paired(*c))


@given(tables)
def test_paired_difference_lies_in_its_interval_and_mirrors(table):
    low, high = table.interval
    assert -1.0 <= low <= high <= 1.0
    swapped = Paired(table.both, table.second, table.first, table.neither)
    assert (-swapped.interval[1], -swapped.interval[0]) == pytest.approx((low, high), abs=1e-12)
    assert swapped.p_value == table.p_value
    if table.n:
        assert low <= table.difference <= high
        successes = table.second + table.both, table.first + table.both
        assert table.difference == pytest.approx((successes[0] - successes[1]) / table.n)


def test_the_interval_covers_the_difference_as_often_as_it_says():
    """Every table of 12 pairs, weighted by its probability under some laws; discreteness leaves it short of 95 %."""
    n = 12
    for law in ((0.3, 0.05, 0.35, 0.3), (0.25, 0.25, 0.25, 0.25), (0.6, 0.1, 0.2, 0.1), (0.1, 0.02, 0.4, 0.48)):
        truth, covered, total = law[2] - law[1], 0.0, 0.0
        for a in range(n + 1):
            for b in range(n + 1 - a):
                for c in range(n + 1 - a - b):
                    counts = (a, b, c, n - a - b - c)
                    ways = math.factorial(n) // math.prod(map(math.factorial, counts))
                    weight = ways * math.prod(p**k for p, k in zip(law, counts, strict=True))
                    low, high = Paired(*counts).interval
                    total += weight
                    covered += weight * (low <= truth <= high)
        assert total == pytest.approx(1.0)
        assert 0.93 <= covered <= 0.995, law


@given(st.integers(0, 7), st.integers(0, 7))
def test_mcnemar_is_a_count_of_coin_tosses(first, second):
    tosses = first + second
    extreme = min(first, second)
    heads = [bin(outcome).count("1") for outcome in range(2**tosses)]
    brute = sum(h <= extreme or h >= tosses - extreme for h in heads) / 2**tosses
    assert Paired(3, first, second, 4).p_value == pytest.approx(brute)


def test_pairs_are_counted_from_outcomes():
    first = ["passed", "motor", "passed", "wire", "motor"]
    second = ["passed", "passed", "print", "wire", "passed"]
    assert paired(first, second) == Paired(both=1, first=1, second=2, neither=1)
    with pytest.raises(ValueError, match="shorter than argument 1"):
        paired(first, second[:-1])
    assert paired([], []).interval == (-1.0, 1.0)
    assert paired([], []).difference is None
    assert paired([], []).p_value == 1.0
