"""`bodyplan build` and `bodyplan score`: the JSON that scripts rely on, statuses, and the agreement of the two."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from decoder.design import VoxelDesign
from decoder.latent import make_decoder, sample_latents
from decoder.sketch import load_design
from experiments import build as command
from mfg.description import describe
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
    assert 3.0 < robot.mass < 8.0
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
    lines = bodyplan("score", good, hopeless).out.splitlines()
    assert len(lines) == 3
    assert "can be built, " in lines[0]
    assert "cannot be built: skeleton: " in lines[1]
    assert lines[2] == "1 of 2 can be built"
