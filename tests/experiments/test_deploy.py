import csv
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
from bodies import ellipsoid, painted
from policies import holding, oscillator

from decoder.design import Joint, VoxelDesign
from experiments.deploy import _stop_on_signals, bundle_of, dry_run
from hardware.bundle import BundleError, load_bundle, save_bundle
from hardware.j60 import Code, decode_command, decode_reply, split_id
from hardware.log import read_log, states_path
from hardware.robot import Robot
from hardware.tick import State
from mfg.description import Description, describe
from mfg.export import write_blueprint
from mfg.manifest import read_description
from mfg.pipeline import build, virtual
from sim.actor import Gait, Policy
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
    assert (joint.can_id, joint.sign, joint.default) == (described.can_id, described.sign, 0.0)
    assert joint.range == tuple(described.range)
    assert (joint.kp, joint.kd) == (described.motor.stiffness, described.motor.damping)
    assert joint.peak_torque == described.motor.peak_torque
    with pytest.raises(BundleError, match="drives 2 joints, the bundle has 1"):
        bundle_of(robot, Gait(1.0, np.zeros(2), np.zeros(2), np.zeros(2)))


def test_a_motor_that_nobody_can_drive_has_no_bundle(robot: Description) -> None:
    motor = replace(robot.joints[0].motor, name="Other", driver="none")
    other = replace(robot, joints=tuple(replace(joint, motor=motor) for joint in robot.joints))
    with pytest.raises(BundleError, match="no driver speaks to a Other"):
        bundle_of(other, Gait(1.0, np.zeros(1), np.zeros(1), np.zeros(1)))


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A blueprint folder in which one motor sits in the parent and one in the child."""
    arm = [ellipsoid((x, 32, 32), (11, 9, 9)) for x in (13, 32, 51)]
    joints = tuple(
        Joint(np.array([x * 0.01, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-0.6, 0.6]), i, i + 1)
        for i, x in ((1, 22.5), (2, 41.5))
    )
    outcome = build(painted(arm, joints))
    assert outcome.ok, outcome.failure
    seats = list(outcome.blueprint.seats)
    for index, parent in ((0, True), (1, False)):
        hinge = outcome.blueprint.hinges[index]
        sides = (hinge.parent, hinge.body) if parent else (hinge.body, hinge.parent)
        seats[index] = replace(seats[index], holder=sides[0], connector=sides[1])
    blueprint = replace(outcome.blueprint, seats=tuple(seats))
    return write_blueprint(replace(outcome, blueprint=blueprint), tmp_path_factory.mktemp("mixed") / "robot")


def test_motors_that_sit_in_the_child_turn_the_other_way_everywhere(mixed: Path) -> None:
    bundle = bundle_of(read_description(mixed), Gait(1.0, np.zeros(2), np.zeros(2), np.zeros(2)))
    manifest = json.loads((mixed / "blueprint.json").read_text())["joints"]
    with (mixed / "wiring.csv").open() as file:
        table = {row["to"]: (int(row["can_id"]), int(row["sign"])) for row in csv.DictReader(file)}
    ours = {joint.name: (joint.can_id, joint.sign) for joint in bundle.joints}
    assert ours == table == {joint["name"]: (joint["can_id"], joint["sign"]) for joint in manifest}
    assert sorted(joint.sign for joint in bundle.joints) == [-1, 1]


def test_the_virtual_motor_turns_against_a_joint_whose_child_holds_it(mixed: Path, tmp_path: Path) -> None:
    robot = read_description(mixed)
    gait = Gait(0.0, np.zeros(2), np.zeros(2), np.array([0.3, 0.3]))
    save_bundle(tmp_path / "policy", bundle_of(robot, gait), mixed)
    log = tmp_path / "run.log"
    result = dry_run(tmp_path / "policy", 0.8, log)
    assert result["latched"] is None, result["latched"]
    bundle = load_bundle(tmp_path / "policy")
    last = [json.loads(line) for line in states_path(log).read_text().splitlines()[2:]]
    joints = next(line["position"] for line in reversed(last) if line["state"] == "policy")
    np.testing.assert_allclose(joints, 0.3, atol=0.15)  # both follow the command, but for the load
    commands, replies = {}, {}
    frames = last[[line["state"] for line in last].index("damping") - 1]["frames"]
    for logged in read_log(log).frames[:frames]:
        number, _, motor = split_id(logged.frame.can_id)
        if number == Code.CONTROL:
            (commands if logged.sent else replies)[motor] = logged.frame.data
    for joint, angle in zip(bundle.joints, joints, strict=True):
        assert decode_command(commands[joint.can_id]).position * joint.sign > 0.1
        assert decode_reply(replies[joint.can_id]).position == pytest.approx(joint.sign * angle, abs=1e-9)


def test_a_robot_in_an_impossible_pose_is_refused_and_nothing_moves(bodyplan: Cli, policy: Path) -> None:
    bundle = load_bundle(policy)
    save_bundle(policy, replace(bundle, joints=(replace(bundle.joints[0], range=(0.4, 0.9), default=0.5),)))
    said = bodyplan("deploy", policy, "--dry-run", "--json")
    assert (said.status, said.out) == (2, "")
    assert len(said.err.strip().splitlines()) == 1
    assert f"{bundle.names[0]} at" in said.err
    assert "range 0.40 to 0.90" in said.err
    assert "--set-home" in said.err


@pytest.mark.parametrize("extra", [("--dry-run",), ()])
def test_setting_home_drives_nothing_and_tells_the_pose(bodyplan: Cli, policy: Path, extra: tuple[str, ...]) -> None:
    said = bodyplan("deploy", policy, *extra, "--set-home", "--json")
    result = json.loads(said.out)
    assert said.status == 0
    assert result["joints"] == list(load_bundle(policy).names)
    assert np.abs(result["after_rad"]).max() < 0.05
    assert "zero set" in bodyplan("deploy", policy, "--dry-run", "--set-home").out


@pytest.mark.parametrize("moment", ["hold", "policy"])
def test_ctrl_c_brakes_and_tells_what_came_of_it_until_then(
    bodyplan: Cli, policy: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    tick = Robot.tick

    def stopped(robot: Robot, index: int, *rest: Any) -> Any:
        if robot.state is State(moment) and index % 10 == 5:
            raise KeyboardInterrupt
        return tick(robot, index, *rest)

    monkeypatch.setattr(Robot, "tick", stopped)
    said = bodyplan("deploy", policy, "--dry-run", "--json")
    result = json.loads(said.out)
    assert (said.status, result["interrupted"], result["state"]) == (1, True, "off")
    assert result["unconfirmed_off"] == []
    assert (result["tracking_rms_rad"] is None) is (moment == "hold")
    with pytest.raises(KeyboardInterrupt):  # within a run, which can be resumed, it must go on
        dry_run(policy, 1.0)


def test_ctrl_c_before_anything_moves_is_not_resumable_either(
    bodyplan: Cli, policy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("experiments.deploy._load_plant", stopped)
    said = bodyplan("deploy", policy, "--dry-run", "--json")
    assert (said.status, said.out) == (1, "")
    assert "interrupted; no motor was driven" in said.err


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


@pytest.mark.parametrize("actor", [holding(np.array([0.3])), oscillator(1)])
def test_a_learned_policy_is_rehearsed_and_replayed(
    bodyplan: Cli, robot: Description, kept: Path, tmp_path: Path, actor: Policy
) -> None:
    policy, log = tmp_path / "learned", tmp_path / "run.log"
    save_bundle(policy, bundle_of(robot, actor), kept)
    said = bodyplan("deploy", policy, "--dry-run", "--seconds", "5", "--log", log, "--json")
    result = json.loads(said.out)
    assert (said.status, result["latched"], result["state"]) == (0, None, "off"), said.err
    states = [json.loads(line) for line in states_path(log).read_text().splitlines()[2:]]
    angles = np.array([line["position"][0] for line in states if line["state"] == "policy"])
    if actor.layout.history == 1:
        assert angles[-1] == pytest.approx(0.3, abs=0.15)  # but for the load
    else:
        assert np.ptp(angles[-75:]) > 0.1
    said = bodyplan("replay", log, "--json")
    assert (said.status, json.loads(said.out)["divergence"]) == (0, None)
    save_bundle(tmp_path / "other", bundle_of(robot, holding(np.array([-0.2]))))
    assert bodyplan("replay", log, "--bundle", tmp_path / "other").status == 1


def test_a_learned_policy_needs_an_imu_on_a_real_bus(
    bodyplan: Cli, robot: Description, kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_bundle(tmp_path / "learned", bundle_of(robot, oscillator(1)), kept)
    monkeypatch.setattr("hardware.bus.open_port", lambda _: pytest.fail("a bus was opened"))
    said = bodyplan("deploy", tmp_path / "learned", "--bus", "socketcan:can0")
    assert (said.status, said.out) == (2, "")
    assert "needs an IMU" in said.err
    assert len(said.err.strip().splitlines()) == 1


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
        (edit_version, "version must be 2, got 99"),
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
        (("--set-home", "--log", "run.log"), "--set-home drives nothing"),
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
