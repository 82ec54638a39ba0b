"""The loop of the robot's computer around copies of its model: the same physics, the same senses, whoever is beside."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from policies import action_map, holding, oscillator, perceptron

from mfg.description import Description
from sim.actor import Gait, low_pass, smooth_step
from sim.closed_loop import Senses, roll_out_actor, roll_out_policy
from sim.herd import Herd, with_latency_room
from sim.model import IMU, Model, compile_model, default_pose, make_spec
from sim.observation import ObservationLayout
from sim.randomisation import RANDOMISED, Draws, Noise, draw, nominal
from sim.rollout import CONTROL_PERIOD, LEAD_IN, Rollouts, measure, roll_out, settle

FIELDS = ("qpos", "com", "up", "yaw", "peak_torque", "rms_torque", "torque", "speed", "work", "failed")
WALK = perceptron(4, 7, history=2, gain=2.0, actions=action_map(4, blend=0.6, step=0.2))


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Model:
    return compile_model(quadruped)


@pytest.fixture(scope="module")
def roomy(quadruped: Description) -> Model:
    return with_latency_room(make_spec(quadruped))


def gait(seed: int = 5) -> Gait:
    rng = np.random.default_rng(seed)
    return Gait(1.2, rng.uniform(0.2, 0.5, 4), rng.uniform(0, 6, 4), rng.uniform(-0.2, 0.2, 4))


def drawn(count: int, seed: int = 0, **changes: object) -> Draws:
    draws = draw(RANDOMISED, np.random.default_rng(seed), count, 4, 5)
    return replace(draws, **changes)  # type: ignore[arg-type]


def same_bytes(one: Rollouts, two: Rollouts, rows: tuple[int, int] | None = None) -> None:
    for field in FIELDS:
        a, b = getattr(one, field), getattr(two, field)
        a, b = (a, b) if rows is None else (a[rows[0]], b[rows[1]])
        assert a.tobytes() == b.tobytes(), field


@dataclass
class Recorder:
    """An actor that keeps what it saw."""

    inner: Gait
    seen: list[NDArray[np.float64]]

    num_joints = 4
    layout = ObservationLayout(4)

    def act(self, time: float, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        self.seen.append(observation.copy())
        return self.inner.act(time, observation)


def test_an_open_loop_gait_does_the_same_as_its_rollout(model: Model) -> None:
    plain = roll_out(model, [gait()], 2.0)
    looped = roll_out_actor(model, gait(), 2.0)
    for field in ("qpos", "up", "yaw", "torque", "speed", "peak_torque"):
        assert getattr(plain, field).tobytes() == getattr(looped, field).tobytes(), field
    # The record of a batch has the centre of mass of one physics step before.
    assert_allclose(looped.com, plain.com, atol=model.opt.timestep * 2.0)
    assert_allclose(looped.work, plain.work, rtol=1e-9)
    assert_allclose(looped.rms_torque, plain.rms_torque, rtol=1e-9)
    judged = [measure(model, rollouts)[0] for rollouts in (plain, looped)]
    assert_allclose(judged[1].speed, judged[0].speed, atol=5e-3)  # type: ignore[union-attr]


def test_the_bytes_do_not_depend_on_threads_or_repetition(roomy: Model) -> None:
    found = [
        roll_out_actor(
            roomy, WALK, 1.0, copies=5, draws=drawn(5), rng=np.random.default_rng(1), nthread=threads
        )
        for threads in (1, 2, 3, 1)
    ]  # fmt: skip
    for other in found[1:]:
        same_bytes(found[0], other)
    assert not found[0].failed.any()
    assert len({row.tobytes() for row in found[0].qpos}) == 5  # each copy is another robot


def test_a_copy_among_many_does_what_it_does_alone(roomy: Model) -> None:
    draws = drawn(4, noise=None, push_speed=None)
    many = roll_out_actor(roomy, WALK, 1.0, copies=4, draws=draws)
    for k in range(4):
        alone = Draws(**{
            name: value[k : k + 1] if isinstance(value := getattr(draws, name), np.ndarray) else value
            for name in Draws.__dataclass_fields__
        })  # fmt: skip
        same_bytes(many, roll_out_actor(roomy, WALK, 1.0, draws=alone), (k, 0))


def test_copies_without_draws_are_the_model_as_it_is(model: Model) -> None:
    three, one = roll_out_actor(model, WALK, 1.0, copies=3), roll_out_policy(model, WALK, 1.0)
    for k in range(3):
        same_bytes(three, one, (k, 0))


def test_a_rollout_is_a_plain_loop_of_looking_and_stepping(model: Model) -> None:
    rolled = roll_out_actor(model, WALK, 0.4)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, settle(model), mujoco.mjtState.mjSTATE_INTEGRATION)
    layout, previous, seen, positions = WALK.layout, np.zeros(4), None, []
    low, high = -0.9, 1.1
    for k in range(round((LEAD_IN + 0.4) / CONTROL_PERIOD)):
        look = mujoco.MjData(model)
        look.qpos[:], look.qvel[:] = data.qpos, data.qvel
        mujoco.mj_forward(model, look)
        site = model.site(IMU).id
        rate = np.zeros(6)
        mujoco.mj_objectVelocity(model, look, mujoco.mjtObj.mjOBJ_SITE, site, rate, 1)
        gravity = look.site_xmat[site].reshape(3, 3).T @ [0.0, 0.0, -1.0]
        seated = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # of the quadruped's IMU
        frame = layout.pack(seated @ gravity, seated @ rate[:3], look.qpos[7:], look.qvel[6:], previous)
        seen = layout.begin(frame) if seen is None else layout.push(seen, frame)
        previous = smooth_step(k * CONTROL_PERIOD / LEAD_IN) * np.clip(WALK.act(0.0, seen), low, high)
        data.ctrl[:] = previous
        mujoco.mj_step(model, data, nstep=5)
        positions.append(data.qpos.copy())
    assert_allclose(rolled.qpos[0], positions[round(LEAD_IN / CONTROL_PERIOD) - 1 :], rtol=0, atol=1e-6)


def test_the_imu_reads_in_its_own_frame(model: Model) -> None:
    """The IMU of the quadruped is turned by a quarter about z: its x is the body's y, its y the body's -x."""
    herd = Herd(model, 2)
    state = settle(model)
    for name, turn, rate, gravity, gyro in (
        ("level", [1, 0, 0, 0], [0.3, 0.2, 0.1], [0, 0, -1], [0.2, -0.3, 0.1]),
        ("nose down", [np.sqrt(0.5), 0, np.sqrt(0.5), 0], [0, 0, 0.4], [0, -1, 0], [0, 0, 0.4]),
        ("left side down", [np.sqrt(0.5), -np.sqrt(0.5), 0, 0], [1.0, 0, 0], [1, 0, 0], [0, -1.0, 0]),
    ):
        placed = state.copy()
        placed[4:8] = turn
        placed[1 + model.nq + 3 : 1 + model.nq + 6] = rate  # in the frame of the root
        herd.place(np.array([1]), placed[None])
        down, turning = herd.imu()
        assert_allclose(down[1], gravity, atol=1e-9, err_msg=name)
        assert_allclose(turning[1], gyro, atol=1e-9, err_msg=name)


def test_an_encoder_that_is_off_shifts_what_is_read_and_what_is_done(roomy: Model) -> None:
    offset = np.array([[0.0, 0.0, 0.0, 0.0], [0.1, -0.05, 0.0, 0.02]])
    rolled = roll_out_actor(
        roomy, holding(np.full(4, 0.1)), 2.0, copies=2, draws=replace(nominal(2, 4), encoder_offset=offset)
    )
    true = rolled.qpos[:, -1, 7:]
    # It goes where it reads 0.1, which is 0.1 less the offset; the load bends both alike, but not quite.
    assert_allclose(true[1] - true[0], -offset[1], atol=0.02)
    herd = Herd(roomy, 2)
    herd.place(np.arange(2), np.repeat(settle(roomy)[None], 2, axis=0))
    layout = ObservationLayout(4)
    frame = Senses(herd, layout, replace(nominal(2, 4), encoder_offset=offset)).frame(herd)
    assert_allclose(frame[:, layout.position], herd.positions + offset)


def test_a_gyro_that_is_biased_and_a_crooked_imu_say_so(model: Model) -> None:
    herd = Herd(model, 1)
    herd.place(np.array([0]), settle(model)[None])
    turn = np.array([[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]])
    draws = replace(nominal(1, 4), gyro_bias=np.array([[0.1, 0.2, 0.3]]), imu_turn=turn)
    layout = ObservationLayout(4)
    gravity, gyro = herd.imu()
    parts = layout.unpack(Senses(herd, layout, draws).frame(herd))
    assert_allclose(parts["gravity"][0], herd.R_link_imu @ turn[0] @ gravity[0], atol=1e-12)
    assert_allclose(parts["gyro"][0], herd.R_link_imu @ (turn[0] @ gyro[0] + [0.1, 0.2, 0.3]), atol=1e-12)


def test_a_policy_does_not_care_how_the_box_with_the_imu_is_turned(quadruped: Description) -> None:
    walks = []
    for turn in np.eye(3), np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]), np.diag([-1.0, -1, 1]):
        T = quadruped.T_link_imu.copy()
        T[:3, :3] = turn
        robot = compile_model(replace(quadruped, T_link_imu=T))
        walks.append(roll_out_actor(robot, WALK, 2.0).qpos)
    assert np.abs(walks[0] - walks[0][:, :1]).max() > 0.02  # it moves
    assert_allclose(walks[1], walks[0], rtol=0, atol=1e-5)
    assert_allclose(walks[2], walks[0], rtol=0, atol=1e-5)


def test_noise_is_white_of_the_stated_strength_and_spares_what_is_not_measured(model: Model) -> None:
    herd = Herd(model, 50)
    herd.place(np.arange(50), np.repeat(settle(model)[None], 50, axis=0))
    noise = Noise(0.03, 0.15, 0.01, 0.75)
    layout = ObservationLayout(4, commanded=True)
    senses = Senses(herd, layout, replace(nominal(50, 4), noise=noise), command=[0.1, 0.2, 0.3])
    rng = np.random.default_rng(0)
    off = np.stack([senses.frame(herd, rng) for _ in range(40)]) - senses.frame(herd)
    parts = layout.unpack(off)
    for name, sigma in (("gravity", 0.03), ("gyro", 0.15), ("position", 0.01), ("velocity", 0.75)):
        assert_allclose(parts[name].std(axis=(0, 1)), sigma, rtol=0.1, err_msg=name)
        assert np.abs(parts[name].mean(axis=(0, 1))).max() < 4 * sigma / np.sqrt(2000)
    assert not parts["action"].any()
    assert not parts["command"].any()
    assert_allclose(layout.unpack(senses.frame(herd, rng))["command"], np.tile([0.1, 0.2, 0.3], (50, 1)))


def test_every_copy_has_noise_of_its_own_level(model: Model) -> None:
    herd, layout = Herd(model, 3), ObservationLayout(4)
    herd.place(np.arange(3), np.repeat(settle(model)[None], 3, axis=0))
    whole = Senses(herd, layout, replace(nominal(3, 4), noise=Noise()))
    some = Senses(herd, layout, replace(nominal(3, 4), noise=Noise(), noise_level=np.array([0.0, 0.5, 1.0])))
    plain = whole.frame(herd)
    off, less = (senses.frame(herd, np.random.default_rng(0)) - plain for senses in (whole, some))
    assert np.abs(off).max() > 0.0
    assert_allclose(less, off * np.array([0.0, 0.5, 1.0])[:, None], atol=1e-12)


def test_a_command_is_felt_after_the_latency_that_was_drawn(roomy: Model) -> None:
    latency = np.array([0.0, 0.004, 0.02, 0.06])
    herd = Herd(roomy, 4)
    from sim.randomisation import apply

    apply(herd, np.arange(4), replace(nominal(4, 4), latency=latency))
    herd.place(np.arange(4), np.repeat(settle(roomy)[None], 4, axis=0))
    herd.command(np.full((4, 4), 0.2))
    felt = []
    for _ in range(20):
        herd.batch.step()
        felt.append(herd.torques[:, 0] > 2.0)
    steps = np.argmax(np.array(felt), axis=0)
    assert steps.tolist() == [1, 1, 5, 15]  # of 4 ms; one step is the least


def test_the_lead_in_fades_from_the_pose_at_rest(model: Model) -> None:
    recorder = Recorder(gait(), [])
    rolled = roll_out_actor(model, recorder, 0.2)
    targets = [layout[0, recorder.layout.action] for layout in recorder.seen]
    assert_allclose(targets[0], default_pose(model))
    for k in range(1, len(targets)):
        at = (k - 1) * CONTROL_PERIOD
        assert_allclose(targets[k], smooth_step(at / LEAD_IN) * gait().targets(at), atol=1e-12)
    # What it saw first after the lead-in is where the measurement starts.
    assert_allclose(recorder.seen[25][0, recorder.layout.position], rolled.qpos[0, 0, 7:])
    assert_allclose(recorder.seen[25][0, recorder.layout.velocity], rolled.speed[0, 0])


def test_the_low_pass_is_the_robots(model: Model) -> None:
    recorder = Recorder(gait(), [])
    roll_out_actor(model, recorder, 0.2, time_constant=0.1)
    target = np.zeros(4)
    for k, seen in enumerate(recorder.seen):
        assert_allclose(seen[0, recorder.layout.action], target, atol=1e-12)
        at = k * CONTROL_PERIOD
        wanted = smooth_step(at / LEAD_IN) * gait().targets(at)
        target = low_pass(target, wanted, CONTROL_PERIOD, 0.1)


def test_the_quick_way_and_the_loop_agree_on_a_gait(model: Model) -> None:
    assert roll_out_policy(model, gait(), 1.0).qpos.tobytes() == roll_out_actor(model, gait(), 1.0).qpos.tobytes()
    slow = roll_out_policy(model, gait(), 1.0, time_constant=0.5)
    assert slow.peak_torque.max() < roll_out_policy(model, gait(), 1.0).peak_torque.max()


def test_a_learned_oscillator_moves_its_robot(model: Model) -> None:
    rolled = roll_out_actor(model, oscillator(4), 4.0)
    assert not rolled.failed[0]
    assert np.ptp(rolled.qpos[0, -75:, 7:], axis=0).min() > 0.1


class Mute:
    """Says no number from some time on, to one copy or to all."""

    num_joints = 4
    layout = ObservationLayout(4)

    def __init__(self, value: float, copy: int | None) -> None:
        self.value, self.copy = value, copy

    def act(self, time: float, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        said = np.full((len(observation), 4), 0.1)
        if time > 0.6:
            said[slice(None) if self.copy is None else self.copy] = self.value
        return said


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_actor_that_says_no_number_fails_and_crashes_nothing(model: Model, value: float) -> None:
    rolled = roll_out_actor(model, Mute(value, 1), 1.0, copies=3)
    assert rolled.failed.tolist() == [False, True, False]
    assert np.isfinite(rolled.qpos).all()
    same_bytes(rolled, roll_out_actor(model, Mute(0.1, 1), 1.0, copies=3), (2, 2))
    assert measure(model, rolled)[1] is None
    assert roll_out_actor(model, Mute(value, None), 1.0).failed.tolist() == [True]


def test_an_explosion_of_one_copy_leaves_the_others_alone(roomy: Model) -> None:
    start = settle(roomy)
    draws = replace(nominal(2, 4), mass=np.array([np.ones(5), np.ones(5)]), contact_time=np.array([1.0, 1e-9]))
    rolled = roll_out_actor(roomy, WALK, 1.0, copies=2, draws=draws, start=start)
    alone = roll_out_actor(roomy, WALK, 1.0, draws=replace(
        nominal(1, 4), mass=np.ones((1, 5)), contact_time=np.array([1.0])), start=start)  # fmt: skip
    same_bytes(rolled, alone, (0, 0))
    wild = start.copy()
    wild[1 + roomy.nq : 1 + roomy.nq + 6] = 1e8
    assert roll_out_actor(roomy, WALK, 0.2, start=wild).failed.tolist() == [True]


def test_another_number_of_joints_or_no_copy_is_refused(model: Model) -> None:
    with pytest.raises(ValueError, match="the actor drives 2 joints, robot quadruped has 4"):
        roll_out_actor(model, holding(np.zeros(2)), 1.0)
    with pytest.raises(ValueError, match="a herd of 0 copies"):
        roll_out_actor(model, holding(np.zeros(4)), 1.0, copies=0)


def test_a_robot_that_cannot_stand_at_zero_is_held_at_the_nearest_angle(quadruped: Description) -> None:
    joints = (replace(quadruped.joints[0], range=np.array([0.2, 0.9])), *quadruped.joints[1:])
    assert default_pose(compile_model(replace(quadruped, joints=joints))).tolist() == [0.2, 0.0, 0.0, 0.0]
