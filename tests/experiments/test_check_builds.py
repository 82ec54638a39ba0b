"""The check of many builds: it finds what is wrong, names it, and goes on where it was stopped."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import check_builds
from experiments.check_builds import earlier_rows
from experiments.foreign_check import admesh_flaws, overlaps, prusa_flaws
from experiments.output import BadInput
from mfg.blueprint import Blueprint
from mfg.parts import PAPER
from mfg.slicer import find_slicer
from mfg.solids import Solid, box
from mfg.stl import stl_bytes, welded
from mfg.threemf import PrintObject, Volume, prusa_3mf

SETTINGS = {"decoder": "genome", "solver": "search", "seed": 7}
ARGUMENTS = ["--decoder", "genome", "--solver", "search", "--seed", "7"]


def fake_row(draws: list[int], problem: str = "") -> Callable[..., dict[str, Any]]:
    """Every second design is built; the one drawn as number 3 has the problem."""

    def row(_: object, settings: dict[str, Any], draw: int, sliced: bool) -> dict[str, Any]:
        draws.append(draw)
        found = {**settings, "draw": draw, "design": f"key{draw}", "built": draw % 2 == 1, "late": False,
                 "failure": None, "problems": []}  # fmt: skip
        if not found["built"]:
            return found | {"failure": {"stage": "motor", "reason": "no_overlap", "detail": "far"}}
        return found | {
            "bodies": 2, "parts": 4, "objects": 3, "lids": 1, "mass_kg": 2.0, "volume_cm3": 100.0, "shared_mm3": 0.01,
            "finish_s": 0.5, "score_differences": dict.fromkeys(check_builds.SCORES, 0.0),
            "slice": {"warnings": []} if sliced else None, "notes": [],
            "problems": [problem] if problem and draw == 3 else [],
        }  # fmt: skip

    return row


def test_it_goes_on_where_it_was_stopped_and_draws_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draws: list[int] = []
    monkeypatch.setattr(check_builds, "_row", fake_row(draws))
    rows = tmp_path / "rows.jsonl"
    assert check_builds.main(["-n", "2", "--slice", "1", "--out", str(rows), *ARGUMENTS]) == 0
    with rows.open("a") as file:
        file.write('{"draw": 4, "dec')  # killed in the middle of a line
    assert check_builds.main(["-n", "4", "--out", str(rows), *ARGUMENTS]) == 0
    assert draws == list(range(8))
    kept = [json.loads(line) for line in rows.read_text().splitlines()]
    assert [row["draw"] for row in kept] == draws
    assert [row["slice"] is not None for row in kept if row["built"]] == [True, False, False, False]
    said = capsys.readouterr().out
    assert "4 robots built of 8 designs, 0 of them with something wrong" in said
    assert "4  motor: no_overlap" in said
    assert "sliced whole, warnings: 1, 0" in said


def test_what_is_wrong_is_named_with_its_design_and_fails_the_check(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(check_builds, "_row", fake_row([], "body_0_bone.stl is not watertight"))
    assert check_builds.main(["-n", "2", *ARGUMENTS]) == 1
    assert "WRONG key3 (draw 3): body_0_bone.stl is not watertight" in capsys.readouterr().out


def test_it_gives_up_where_nothing_is_ever_built(monkeypatch: pytest.MonkeyPatch) -> None:
    draws: list[int] = []
    row = fake_row(draws)
    monkeypatch.setattr(check_builds, "_row", lambda *args: row(*args) | {"built": False, "late": False})
    assert check_builds.main(["-n", "2", *ARGUMENTS]) == 1
    assert len(draws) == 2 * check_builds.MOST_DRAWN


@pytest.mark.parametrize("line", ['{"draw": 0}', "what?", "[1]", json.dumps({**SETTINGS, "seed": 8, "draw": 0}),
                                  json.dumps({**SETTINGS, "draw": 1})])  # fmt: skip
def test_rows_of_something_else_are_refused(tmp_path: Path, line: str) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text(line + "\n")
    with pytest.raises(BadInput, match="name another file"):
        earlier_rows(path, SETTINGS)
    assert path.read_text() == line + "\n"


@pytest.mark.skipif(shutil.which("admesh") is None, reason="needs ADMesh")
def test_admesh_finds_the_hole_in_a_surface(tmp_path: Path) -> None:
    vertices, triangles = welded(box((0, 0, 0), (0.01, 0.02, 0.03)))
    path = tmp_path / "box.stl"
    path.write_bytes(stl_bytes(vertices, triangles, "box"))
    assert admesh_flaws(path) == []
    path.write_bytes(stl_bytes(vertices, triangles[1:], "box"))
    assert any("disconnected" in flaw for flaw in admesh_flaws(path))
    path.write_bytes(stl_bytes(vertices, triangles[:, ::-1], "box"))
    assert any("facets reversed" in flaw for flaw in admesh_flaws(path))


@pytest.mark.skipif(find_slicer() is None, reason="needs PrusaSlicer")
def test_prusa_slicer_finds_the_object_that_is_open_and_the_one_that_is_missing(tmp_path: Path) -> None:
    vertices, triangles = welded(box((0, 0, 0), (0.01, 0.02, 0.03)))
    path = tmp_path / "print.3mf"
    for faces, flaws in ((triangles, 0), (triangles[1:], 1)):
        thing = PrintObject("box", (Volume("box", vertices, faces, 1, PAPER.rigid),), np.eye(4), 0)
        path.write_bytes(prusa_3mf([thing], "t", PAPER))
        assert len(prusa_flaws(path, 1)) == flaws
        assert "objects of 2" in prusa_flaws(path, 2)[0]


def test_things_that_share_room_are_named() -> None:
    class Bare:
        seats, boxes, wires = (), (), ()

    solids: dict[str, Solid] = {"a": box((0, 0, 0), (1, 1, 1)), "b": box((0.5, 0, 0), (2, 1, 1)),
                                "c": box((3, 0, 0), (4, 1, 1))}  # fmt: skip
    bare: Blueprint = Bare()  # type: ignore[assignment]
    assert overlaps(bare, solids) == {"a and b": pytest.approx(0.5)}
