import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.bundle import Bundle, BundleError, JointSetup, load_bundle, save_bundle
from sim.actor import Gait, low_pass

finite = st.floats(-10.0, 10.0)
MJCF = (
    "<mujoco><worldbody><body><freejoint/>"
    '<body><joint name="hip"/></body><body><joint name="knee"/></body></body></worldbody></mujoco>'
)


def joint(name: str = "hip", can_id: int = 1, **changes: Any) -> JointSetup:
    return replace(JointSetup(name, can_id, 1, (-1.0, 1.2), 0.1, 40.0, 1.6, 19.94, 6.6, 24.18), **changes)


def bundle(actor: Gait | None = None, **changes: Any) -> Bundle:
    actor = actor or Gait(1 / 3, np.array([0.1, np.pi / 7]), np.array([0.0, 1e-17]), np.array([0.2, -0.3]))
    return replace(Bundle("d" * 16, (joint(), joint("knee", 2, sign=-1)), actor, 0.02, 0.05, "abc"), **changes)


def corrupt(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "bundle.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


@given(st.floats(0.0, 3.0), finite, finite, finite, st.floats(0.0, 20.0))
def test_gait_follows_its_law_and_its_period(
    frequency: float, amplitude: Any, phase: Any, offset: float, time: float
) -> None:
    gait = Gait(frequency, np.array([amplitude, 0.0]), np.array([phase, phase]), np.array([offset, 1.0]))
    expected = offset + amplitude * np.sin(2 * np.pi * frequency * time + phase)
    np.testing.assert_allclose(gait.targets(time), [expected, 1.0], atol=1e-12)
    if frequency > 0.1:
        np.testing.assert_allclose(gait.targets(time + 1 / frequency), gait.targets(time), atol=1e-9)
    np.testing.assert_array_equal(gait.act(time, np.zeros(12)), gait.targets(time))


def test_gait_of_many_times_is_the_gait_of_each() -> None:
    gait = bundle().actor
    times = np.linspace(0, 2, 6).reshape(2, 3)
    batch = gait.targets(times)
    assert batch.shape == (2, 3, 2)
    np.testing.assert_allclose(batch[1, 2], gait.targets(times[1, 2]), rtol=1e-15)


def test_gait_keeps_its_own_frozen_copy() -> None:
    amplitude = np.ones(2)
    gait = Gait(1.0, amplitude, np.zeros(2), np.zeros(2))
    amplitude[0] = 5.0
    assert gait.amplitude[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        gait.amplitude[0] = 2.0


@pytest.mark.parametrize(
    ("frequency", "amplitude", "phase", "message"),
    [
        (np.nan, np.ones(2), np.ones(2), "frequency"),
        (-1.0, np.ones(2), np.ones(2), "frequency"),
        (1.0, np.array([1.0, np.inf]), np.ones(2), "amplitude must be finite"),
        (1.0, np.ones(2), np.ones(3), "phase must be"),
        (1.0, np.ones((2, 1)), np.ones((2, 1)), "amplitude must be"),
    ],
)
def test_gait_refuses_bad_parameters(frequency: float, amplitude: Any, phase: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Gait(frequency, amplitude, phase, np.zeros(2))


def test_low_pass_composes_in_time_and_settles() -> None:
    start, target = np.zeros(2), np.array([1.0, -2.0])
    twice = low_pass(low_pass(start, target, 0.01, 0.1), target, 0.01, 0.1)
    np.testing.assert_allclose(twice, low_pass(start, target, 0.02, 0.1), rtol=1e-12)
    np.testing.assert_allclose(low_pass(start, target, 10.0, 0.1), target, rtol=1e-12)
    assert low_pass(start, target, 0.02, 0.0) is target


def test_bundle_round_trip_is_exact(tmp_path: Path) -> None:
    original = bundle()
    save_bundle(tmp_path / "b", original)
    loaded = load_bundle(tmp_path / "b")
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
        (lambda d: d.update(version=2), "version must be 1, got 2"),
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
