"""The study of the time step: what it compares, and that the same seed walks the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decoder.design import VoxelDesign
from experiments import step_study
from experiments.step_study import PAIRS, RESULT, TABLE, main, markdown, walks
from mfg.pipeline import score

FOUR = [0.1, 0.2, 0.3, 0.4]


@pytest.fixture
def one_body(hinge: VoxelDesign, monkeypatch: pytest.MonkeyPatch) -> None:
    blueprint = score(hinge).blueprint
    monkeypatch.setattr(step_study, "body_of", lambda *_: blueprint)


def test_every_row_compares_what_it_says() -> None:
    body: dict[str, Any] = {name: FOUR for pair in PAIRS.values() for name in pair} | {"half": FOUR[::-1]}
    rows = {line.split(" | ")[0].strip("| "): line for line in markdown([body, body], 4, 1.0).splitlines()[4:]}
    assert set(rows) == set(PAIRS)
    assert "| -1.000 | -1.00 |" in rows["step halved, 4 to 2 ms"]
    assert "| 1.000 | 1.00 |" in rows["start a millimetre higher"]


@pytest.mark.usefixtures("one_body")
def test_walks_repeat_and_differ_only_by_what_is_varied() -> None:
    found, again = (walks("vae", "search", 0, 3, 1.5, 0) for _ in range(2))
    assert found == again
    usual = np.array(found["usual"], dtype=float)
    near = np.array(found["a micrometre higher"], dtype=float)
    assert np.abs(near - usual).max() < 0.02
    assert all(found[name] != found["usual"] for pair in PAIRS.values() for name in pair if name != "usual")


def test_the_command_writes_table_and_speeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(step_study, "passing", lambda *_: iter([4, 9]))
    monkeypatch.setattr(step_study, "Pool", _Here)
    monkeypatch.setattr(step_study, "walks", _pretend)
    assert main(["-n", "2", "--out", str(tmp_path / "step")]) == 0
    assert (tmp_path / "step" / TABLE).read_text(encoding="utf-8") in capsys.readouterr().out
    assert list(json.loads((tmp_path / "step" / RESULT).read_text("utf-8"))["bodies"]) == ["4", "9"]


def _pretend(*_: Any) -> dict[str, Any]:
    return {name: FOUR for pair in PAIRS.values() for name in pair}


class _Here:
    """A pool without processes that finishes the last first."""

    def __class_getitem__(cls, _: Any) -> type[_Here]:
        return cls

    def __init__(self, work: Any, *_: Any) -> None:
        self.work = work

    def __enter__(self) -> _Here:
        return self

    def __exit__(self, *_: object) -> None: ...

    def run(self, tasks: Any) -> Any:
        return ((task, self.work(task), 0.0) for task in reversed(tasks))
