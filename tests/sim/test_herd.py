"""Copies of one robot: each by itself, in the order of the model's actuators, and told apart when one is lost."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfg.description import Description
from sim.herd import MOST_LATENCY, Herd, with_latency_room
from sim.model import Model, compile_model, drive_of, make_spec
from sim.rollout import settle


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Model:
    return compile_model(quadruped)


def placed(model: Model, count: int, nthread: int = 1) -> Herd:
    herd = Herd(model, count, nthread=nthread)
    herd.place(np.arange(count), np.repeat(settle(model)[None], count, axis=0))
    return herd


def test_room_for_latency_changes_no_motion(quadruped: Description, model: Model) -> None:
    roomy = with_latency_room(make_spec(quadruped))
    assert roomy.actuator_history[:, 0].min() * roomy.opt.timestep >= MOST_LATENCY
    assert_allclose(roomy.actuator_delay, model.actuator_delay)
    rng = np.random.default_rng(0)
    targets = rng.uniform(-0.5, 0.5, (20, 1, 4))
    found = []
    for one in (model, roomy):
        herd = placed(one, 1)
        for target in targets:
            herd.advance(target)
        found.append(herd.qpos.copy())
    assert found[0].tobytes() == found[1].tobytes()


def test_a_motor_without_latency_gets_the_least_there_is(pendulum: Description) -> None:
    spec = make_spec(pendulum)
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample = 0.0, 0
    roomy = with_latency_room(spec, 0.02)
    assert roomy.actuator_delay.tolist() == [roomy.opt.timestep]
    assert roomy.actuator_history[0, 0] == 5


def test_a_period_is_so_many_steps_of_the_model(model: Model) -> None:
    herd, data = placed(model, 3), mujoco.MjData(model)
    mujoco.mj_setState(model, data, settle(model), mujoco.mjtState.mjSTATE_INTEGRATION)
    for k in range(10):
        targets = 0.3 * np.sin(k + np.arange(12.0)).reshape(3, 4)
        data.ctrl[:] = targets[1]
        assert not herd.advance(targets).any()
        mujoco.mj_step(model, data, nstep=5)
    drive = drive_of(model)
    assert herd.names == drive.names
    assert_allclose(herd.qpos[1], data.qpos, rtol=0, atol=1e-12)
    assert_allclose(herd.positions[1], data.qpos[drive.position], rtol=0, atol=1e-12)
    assert_allclose(herd.velocities[1], data.qvel[drive.velocity], rtol=0, atol=1e-10)
    assert_allclose(herd.torques[1], data.actuator_force, rtol=0, atol=1e-9)
    mujoco.mj_forward(model, data)
    assert_allclose(herd.centre_of_mass[1], data.subtree_com[1], rtol=0, atol=1e-12)


def test_what_is_read_does_not_change_afterwards(model: Model) -> None:
    herd = placed(model, 2)
    read = [herd.positions, herd.velocities, herd.torques, herd.centre_of_mass, *herd.imu()]
    kept = [value.copy() for value in read]
    for _ in range(5):
        herd.advance(np.full((2, 4), 0.5))
    for value, was in zip(read, kept, strict=True):
        assert value.tobytes() == was.tobytes()
    assert np.abs(herd.positions - kept[0]).max() > 0.1


def test_placing_one_copy_leaves_the_others_where_they_are(model: Model) -> None:
    herd, other = placed(model, 3), placed(model, 3)
    for k in range(6):
        herd.advance(np.full((3, 4), 0.05 * k))
        other.advance(np.full((3, 4), 0.05 * k))
    herd.place(np.array([1]), settle(model)[None])
    herd.place(np.array([], dtype=np.intp), np.zeros((0, herd.batch.nstate)))
    for k in range(6):
        herd.advance(np.full((3, 4), 0.05 * k))
        other.advance(np.full((3, 4), 0.05 * k))
    assert herd.qpos[[0, 2]].tobytes() == other.qpos[[0, 2]].tobytes()
    fresh = placed(model, 1)
    for k in range(6):
        fresh.advance(np.full((1, 4), 0.05 * k))
    # Nothing is left of what it did before: neither commands on their way nor the clock.
    assert herd.qpos[1].tobytes() == fresh.qpos[0].tobytes()


def test_a_lost_copy_is_told_apart_and_comes_back_when_it_is_placed(model: Model) -> None:
    herd = placed(model, 3)
    herd.qvel[1, :] = 1e9
    assert herd.advance(np.zeros((3, 4))).tolist() == [False, True, False]
    assert herd.advance(np.zeros((3, 4))).tolist() == [False, True, False]
    herd.place(np.array([1]), settle(model)[None])
    assert herd.advance(np.zeros((3, 4))).tolist() == [False, False, False]
    calm = placed(model, 3)
    calm.advance(np.zeros((3, 4)))
    assert herd.qpos[1].tobytes() == calm.qpos[1].tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_targets_that_are_no_number_lose_that_copy_only(model: Model, value: float) -> None:
    herd, calm = placed(model, 2), placed(model, 2)
    targets = np.zeros((2, 4))
    targets[0, 2] = value
    lost = [herd.advance(targets) for _ in range(3)][-1]
    for _ in range(3):
        calm.advance(np.zeros((2, 4)))
    assert lost.tolist() == [True, False]
    assert herd.qpos[1].tobytes() == calm.qpos[1].tobytes()


def test_a_herd_that_cannot_be_is_refused(model: Model) -> None:
    with pytest.raises(ValueError, match="a herd of 0 copies of quadruped"):
        Herd(model, 0)
    for period in (0.0, 0.003, 0.0221):
        with pytest.raises(ValueError, match=r"no whole number of steps of 0\.004 s"):
            Herd(model, 1, period=period)
    assert Herd(model, 1, period=0.008).substeps == 2
