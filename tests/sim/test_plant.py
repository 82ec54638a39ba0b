"""The plant gives the torque that was asked for, within the motor's limits, after its latency, in the order asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfg.description import Description
from mfg.parts import J60_6
from sim.actor import Gait, smooth_step
from sim.model import ModelError, compile_model, drive_of, make_spec
from sim.plant import TIMESTEP, Plant
from sim.rollout import CONTROL_PERIOD, LEAD_IN, roll_out, settle

LEGS = np.zeros(4)


def saved(description: Description, folder: Path) -> Path:
    spec = make_spec(description)
    spec.compile()
    path = folder / "robot.xml"
    path.write_text(spec.to_xml())
    return path


def test_it_stands_at_rest_and_its_imu_feels_down(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    gravity, gyro = plant.imu()
    assert_allclose(gravity, [0.0, 0.0, -1.0], atol=1e-3)
    assert_allclose(gyro, 0.0, atol=1e-3)
    assert_allclose(plant.base_position[2], quadruped.standing_height, atol=1e-3)
    assert_allclose(plant.joint_positions, 0.0, atol=0.05)
    assert plant.time == 0.0


def test_the_imu_reports_in_its_own_frame(quadruped: Description) -> None:
    tipped = np.eye(4)
    tipped[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # the sensor's y is the body's z
    gravity, _ = Plant.of(replace(quadruped, T_link_imu=tipped)).imu()
    assert_allclose(gravity, [0.0, -1.0, 0.0], atol=1e-3)


def test_the_gyro_is_the_rate_of_the_gravity_vector(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    for k in range(60):
        plant.step(0.5 * np.sin(0.3 * k + np.arange(4)), LEGS, LEGS + 40, LEGS + 1.6, LEGS, 0.01)
    before, rate = plant.imu()
    plant.step(LEGS, LEGS, LEGS + 40, LEGS + 1.6, LEGS, TIMESTEP)
    after, rate_after = plant.imu()
    # A fixed direction seen from a turning frame: dg/dt = -omega x g.
    middle = (rate + rate_after) / 2
    assert_allclose((after - before) / TIMESTEP, -np.cross(middle, (before + after) / 2), atol=0.1)
    assert np.linalg.norm(rate) > 0.05


def test_a_joint_goes_where_it_is_told(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    target = np.array([0.3, -0.2, 0.1, 0.4])
    for _ in range(200):
        plant.step(target, LEGS, LEGS + 200, LEGS + 10, LEGS, 0.01)
    assert_allclose(plant.joint_positions, target, atol=0.05)


def test_feedforward_comes_out_as_torque_and_a_limp_motor_gives_none(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    wanted = np.array([0.5, -1.0, 0.25, 0.0])
    plant.step(LEGS, LEGS, LEGS, LEGS, wanted, 0.05)
    assert_allclose(plant.joint_torques, wanted, atol=1e-9)
    plant.step(LEGS, LEGS, LEGS, LEGS, LEGS, 0.05)
    assert_allclose(plant.joint_torques, 0.0, atol=1e-9)


def test_torque_stops_at_the_peak(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    plant.step(LEGS, LEGS, LEGS, LEGS, LEGS + 39.0, 0.012)
    assert_allclose(plant.joint_torques, J60_6.peak_torque)


def test_a_joint_cannot_be_driven_past_the_no_load_speed(pendulum: Description) -> None:
    plant = Plant.of(replace(pendulum, standing_height=1000.0))  # nothing to hit as it falls
    fastest = 0.0
    for _ in range(60):
        plant.step([0.0], [0.0], [0.0], [0.0], [39.0], 0.002)
        fastest = max(fastest, float(plant.joint_velocities[0]))
    assert 0.5 * J60_6.max_speed < fastest < 1.02 * J60_6.max_speed


def test_a_command_is_felt_after_the_latency(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    felt = []
    for _ in range(12):
        plant.step(LEGS, LEGS, LEGS, LEGS, LEGS + 1.0, TIMESTEP)
        felt.append(plant.joint_torques[0] > 0.5)
    assert felt.index(True) == round(J60_6.latency / TIMESTEP)


def test_time_never_drifts_from_the_bus(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    for _ in range(300):
        plant.step(LEGS, LEGS, LEGS, LEGS, LEGS, 0.00037)
    assert_allclose(plant.time, 300 * 0.00037, atol=TIMESTEP)


def test_the_same_commands_give_the_same_bytes(quadruped: Description) -> None:
    def run() -> bytes:
        plant = Plant.of(quadruped)
        for k in range(40):
            plant.step(0.5 * np.sin(0.3 * k + np.arange(4)), LEGS, LEGS + 40, LEGS + 1.6, LEGS, 0.01)
        return plant.joint_positions.tobytes() + plant.base_position.tobytes()

    assert run() == run()


def test_a_file_loads_and_its_joints_come_in_the_order_asked(quadruped: Description, tmp_path: Path) -> None:
    path = saved(quadruped, tmp_path)
    names = ["joint_3", "joint_1", "joint_4", "joint_2"]
    plant = Plant.load(path, names)
    assert plant.names == tuple(names)
    target = np.array([0.3, -0.2, 0.1, 0.4])
    for _ in range(200):
        plant.step(target, LEGS, LEGS + 200, LEGS + 10, LEGS, 0.01)
    assert_allclose(plant.joint_positions, target, atol=0.05)
    with pytest.raises(ModelError, match="were asked for"):
        Plant.load(path, ["joint_1"])


def test_a_command_must_be_finite_and_of_the_right_size(quadruped: Description) -> None:
    plant = Plant.of(quadruped)
    with pytest.raises(ValueError, match="position is"):
        plant.step(LEGS + np.nan, LEGS, LEGS, LEGS, LEGS, 0.01)
    with pytest.raises(ValueError, match="broadcast"):
        plant.step(np.zeros(3), LEGS, LEGS, LEGS, LEGS, 0.01)


def test_a_rollout_and_the_plant_go_the_same_way(quadruped: Description) -> None:
    """From the same rest under the same targets they are one physics, the latency included."""
    model = compile_model(quadruped, timestep=TIMESTEP)
    gait, seconds = Gait(1.3, LEGS + 0.4, np.array([0.0, 3.0, 3.0, 0.0]), LEGS + 0.1), 2.0
    rolled = roll_out(model, [gait], seconds, settle(model)).qpos[0]
    plant = Plant.of(quadruped)
    kp, kd = LEGS + J60_6.stiffness, LEGS + J60_6.damping
    for _ in range(25):  # a limp motor must hold again before the gait, as it does in a rollout
        plant.step(LEGS, LEGS, kp, kd, LEGS, CONTROL_PERIOD)
    joints = []
    for k in range(round((LEAD_IN + seconds) / CONTROL_PERIOD)):
        t = k * CONTROL_PERIOD
        plant.step(smooth_step(t / LEAD_IN) * gait.targets(t), LEGS, kp, kd, LEGS, CONTROL_PERIOD)
        joints.append(plant.joint_positions)
    expected = rolled[:, drive_of(model).position]
    assert_allclose(np.array(joints)[-len(expected) :], expected, atol=0.01)
