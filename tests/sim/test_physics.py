"""The world that the builder makes obeys laws that can be checked on paper, as far as its integrator goes.

The integrator is of first order: a drift that comes from the step halves with it, and tolerances say which step.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.stats import rankdata

from mfg.catalogue import Motor
from mfg.description import Description
from mfg.parts import J60_6
from sim.actor import Gait
from sim.gaits import decode, random_points
from sim.model import CONTACT_TIME, FLOOR, STALL_OVER_PEAK, Model, compile_model, drive_of, make_spec
from sim.rollout import CONTROL_PERIOD, GRAVITY, measure, roll_out, settle
from sim.terrain import Kind, Terrain, lay

Array = NDArray[np.float64]

MU = 0.5
FRICTION_ANGLE = np.arctan(MU)


def passive(model: Model) -> Model:
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    return model


def with_motor(pendulum: Description, motor: Motor) -> Description:
    return replace(pendulum, joints=(replace(pendulum.joints[0], motor=motor),))


# Falling and swinging.


@pytest.mark.parametrize("step", [0.004, 0.001])
def test_a_dropped_robot_falls_by_half_g_t_squared(quadruped: Description, step: float) -> None:
    model = passive(compile_model(quadruped, timestep=step))
    data = mujoco.MjData(model)
    data.qpos[2] = start = 50.0
    mujoco.mj_step(model, data, nstep=round(1.0 / step))
    # Velocity is stepped before position, so that the fall is half a step ahead of the exact law.
    assert_allclose(start - data.qpos[2], 0.5 * GRAVITY * 1.0 * (1.0 + step), rtol=1e-9)
    assert_allclose(data.qvel[2], -GRAVITY * 1.0, rtol=1e-9)


def test_a_pendulum_swings_with_its_period(pendulum: Description) -> None:
    spec = make_spec(with_motor(pendulum, replace(J60_6, friction=0.0, armature=0.0)))
    spec.body("root").gravcomp = 1.0  # the root is held up, so that gravity acts on the bob alone
    model = passive(spec.compile())
    data = mujoco.MjData(model)
    data.qpos[7] = amplitude = 0.05
    crossings = []
    for _ in range(1500):
        before = data.qpos[7]
        mujoco.mj_step(model, data)
        if before < 0 <= data.qpos[7]:
            crossings.append(data.time - model.opt.timestep * data.qpos[7] / (data.qpos[7] - before))
    rod, arm = pendulum.links[1], 0.15
    moment = rod.inertia[1, 1] + rod.mass * arm**2
    exact = 2 * np.pi * np.sqrt(moment / (rod.mass * GRAVITY * arm)) * (1 + amplitude**2 / 16)
    assert_allclose(np.diff(crossings).mean(), exact, rtol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_passive_robot_never_gains_energy(quadruped: Description, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = passive(compile_model(quadruped))
    data = mujoco.MjData(model)
    data.qpos[2] = 0.4
    data.qpos[3:7] = rng.standard_normal(4)
    data.qvel[:6] = rng.standard_normal(6)
    data.qpos[7:] = rng.uniform(-0.8, 0.8, 4)
    energy = []
    for _ in range(750):
        mujoco.mj_step(model, data)
        energy.append(data.energy.sum())
    spare = 0.02 * energy[0]  # springs of contacts and stops store and return a little
    assert (np.array(energy) <= np.minimum.accumulate(energy) + spare).all()
    assert energy[-1] < 0.6 * energy[0]


# Momentum.


def momenta(quadruped: Description, step: float, spin: float) -> tuple[Array, Array, Array, Array]:
    """Of a robot that kicks while it floats: linear (k, 3) and angular (k, 3), and how much its legs exchange (k,)."""
    model = compile_model(quadruped, timestep=step)
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.qpos[2] = 50.0
    data.qvel[:6] = spin * np.random.default_rng(0).standard_normal(6)
    gait = Gait(1.3, np.full(4, 0.7), 1.4 * np.arange(4), np.zeros(4))
    rows = []
    for k in range(100):
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        leg = data.subtree_linvel[2:6] - data.subtree_linvel[1]
        rows.append((
            model.body_subtreemass[1] * data.subtree_linvel[1], data.subtree_angmom[1].copy(),
            (model.body_mass[2:6] * np.linalg.norm(leg, axis=1)).sum(),
            np.linalg.norm(data.subtree_angmom[2:6], axis=1).sum(),
        ))  # fmt: skip
        data.ctrl[:] = gait.targets(k * CONTROL_PERIOD)
        mujoco.mj_step(model, data, nstep=round(CONTROL_PERIOD / step))
    linear, angular, pushed, turned = (np.array(column) for column in zip(*rows, strict=True))
    return linear, angular, pushed, turned


@pytest.mark.parametrize("spin", [0.0, 1.0])
def test_a_floating_robot_cannot_change_its_momentum_by_kicking(quadruped: Description, spin: float) -> None:
    """Motors push on both of their links, so that whatever drift there is comes from the step and vanishes with it."""
    coarse, fine = momenta(quadruped, 0.004, spin), momenta(quadruped, 0.002, spin)
    for law in (0, 1):
        exchanged = coarse[2 + law].max()
        assert exchanged > (0.5, 0.02)[law]  # N.s and N.m.s: it does kick
        drift, finer = (np.linalg.norm(run[law] - run[law][0], axis=1).max() for run in (coarse, fine))
        assert 1.8 < drift / finer < 2.2  # of first order
        vanishing = 2 * (fine[law] - fine[law][0]) - (coarse[law] - coarse[law][0])  # to a step of nothing
        assert np.linalg.norm(vanishing, axis=1).max() < 0.01 * exchanged


# Friction.


def slid(quadruped: Description, angle: float, seconds: float = 2.0) -> tuple[Array, Array]:
    """Time [s] and way down a slope of a hull that is a link's in everything but its friction [m], (k,) both."""
    spec = make_spec(quadruped)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    spec.delete(spec.body("torso"))
    spec.geom(FLOOR).friction[0] = MU
    block = spec.worldbody.add_body(name="block", pos=(0.0, 0.0, 0.05))
    block.add_freejoint()
    corners = np.array(np.meshgrid((-0.1, 0.1), (-0.1, 0.1), (-0.05, 0.05))).reshape(3, -1).T
    spec.add_mesh(name="block", uservert=corners.ravel())
    block.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="block", mass=1.0, contype=0, conaffinity=1, condim=3,
                   friction=(MU, 0.005, 0.0001), solref=(CONTACT_TIME, 1.0))  # fmt: skip
    lay(spec, Terrain(Kind.SLOPE, angle=angle))
    model = spec.compile()
    data = mujoco.MjData(model)
    way = []
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        way.append(-np.cos(angle) * data.qpos[0] - np.sin(angle) * data.qpos[2])
    return model.opt.timestep * np.arange(1, len(way) + 1), np.array(way)


def acceleration(time: Array, way: Array) -> float:
    """Of the parabola through the way after the first 0.3 s [m/s2]."""
    late = time > 0.3
    return float(2 * np.polyfit(time[late], way[late], 2)[0])


def test_a_block_slides_down_35_degrees_with_coulombs_acceleration(quadruped: Description) -> None:
    """g (sin a - mu cos a) = 1.609 m/s2, over the way: a fast block hops by millimetres in between."""
    exact = GRAVITY * (np.sin(np.radians(35)) - MU * np.cos(np.radians(35)))
    assert exact == pytest.approx(1.609, abs=5e-4)
    assert_allclose(acceleration(*slid(quadruped, np.radians(35))), exact, rtol=0.01)


def test_a_block_sticks_on_20_degrees(quadruped: Description) -> None:
    """It creeps, because contacts are soft, but by less than 0.2 mm/s."""
    time, way = slid(quadruped, np.radians(20))
    late = time > 0.5
    assert np.polyfit(time[late], way[late], 1)[0] < 0.2e-3


def test_the_friction_angle_parts_sticking_from_sliding(quadruped: Description) -> None:
    """Half a degree below the angle whose tangent is mu a block stays, half a degree above it goes, by the law."""
    time, way = slid(quadruped, FRICTION_ANGLE - np.radians(0.5))
    assert way[-1] - way[time > 0.5][0] < 0.2e-3 * time[-1]
    time, way = slid(quadruped, FRICTION_ANGLE + np.radians(0.5))
    exact = GRAVITY * np.sqrt(1 + MU**2) * np.sin(np.radians(0.5))
    assert_allclose(acceleration(time, way), exact, rtol=0.02)


# Motors.


def torque_at(model: Model, speed: float, target: float) -> float:
    data = mujoco.MjData(model)
    data.qvel[6] = speed
    data.ctrl[:] = target
    mujoco.mj_forward(model, data)
    return float(data.actuator_force[0])


def test_the_motor_gives_its_peak_at_stall_and_nothing_at_its_no_load_speed(pendulum: Description) -> None:
    model = compile_model(with_motor(pendulum, replace(J60_6, latency=0.0)))
    far = 100.0  # a target so far away that the motor does all it can
    assert_allclose(torque_at(model, 0.0, far), J60_6.peak_torque)
    assert_allclose(torque_at(model, J60_6.max_speed, far), 0.0, atol=1e-9)
    speed = 0.9 * J60_6.max_speed
    assert_allclose(torque_at(model, speed, far), 0.1 * STALL_OVER_PEAK * J60_6.peak_torque)
    assert torque_at(model, 1.2 * J60_6.max_speed, far) < 0


def test_within_its_limits_the_motor_is_the_wires_proportional_derivative_law(pendulum: Description) -> None:
    model = compile_model(with_motor(pendulum, replace(J60_6, latency=0.0, stiffness=20.9, damping=0.5)))
    assert_allclose(torque_at(model, 1.5, 0.3), 20.0 * 0.3 - 0.4 * 1.5)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_free_motor_runs_up_to_the_speed_where_its_torque_is_its_friction(
    pendulum: Description, friction: float
) -> None:
    """No-load speed (1 - friction / stall torque), reached with the motor's time constant."""
    spec = make_spec(with_motor(pendulum, replace(J60_6, friction=friction)))
    spec.joint("swing").limited = mujoco.mjtLimited.mjLIMITED_FALSE
    model = spec.compile()
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.ctrl[:] = 1e4
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    stall = STALL_OVER_PEAK * J60_6.peak_torque
    assert_allclose(data.qvel[6], J60_6.max_speed * (1 - friction / stall), rtol=1e-3)


def second_order(time: Array, frequency: float, damping: float) -> Array:
    """Unit step response of q'' + 2 damping frequency q' + frequency^2 (q - 1) = 0 from rest, any damping but 1."""
    root = np.sqrt(complex(damping**2 - 1))
    fast, slow = -frequency * (damping + root), -frequency * (damping - root)
    return np.real(1 - (fast * np.exp(slow * time) - slow * np.exp(fast * time)) / (fast - slow))


@pytest.mark.parametrize("inertia", [0.01, 0.02, 0.05])  # of legs of the examples, and more [kg.m2]
def test_a_step_of_the_target_is_answered_as_a_second_order_system(pendulum: Description, inertia: float) -> None:
    """0.3 rad, with gains, armature and inertia as stated, later by the latency; the error is of first order."""

    def error(step: float) -> float:
        rod = replace(pendulum.links[1], com=np.zeros(3), inertia=inertia * np.eye(3))
        robot = replace(with_motor(pendulum, replace(J60_6, friction=0.0)), links=(pendulum.links[0], rod))
        model = compile_model(robot, timestep=step)
        model.opt.gravity[:] = 0
        data = mujoco.MjData(model)
        data.ctrl[:] = 0.3
        angles = []
        for _ in range(round(0.4 / step)):
            mujoco.mj_step(model, data)
            angles.append(data.qpos[7])
        since = np.maximum(step * np.arange(1, len(angles) + 1) - J60_6.latency, 0.0)
        total = inertia + J60_6.armature
        frequency = np.sqrt(J60_6.stiffness / total)
        exact = 0.3 * second_order(since, frequency, J60_6.damping / (2 * np.sqrt(J60_6.stiffness * total)))
        return float(np.abs(np.array(angles) - exact).max() / 0.3)

    assert error(0.004) < 0.02
    assert error(0.002) < 0.55 * error(0.004)


# The step.


def speeds(model: Model, gaits: list[Gait], turned: Array | float = 0.0) -> Array:
    """Of each gait over 5 s along the body's heading [m/s], the joints turned by so much at the start [rad]."""
    start = settle(model)
    start[1 + drive_of(model).position] += turned
    behaviours = measure(model, roll_out(model, gaits, 5.0, start))
    assert None not in behaviours
    return np.array([behaviour.speed for behaviour in behaviours if behaviour is not None])


def rank_correlations(a: Array, b: Array) -> Array:
    """Spearman's, of each row (k, n)."""
    a, b = (rankdata(values, axis=1) for values in (a, b))
    a, b = (values - values.mean(axis=1, keepdims=True) for values in (a, b))
    return (a * b).sum(axis=1) / np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))


def test_halving_the_step_changes_the_ranking_of_gaits_no_more_than_the_start_does(quadruped: Description) -> None:
    """A paired bootstrap over 32 gaits, of Spearman's correlation with the ranking at 4 ms.

    Contact is chaotic, so that a ranking repeats only as well as its start does. Joints turned by 0.01 rad, half of
    what an encoder may be off on the robot, rank this body's gaits anew as much as half the step does: 0.947 and 0.945,
    in the mean of six sets of gaits, and 0.661 and 0.665 for the quadruped of the examples, which topples more easily.
    A start moved by 1e-6 m changes less, 0.994 and 0.92, because 5 s are too short for so small a difference to grow.
    """
    rng = np.random.default_rng(0)
    model = compile_model(quadruped)
    gaits = [decode(drive_of(model), point) for point in random_points(drive_of(model), 32, rng)]
    ranked = speeds(model, gaits)
    halved = speeds(compile_model(quadruped, timestep=0.002), gaits)
    moved = [speeds(model, gaits, 0.01 * rng.choice([-1.0, 1.0], model.nu)) for _ in range(3)]
    draw = rng.integers(0, len(gaits), (2000, len(gaits)))
    by_step = rank_correlations(ranked[draw], halved[draw])
    by_start = np.mean([rank_correlations(ranked[draw], other[draw]) for other in moved], axis=0)
    worse = np.quantile(by_start - by_step, 0.025)
    assert worse <= 0  # the step does not do more than the start
    assert np.quantile(by_step, 0.025) > 0.6  # and the order survives
