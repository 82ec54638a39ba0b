import json
import os
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decoder.design import VoxelDesign
from experiments.deploy import _stop_on_signals, bundle_of, dry_run
from mfg.description import Description, describe
from mfg.pipeline import virtual
from sim.actor import BundleError, Gait, load_bundle, save_bundle
from sim.model import make_spec

Cli = Callable[..., Any]


@pytest.fixture(scope="module")
def robot(hinge: VoxelDesign) -> Description:
    return describe(virtual(hinge).blueprint)


@pytest.fixture(scope="module")
def kept(robot: Description, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("deploy")
    spec = make_spec(robot)
    spec.compile()
    (folder / "model").mkdir()
    (folder / "model" / "robot.xml").write_text(spec.to_xml())
    gait = Gait(1.0, np.array([0.4]), np.zeros(1), np.zeros(1))
    save_bundle(folder / "policy", bundle_of(robot, gait, config_hash="c0ffee"), folder / "model")
    return folder / "policy"


@pytest.fixture
def policy(kept: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(kept, tmp_path / "policy"))


def test_the_bundle_of_a_robot_has_its_joints_and_gains_that_the_wire_keeps(robot: Description, policy: Path) -> None:
    bundle = load_bundle(policy)
    joint, described = bundle.joints[0], robot.joints[0]
    assert bundle.names == (described.name,)
    assert bundle.design == robot.name
    assert bundle.config_hash == "c0ffee"
    assert (joint.can_id, joint.sign, joint.default) == (1, 1, 0.0)
    assert joint.range == tuple(described.range)
    assert (joint.kp, joint.kd) == (described.motor.stiffness, described.motor.damping)
    assert joint.peak_torque == described.motor.peak_torque
    with pytest.raises(BundleError, match="drives 2 joints, the bundle has 1"):
        bundle_of(robot, Gait(1.0, np.zeros(2), np.zeros(2), np.zeros(2)))


def test_a_dry_run_tracks_the_gait_and_prints_the_contract(bodyplan: Cli, policy: Path) -> None:
    said = bodyplan("deploy", policy, "--bus", "virtual", "--dry-run", "--seconds", "2", "--json")
    assert said.status == 0, said.err
    result = json.loads(said.out)
    assert {"ticks", "overruns", "tracking_rms_rad", "speed_m_s", "state", "latched"} <= set(result)
    assert (result["overruns"], result["state"], result["latched"]) == (0, "off", None)
    assert 0.0 < result["tracking_rms_rad"] < 0.12  # of an amplitude of 0.4 rad
    assert result["speed_m_s"] >= 0.0
    assert result == dry_run(policy, 2.0)  # nothing in it depends on the clock on the wall


def test_a_longer_run_has_more_periods_of_policy_only(policy: Path) -> None:
    assert dry_run(policy, 1.0)["ticks"] - dry_run(policy, 0.5)["ticks"] == 25


def test_a_logged_run_replays_and_another_policy_diverges(bodyplan: Cli, policy: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    assert bodyplan("deploy", policy, "--dry-run", "--seconds", "0.5", "--log", log).status == 0
    said = bodyplan("replay", log, "--json")
    result = json.loads(said.out)
    assert (said.status, result["divergence"]) == (0, None)
    assert result["agree"] == result["frames"] > 400
    bundle = load_bundle(policy)
    other = Gait(2.0, bundle.actor.amplitude, bundle.actor.phase, bundle.actor.offset)
    save_bundle(tmp_path / "other", replace(bundle, actor=other))
    said = bodyplan("replay", log, "--bundle", tmp_path / "other", "--json")
    divergence = json.loads(said.out)["divergence"]
    assert said.status == 1
    assert divergence["joint"] == bundle.names[0]
    assert divergence["logged"]["position"] != divergence["recomputed"]["position"]
    assert "divergence in period" in bodyplan("replay", log, "--bundle", tmp_path / "other").out


def test_a_policy_that_jumps_is_stopped_with_status_1(bodyplan: Cli, policy: Path) -> None:
    bundle = load_bundle(policy)
    save_bundle(policy, replace(bundle, actor=Gait(20.0, np.array([0.6]), np.zeros(1), np.zeros(1))))
    said = bodyplan("deploy", policy, "--dry-run", "--json")
    result = json.loads(said.out)
    assert said.status == 1
    assert result["latched"]["guard"] == "target_step"
    assert result["latched"]["joint"] == bundle.names[0]
    assert result["latched"]["value"] > result["latched"]["bound"]
    assert result["state"] == "off"
    assert "stopped by the guard target_step" in bodyplan("deploy", policy, "--dry-run").out


def test_in_real_time_the_same_program_runs_on_the_same_bus(bodyplan: Cli, policy: Path) -> None:
    said = bodyplan("deploy", policy, "--seconds", "0.2", "--json")
    # On a busy machine the loop may be late, and a guard may rightly say so; the motors must end up off either way.
    assert said.status in (0, 1), said.err
    result = json.loads(said.out)
    assert (result["state"], result["unconfirmed_off"]) == ("off", [])


def edit_version(policy: Path) -> None:
    document = json.loads((policy / "bundle.json").read_text())
    (policy / "bundle.json").write_text(json.dumps(document | {"version": 99}))


def edit_gain(policy: Path) -> None:
    text = (policy / "bundle.json").read_text()
    (policy / "bundle.json").write_text(text.replace('"kd": 1.6', '"kd": 1.5'))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda p: shutil.rmtree(p), "has no bundle.json"),
        (lambda p: (p / "robot.xml").unlink(), "has no robot.xml to rehearse with"),
        (lambda p: (p / "robot.xml").write_text("<mujoco><worldbody/></mujoco>"), "missing"),
        (lambda p: (p / "robot.xml").write_text("no xml"), "is not an MJCF file"),
        (edit_version, "version must be 1, got 99"),
        (edit_gain, "the wire makes kp 40, kd 1.5 into kp 40, kd 1.4"),
    ],
)
def test_an_unusable_bundle_is_one_line_and_status_2(
    bodyplan: Cli, policy: Path, damage: Callable[[Path], object], message: str
) -> None:
    damage(policy)
    said = bodyplan("deploy", policy, "--dry-run", "--json")
    assert (said.status, said.out) == (2, "")
    assert message in said.err
    assert len(said.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--bus", "canopen:can0"), "unknown bus 'canopen:can0'"),
        (("--bus", "socketcan:can0", "--dry-run"), "--dry-run moves nothing real"),
        (("--bus", "socketcan:nosuchcan9"), "Cannot open socketcan:nosuchcan9"),
        (("--bus", "slcan:/dev/nosuchtty"), "Cannot open slcan:/dev/nosuchtty"),
        (("--seconds", "nan"), "out of bounds"),
        (("--seconds", "ten"), "not a number"),
        (("--dry-run", "--log", "/nowhere/run.log"), "No such file or directory"),
    ],
)
def test_bad_arguments_are_one_line_and_status_2(
    bodyplan: Cli, policy: Path, words: tuple[str, ...], message: str
) -> None:
    said = bodyplan("deploy", policy, *words)
    assert said.status == 2
    assert message in said.err
    assert "Traceback" not in said.err


def test_what_is_no_log_is_one_line_and_status_2(bodyplan: Cli, policy: Path, tmp_path: Path) -> None:
    for path in (tmp_path / "nothing.log", policy, policy / "bundle.json"):
        said = bodyplan("replay", path)
        assert said.status == 2
        assert len(said.err.strip().splitlines()) == 1


def test_a_polite_kill_ends_as_an_interrupt() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), _stop_on_signals():
        os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before
