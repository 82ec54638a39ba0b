"""`bodyplan simulate`: measures a blueprint folder or a design, by a found gait or by a bundle's, and films it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from policies import holding, oscillator, perceptron

from decoder.design import GRID, Joint, Material, VoxelDesign
from hardware.bundle import Bundle, JointSetup, save_bundle
from mfg.description import Description, describe
from mfg.pipeline import virtual
from mfg.robot_files import mesh_files, mjcf
from sim import gaits
from sim.actor import Gait, Perceptron, Policy

CONTRACT = {"seconds", "distance_m", "speed_m_s", "body_length_m", "fell", "cost_of_transport", "max_torque_Nm",
            "steps_per_s"}  # fmt: skip


@pytest.fixture(scope="module")
def walker() -> VoxelDesign:
    """Three boxes of bone in a row, joined by two hinges."""
    material = np.zeros((GRID,) * 3, np.uint8)
    segment = np.zeros((GRID,) * 3, np.int16)
    for number, (low, high) in enumerate(((4, 20), (22, 42), (44, 60)), start=1):
        box = np.s_[low:high, 25:39, 27:37]
        material[box], segment[box] = Material.RIGID, number
    joints = tuple(
        Joint(np.array([x, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-0.8, 0.8]), parent, child)
        for x, parent, child in ((0.21, 2, 1), (0.43, 2, 3))
    )
    return VoxelDesign(material, segment, joints=joints)


@pytest.fixture(scope="module")
def description(walker: VoxelDesign) -> Description:
    return describe(virtual(walker).blueprint)


@pytest.fixture
def blueprint(description: Description, tmp_path: Path) -> Path:
    """As much of a blueprint folder as a simulator reads."""
    folder = tmp_path / "blueprint"
    for name, content in mesh_files(description, ()).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    (folder / "robot.xml").write_text(mjcf(description))
    return folder


@pytest.fixture
def design_file(walker: VoxelDesign, tmp_path: Path) -> Path:
    walker.save(tmp_path / "walker.npz")
    return tmp_path / "walker.npz"


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that does not take seconds."""
    monkeypatch.setattr(
        gaits, "SCREENING", replace(gaits.SCREENING, random=4, generations=1, population=4, seconds=1.0)
    )


def saved_bundle(
    description: Description, folder: Path, order: list[int], actor: Policy | None = None, **changes: Any
) -> Path:
    """A policy for the joints in the order given; the actor's own joints are in the robot's."""
    names = [description.joints[k].name for k in order]
    joints = tuple(JointSetup(n, k, 1, (-0.8, 0.8), 0.0, 40.0, 1.6, 19.0, 6.0, 24.0) for k, n in enumerate(names))
    actor = actor or Gait(1.2, np.array([0.5, 0.3]), np.array([0.0, 1.5]), np.zeros(2))
    save_bundle(folder, replace(Bundle(description.name, joints, actor.arranged(order), 0.02), **changes))
    return folder


def said_json(bodyplan: Callable[..., Any], *words: object) -> dict[str, Any]:
    answer = bodyplan("simulate", *words, "--json")
    assert answer.status == 0, answer.err
    return json.loads(answer.out)


def test_a_blueprint_folder_is_measured_the_same_every_time(bodyplan: Callable[..., Any], blueprint: Path) -> None:
    one = said_json(bodyplan, blueprint, "--seconds", 3, "--seed", 1)
    two = said_json(bodyplan, blueprint, "--seconds", 3, "--seed", 1)
    assert set(one) >= CONTRACT
    assert one["seconds"] == pytest.approx(3.0)
    assert one["distance_m"] > 0
    assert {k: v for k, v in one.items() if k != "steps_per_s"} == {k: v for k, v in two.items() if k != "steps_per_s"}
    assert said_json(bodyplan, blueprint, "--seconds", 3, "--seed", 2)["gait"] != one["gait"]


def test_a_policy_drives_the_joints_by_name_whatever_their_order(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path
) -> None:
    found = [
        said_json(bodyplan, blueprint, "--policy", saved_bundle(description, tmp_path / name, order), "--seconds", 2)
        for name, order in (("plain", [0, 1]), ("swapped", [1, 0]))
    ]
    assert found[0]["gait"] == found[1]["gait"]
    assert found[0]["distance_m"] == found[1]["distance_m"]


def test_a_learned_policy_drives_the_joints_by_name_whatever_their_order(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path
) -> None:
    actor = perceptron(2, 3, history=2)
    found = [
        said_json(
            bodyplan, blueprint, "--policy", saved_bundle(description, tmp_path / name, order, actor), "--seconds", 1
        )
        for name, order in (("plain", [0, 1]), ("swapped", [1, 0]))
    ]
    assert set(found[0]) >= CONTRACT
    assert (found[0]["actor"], found[0]["gait"]) == ("perceptron", None)
    for key in ("distance_m", "speed_m_s", "max_torque_Nm", "overload"):
        assert found[0][key] == pytest.approx(found[1][key], rel=1e-4, abs=1e-6), key


def test_a_learned_policy_moves_the_robot_and_is_filmed(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path
) -> None:
    still = saved_bundle(description, tmp_path / "still", [0, 1], holding(np.zeros(2)))
    swing = saved_bundle(description, tmp_path / "swing", [0, 1], oscillator(2))
    film = tmp_path / "walk.png"
    assert said_json(bodyplan, blueprint, "--policy", still, "--seconds", 2)["distance_m"] < 0.01
    moved = said_json(bodyplan, blueprint, "--policy", swing, "--seconds", 4, "--video", film)
    assert moved["max_torque_Nm"] > 1.0
    assert film.exists()


def test_the_low_pass_of_a_policy_is_part_of_it(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path
) -> None:
    plain = saved_bundle(description, tmp_path / "plain", [0, 1])
    slow = saved_bundle(description, tmp_path / "slow", [0, 1], time_constant=1.0)
    fast, damped = (said_json(bodyplan, blueprint, "--policy", p, "--seconds", 2) for p in (plain, slow))
    assert damped["max_torque_Nm"] < 0.7 * fast["max_torque_Nm"]


def wild(num_joints: int) -> Perceptron:
    """Its numbers overflow, infinity less infinity."""
    policy = perceptron(num_joints, units=())
    weight = 1e200 * np.resize([1.0, -1.0], policy.layout.size)[:, None] * np.ones(num_joints)
    return replace(policy, input_gain=np.full(policy.layout.size, 1e200), layers=((weight, np.zeros(num_joints)),))


@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        ({"actor": wild(2)}, 1, "policy said what is no number"),
        ({"actor": perceptron(2), "dt": 0.01}, 2, "acts every 0.01 s; what is simulated here acts every 0.02 s"),
    ],
)
def test_a_learned_policy_that_cannot_drive_is_one_clear_line(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path, options: dict[str, Any],
    status: int, message: str,
) -> None:  # fmt: skip
    policy = saved_bundle(description, tmp_path / "policy", [0, 1], **options)
    answer = bodyplan("simulate", blueprint, "--policy", policy, "--seconds", 1, "--json")
    assert (answer.status, answer.out) == (status, "")
    assert message in answer.err
    assert len(answer.err.strip().splitlines()) == 1


def test_a_design_walks_before_it_has_hardware(
    bodyplan: Callable[..., Any], design_file: Path, blueprint: Path, description: Description, tmp_path: Path
) -> None:
    policy = saved_bundle(description, tmp_path / "policy", [0, 1])
    bare = said_json(bodyplan, design_file, "--virtual", "--policy", policy, "--seconds", 2)
    twin = said_json(bodyplan, blueprint, "--policy", policy, "--seconds", 2)
    # The same description through memory and through a file.
    assert bare["body_length_m"] == pytest.approx(twin["body_length_m"], rel=1e-6)
    assert bare["distance_m"] == pytest.approx(twin["distance_m"], abs=0.05)


def test_a_design_that_cannot_be_built_ends_with_status_one_and_the_reason(
    bodyplan: Callable[..., Any], walker: VoxelDesign, tmp_path: Path
) -> None:
    # A slip of a body: no motor can hold on to it.
    thin = np.zeros_like(walker.material)
    segment = np.zeros_like(walker.segment)
    for number, (low, high) in enumerate(((4, 20), (22, 42)), start=1):
        thin[low:high, 31:33, 31:33], segment[low:high, 31:33, 31:33] = Material.RIGID, number
    joint = Joint(np.array([0.21, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-0.8, 0.8]), 1, 2)
    VoxelDesign(thin, segment, joints=(joint,)).save(tmp_path / "thin.npz")
    answer = bodyplan("simulate", tmp_path / "thin.npz")
    assert answer.status == 1
    assert "cannot be built" in answer.err
    assert answer.out == ""


def test_a_film_is_drawn_and_people_get_sentences(
    bodyplan: Callable[..., Any], blueprint: Path, tmp_path: Path
) -> None:
    answer = bodyplan("simulate", blueprint, "--seconds", 1, "--video", tmp_path / "walk.png")
    assert answer.status == 0
    assert "body lengths" in answer.out
    with Image.open(tmp_path / "walk.png") as image:
        assert image.size == (1920, 240)


def test_a_report_is_one_page_with_everything_in_it(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path
) -> None:
    policy = saved_bundle(description, tmp_path / "swing", [1, 0], oscillator(2))
    film = tmp_path / "walk.mp4"
    words = ("--policy", policy, "--seconds", 1)
    found = said_json(bodyplan, blueprint, *words, "--report", tmp_path / "new" / "folder", "--video", film)
    page = tmp_path / "new" / "folder" / "behaviour.html"
    assert found["report"] == str(page)
    text = page.read_text("utf-8")
    for part in ("How it looks", "Gait", "Motors", "Joints", "learned policy", "swing", "data:video/mp4;base64,"):
        assert part in text, part
    assert text.count("data:image/png;base64,") == 5
    assert "http" not in text.replace("http://www.w3.org", "")
    for joint in description.joints:
        assert joint.name in text
    assert [motor["joint"] for motor in found["motors"]] == [joint.name for joint in description.joints]
    assert found["warnings"] == []
    assert "The motors can do all" in text
    plain = said_json(bodyplan, blueprint, *words)
    assert plain["report"] is None
    assert {k: v for k, v in found.items() if k not in ("report", "video", "steps_per_s")} == {
        k: v for k, v in plain.items() if k not in ("report", "video", "steps_per_s")
    }


def test_what_the_motors_could_not_do_is_said(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path
) -> None:
    robot = blueprint / "robot.xml"
    text, count = re.subn(r' user="[^"]*"', ' user="0.1"', robot.read_text())
    assert count == 2
    robot.write_text(text)
    policy = saved_bundle(description, tmp_path / "policy", [0, 1])
    page = tmp_path / "page.html"
    answer = bodyplan("simulate", blueprint, "--policy", policy, "--seconds", 1, "--report", page)
    assert answer.status == 0
    assert "warning: " in answer.out
    assert "it would overheat" in answer.out
    assert f"report in {page}" in answer.out
    assert "The real motors could not do this." in page.read_text("utf-8")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--report", "nowhere/page.html"], "there is no folder nowhere"),
        (["--report", "pyproject.toml"], "it is a file that does not end in .html"),
        (["--video", "walk.gif"], "a film ends in .mp4 or .png"),
        (["--video", "nowhere/walk.mp4"], "there is no folder nowhere"),
        (["--seconds", "0"], "out of bounds"),
        (["--seconds", "soon"], "is not a number"),
        (["--virtual"], "--virtual needs a design"),
    ],
)
def test_bad_words_are_one_clear_line(
    bodyplan: Callable[..., Any], blueprint: Path, words: list[str], message: str
) -> None:
    answer = bodyplan("simulate", blueprint, *words)
    assert answer.status == 2
    assert message in answer.err
    assert len(answer.err.strip().splitlines()) == 1


def test_a_policy_for_other_joints_is_refused(
    bodyplan: Callable[..., Any], blueprint: Path, description: Description, tmp_path: Path
) -> None:
    other = replace(description, joints=tuple(replace(j, name=j.name + "x") for j in description.joints))
    answer = bodyplan("simulate", blueprint, "--policy", saved_bundle(other, tmp_path / "other", [0, 1]))
    assert answer.status == 2
    assert "drives joints" in answer.err
