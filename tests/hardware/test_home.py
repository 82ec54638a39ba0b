from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.bundle import Bundle
from hardware.bus import MotorSilent
from hardware.control import drive
from hardware.home import PoseError, check_pose, measure_pose, set_home
from hardware.virtual import Imperfection

Make = Callable[..., Any]


def test_the_pose_is_measured_in_the_joints_own_sense(make_rig: Make) -> None:
    rig = make_rig()
    np.testing.assert_allclose(measure_pose(rig.bus, rig.bundle), [0.5, -0.6, 0.3], atol=1e-3)
    assert not any(node.enabled for node in rig.motors.nodes)


def test_a_lost_frame_is_asked_for_again_and_a_silent_motor_named(make_rig: Make) -> None:
    rig = make_rig(imperfection=Imperfection(drop=0.15))
    np.testing.assert_allclose(measure_pose(rig.bus, rig.bundle), [0.5, -0.6, 0.3], atol=1e-3)
    rig.motors.nodes[1].present = False
    with pytest.raises(MotorSilent, match=r"Motors \[7\] do not say"):
        measure_pose(rig.bus, rig.bundle)


def test_the_margin_is_where_a_pose_becomes_impossible(bundle: Bundle) -> None:
    check_pose(np.array([1.34, -1.34, 0.0]), bundle, 0.15)
    with pytest.raises(PoseError, match=r"hip at 1\.36 \(range -1\.20 to 1\.20\) rad"):
        check_pose(np.array([1.36, -1.34, 0.0]), bundle, 0.15)
    with pytest.raises(PoseError, match="knee"):
        check_pose(np.array([0.0, np.nan, 0.0]), bundle, 0.15)


def test_a_robot_whose_zeros_are_lost_runs_again_after_they_are_set(make_rig: Make) -> None:
    rig = make_rig()
    rig.motors.nodes[1].home = 2.5
    with pytest.raises(PoseError, match="knee at") as caught:
        drive(rig.robot, rig.motors)
    assert "\n" not in str(caught.value)
    assert not any(node.enabled for node in rig.motors.nodes)
    assert np.abs(rig.plant.joint_positions - [0.5, -0.6, 0.3]).max() < 1e-9  # nothing moved
    rig.plant.joint_positions = np.array([0.02, -0.01, 0.0])  # held as painted
    before, after = set_home(rig.bus, rig.bundle)
    assert before[1] == pytest.approx(-0.01 + 2.5, abs=1e-3)
    np.testing.assert_allclose(after, 0.0, atol=1e-3)
    assert [node.home for node in rig.motors.nodes] == pytest.approx([0.02, 0.01, 0.0])
    robot = type(rig.robot)(rig.bus, rig.motors, rig.bundle)
    robot.bring_up()


def test_home_that_is_not_kept_is_refused(make_rig: Make, bundle: Bundle, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = make_rig(replace(bundle))
    poses = iter([np.zeros(3), np.array([0.0, 0.2, 0.0])])
    monkeypatch.setattr("hardware.home.measure_pose", lambda *_: next(poses))
    with pytest.raises(PoseError, match=r"knee at 0\.20; hold still and retry"):
        set_home(rig.bus, rig.bundle)
