"""One robot stepped in lock-step with a bus: what the motors and the IMU of the virtual robot are attached to."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfg.description import Description
from sim.model import DAMPING, IMU, STIFFNESS, ModelError, drive_of, load_spec, make_spec
from sim.rollout import rest

TIMESTEP = 0.001  # a motor closes its loop at 1 kHz [s]
HOLD_STIFFNESS, HOLD_DAMPING = 40.0, 1.6  # while the robot drops onto the floor [N.m/rad, N.m.s/rad]

Array = NDArray[np.float64]


class Plant:
    """A robot whose motors take MIT-style commands, tau = kp (q* - q) + kd (qd* - qd) + tau_ff.

    The torque stays within the motor's peak and its torque-speed line, and follows the command after the motor's
    latency. Vectors have one entry per joint, in the order of `names`.
    """

    def __init__(self, spec: mujoco.MjSpec, names: Sequence[str] | None = None) -> None:
        """Drop the robot of a specification onto the floor; its motors are limp until the first command."""
        latency = [actuator.delay for actuator in spec.actuators]
        for actuator in spec.actuators:
            # The whole command is delayed here, because MuJoCo would delay the targets but not the gains.
            actuator.delay, actuator.nsample = 0.0, 0
            actuator.ctrlspec = (
                mujoco.mjtCtrlInput.mjINPUT_POS | mujoco.mjtCtrlInput.mjINPUT_VEL | mujoco.mjtCtrlInput.mjINPUT_FF
            )
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        drive = drive_of(self._model)
        self.names = drive.names if names is None else tuple(names)
        if sorted(self.names) != sorted(drive.names):
            raise ModelError(f"the robot's joints are {sorted(drive.names)}, but {sorted(self.names)} were asked for")
        order = [drive.names.index(name) for name in self.names]
        self._order = np.array(order)
        self._position, self._velocity = drive.position[order], drive.velocity[order]
        self._latency = max(latency)
        self._waiting: deque[tuple[float, Array]] = deque()
        self._imu = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, IMU)
        self._stand()

    @classmethod
    def load(cls, path: Path | str, names: Sequence[str] | None = None) -> Plant:
        """Read the robot from an MJCF file, `robot.xml` of a blueprint or of a policy bundle.

        Raises:
            ModelError: if the file is no robot, or has other joints than `names`.
            OSError: if it cannot be read.
        """
        return cls(load_spec(path, timestep=TIMESTEP), names)

    @classmethod
    def of(cls, description: Description) -> Plant:
        """The plant of a described robot."""
        return cls(make_spec(description, timestep=TIMESTEP))

    @property
    def time(self) -> float:
        """Since the robot stood [s]."""
        return float(self._data.time)

    @property
    def joint_positions(self) -> Array:
        """Angles [rad], (n,)."""
        return np.array(self._data.qpos[self._position])

    @property
    def joint_velocities(self) -> Array:
        """Speeds [rad/s], (n,)."""
        return np.array(self._data.qvel[self._velocity])

    @property
    def joint_torques(self) -> Array:
        """What the motors gave in the last step [N.m], (n,)."""
        return np.array(self._data.actuator_force[self._order])

    @property
    def base_position(self) -> Array:
        """Origin of the root in the world [m], (3,)."""
        return np.array(self._data.qpos[:3])

    @property
    def base_quaternion(self) -> Array:
        """Orientation of the root in the world, w first, (4,)."""
        return np.array(self._data.qpos[3:7])

    @property
    def centre_of_mass(self) -> Array:
        """Of the whole robot, in the world [m], (3,)."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return np.array(self._data.subtree_com[1])

    def imu(self) -> tuple[Array, Array]:
        """Direction of gravity (unit vector, down) and angular velocity [rad/s], both in the IMU frame, (3,) each."""
        mujoco.mj_kinematics(self._model, self._data)
        root = self._data.xmat[1].reshape(3, 3)
        turn = self._data.site_xmat[self._imu].reshape(3, 3) if self._imu >= 0 else root
        rate = np.zeros(6)
        if self._imu >= 0:
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_comVel(self._model, self._data)
            mujoco.mj_objectVelocity(self._model, self._data, mujoco.mjtObj.mjOBJ_SITE, self._imu, rate, 1)
        else:
            rate[:3] = self._data.qvel[3:6]
        return -turn[2].copy(), rate[:3].copy()

    def step(
        self, position: ArrayLike, velocity: ArrayLike, kp: ArrayLike, kd: ArrayLike, torque: ArrayLike, dt: float
    ) -> None:
        """Give every motor its command and let `dt` seconds pass.

        Args:
            position: targets q* [rad], (n,).
            velocity: targets qd* [rad/s], (n,).
            kp: stiffness [N.m/rad], (n,).
            kd: damping [N.m.s/rad], (n,).
            torque: feedforward [N.m], (n,).
            dt: how long; rounded so that time never drifts from the sum of all `dt`.

        Raises:
            ValueError: if a vector has another size or is not finite.
            RuntimeError: if the physics explodes.
        """
        n = len(self.names)
        command = np.zeros((5, n))
        for row, (what, value) in enumerate(
            (("position", position), ("velocity", velocity), ("kp", kp), ("kd", kd), ("torque", torque))
        ):
            command[row] = value
            if not np.isfinite(command[row]).all():
                raise ValueError(f"plant command: {what} is {command[row].tolist()}; every number must be finite")
        self._waiting.append((self._clock + self._latency, command))
        self._clock += dt
        while self._data.time < self._clock - 0.5 * TIMESTEP:
            while self._waiting and self._waiting[0][0] <= self._data.time + 1e-9:
                self._apply(self._waiting.popleft()[1])
            mujoco.mj_step(self._model, self._data)
        if any(warning.number for warning in self._data.warning):
            raise RuntimeError(
                f"the robot's physics exploded at {self._clock:.3f} s; the command was {command.tolist()}"
            )

    def _stand(self) -> None:
        n = len(self.names)
        hold = np.zeros((5, n))
        hold[2], hold[3] = HOLD_STIFFNESS, HOLD_DAMPING
        self._apply(hold)
        rest(self._model, self._data)
        self._data.time = 0.0
        self._clock = 0.0
        # A motor that has heard nothing yet is limp.
        self._apply(np.zeros((5, n)))

    def _apply(self, command: Array) -> None:
        """Write a command (5, n): position, velocity, kp, kd, torque."""
        self._data.ctrl.reshape(-1, 3)[self._order] = command[[0, 1, 4]].T
        self._model.actuator_gainprm[self._order, STIFFNESS] = command[2]
        self._model.actuator_gainprm[self._order, DAMPING] = command[3]
