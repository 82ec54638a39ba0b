from __future__ import annotations

import argparse
import json

import pytest

from experiments.fidelity_study import LEVELS, REFERENCE, Walks, markdown, spearman, summary
from experiments.simulate import FIDELITIES
from sim.skin import Fidelity

SPEEDS: list[float | None] = [0.1, 0.2, 0.3, 0.4, 0.5]


def walks(level: str, speeds: list[float | None], again: list[float | None] | None = None) -> Walks:
    return Walks(level, speeds, speeds if again is None else again, 1000.0, 4.0, 10, 5.0)


def test_the_command_line_offers_every_fidelity() -> None:
    assert tuple(Fidelity) == FIDELITIES
    assert set(FIDELITIES) == set(LEVELS) - {"constant"}


def test_ranks_leave_out_what_exploded() -> None:
    assert spearman(SPEEDS, [1.0, 2.0, None, 3.0, 4.0]) == pytest.approx(1.0)
    assert spearman(SPEEDS, SPEEDS[::-1]) == pytest.approx(-1.0)
    assert spearman([1.0, 2.0], [1.0, 2.0]) == 0.0


def test_every_level_is_held_against_the_reference_and_the_reference_against_its_second_run() -> None:
    swapped: list[float | None] = [0.2, 0.1, 0.3, 0.4, 0.5]
    body = [walks(level, SPEEDS[::-1] if level == "sprung" else SPEEDS) for level in LEVELS[:-1]]
    rows = {row["level"]: row for row in summary([[*body, walks(REFERENCE, SPEEDS, swapped)]] * 3)}
    assert rows["flex"]["rank"][0] == pytest.approx(1.0)
    assert rows["sprung"]["rank"][0] == pytest.approx(-1.0)
    assert rows[REFERENCE]["rank"][0] == rows[REFERENCE]["rank_with_itself"][0] == pytest.approx(0.9)
    assert rows["flex"]["error_mm_s"] == pytest.approx(0.0)
    assert rows["flex"]["speed_ratio"] == pytest.approx(1.0)


def test_explosions_are_counted() -> None:
    broken: list[float | None] = [None, *SPEEDS[1:]]
    body = [walks(level, broken if level == "flex" else SPEEDS) for level in LEVELS]
    rows = {row["level"]: row for row in summary([body] * 3)}
    assert (rows["flex"]["exploded"], rows["hull"]["exploded"]) == (6, 0)
    json.dumps(list(rows.values()), allow_nan=False)


def test_the_table_has_a_line_per_level() -> None:
    table = markdown(summary([[walks(level, SPEEDS) for level in LEVELS]] * 2),
                     argparse.Namespace(n=2, gaits=5, seconds=3.0))  # fmt: skip
    assert all(f"| {level} |" in table for level in LEVELS)
