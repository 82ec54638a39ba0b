"""A policy bundle comes back as it was written, to the bit, and a damaged one is refused in one line."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policies import holding, oscillator, perceptron

from hardware.actor_document import MOST_HISTORY
from hardware.bundle import Bundle, BundleError, JointSetup, bundle_document, load_bundle, parse_bundle, save_bundle
from hardware.document import MOST_SIDE
from sim.actor import Gait, Perceptron, Policy

MJCF = (
    "<mujoco><worldbody><body><freejoint/>"
    '<body><joint name="hip"/></body><body><joint name="knee"/></body></body></worldbody></mujoco>'
)


def joint(name: str = "hip", can_id: int = 1, **changes: Any) -> JointSetup:
    return replace(JointSetup(name, can_id, 1, (-1.0, 1.2), 0.1, 40.0, 1.6, 19.94, 6.6, 24.18), **changes)


def bundle(actor: Policy | None = None, **changes: Any) -> Bundle:
    actor = actor or Gait(1 / 3, np.array([0.1, np.pi / 7]), np.array([0.0, 1e-17]), np.array([0.2, -0.3]))
    return replace(Bundle("d" * 16, (joint(), joint("knee", 2, sign=-1)), actor, 0.02, 0.05, "abc"), **changes)


def corrupt(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "bundle.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_bundle_round_trip_is_exact(tmp_path: Path) -> None:
    c, s = np.cos(0.3), np.sin(0.3)
    original = bundle(R_link_imu=np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))
    save_bundle(tmp_path / "b", original)
    loaded = load_bundle(tmp_path / "b")
    np.testing.assert_array_equal(loaded.R_link_imu, original.R_link_imu)
    assert loaded.joints == original.joints
    assert (loaded.design, loaded.dt, loaded.time_constant, loaded.config_hash) == ("d" * 16, 0.02, 0.05, "abc")
    assert loaded.actor.frequency == original.actor.frequency
    for name in ("amplitude", "phase", "offset"):
        np.testing.assert_array_equal(getattr(loaded.actor, name), getattr(original.actor, name))


def test_the_model_travels_with_the_bundle(tmp_path: Path) -> None:
    (tmp_path / "blueprint" / "meshes").mkdir(parents=True)
    (tmp_path / "blueprint" / "robot.xml").write_text(MJCF)
    (tmp_path / "blueprint" / "meshes" / "a.stl").write_bytes(b"abc")
    save_bundle(tmp_path / "b", bundle(), tmp_path / "blueprint")
    load_bundle(tmp_path / "b")
    assert (tmp_path / "b" / "meshes" / "a.stl").read_bytes() == b"abc"
    (tmp_path / "b" / "robot.xml").write_text(MJCF.replace("knee", "elbow"))
    with pytest.raises(BundleError, match=r"missing \['knee'\], unknown \['elbow'\]"):
        load_bundle(tmp_path / "b")
    (tmp_path / "b" / "robot.xml").write_text("<mujoco>")
    with pytest.raises(BundleError, match="not an MJCF"):
        load_bundle(tmp_path / "b")


def rename_joint(document: dict[str, Any]) -> None:
    document["joints"]["elbow"] = document["joints"].pop("knee")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(version=1), "version must be 2, got 1"),
        (lambda d: d.pop("dt"), r"missing \['dt'\]"),
        (lambda d: d.update(extra=1), r"unknown \['extra'\]"),
        (rename_joint, r"missing \['knee'\], unknown \['elbow'\]"),
        (lambda d: d.update(order=["hip", "hip"]), r"missing \[\], unknown \['knee'\]"),
        (lambda d: d["actor"].update(kind="magic"), "kind must be 'gait' or 'perceptron', got 'magic'"),
        (lambda d: d["actor"]["phase"].append(0.0), "phase must be a list of 2 numbers"),
        (lambda d: d["actor"].update(frequency=float("nan")), "every number must be finite, got NaN"),
        (lambda d: d["actor"].update(frequency=True), "frequency must be a finite number"),
        (lambda d: d.update(dt=10**400), "dt must be a finite number"),
        (lambda d: d.update(dt=0.0), r"dt must lie in \(0, 1\]"),
        (lambda d: d.update(time_constant=-1), "time_constant"),
        (lambda d: d.update(R_link_imu=[1, 0, 0]), "R_link_imu must be a matrix"),
        (lambda d: d.update(R_link_imu=[[1, 0], [0, 1]]), r"R_link_imu must be a rotation matrix \(3, 3\)"),
        (lambda d: d["R_link_imu"][0].reverse(), "R_link_imu must be a rotation matrix"),
        (lambda d: d.update(R_link_imu=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "R_link_imu must be a rotation matrix"),
        (lambda d: d["joints"]["hip"].update(can_id=16), r"'hip': can_id must be in 0..15, got 16"),
        (lambda d: d["joints"]["hip"].update(can_id=2), "share a can_id"),
        (lambda d: d["joints"]["hip"].update(sign=0), "sign must be"),
        (lambda d: d["joints"]["hip"].update(range=[1, -1]), "range must be"),
        (lambda d: d["joints"]["hip"].update(default=3.0), "default must be in its range"),
        (lambda d: d["joints"]["hip"].update(kp="40"), "kp must be a finite number"),
        (lambda d: d["joints"]["hip"].update(peak_torque=1.0), "at most the peak torque"),
        (lambda d: d.update(joints=[]), "joints must be an object"),
    ],
)
def test_a_damaged_bundle_is_refused_in_one_line(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    save_bundle(tmp_path, bundle())
    corrupt(tmp_path, change)
    with pytest.raises(BundleError, match=message) as caught:
        load_bundle(tmp_path)
    assert "\n" not in str(caught.value)
    assert "bundle.json" in str(caught.value)


@pytest.mark.parametrize(
    "policy",
    [
        perceptron(2), perceptron(2, 5, history=3, command=(0.1, -0.2, 1 / 3)), perceptron(2, units=()),
        holding(np.array([0.1, 0.2])), oscillator(2),
    ],
)  # fmt: skip
def test_a_learned_policy_comes_back_to_the_bit(tmp_path: Path, policy: Perceptron) -> None:
    save_bundle(tmp_path, bundle(policy))
    loaded = load_bundle(tmp_path).actor
    assert isinstance(loaded, Perceptron)
    assert (loaded.history, loaded.command) == (policy.history, policy.command)
    assert len(loaded.layers) == len(policy.layers)
    pairs = [(a, b) for ours, theirs in zip(loaded.layers, policy.layers, strict=True)
             for a, b in zip(ours, theirs, strict=True)]  # fmt: skip
    pairs += [(getattr(loaded, name), getattr(policy, name)) for name in ("input_centre", "input_gain")]
    pairs += [(getattr(loaded.actions, n), getattr(policy.actions, n)) for n in ("centre", "scale", "low", "high")]
    for a, b in pairs:
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes()
    assert (loaded.actions.blend, loaded.actions.step) == (policy.actions.blend, policy.actions.step)
    observations = np.random.default_rng(0).normal(size=(5, policy.layout.size))
    assert loaded.act(0.0, observations).tobytes() == policy.act(0.0, observations).tobytes()
    # And once more: what is written again is the same file.
    save_bundle(tmp_path / "again", load_bundle(tmp_path))
    assert (tmp_path / "again" / "bundle.json").read_bytes() == (tmp_path / "bundle.json").read_bytes()


def layer(document: dict[str, Any], index: int = 0) -> dict[str, Any]:
    return document["actor"]["layers"][index]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["actor"].pop("history"), r"actor: fields disagree: missing \['history'\]"),
        (lambda d: d["actor"].update(frequency=1.0), r"actor: fields disagree: missing \[\], unknown \['frequency'\]"),
        (lambda d: d["actor"].update(kind=["perceptron"]), "kind must be 'gait' or 'perceptron'"),
        (lambda d: d.update(actor=[]), "kind must be 'gait' or 'perceptron', got None"),
        (lambda d: d["actor"].update(history=0), "history must be a whole number in 1..64, got 0"),
        (lambda d: d["actor"].update(history=True), "history must be a whole number in 1..64, got True"),
        (lambda d: d["actor"].update(history=2.0), "history must be a whole number in 1..64, got 2.0"),
        (lambda d: d["actor"].update(history=10**9), "history must be a whole number in 1..64"),
        (lambda d: d["actor"].update(history=2), "input_centre must be 24 finite numbers"),
        (lambda d: d["actor"].update(command=None), "command must be a list of numbers"),
        (lambda d: d["actor"].update(command=[1, 2]), "input_centre must be 15 finite numbers"),
        (lambda d: d["actor"].update(command=[1, 2, "x"]), "command must be a finite number"),
        (lambda d: d["actor"]["input_gain"].pop(), "input_gain must be 12 finite numbers"),
        (lambda d: d["actor"].update(input_gain=3.0), "input_gain must be a list of numbers"),
        (lambda d: d["actor"].update(input_centre=[]), "input_centre must be rectangular"),
        (lambda d: d["actor"].update(input_centre=[None] * 12), "input_centre must be a finite number, got None"),
        (lambda d: d["actor"].update(layers={}), "layers must be a list"),
        (lambda d: d["actor"].update(layers=[]), "at least one layer"),
        (lambda d: d["actor"].update(layers=[3]), "layer 0: fields must be a JSON object, got 3"),
        (lambda d: d["actor"]["layers"].pop(), "last layer has 6 outputs, the robot has 2 joints"),
        (lambda d: d["actor"]["layers"].reverse(), r"Layer 0: weight must be \(12, outputs\)"),
        (lambda d: layer(d).pop("bias"), r"layer 0: fields disagree: missing \['bias'\]"),
        (lambda d: layer(d).update(more=1), r"layer 0: fields disagree: missing \[\], unknown \['more'\]"),
        (lambda d: layer(d)["bias"].pop(), "Layer 0: weight must be"),
        (lambda d: layer(d)["weight"].pop(), r"Layer 0: weight must be \(12, outputs\)"),
        (lambda d: layer(d)["weight"][3].pop(), "layer 0: weight must be rectangular"),
        (lambda d: layer(d, 1).update(weight=[1.0, 2.0]), "layer 1: weight must be a matrix"),
        (lambda d: layer(d, 1).update(weight=[]), "layer 1: weight must be a matrix"),
        (lambda d: layer(d, 1).update(weight=[[]]), "layer 1: weight must be rectangular"),
        (lambda d: layer(d, 1).update(bias={"a": 1}), "layer 1: bias must be a list of numbers"),
        (lambda d: layer(d)["weight"][0].__setitem__(0, float("nan")), "every number must be finite, got NaN"),
        (lambda d: layer(d)["weight"][0].__setitem__(0, float("inf")), "every number must be finite, got Infinity"),
        (lambda d: layer(d)["weight"][0].__setitem__(0, "1"), "layer 0: weight must be a finite number, got '1'"),
        (lambda d: layer(d)["weight"][0].__setitem__(0, 10**400), "weight must be a finite number"),
        (lambda d: layer(d)["weight"][0].__setitem__(0, [1.0]), "weight must be a finite number"),
        (lambda d: layer(d)["bias"].__setitem__(0, False), "bias must be a finite number, got False"),
        (lambda d: d["actor"].update(actions=[]), "actions: fields must be a JSON object"),
        (lambda d: d["actor"]["actions"].pop("blend"), r"actions: fields disagree: missing \['blend'\]"),
        (lambda d: d["actor"]["actions"].update(centre=[0.0]), "actions: centre must be a list of 2 numbers"),
        (lambda d: d["actor"]["actions"].update(low=[1.0, 0.0]), "low <= high"),
        (lambda d: d["actor"]["actions"].update(scale=[-1.0, 0.0]), "scale >= 0"),
        (lambda d: d["actor"]["actions"].update(blend=0), r"blend must lie in \(0, 1\]"),
        (lambda d: d["actor"]["actions"].update(step=-1), "step must be finite and > 0"),
        (lambda d: d["actor"]["actions"].update(step="far"), "step must be a finite number, got 'far'"),
    ],
)
def test_a_damaged_learned_policy_is_refused_in_one_line(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    save_bundle(tmp_path, bundle(perceptron(2)))
    corrupt(tmp_path, change)
    with pytest.raises(BundleError, match=message) as caught:
        load_bundle(tmp_path)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 500
    assert "bundle.json" in str(caught.value)


@pytest.mark.parametrize(
    "weight",
    [[[0.0] * (MOST_SIDE + 1)], [[0.0]] * (MOST_SIDE + 1), [[[[[0.0]]]]], [0.0] * 10**6, [[0.0] * 10**6]],
)
def test_a_policy_that_is_too_large_is_refused_and_at_once(weight: list[Any]) -> None:
    document = bundle_document(bundle(perceptron(2)))
    layer(document)["weight"] = weight
    before = time.process_time()
    with pytest.raises(BundleError, match="weight must be"):
        parse_bundle(document)
    assert time.process_time() - before < 1.0


def test_the_longest_history_is_read() -> None:
    policy = perceptron(2, history=MOST_HISTORY, units=(4,))
    assert parse_bundle(bundle_document(bundle(policy))).actor.layout.history == MOST_HISTORY


@pytest.mark.parametrize(
    "text", ["[" * 200_000, '{"version":' * 100_000, "9" * 5000, f'{{"version": 1{"0" * 4000}}}', "", "{", '{"a": 1} x']
)
def test_text_that_no_one_can_read_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "bundle.json").write_text(text)
    with pytest.raises(BundleError, match=r"bundle\.json") as caught:
        load_bundle(tmp_path)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 500


def test_missing_and_unreadable_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=r"has no bundle\.json"):
        load_bundle(tmp_path / "nowhere")
    (tmp_path / "bundle.json").write_bytes(b"\xff\xfe{")
    with pytest.raises(BundleError, match="not a JSON file"):
        load_bundle(tmp_path)
    (tmp_path / "bundle.json").write_text("[1, 2]")
    with pytest.raises(BundleError, match="must be a JSON object"):
        load_bundle(tmp_path)


def test_actor_and_joints_must_agree() -> None:
    with pytest.raises(BundleError, match="drives 1 joints, the bundle has 2"):
        bundle(Gait(1.0, np.ones(1), np.ones(1), np.ones(1)))
