"""What a policy sees, packed the same way in simulation and on the robot (numpy only)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True)
class ObservationLayout:
    """Where each quantity stands in the observation of a robot with `num_joints` joints, its size 6 + 3 n.

    Order: gravity (unit vector in the IMU frame, pointing down), gyro [rad/s, IMU frame], joint positions [rad],
    joint velocities [rad/s], previous action (the joint targets last commanded) [rad]. Neither yaw nor base
    velocity is in it, because the robot cannot measure them.
    """

    num_joints: int

    def __post_init__(self) -> None:
        if self.num_joints < 1:
            raise ValueError(f"An observation needs num_joints >= 1, got {self.num_joints}.")

    @property
    def size(self) -> int:
        """Length of the packed vector."""
        return 6 + 3 * self.num_joints

    @property
    def gravity(self) -> slice:
        """Place of the gravity direction."""
        return slice(0, 3)

    @property
    def gyro(self) -> slice:
        """Place of the angular velocity."""
        return slice(3, 6)

    @property
    def position(self) -> slice:
        """Place of the joint positions."""
        return slice(6, 6 + self.num_joints)

    @property
    def velocity(self) -> slice:
        """Place of the joint velocities."""
        return slice(6 + self.num_joints, 6 + 2 * self.num_joints)

    @property
    def action(self) -> slice:
        """Place of the previous action."""
        return slice(6 + 2 * self.num_joints, 6 + 3 * self.num_joints)

    @property
    def slices(self) -> dict[str, slice]:
        """All places by name, in order."""
        return {
            "gravity": self.gravity,
            "gyro": self.gyro,
            "position": self.position,
            "velocity": self.velocity,
            "action": self.action,
        }

    def pack(
        self, gravity: ArrayLike, gyro: ArrayLike, position: ArrayLike, velocity: ArrayLike, action: ArrayLike
    ) -> NDArray[np.float64]:
        """Join the quantities, each (..., its size) with equal leading axes, into (..., size).

        Raises:
            ValueError: A quantity has the wrong size.
        """
        parts = []
        for (name, place), value in zip(self.slices.items(), (gravity, gyro, position, velocity, action), strict=True):
            part = np.asarray(value, dtype=np.float64)
            expected = place.stop - place.start
            if part.ndim == 0 or part.shape[-1] != expected:
                raise ValueError(f"Observation part {name!r} has shape {part.shape}, its last axis must be {expected}.")
            parts.append(part)
        return np.concatenate(parts, axis=-1)

    def unpack(self, observation: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Split (..., size) into its named quantities, the inverse of `pack`.

        Raises:
            ValueError: The last axis is not `size`.
        """
        vector = np.asarray(observation, dtype=np.float64)
        if vector.ndim == 0 or vector.shape[-1] != self.size:
            raise ValueError(f"An observation of {self.num_joints} joints has size {self.size}, got {vector.shape}.")
        return {name: vector[..., place] for name, place in self.slices.items()}
