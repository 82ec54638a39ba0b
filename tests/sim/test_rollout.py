"""A rollout is the physics of one robot, the same bytes however it is batched, and the measures keep their laws."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mfg.description import Description
from sim.actor import Gait, smooth_step
from sim.model import Model, compile_model
from sim.rollout import (
    CONTROL_PERIOD,
    FALL_TILT,
    LEAD_IN,
    Diverged,
    Rollouts,
    body_velocity,
    measure,
    roll_out,
    settle,
    simulate,
)
from sim.surfaces import body_length

PERIOD = np.arange(501) * CONTROL_PERIOD


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Model:
    return compile_model(quadruped)


def gaits(count: int) -> list[Gait]:
    rng = np.random.default_rng(5)
    return [
        Gait(1.0 + 0.1 * k, rng.uniform(0.2, 0.6, 4), rng.uniform(0, 6, 4), rng.uniform(-0.2, 0.2, 4))
        for k in range(count)
    ]


def test_the_bytes_do_not_depend_on_threads_batches_or_repetition(quadruped: Description, model: Model) -> None:
    start = settle(model)
    one = roll_out(model, gaits(3), 1.0, start)
    two = roll_out(compile_model(quadruped), gaits(3), 1.0, settle(model), nthread=2)
    alone = roll_out(model, gaits(3)[2:], 1.0, start)
    for field in ("qpos", "com", "up", "yaw", "peak_torque", "rms_torque", "work"):
        assert getattr(one, field).tobytes() == getattr(two, field).tobytes(), field
        assert getattr(one, field)[2].tobytes() == getattr(alone, field)[0].tobytes(), field


def test_a_rollout_is_a_plain_loop_of_steps(model: Model) -> None:
    gait, seconds = gaits(1)[0], 0.5
    rolled = roll_out(model, [gait], seconds)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, settle(model), mujoco.mjtState.mjSTATE_INTEGRATION)
    positions = []
    for k in range(round((LEAD_IN + seconds) / CONTROL_PERIOD)):
        t = k * CONTROL_PERIOD
        data.ctrl[:] = smooth_step(t / LEAD_IN) * gait.targets(t)
        mujoco.mj_step(model, data, nstep=5)
        positions.append(data.qpos.copy())
    lead = round(LEAD_IN / CONTROL_PERIOD)
    assert_allclose(rolled.qpos[0], positions[lead - 1 :], rtol=0, atol=1e-12)


def test_a_robot_that_holds_still_goes_nowhere(quadruped: Description) -> None:
    still = simulate(quadruped, Gait(1.0, np.zeros(4), np.zeros(4), np.zeros(4)), 3.0)
    assert still.distance < 2e-3
    assert still.speed < 1e-3
    assert not still.fell
    assert still.upright == 1.0
    assert still.seconds == pytest.approx(3.0)
    assert still.body_length == pytest.approx(body_length(compile_model(quadruped)))


def test_the_json_keys_are_the_contracts(quadruped: Description) -> None:
    document = simulate(quadruped, gaits(1)[0], 1.0).to_json()
    contract = {"seconds", "distance_m", "speed_m_s", "body_length_m", "fell", "cost_of_transport", "max_torque_Nm",
                "steps_per_s"}  # fmt: skip
    assert contract <= set(document)


def synthetic(path: np.ndarray, yaw: np.ndarray, tilt: np.ndarray | None = None, failed: bool = False) -> Rollouts:
    k = len(path)
    tilt = np.zeros(k) if tilt is None else tilt
    return Rollouts(
        qpos=np.zeros((1, k, 11)), com=np.column_stack([path, np.full(k, 0.1)])[None],
        up=np.stack([np.sin(tilt), np.zeros(k), np.cos(tilt)], axis=1)[None], yaw=yaw[None],
        peak_torque=np.array([[1.0, 5.0, 2.0, 3.0]]), rms_torque=np.array([[1.0, 2.0, 1.0, 1.0]]),
        torque=np.zeros((1, k, 4)), speed=np.zeros((1, k, 4)), work=np.array([30.0]), failed=np.array([failed]),
        steps_per_s=1.0,
    )  # fmt: skip


def test_measures_of_a_straight_walk(quadruped: Description, model: Model) -> None:
    heading, speed = 0.7, 0.25
    path = speed * PERIOD[:, None] * [np.cos(heading), np.sin(heading)]
    found = measure(model, synthetic(path, np.zeros(501)))[0]
    assert found is not None
    assert_allclose([found.distance, found.speed, found.heading], [2.5, speed, heading])
    assert_allclose(found.cost_of_transport, 30.0 / (quadruped.mass * 9.81 * 2.5))
    assert found.max_torque == 5.0
    assert_allclose(found.overload, 2.0 / quadruped.joints[1].motor.continuous_torque)


def test_a_fall_is_a_tilt_beyond_the_bound(model: Model) -> None:
    path = PERIOD[:, None] * [0.2, 0.0]
    for bound, fell in ((0.99 * FALL_TILT, False), (1.01 * FALL_TILT, True)):
        tilt = np.where(PERIOD >= 4.0, bound, 0.0)
        found = measure(model, synthetic(path, np.zeros(501), tilt))[0]
        assert found is not None
        assert found.fell is fell
        assert_allclose(found.upright, 0.4 if fell else 1.0)


def test_a_robot_put_upside_down_by_its_gait_has_fallen(quadruped: Description, model: Model) -> None:
    start = settle(model)
    over = start.copy()
    over[1 + 3 : 1 + 7] = 0.0, 1.0, 0.0, 0.0  # half a turn about x: it lies on its back
    still = Gait(1.0, np.zeros(4), np.zeros(4), np.zeros(4))
    rolled = roll_out(model, [still], 1.0, over)
    assert_allclose(rolled.up[0, :, 2], 1.0, atol=1e-2)  # upright is how it stood at the start, whatever that was
    moved = rolled.qpos[0, -1].copy()
    assert moved[3] < 0.1


def test_an_explosion_is_flagged_and_has_no_behaviour(quadruped: Description, model: Model) -> None:
    start = settle(model)
    wild = start.copy()
    wild[1 + model.nq : 1 + model.nq + 6] = 1e8  # faster than any physics
    still = Gait(1.0, np.zeros(4), np.zeros(4), np.zeros(4))
    rolled = roll_out(model, [still], 1.0, wild)
    assert rolled.failed.tolist() == [True]
    assert measure(model, rolled) == [None]
    assert measure(model, synthetic(PERIOD[:, None] * [0.2, 0.0], np.zeros(501), failed=True)) == [None]


def test_a_simulation_that_explodes_is_an_error_that_names_the_robot(
    quadruped: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.rollout.SPEED_BOUND", 1e-3)  # so that any movement counts as an explosion
    with pytest.raises(Diverged, match="quadruped exploded within 1 s"):
        simulate(quadruped, gaits(1)[0], 1.0)


def test_gaits_for_another_robot_are_refused(model: Model) -> None:
    with pytest.raises(ValueError, match=r"the gaits drive \[2\] joints, robot quadruped has 4"):
        roll_out(model, [Gait(1.0, np.zeros(2), np.zeros(2), np.zeros(2))], 1.0)
    with pytest.raises(ValueError, match="the gaits drive"):
        roll_out(model, [], 1.0)


@given(st.floats(-3, 3), st.floats(0.0, 0.5), st.floats(-3, 3))
def test_speed_does_not_depend_on_where_the_world_points(turn: float, speed: float, heading: float) -> None:
    path = speed * PERIOD[:, None] * [np.cos(heading), np.sin(heading)]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    plain = body_velocity(path, np.zeros(501))
    turned = body_velocity(path @ rotation.T, np.full(501, turn))
    assert_allclose(turned, plain, atol=1e-12)
    assert_allclose(np.linalg.norm(plain), speed, atol=1e-12)


def test_a_slow_curve_keeps_its_speed_and_a_fast_spin_has_none() -> None:
    def circle(turns: float) -> tuple[np.ndarray, np.ndarray]:
        yaw = 2 * np.pi * turns * PERIOD / 10.0
        radius = 10.0 * 0.3 / (2 * np.pi * turns)
        return radius * np.stack([np.sin(yaw), 1 - np.cos(yaw)], axis=1), yaw

    assert 0.28 < np.linalg.norm(body_velocity(*circle(0.5))) < 0.3
    assert np.linalg.norm(body_velocity(*circle(5.0))) < 1e-9
    there_and_back = 0.3 * np.abs(np.mod(PERIOD, 2.0) - 1.0)[:, None] * [1.0, 0.0]
    assert np.linalg.norm(body_velocity(there_and_back, np.zeros(501))) < 1e-9


def test_a_rollout_feels_a_command_after_the_latency(model: Model) -> None:
    """The fall before a rollout leaves nothing in the delay line that would let commands through early."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, settle(model), mujoco.mjtState.mjSTATE_INTEGRATION)
    felt = []
    for _ in range(8):
        data.ctrl[:] = 0.2
        mujoco.mj_step(model, data)
        felt.append(bool(data.actuator_force[0] > 2.0))
    assert felt.index(True) == round(model.actuator_delay[0] / model.opt.timestep)
