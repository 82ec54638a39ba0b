"""The tables of the fitness study, on bodies made up so that the answer is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.fitness_table import gold, interval, ladder, rank, transfer, write_tables
from experiments.output import BadInput


def body(k: int, rng: np.random.Generator, **changes: Any) -> dict[str, Any]:
    """A body whose long training reaches k / 100 m/s: the races know it, the gaits are noise."""
    gait = {"speed": float(rng.random()), "upright": 1.0}
    point = {"steps": 1000, "cpu": 2.0, "exploring": k / 200, "speed": k / 150, "robust": 0.0, "falls": 0}
    row = {
        "design": f"d{k}", "joints": 3, "mass_kg": 5.0, "random": [gait], "cpu_random": 1.0,
        "screening": {"score": float(rng.random())}, "cpu_screening": 2.0,
        "thorough": {"score": float(rng.random())}, "cpu_thorough": 3.0,
        "race": [k / 300, k / 250], "cpu_race": 4.0,
        "training": [point, point | {"steps": 2000, "speed": k / 100}],
        "virtual": {"speed": k / 100, "upright": 1.0}, "twin": {"speed": k / 200, "upright": 1.0},
        "twin_ranges_differ": False, "twin_mass_kg": 5.5,
    }  # fmt: skip
    return row | changes


@pytest.fixture
def rows() -> list[dict[str, Any]]:
    rng = np.random.default_rng(0)
    return [body(k, rng) for k in range(10, 50)]


def test_a_fitness_that_knows_ranks_perfectly_and_noise_does_not(rows: list[dict[str, Any]]) -> None:
    table = {entry["rung"]: entry for entry in ladder(rows)}
    best = table["short PPO: best of 4 starts"]
    assert best["rank"] == pytest.approx(1.0)
    assert best["low"] == pytest.approx(1.0)
    assert best["cpu_s"] == 4.0
    noise = table["random gaits: best"]
    assert noise["low"] < 0 < noise["high"]
    assert table["PPO 1 k: exploring"]["cpu_s"] == 6.0
    assert table["PPO 1 k: randomised"]["rank"] == 0.0  # it says the same of every body


def test_the_gold_is_the_best_of_the_long_training(rows: list[dict[str, Any]]) -> None:
    assert gold(rows[0]) == pytest.approx(0.1)


def test_ranks_are_spearmans() -> None:
    x = np.arange(10.0)
    assert rank(np.exp(x), x) == pytest.approx(1.0)
    assert rank(-x, x) == pytest.approx(-1.0)
    low, high = interval(x, x)
    assert (low, high) == pytest.approx((1.0, 1.0))


def test_transfer_tells_the_ratio_and_what_differs(rows: list[dict[str, Any]]) -> None:
    rows[3] = body(13, np.random.default_rng(1), twin={"speed": 0.01, "upright": 0.2}, twin_ranges_differ=True)
    rows[4] = body(14, np.random.default_rng(1), twin=None)
    found = transfer(rows)
    assert found["bodies"] == 39
    assert found["quantiles"][3] == pytest.approx(0.5)
    assert found["worst"][0]["design"] == "d13"
    assert found["worst"][0]["causes"] == ["it falls on the twin", "other joint ranges", "mass x 1.10"]


def test_the_files_are_written_and_too_few_bodies_refused(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    lines = [json.dumps(row) for row in rows]
    (tmp_path / "bodies.jsonl").write_text("\n".join(lines) + '\n{"design": "cut o', encoding="utf-8")
    text = write_tables(tmp_path)
    assert text.startswith("40 bodies")
    assert json.loads((tmp_path / "ladder.json").read_text("utf-8"))["bodies"] == 40
    (tmp_path / "bodies.jsonl").write_text("\n".join(lines[:2]), encoding="utf-8")
    with pytest.raises(BadInput, match="2 bodies are measured"):
        write_tables(tmp_path)
