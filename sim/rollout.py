"""Open-loop rollouts of many gaits at once, and what they say about a body's behaviour."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from mfg.description import Description
from sim.actor import Gait, smooth_step
from sim.model import Model, compile_model, default_pose, drive_of, model_name
from sim.surfaces import body_length

CONTROL_PERIOD = 0.02  # targets change at 50 Hz [s]
SETTLE = 6.0  # at most so long a robot may drop, topple and rock before any gait [s]
SETTLE_CHECK = 0.25  # how often it is asked whether it rests [s]
REST = 0.02  # it does if nothing moves faster [m/s, rad/s]
LEAD_IN = 0.5  # the gait is faded in, and nothing is measured yet [s]
WINDOW = 2.0  # speed is measured over windows of this length, each in the heading the body has at its start [s]
FALL_TILT = np.pi / 3  # a root that has turned further from upright than this has fallen [rad]
SPEED_BOUND = 100.0  # a robot faster than this in any coordinate has exploded, whatever the warnings say [m/s, rad/s]
GRAVITY = 9.81  # [m/s2]


class Diverged(RuntimeError):
    """The physics of a rollout exploded, so that it has no behaviour; the message names the robot."""


@dataclass(frozen=True, eq=False, slots=True)
class Rollouts:
    """What g gaits did to one robot at k control steps, the lead-in excluded; row 0 is the start of the measurement.

    Attributes:
        qpos: generalised positions, (g, k, nq).
        com: centre of mass of the whole robot [m], (g, k, 3).
        up: the direction that was up when the robot stood, as it has turned with the root, (g, k, 3).
        yaw: how far the root has turned about the vertical since it stood [rad], (g, k).
        peak_torque: greatest torque of each motor [N.m], (g, n).
        rms_torque: root mean square torque of each motor [N.m], (g, n).
        torque: what each motor gave in the last physics step before each control step [N.m], (g, k, n).
        speed: of each joint at each control step [rad/s], (g, k, n).
        work: mechanical work of all motors, braking not recovered [J], (g,).
        failed: the physics exploded, or the actor said what is no number; such a row means nothing else, (g,).
        steps_per_s: physics steps of all robots per second of computing.
    """

    qpos: NDArray[np.float64]
    com: NDArray[np.float64]
    up: NDArray[np.float64]
    yaw: NDArray[np.float64]
    peak_torque: NDArray[np.float64]
    rms_torque: NDArray[np.float64]
    torque: NDArray[np.float64]
    speed: NDArray[np.float64]
    work: NDArray[np.float64]
    failed: NDArray[np.bool_]
    steps_per_s: float


@dataclass(frozen=True, slots=True)
class Behaviour:
    """How a robot moved in one episode.

    Attributes:
        seconds: length of the episode.
        distance: net horizontal displacement of the centre of mass [m].
        speed: along the best heading [m/s]. The episode is cut into windows of 2 s; each window's displacement is
            turned into the heading that the body had at the window's start; their mean over 2 s is the velocity in the
            body's frame, and its length is the speed over the best of all headings. A slow curve costs nothing, because
            a closed loop can hold a heading; going to and fro, or round in circles within 2 s, earns nothing.
        heading: that best direction of the body, from the x axis it stood in [rad].
        body_length: greatest extent of the robot at rest [m].
        fell: the root turned more than 60 degrees from how it stood (or lay) at the start.
        upright: share of the episode before it fell, 1 if it did not.
        cost_of_transport: mechanical work / (weight * distance); None where it did not move a millimetre.
        max_torque: greatest torque of any motor [N.m].
        overload: greatest root mean square torque of any motor over what it bears for long.
        steps_per_s: physics steps per second of computing, for one robot or all of a batch together.
    """

    seconds: float
    distance: float
    speed: float
    heading: float
    body_length: float
    fell: bool
    upright: float
    cost_of_transport: float | None
    max_torque: float
    overload: float
    steps_per_s: float

    def to_json(self) -> dict[str, float | bool | None]:
        """The record under the names that scripts rely on."""
        return {
            "seconds": self.seconds,
            "distance_m": self.distance,
            "speed_m_s": self.speed,
            "body_length_m": self.body_length,
            "fell": self.fell,
            "cost_of_transport": self.cost_of_transport,
            "max_torque_Nm": self.max_torque,
            "steps_per_s": self.steps_per_s,
            "heading_rad": self.heading,
            "upright": self.upright,
            "overload": self.overload,
        }


def as_model(robot: Description | Model) -> Model:
    """The model of a described robot; a model stays as it is."""
    return compile_model(robot) if isinstance(robot, Description) else robot


def simulate(robot: Description | Model, gait: Gait, seconds: float = 10.0) -> Behaviour:
    """Let a robot stand, fade a gait in, and measure `seconds` of it.

    Raises:
        Diverged: if the physics exploded.
        ValueError: if the gait is for another number of joints.
    """
    model = as_model(robot)
    behaviour = measure(model, roll_out(model, [gait], seconds))[0]
    if behaviour is None:
        raise Diverged(f"robot {model_name(model)} exploded within {seconds:g} s; use a slower or smaller gait")
    return behaviour


def settle(model: Model) -> NDArray[np.float64]:
    """Drop the robot onto the floor in its pose at rest and wait until it lies still; gives the full state, (nstate,).

    Many bodies cannot stand as they were drawn. How they lie after they have toppled is how they start, so that no gait
    earns anything by falling over.
    """
    data = mujoco.MjData(model)
    rest(model, data)
    qpos, qvel, warm = data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy()
    # The delayed controls carry the times at which they were given, so a clock that is only set back would make every
    # later command look older than those of the fall, and it would be felt too early.
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = qpos, qvel, warm
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return state


def rest(model: Model, data: mujoco.MjData) -> None:
    """Step until nothing moves any more, with the controls as they are."""
    for _ in range(round(SETTLE / SETTLE_CHECK)):
        mujoco.mj_step(model, data, nstep=_steps(model, SETTLE_CHECK))
        if np.abs(data.qvel).max() < REST:
            break


def roll_out(
    model: Model,
    gaits: Sequence[Gait],
    seconds: float,
    start: NDArray[np.float64] | None = None,
    nthread: int = 1,
) -> Rollouts:
    """Run gaits from the same start, a settled state, for `seconds` after the lead-in; same bytes for any `nthread`.

    Raises:
        ValueError: if there is no gait, or one for another number of joints.
    """
    counts = [gait.num_joints for gait in gaits]
    if set(counts) != {model.nu}:
        raise ValueError(f"the gaits drive {counts} joints, robot {model_name(model)} has {model.nu}")
    start = settle(model) if start is None else start
    lead, length = round(LEAD_IN / CONTROL_PERIOD), max(1, round(seconds / CONTROL_PERIOD))
    at = np.arange(lead + length) * CONTROL_PERIOD
    fade = smooth_step(at / LEAD_IN)[:, None]
    # As the robot does: within each joint's range, and from the pose in which it was built.
    default, (low, high) = default_pose(model), drive_of(model).range.T
    control = np.stack([default + fade * (np.clip(gait.targets(at), low, high) - default) for gait in gaits])
    substeps = _steps(model, CONTROL_PERIOD)
    simulations = batch.Batch(model, nsim=len(gaits), nthread=nthread, persistent=True)
    simulations.state[:] = start
    before = time.process_time()
    record = simulations.rollout(
        (lead + length) * substeps,
        np.repeat(control, substeps, axis=1),
        record=("qpos", "qvel", "actuator_force", "subtree_com"),
    )
    elapsed = max(time.process_time() - before, 1e-9)
    qpos, qvel, torque, com = (record[name] for name in ("qpos", "qvel", "actuator_force", "subtree_com"))
    failed = (simulations.warning[..., 1] > 0).any(axis=1)
    failed |= ~np.isfinite(qpos).all(axis=(1, 2)) | ~(np.abs(qvel) < SPEED_BOUND).all(axis=(1, 2))
    measured = slice(lead * substeps, None)
    speed = qvel[:, :, drive_of(model).velocity]
    power = torque[:, measured] * speed[:, measured]
    # The records follow each step, so the last one of the lead-in is the start of the measurement.
    rows = slice(lead * substeps - 1, None, substeps)
    up, yaw = turned(start[root_quaternion(model)], qpos[:, rows, 3:7])
    return Rollouts(
        qpos=qpos[:, rows], com=com[:, rows, 1], up=up, yaw=yaw,
        peak_torque=np.abs(torque[:, measured]).max(axis=1),
        rms_torque=np.sqrt(np.square(torque[:, measured]).mean(axis=1)), torque=torque[:, rows], speed=speed[:, rows],
        work=np.maximum(power, 0.0).sum(axis=(1, 2)) * model.opt.timestep,
        failed=failed, steps_per_s=qpos.shape[0] * qpos.shape[1] / elapsed,
    )  # fmt: skip


def measure(model: Model, rollouts: Rollouts, length: float | None = None) -> list[Behaviour | None]:
    """Judge every rollout; None where the physics exploded.

    Args:
        model: of the robot.
        rollouts: as `roll_out` gives them.
        length: the robot's body length [m], if it is known already.
    """
    length = body_length(model) if length is None else length
    continuous = drive_of(model).continuous_torque
    weight = float(model.body_subtreemass[1]) * GRAVITY
    steps = rollouts.yaw.shape[1] - 1
    found: list[Behaviour | None] = []
    for index, failed in enumerate(rollouts.failed):
        if failed:
            found.append(None)
            continue
        com = rollouts.com[index, :, :2]
        distance = float(np.linalg.norm(com[-1] - com[0]))
        velocity = body_velocity(com, rollouts.yaw[index])
        fallen = np.flatnonzero(rollouts.up[index, :, 2] < np.cos(FALL_TILT))
        found.append(Behaviour(
            seconds=steps * CONTROL_PERIOD, distance=distance, speed=float(np.linalg.norm(velocity)),
            heading=float(np.arctan2(velocity[1], velocity[0])), body_length=length, fell=fallen.size > 0,
            upright=float(fallen[0] / steps) if fallen.size else 1.0,
            cost_of_transport=float(rollouts.work[index]) / (weight * distance) if distance > 1e-3 else None,
            max_torque=float(rollouts.peak_torque[index].max()),
            overload=float((rollouts.rms_torque[index] / continuous).max()), steps_per_s=rollouts.steps_per_s,
        ))  # fmt: skip
    return found


def body_velocity(
    com: NDArray[np.float64], yaw: NDArray[np.float64], period: float = CONTROL_PERIOD
) -> NDArray[np.float64]:
    """Mean velocity in the body's heading frame, by windows: mean over w of R(-yaw_w) (p_w+1 - p_w) / window.

    Args:
        com: centre of mass on the floor at control steps [m], (k, 2).
        yaw: heading of the body [rad], (k,).
        period: of the control [s].

    Returns:
        (forward, left) [m/s], (2,), in the frame of yaw = 0.
    """
    steps = len(yaw) - 1
    windows = max(1, round(steps * period / WINDOW))
    edges = np.round(np.linspace(0, steps, windows + 1)).astype(int)
    moved, turn = np.diff(com[edges], axis=0), yaw[edges[:-1]]
    forward = np.cos(turn) * moved[:, 0] + np.sin(turn) * moved[:, 1]
    left = np.cos(turn) * moved[:, 1] - np.sin(turn) * moved[:, 0]
    return np.array([forward.sum(), left.sum()]) / (steps * period)


def turned(
    standing: NDArray[np.float64], quaternion: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the root's standing up and x directions point later: up (..., 3) and yaw (...) [rad].

    Args:
        standing: quaternion of the root when it stood, w first, (4,).
        quaternion: the later ones, (..., 4).
    """
    inverse = standing * (1.0, -1.0, -1.0, -1.0)
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    a, b, c, d = inverse
    # The turn since standing, quaternion times inverse, of which two columns of the rotation matrix are wanted.
    w, x, y, z = (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )
    up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return up, yaw


def root_quaternion(model: Model) -> slice:
    """Place of the root's orientation in the full state, which starts with time and qpos."""
    first = 1 + int(model.jnt_qposadr[0]) + 3
    return slice(first, first + 4)


def _steps(model: Model, seconds: float) -> int:
    return max(1, round(seconds / model.opt.timestep))
