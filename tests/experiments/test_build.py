"""`bodyplan build` and `bodyplan score`: the JSON that scripts rely on, statuses, and the agreement of the two."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bodies import ellipsoid, painted

from decoder.design import Joint, VoxelDesign
from decoder.latent import make_decoder, sample_latents
from decoder.sketch import load_design
from experiments import build as command
from mfg.description import describe
from mfg.manifest import changed_files
from mfg.pipeline import build, score
from sim.actor import Gait
from sim.model import compile_model
from sim.rollout import measure, roll_out

EXAMPLES = Path(command.__file__).parent / "examples"
SCORES = ("motor", "electronics", "cable", "electronics_install", "body_install")


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """The first random body that can be built, as a file."""
    decoder, rng = make_decoder("genome"), np.random.default_rng(0)
    design = next(d for _ in range(40) for d in decoder.decode(sample_latents(1, rng)) if score(d).ok)
    path = tmp_path_factory.mktemp("good") / "good.npz"
    design.save(path)
    return path


@pytest.fixture
def hopeless(hinge, tmp_path):
    """Two bones and no joint between them."""
    path = tmp_path / "hopeless.npz"
    VoxelDesign(hinge.material, hinge.segment, hinge.pitch, ()).save(path)
    return path


SLICER = """#!/bin/sh
if [ "$1" = --help ]; then echo "PrusaSlicer-2.5.0+fake based on Slic3r"; exit 0; fi
while [ $# -gt 1 ]; do [ "$1" = --output ] && out=$2; shift; done
printf '; filament used [g] = 10.5, 2.25\\n; estimated printing time (normal mode) = 1h 2m 3s\\n' > "$out"
echo "print warning: Detected print stability issues"
"""


@pytest.fixture
def slicer(tmp_path, monkeypatch):
    """A program in the place of PrusaSlicer, and nothing else on the search path but what a shell needs."""
    place = tmp_path / "bin" / "prusa-slicer"
    place.parent.mkdir()
    place.write_text(SLICER)
    place.chmod(0o755)
    monkeypatch.setenv("PATH", str(place.parent))
    return place


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(command, "PICTURE", (64, 48))


def check(verdict: dict, design: Path) -> None:
    """The object of the contract."""
    assert verdict["design"] == VoxelDesign.load(design).key
    assert (verdict["failure"] is None) is verdict["ok"]
    assert set(verdict["scores"]) == {*SCORES, "total"}
    given = [verdict["scores"][name] for name in SCORES if verdict["scores"][name] is not None]
    assert all(0.0 <= value <= 1.0 for value in given)
    assert verdict["scores"]["total"] == pytest.approx(sum(given))
    assert all(seconds >= 0 for seconds in verdict["seconds"].values())
    if not verdict["ok"]:
        assert set(verdict["failure"]) == {"stage", "reason", "detail"}
        assert verdict["out"] is None


def test_a_build_leaves_the_blueprint_folder_of_the_contract(bodyplan, good, tmp_path, small):
    said = bodyplan("build", good, "--out", tmp_path / "robot", "--json")
    assert said.status == 0
    verdict = json.loads(said.out)
    check(verdict, good)
    assert verdict["ok"]
    assert verdict["out"] == str(tmp_path / "robot")
    assert all(verdict["scores"][name] is not None for name in SCORES)
    for name in ("blueprint.json", "print.3mf", "assembly.glb", "robot.urdf", "robot.xml", "bom.csv", "wiring.csv",
                 "blueprint.png", "meshes", "parts"):  # fmt: skip
        assert (tmp_path / "robot" / name).exists(), name
    assert list((tmp_path / "robot" / "parts").glob("*.stl"))


@pytest.mark.parametrize("sketch", sorted(EXAMPLES.glob("*.vox")), ids=lambda path: path.stem)
def test_every_example_sketch_is_a_robot_that_stands(sketch):
    outcome = build(load_design(sketch))
    assert outcome.ok, outcome.failure
    robot = describe(outcome.blueprint)
    assert 3 <= len(robot.joints) <= 8
    assert 3.0 < robot.mass < 9.0
    assert all(joint.range[1] - joint.range[0] > 1.0 for joint in robot.joints)
    model, still = compile_model(robot), np.zeros(len(robot.joints))
    behaviour = measure(model, roll_out(model, [Gait(1.0, still, still, still)], 2.0))[0]
    assert behaviour is not None
    assert not behaviour.fell
    assert behaviour.distance < 0.02


def test_a_build_goes_into_the_folder_one_stands_in(bodyplan, good, tmp_path, small, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = bodyplan("build", good, "--out", ".", "--json")
    assert (said.status, json.loads(said.out)["out"]) == (0, ".")
    assert (tmp_path / "blueprint.json").exists()
    assert (tmp_path / "blueprint.png").exists()


def test_the_folder_one_stands_in_is_refused_in_one_line_if_it_holds_other_things(
    bodyplan, good, tmp_path, small, monkeypatch
):
    (tmp_path / "thesis.txt").write_text("years of work")
    monkeypatch.chdir(tmp_path)
    said = bodyplan("build", good, "--out", ".")
    assert said.status == 2
    assert said.err.count("\n") == 1
    assert "is not empty and holds no blueprint.json" in said.err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_build_tells_people_what_came_of_it(bodyplan, good, tmp_path, small):
    said = bodyplan("build", good, "--out", tmp_path / "robot")
    assert said.status == 0
    assert "can be built" in said.out
    assert str(tmp_path / "robot" / "print.3mf") in said.out


def test_a_design_that_cannot_be_built_is_status_1_with_its_reason_and_no_folder(bodyplan, hopeless, tmp_path):
    said = bodyplan("build", hopeless, "--out", tmp_path / "robot", "--json")
    assert said.status == 1
    verdict = json.loads(said.out)
    check(verdict, hopeless)
    assert verdict["failure"]["stage"] == "skeleton"
    assert said.err.count("\n") == 1
    assert "cannot be built: skeleton" in said.err
    assert not (tmp_path / "robot").exists()


def test_a_folder_that_was_there_before_stays(bodyplan, hopeless, tmp_path):
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "notes.txt").write_text("mine")
    assert bodyplan("build", hopeless, "--out", tmp_path / "robot").status == 1
    assert (tmp_path / "robot" / "notes.txt").read_text() == "mine"


def test_score_of_one_design_is_an_object_and_of_several_a_list(bodyplan, good, hopeless):
    one = bodyplan("score", good, "--json")
    assert one.status == 0
    check(json.loads(one.out), good)
    several = bodyplan("score", good, hopeless, "--json")
    assert several.status == 1
    first, second = json.loads(several.out)
    check(first, good)
    check(second, hopeless)
    assert (first["file"], second["file"]) == (str(good), str(hopeless))
    assert first["scores"] == json.loads(one.out)["scores"]


def test_score_gives_people_one_line_per_design_and_a_count(bodyplan, good, hopeless):
    lines = [line for line in bodyplan("score", good, hopeless).out.splitlines() if not line.startswith("  note: ")]
    assert len(lines) == 3
    assert "can be built, " in lines[0]
    assert "cannot be built: skeleton: " in lines[1]
    assert lines[2] == "1 of 2 can be built"


def content(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_slicing_adds_to_the_bill_and_the_manifest_and_touches_nothing_else(bodyplan, good, tmp_path, small, slicer):
    plain, robot = tmp_path / "plain", tmp_path / "robot"
    assert bodyplan("build", good, "--out", plain, "--json").status == 0
    said = bodyplan("build", good, "--out", robot, "--slice", "--json")
    assert said.status == 0, said.err
    verdict, before = json.loads(said.out), json.loads((plain / "blueprint.json").read_text())
    check(verdict, good)
    manifest = json.loads((robot / "blueprint.json").read_text())
    assert manifest.pop("slice") == verdict["slice"]
    plates = {body["plate"] for body in manifest["bodies"]}
    assert verdict["slice"]["seconds"] == 3723 * len(plates)
    assert verdict["slice"]["filament_g"] == {"rigid": 10.5 * len(plates), "soft": 2.25 * len(plates)}
    assert verdict["slice"]["warnings"] == ["Detected print stability issues"]
    assert changed_files(robot) == []
    assert manifest["files"].pop("bom.csv") != before["files"].pop("bom.csv")
    assert manifest == before
    sliced, unsliced = content(robot), content(plain)
    assert {name for name in sliced if sliced[name] != unsliced.get(name)} == {"bom.csv", "blueprint.json"}
    assert set(sliced) == set(unsliced)


def test_without_a_slicer_nothing_is_begun(bodyplan, good, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    said = bodyplan("build", good, "--out", tmp_path / "robot", "--slice")
    assert said.status == 2
    assert said.err.count("\n") == 1
    assert "apt install" in said.err
    assert not (tmp_path / "robot").exists()


def test_a_slicer_that_fails_leaves_the_blueprint_as_it_was(bodyplan, good, tmp_path, small, slicer):
    slicer.write_text(SLICER.replace('echo "print warning', 'echo "no flat bottom" >&2; exit 1; echo "'))
    said = bodyplan("build", good, "--out", tmp_path / "robot", "--slice", "--json")
    assert said.status == 2
    assert said.err.count("\n") == 1
    assert "no flat bottom" in said.err
    verdict = json.loads(said.out)
    check(verdict, good)
    assert verdict["slice"] is None
    assert changed_files(tmp_path / "robot") == []
    assert "slice" not in json.loads((tmp_path / "robot" / "blueprint.json").read_text())


def test_step_files_come_only_when_asked_for(bodyplan, good, tmp_path, small):
    assert bodyplan("build", good, "--out", tmp_path / "robot", "--step").status == 0
    robot = tmp_path / "robot"
    rigid = {p.stem for p in (robot / "parts").iterdir() if "_skin" not in p.stem}  # bones, and lids
    assert {p.stem for p in (robot / "step").iterdir()} == rigid
    assert changed_files(robot) == []
    assert bodyplan("build", good, "--out", robot).status == 0
    assert not (robot / "step").exists()


def test_a_body_that_cannot_be_built_is_repaired_on_request(bodyplan, tmp_path):
    joint = Joint(np.array([0.32, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-0.6, 0.6]), 1, 2)
    thin = painted([ellipsoid((21, 32, 32), (12, 11, 10)), ellipsoid((45, 32, 32), (11, 2.2, 2.2))], (joint,))
    thin.save(tmp_path / "thin.npz")
    words = ("build", tmp_path / "thin.npz", "--out", tmp_path / "robot", "--no-guide")
    assert bodyplan(*words).status == 1
    said = bodyplan(*words, "--repair")
    assert said.status == 0, said.err
    assert "note: repaired: " in said.out
    notes = json.loads((tmp_path / "robot" / "blueprint.json").read_text())["notes"]
    assert any(note.startswith("repaired: ") for note in notes)
    assert VoxelDesign.load(tmp_path / "robot" / "design.npz").key != thin.key
