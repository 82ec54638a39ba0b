from __future__ import annotations

import hashlib
import io
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from decoder.design import VoxelDesign
from experiments.foreign_check import TOUCH, check, checked
from mfg.export import blueprint_files, write_blueprint
from mfg.manifest import NAME, changed_files
from mfg.outcome import Failure, Reason, Stage
from mfg.pipeline import Outcome, score
from mfg.retreat import RETREAT, retreated


@pytest.fixture(scope="module")
def files(built: Outcome) -> dict[str, bytes]:
    return blueprint_files(built.blueprint)


@pytest.fixture(scope="module")
def folder(built: Outcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_blueprint(built, tmp_path_factory.mktemp("export") / "robot")


@pytest.fixture
def quick(files: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    """Writing is under test, not what is written."""
    monkeypatch.setattr("mfg.export.blueprint_files", lambda *_, **__: files)


def test_the_folder_holds_what_the_contract_names(folder: Path, built: Outcome) -> None:
    for name in ("blueprint.json", "print.3mf", "assembly.glb", "robot.urdf", "robot.xml", "meshes", "bom.csv",
                 "wiring.csv", "design.npz"):  # fmt: skip
        assert (folder / name).exists(), name
    assert sorted(p.stem for p in (folder / "parts").glob("*.stl")) == sorted(p.name for p in built.blueprint.parts)
    assert [p.name for p in folder.parent.iterdir()] == ["robot"]  # no trace of how it was made
    assert changed_files(folder) == []
    assert VoxelDesign.load(folder / "design.npz").key == built.design.key


def test_exporting_twice_gives_the_same_bytes(files: dict[str, bytes], built: Outcome) -> None:
    again = blueprint_files(built.blueprint)
    assert list(again) == list(files)
    assert [name for name in files if files[name] != again[name]] == []


def test_step_files_of_the_rigid_parts_are_extra_and_change_nothing_else(
    files: dict[str, bytes], built: Outcome
) -> None:
    more = blueprint_files(built.blueprint, step=True)
    added = sorted(set(more) - set(files))
    assert added == sorted(f"step/{p.name}.step" for p in built.blueprint.parts if p.material == "rigid")
    assert {name for name in files if files[name] != more[name]} == {NAME}
    stored = json.loads(more[NAME])["files"]
    assert all(stored[name] == hashlib.sha256(more[name]).hexdigest() for name in added)


def test_every_file_of_a_build_passes_the_foreign_check(built: Outcome, tmp_path: Path) -> None:
    assert check(built, tmp_path / "robot") == []


def test_a_part_that_did_not_step_back_from_what_it_touches_fails_the_check(built: Outcome, tmp_path: Path) -> None:
    parts = built.blueprint.parts
    # As far back out as it went in: it touches motors and skin again, and the lattice decides what they share.
    parts = (replace(parts[0], solid=retreated(parts[0].solid, -RETREAT)), *parts[1:])
    problems, shared = checked(replace(built, blueprint=replace(built.blueprint, parts=parts)), tmp_path / "robot")
    assert TOUCH < shared < 1000 * TOUCH
    assert problems
    assert all(parts[0].name in problem and "share" in problem for problem in problems)


def test_the_assembly_is_the_robot_in_metres_with_y_up(files: dict[str, bytes], built: Outcome) -> None:
    scene = trimesh.load(io.BytesIO(files["assembly.glb"]), file_type="glb")
    points = np.concatenate([part.solid.vertices for part in built.blueprint.parts])
    size = np.ptp(points, axis=0)
    assert_allclose(np.ptp(scene.bounds, axis=0), size[[0, 2, 1]], atol=0.004)
    assert {part.name for part in built.blueprint.parts} <= set(scene.geometry)
    colours = {mesh.visual.material.baseColorFactor[:3].tobytes() for mesh in scene.geometry.values()}
    assert len(colours) >= 5  # bone, skin, motor, battery, controller, cable


@pytest.mark.usefixtures("quick")
def test_a_changed_file_no_longer_matches_the_manifest(built: Outcome, tmp_path: Path) -> None:
    folder = write_blueprint(built, tmp_path / "robot")
    (folder / "bom.csv").write_text("kind,item\n")
    (folder / "wiring.csv").unlink()
    assert changed_files(folder) == ["bom.csv", "wiring.csv"]


@pytest.mark.usefixtures("quick")
def test_an_older_blueprint_is_replaced_whole(built: Outcome, tmp_path: Path) -> None:
    folder = write_blueprint(built, tmp_path / "robot")
    (folder / "parts" / "stale.stl").write_bytes(b"")
    write_blueprint(built, folder)
    assert not (folder / "parts" / "stale.stl").exists()
    assert changed_files(folder) == []


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("older", [False, True])
def test_the_folder_one_stands_in_is_filled_and_stays_the_same_folder(
    built: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, older: bool
) -> None:
    folder = tmp_path / "robot"
    folder.mkdir()
    if older:
        write_blueprint(built, folder)
        (folder / "parts" / "stale.stl").write_bytes(b"")
    before = folder.stat().st_ino
    monkeypatch.chdir(folder)
    assert write_blueprint(built, Path()) == folder.resolve()
    assert folder.stat().st_ino == before
    assert changed_files(Path()) == []
    assert not Path("parts", "stale.stl").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["robot"]


@pytest.mark.usefixtures("quick")
def test_what_a_killed_export_left_is_removed_and_what_another_makes_is_not(built: Outcome, tmp_path: Path) -> None:
    gone, alive = 2**22 + 1, os.getppid()  # beyond the greatest process id there is; the process that started us
    names = [f".robot.{process}.{end}" for process in (gone, alive) for end in ("partial", "old")]
    for name in (*names, f".other.{gone}.partial", f".robot.{gone}.partial.txt"):
        (tmp_path / name / "parts").mkdir(parents=True)
    write_blueprint(built, tmp_path / "robot")
    assert {path.name for path in tmp_path.iterdir()} == {
        "robot", *names[2:], f".other.{gone}.partial", f".robot.{gone}.partial.txt"
    }  # fmt: skip


def test_a_folder_with_other_things_in_it_is_left_alone(built: Outcome, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(FileExistsError, match=f"holds no {NAME}"):
        write_blueprint(built, tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    with pytest.raises(FileExistsError, match="is a file"):
        write_blueprint(built, tmp_path / "thesis.txt")


@pytest.mark.usefixtures("quick")
def test_a_failed_export_leaves_nothing_and_says_why(
    built: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.name == "robot.xml":
            raise OSError(28, os.strerror(28), str(path))
        return written(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        write_blueprint(built, tmp_path / "robot")
    assert list(tmp_path.iterdir()) == []


def test_only_built_designs_are_exported(built: Outcome, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="build it before"):
        write_blueprint(score(built.design), tmp_path / "robot")
    failed = replace(built, failure=Failure(Stage.PRINT, Reason.TOO_LARGE, "too long"))
    with pytest.raises(ValueError, match="too long"):
        write_blueprint(failed, tmp_path / "robot")
    assert list(tmp_path.iterdir()) == []
