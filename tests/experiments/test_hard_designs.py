"""Every recipe for garbage makes what it says, and an end that may not be is told apart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from decoder.design import DesignError, VoxelDesign
from experiments import hard_designs
from experiments.hard_designs import Task, Try, main, table
from experiments.output import BAD_INPUT


def test_every_recipe_gives_designs_or_refusals() -> None:
    kept = 0
    for name, recipe in hard_designs._garbage().items():
        for seed in range(2):
            try:
                body = recipe(np.random.default_rng(seed))
            except DesignError:
                continue
            assert isinstance(body, VoxelDesign), name
            kept += 1
    assert kept >= 6  # garbage that no design can hold would test nothing of the solvers


def test_the_answer_depends_on_the_task_alone() -> None:
    judge, task = Try("paper"), Task("garbage", 2)
    assert judge(task) == judge(task)


def test_an_exception_is_an_end_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Try, task: Task) -> dict[str, object]:
        raise ZeroDivisionError("no")

    monkeypatch.setattr(hard_designs.Try, "__call__", broken)
    rows = list(hard_designs._tried([Task("random", 0)], "paper", 0))
    assert rows[0]["end"] == "lost"
    assert "ZeroDivisionError" in rows[0]["why"]


def test_it_goes_on_where_it_was_cut(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--random", "1", "--garbage", "1", "--workers", "1", "--solver", "paper", "--out", str(tmp_path)]
    assert main(arguments) == 0
    path = tmp_path / "hard_designs.jsonl"
    rows = path.read_text().splitlines()
    assert sorted(json.loads(row)["kind"] for row in rows) == ["garbage", "random"]
    path.write_text(rows[0] + "\n" + rows[1][:20])
    assert main(arguments) == 0
    again = [json.loads(row) for row in path.read_text().splitlines()]
    assert sorted(row["kind"] for row in again) == ["garbage", "random"]
    assert again[0] == json.loads(rows[0])  # with the seconds that it took the first time
    capsys.readouterr()
    assert main([*arguments[:-4], "--solver", "search", *arguments[-2:]]) == BAD_INPUT
    assert "--solver paper, now it is search; choose another --out" in capsys.readouterr().err


def test_the_table_counts_ends() -> None:
    row = {"kind": "random", "index": 0, "recipe": "prior", "end": "passed", "why": "", "seconds": 0.25}
    assert "| prior | 2 | 0 | 1 | 1 | 0 | 0 | 0.5 s |" in table([row, {**row, "end": "failed", "seconds": 0.5}])
