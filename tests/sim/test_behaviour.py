"""What motors and links did, and the words for what a real motor could not do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from policies import holding

from mfg.description import Description
from sim.actor import Gait
from sim.behaviour import MotorLimits, MotorUse, motor_limits, motor_uses, motor_warnings, stance
from sim.closed_loop import roll_out_policy
from sim.model import Model, compile_model
from sim.rollout import Rollouts, roll_out, settle
from sim.skin import Fidelity

STILL = Gait(1.0, np.zeros(4), np.zeros(4), np.zeros(4))


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Model:
    return compile_model(quadruped)


@pytest.fixture(scope="module")
def walk(model: Model) -> Rollouts:
    rng = np.random.default_rng(1)
    return roll_out(model, [STILL, Gait(1.5, rng.uniform(0.3, 0.5, 4), rng.uniform(0, 6, 4), np.zeros(4))], 2.0)


def test_the_limits_are_those_of_the_catalogues_motor(quadruped: Description, model: Model) -> None:
    for limit, joint in zip(motor_limits(model), quadruped.joints, strict=True):
        motor = joint.motor
        assert limit.joint == joint.name
        assert_allclose([limit.peak, limit.continuous], [motor.peak_torque, motor.continuous_torque])
        assert_allclose([limit.stall, limit.no_load], [2 * motor.peak_torque, motor.max_speed], rtol=1e-9)


@given(st.floats(-40.0, 40.0))
def test_a_motor_gives_its_peak_and_less_where_its_line_is_lower(speed: float) -> None:
    limit = MotorLimits("a", 20.0, 6.0, 40.0, 24.0)
    found = float(limit.available(speed))
    assert 0.0 <= found <= 20.0
    if speed <= 12.0:
        assert found == 20.0
    elif speed < 24.0:
        assert found == pytest.approx(40.0 * (1 - speed / 24.0))
    else:
        assert found == 0.0


def test_uses_are_taken_from_all_physics_steps(model: Model, walk: Rollouts) -> None:
    for j, (use, limit) in enumerate(zip(motor_uses(model, walk, 1), motor_limits(model), strict=True)):
        assert use.joint == limit.joint
        assert use.peak_torque == walk.peak_torque[1, j] >= np.abs(walk.torque[1, :, j]).max()
        assert use.peak_share == pytest.approx(use.peak_torque / limit.peak)
        assert use.rms_share == pytest.approx(walk.rms_torque[1, j] / limit.continuous)
        assert use.peak_speed == np.abs(walk.speed[1, :, j]).max() > 0.5
        assert use.speed_share == pytest.approx(use.peak_speed / limit.no_load)
        assert 0.0 <= use.at_limit < 0.2
        assert set(use.to_json()) == {"joint", "peak_torque_Nm", "peak_share", "rms_torque_Nm", "rms_share",
                                      "peak_speed_rad_s", "speed_share", "at_limit"}  # fmt: skip
    assert all(use.peak_speed < 0.05 for use in motor_uses(model, walk, 0))
    assert motor_warnings(motor_limits(model), motor_uses(model, walk, 0)) == ()


def test_a_motor_at_its_limit_is_counted_by_the_direction_of_its_torque(model: Model, walk: Rollouts) -> None:
    limit = motor_limits(model)[0]
    torque, speed = np.zeros((1, 5, 4)), np.zeros((1, 5, 4))
    speed[0, :, 0] = 18.0, -18.0, 18.0, -18.0, 0.0
    line = float(limit.available(18.0))
    assert line < limit.peak
    torque[0, :, 0] = line, line, -line, -line, limit.peak  # driving, braking, braking, driving, stalled
    use = motor_uses(model, replace(walk, torque=torque, speed=speed))[0]
    assert use.at_limit == pytest.approx(3 / 5)


def test_the_words_name_joint_number_and_consequence() -> None:
    limit = MotorLimits("knee", 20.0, 6.6, 40.0, 24.0)
    easy = MotorUse("knee", 10.0, 0.5, 3.0, 3.0 / 6.6, 10.0, 10 / 24, 0.0)
    assert motor_warnings([limit], [easy]) == ()
    hot = replace(easy, rms_torque=9.1, rms_share=9.1 / 6.6)
    assert motor_warnings([limit], [hot]) == (
        "knee needs 9.1 N.m rms, its motor bears 6.6 N.m for long: it would overheat",
    )
    weak, fast = replace(easy, at_limit=0.23), replace(easy, peak_speed=26.0, speed_share=26 / 24)
    said = motor_warnings([limit] * 2, [weak, fast])
    assert "for 23% of the time: it cannot follow its targets" in said[0]
    assert "turns at up to 26.0 rad/s, its motor without load at 24.0 rad/s" in said[1]
    assert len(motor_warnings([limit], [replace(hot, at_limit=0.5, speed_share=1.2)])) == 3


def test_a_standing_robot_stands_on_its_legs(model: Model, walk: Rollouts) -> None:
    found = stance(model, walk)
    assert found.links == ("torso", "leg_1", "leg_2", "leg_3", "leg_4")
    assert found.touching.shape == (101, 5)
    assert not found.touching[:, 0].any()
    assert found.touching[:, 1:].mean() > 0.95
    moving = stance(model, walk, 1).touching[:, 1:]
    assert 0.05 < moving.mean() < 0.95


def test_a_robot_in_the_air_touches_nothing_and_one_on_its_back_its_root(model: Model, walk: Rollouts) -> None:
    qpos = walk.qpos[:1].copy()
    qpos[..., 2] += 1.0
    assert not stance(model, replace(walk, qpos=qpos)).touching.any()
    qpos[..., 2], qpos[..., 3:7] = 0.05, (0.0, 1.0, 0.0, 0.0)
    assert stance(model, replace(walk, qpos=qpos)).touching[:, 0].all()


@pytest.mark.parametrize("fidelity", [Fidelity.SPRUNG, Fidelity.FLEX])
def test_skin_that_is_a_thing_of_its_own_counts_as_its_link(quadruped: Description, fidelity: Fidelity) -> None:
    soft = tuple(replace(link, skin_thickness=0.02) for link in quadruped.links)
    model = compile_model(replace(quadruped, links=soft), fidelity=fidelity)
    found = stance(model, roll_out_policy(model, holding(np.zeros(4)), 0.2, start=settle(model)))
    assert found.links == ("torso", "leg_1", "leg_2", "leg_3", "leg_4")
    assert found.touching[:, 1:].mean() > 0.9
    assert not found.touching[:, 0].any()
