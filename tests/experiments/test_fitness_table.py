"""The tables of the fitness study, on bodies made up so that the answer is known."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.fitness_combination import combinations
from experiments.fitness_rungs import BASELINE, gold, interval, rank
from experiments.fitness_table import ladder, transfer, write_tables
from experiments.output import BadInput


def body(k: int, rng: np.random.Generator, **changes: Any) -> dict[str, Any]:
    """A body whose long training reaches k / 100 m/s: the races know it, the gaits are noise."""
    gait = {"speed": float(rng.random()), "upright": 1.0}
    point = {"steps": 1000, "cpu": 2.0, "exploring": k / 200, "speed": k / 150, "robust": 0.0, "falls": 0}
    row = {
        "design": f"d{k}", "joints": 3, "mass_kg": 5.0, "body_length_m": 0.5, "random": [gait], "cpu_random": 1.0,
        "screening": {"score": float(rng.random()), "speed": 0.1}, "cpu_screening": 2.0,
        "thorough": {"score": float(rng.random()), "speed": 0.1}, "cpu_thorough": 3.0,
        "race": [k / 300, k / 250], "cpu_race": 4.0,
        "training": [point, point | {"steps": 2000, "speed": k / 100, "robust": k / 110}], "cpu_training": 5.0,
        "virtual": {"speed": k / 100, "upright": 1.0}, "twin": {"speed": k / 200, "upright": 1.0},
        "twin_ranges_differ": False, "twin_mass_kg": 5.5, "twin_hull_shift_m": 0.0,
    }  # fmt: skip
    return row | changes


@pytest.fixture(autouse=True)
def few_halves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.fitness_combination.HALVES", 60)


@pytest.fixture
def rows() -> list[dict[str, Any]]:
    rng = np.random.default_rng(0)
    return [body(k, rng) for k in range(10, 50)]


def test_a_fitness_that_knows_ranks_perfectly_and_noise_does_not(rows: list[dict[str, Any]]) -> None:
    table = {entry["rung"]: entry for entry in ladder(rows)}
    best = table["short PPO: best of 2"]
    assert best["rank"] == pytest.approx(1.0)
    assert (best["low"], best["high"]) == pytest.approx((1.0, 1.0))
    assert best["rank_robust"] == pytest.approx(1.0)
    noise = table["random gaits: greatest"]
    assert noise["low"] < 0 < noise["high"]
    assert abs(noise["rank"]) < 0.4
    assert table["PPO at 50 %: randomised"]["rank"] == 0.0  # it says the same of every body


def test_a_rung_costs_all_that_it_needs(rows: list[dict[str, Any]]) -> None:
    table = {entry["rung"]: entry["cpu_s"] for entry in ladder(rows)}
    assert table["random gaits: median"] == 1.0
    assert table["short PPO: corrected gait"] == 5.0  # a gait of 3 s and one race of two
    assert table["short PPO: best of 2"] == 7.0
    assert table["PPO at 50 %: exploring"] == 9.0
    assert table["PPO at 50 %: randomised"] == 9.5  # one evaluation of the two that took 1 s
    assert table["PPO at 100 %: randomised"] == 11.5


def test_the_gold_is_the_best_of_the_long_training(rows: list[dict[str, Any]]) -> None:
    assert gold(rows[0]) == pytest.approx(0.1)
    assert math.isnan(gold({"training": []}))


def test_ranks_are_spearmans() -> None:
    x = np.arange(10.0)
    assert rank(np.exp(x), x) == pytest.approx(1.0)
    assert rank(-x, x) == pytest.approx(-1.0)
    assert interval(x, x) == pytest.approx((1.0, 1.0))
    # By hand: ranks 1.5, 1.5, 3, 4 against 1 to 4 have the correlation 4.5 / sqrt(4.5 * 5).
    assert rank(np.array([0.0, 0.0, 1.0, 2.0]), np.arange(4.0)) == pytest.approx(math.sqrt(0.9))
    assert rank(np.zeros(5), np.arange(5.0)) == 0.0


def test_a_number_that_is_not_known_leaves_the_body_out(rows: list[dict[str, Any]]) -> None:
    x = np.array([0.0, np.nan, 2.0, 3.0])
    assert rank(x, np.array([0.0, 9.0, 1.0, 2.0])) == pytest.approx(1.0)
    assert math.isnan(rank(x, np.array([0.0, 1.0, np.nan, 2.0])))  # two bodies are left
    assert all(math.isnan(bound) for bound in interval(x[:2], x[:2]))
    rows[0]["race"] = [None, math.nan]
    del rows[1]["race"], rows[1]["cpu_race"]
    rows[2]["training"] = None
    found = {entry["rung"]: entry for entry in ladder(rows)}["short PPO: corrected gait"]
    assert (found["bodies"], found["rank"]) == (37, pytest.approx(1.0))


def test_a_rung_that_no_body_has_is_no_line(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    for row in rows:
        for name in ("race", "screening", "twin", "twin_ranges_differ", "twin_mass_kg", "twin_hull_shift_m"):
            del row[name]
    assert not [entry for entry in ladder(rows) if "short PPO" in entry["rung"] or "screening" in entry["rung"]]
    (tmp_path / "bodies.jsonl").write_text("\n".join(map(json.dumps, rows)), encoding="utf-8")
    assert "0 bodies, speed on the twin" in write_tables(tmp_path)


def test_a_choice_among_noise_looks_good_only_where_it_was_made(rows: list[dict[str, Any]]) -> None:
    one, two, three = combinations(rows)
    assert one["candidates"] < two["candidates"] < three["candidates"]
    assert three["selected_on"] > 0.3
    assert abs(three["tested_on"]) < 0.25
    assert combinations(rows)[0] == one
    assert combinations(rows[:7]) == []


def test_a_combination_that_is_better_is_found(rows: list[dict[str, Any]]) -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 20, len(rows))
    for row, off in zip(rows, noise, strict=True):  # two numbers, each half of the truth
        k = 100 * gold(row)
        row["screening"]["score"], row["thorough"]["score"] = k + off, k - off
    alone, found, _ = combinations(rows)
    assert alone["tested_on"] < found["tested_on"]
    assert found["tested_on"] > 0.9
    assert found["gain"] > 0.2
    assert {"open-loop gait, screening: score", BASELINE} <= set(found["chosen_on_all"].split(" + "))
    assert found["cpu_s"] >= 5.0


def test_transfer_tells_the_ratio_and_what_differs(rows: list[dict[str, Any]]) -> None:
    rng = np.random.default_rng(1)
    fallen = {"speed": 0.01, "upright": 0.2, "seconds": 10.0}
    rows[3] = body(13, rng, twin=fallen, twin_ranges_differ=True, twin_hull_shift_m=0.002)
    rows[4] = body(14, rng, twin=None)
    rows[5] = body(15, rng, virtual={"speed": 0.001, "upright": 1.0})
    found = transfer(rows)
    assert (found["bodies"], found["stand_still"], found["lost"]) == (38, 1, 1)
    assert found["quantiles"][3] == pytest.approx(0.5)
    assert found["worst"][0]["design"] == "d13"
    told = ["falls on the twin after 2.0 s", "other joint ranges", "mass x 1.10", "length differs by 2 mm"]
    assert found["worst"][0]["causes"] == told
    falls = found["groups"][0]
    assert (falls["with"], falls["without"]) == (1, 37)


def test_the_files_are_written_and_too_few_bodies_refused(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    lines = [json.dumps(row) for row in rows]
    (tmp_path / "bodies.jsonl").write_text("\n".join(lines) + '\n{"design": "cut o', encoding="utf-8")
    text = write_tables(tmp_path)
    assert text.startswith("40 bodies")
    assert (tmp_path / "ladder.md").read_text("utf-8") == text + "\n"
    assert json.loads((tmp_path / "ladder.json").read_text("utf-8"))["bodies"] == 40
    for name in ("ladder.png", "transfer.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    (tmp_path / "bodies.jsonl").write_text("\n".join(lines[:3]) + "\n", encoding="utf-8")
    assert "too few bodies to choose" in write_tables(tmp_path)
    (tmp_path / "bodies.jsonl").write_text("\n".join(lines[:2]) + "\n", encoding="utf-8")
    with pytest.raises(BadInput, match="2 bodies are measured"):
        write_tables(tmp_path)
    (tmp_path / "bodies.jsonl").write_text(f"{lines[0]}\n{{damaged\n{lines[1]}\n", encoding="utf-8")
    with pytest.raises(BadInput, match="damaged line"):
        write_tables(tmp_path)
