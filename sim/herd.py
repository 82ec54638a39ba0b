"""Many copies of one robot, each with its motors and its IMU, stepped together one control period at a time."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from sim.model import IMU, Model, drive_of, model_name
from sim.rollout import CONTROL_PERIOD, SPEED_BOUND

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

MOST_LATENCY = 0.06  # that `with_latency_room` makes room for [s]


def with_latency_room(spec: mujoco.MjSpec, most: float = MOST_LATENCY) -> Model:
    """Compile a specification so that every motor's latency may later be set to anything up to `most` [s]."""
    samples = int(np.ceil(most / spec.option.timestep - 1e-9))
    for actuator in spec.actuators:
        # MuJoCo allows no buffer without a delay; one step is what a command takes anyway.
        actuator.delay = max(actuator.delay, spec.option.timestep)
        actuator.nsample = max(actuator.nsample, samples)
    return spec.compile()


class Herd:
    """Copies of a robot; arrays have one row per copy, and joint vectors the order of the model's actuators.

    The copies do not feel each other. Results are the same bytes for any number of threads.
    """

    def __init__(self, model: Model, count: int, *, nthread: int = 1, period: float = CONTROL_PERIOD) -> None:
        """Make `count` copies of a model, which stays as it is.

        Raises:
            ValueError: if there is no copy, or the control period is no whole number of time steps.
        """
        if count < 1:
            raise ValueError(f"a herd of {count} copies of {model_name(model)}; it needs at least one")
        substeps = round(period / model.opt.timestep)
        if substeps < 1 or abs(substeps * model.opt.timestep - period) > 1e-9:
            raise ValueError(
                f"a control period of {period:g} s is no whole number of steps of {model.opt.timestep:g} s"
            )
        self.model, self.count, self.period, self.substeps = model, count, period, substeps
        self.drive = drive_of(model)
        self.batch = batch.Batch(model, nsim=count, nthread=nthread, persistent=True)
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")  # live views of the state
        self._control = self.batch.bind("ctrl")
        self._force = self.batch.bind("actuator_force")
        self._velocities = self.batch.bind("cvel")
        self._com = self.batch.bind("subtree_com")
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, IMU)
        self._imu_body = int(model.site_bodyid[site]) if site >= 0 else 1
        turn = self.batch.bind("site_xmat" if site >= 0 else "xmat")
        self._imu_turn = turn[:, site if site >= 0 else 1].reshape(count, 3, 3)
        self.R_link_imu = turn_of(model.site_quat[site]) if site >= 0 else np.eye(3)
        self._warned = np.zeros(count, dtype=np.int64)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the driven hinges."""
        return self.drive.names

    @property
    def positions(self) -> Array:
        """Joint angles [rad], (count, n), a copy."""
        return self.qpos[:, self.drive.position]

    @property
    def velocities(self) -> Array:
        """Joint speeds [rad/s], (count, n), a copy."""
        return self.qvel[:, self.drive.velocity]

    @property
    def torques(self) -> Array:
        """What the motors gave in the last step [N.m], (count, n), a copy."""
        return self._force.copy()

    @property
    def centre_of_mass(self) -> Array:
        """Of the whole robot, in the world [m], (count, 3), a copy."""
        return self._com[:, 1].copy()

    def imu(self) -> tuple[Array, Array]:
        """Direction of gravity (unit vector, down) and angular velocity [rad/s], both in the IMU frame, (count, 3)."""
        turn = self._imu_turn
        gyro = np.einsum("ijk,ij->ik", turn, self._velocities[:, self._imu_body, :3])
        return -turn[:, 2], gyro

    def place(self, ids: Ids, states: Array) -> None:
        """Put copies, `ids` rising, into full states, (len(ids), nstate), and forget what happened to them."""
        if len(ids) == 0:
            return
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self.batch.state[ids] = states
        self.batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_VEL)
        self._warned[ids] = self._warnings()[ids]

    def refresh(self, ids: Ids) -> None:
        """Work out what the sensors read after the state of copies was written."""
        self.batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def command(self, targets: Array) -> None:
        """Give joint targets (count, n) [rad], which hold until the next."""
        self._control[:] = targets

    def advance(self, targets: Array) -> NDArray[np.bool_]:
        """Let one control period pass with joint targets (count, n) [rad]; says whose physics exploded, (count,)."""
        self.command(targets)
        self.batch.step(nstep=self.substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        return self.exploded()

    def exploded(self) -> NDArray[np.bool_]:
        """Whose physics raised a warning since it was placed, is not finite, or is faster than any robot, (count,)."""
        speed = np.abs(self.qvel)
        return (
            (self._warnings() > self._warned) | ~(speed < SPEED_BOUND).all(axis=1) | ~np.isfinite(self.qpos).all(axis=1)
        )

    def _warnings(self) -> NDArray[np.int64]:
        return np.asarray(self.batch.warning[..., 1].sum(axis=1), dtype=np.int64)


def turn_of(quaternion: Array) -> Array:
    """The rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
