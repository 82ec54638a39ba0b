"""What a policy sees and what it commands, packed the same way in simulation and on the robot (numpy only)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

GYRO_SCALE = 4.0  # an ordinary turning rate of a walking body, which a policy's first layer reads as 1 [rad/s]
SPEED_SCALE = 8.0  # the same of a joint [rad/s]
COMMAND_SIZE = 3  # forward and left speed [m/s], yaw rate [rad/s], in the body's heading frame


@dataclass(frozen=True, slots=True)
class ObservationLayout:
    """Where each quantity stands in the observation of a robot with `num_joints` joints.

    A frame has 6 + 3 n numbers: gravity (unit vector pointing down) and gyro [rad/s], both in the axes of the link that
    carries the IMU (`in_link_axes`), joint positions [rad], joint velocities [rad/s], previous action (the joint
    targets last commanded) [rad]; three more where the policy takes a velocity command. Neither yaw nor base velocity
    is in it, because the robot cannot measure them. With a history, the latest frame is followed by the ones before it,
    the oldest last.
    """

    num_joints: int
    history: int = 1  # frames
    commanded: bool = False  # whether a frame ends with a velocity command

    def __post_init__(self) -> None:
        if self.num_joints < 1:
            raise ValueError(f"An observation needs num_joints >= 1, got {self.num_joints}.")
        if self.history < 1:
            raise ValueError(f"An observation needs history >= 1 frame, got {self.history}.")

    @property
    def frame_size(self) -> int:
        """Length of one packed frame."""
        return 6 + 3 * self.num_joints + (COMMAND_SIZE if self.commanded else 0)

    @property
    def size(self) -> int:
        """Length of the packed vector, all frames of it."""
        return self.history * self.frame_size

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
    def command(self) -> slice:
        """Place of the velocity command, empty where there is none."""
        return slice(6 + 3 * self.num_joints, self.frame_size)

    @property
    def slices(self) -> dict[str, slice]:
        """All places of the latest frame by name, in order."""
        places = {
            "gravity": self.gravity,
            "gyro": self.gyro,
            "position": self.position,
            "velocity": self.velocity,
            "action": self.action,
        }
        return places | {"command": self.command} if self.commanded else places

    def pack(
        self,
        gravity: ArrayLike,
        gyro: ArrayLike,
        position: ArrayLike,
        velocity: ArrayLike,
        action: ArrayLike,
        command: ArrayLike | None = None,
    ) -> Array:
        """Join the quantities, each (..., its size) with equal leading axes, into a frame (..., frame_size).

        Raises:
            ValueError: A quantity has the wrong size, or the command is missing or not wanted.
        """
        if (command is not None) != self.commanded:
            raise ValueError(f"Observation of a policy that {'takes' if self.commanded else 'takes no'} command.")
        values = (gravity, gyro, position, velocity, action) if command is None else (
            gravity, gyro, position, velocity, action, command
        )  # fmt: skip
        parts = []
        for (name, place), value in zip(self.slices.items(), values, strict=True):
            part = np.asarray(value, dtype=np.float64)
            expected = place.stop - place.start
            if part.ndim == 0 or part.shape[-1] != expected:
                raise ValueError(f"Observation part {name!r} has shape {part.shape}, its last axis must be {expected}.")
            parts.append(part)
        return np.concatenate(parts, axis=-1)

    def begin(self, frame: ArrayLike) -> Array:
        """The observation (..., size) when there is no past: every frame is this one (..., frame_size)."""
        return np.concatenate([np.asarray(frame, dtype=np.float64)] * self.history, axis=-1)

    def push(self, observation: ArrayLike, frame: ArrayLike) -> Array:
        """The next observation (..., size): a new frame (..., frame_size) first, the oldest one dropped."""
        kept = np.asarray(observation, dtype=np.float64)[..., : self.size - self.frame_size]
        return np.concatenate([np.asarray(frame, dtype=np.float64), kept], axis=-1)

    def unpack(self, observation: ArrayLike) -> dict[str, Array]:
        """Split the latest frame of (..., size) into its named quantities, the inverse of `pack`.

        Raises:
            ValueError: The last axis is not `size`.
        """
        vector = np.asarray(observation, dtype=np.float64)
        if vector.ndim == 0 or vector.shape[-1] != self.size:
            raise ValueError(f"An observation of {self.num_joints} joints has size {self.size}, got {vector.shape}.")
        return {name: vector[..., place] for name, place in self.slices.items()}


def in_link_axes(R_link_imu: ArrayLike, gravity: ArrayLike, gyro: ArrayLike) -> tuple[Array, Array]:
    """What an IMU reads, (..., 3) each in its own frame, in the axes of its link, whose pose the blueprint records.

    A link's axes are the design's while the robot stands as it was built. Controller boxes sit as the room in the bone
    allows, so the IMU's own axes say nothing about the body: a policy that reads them fits one seat of the box only.
    """
    # Not by matmul, whose last bit depends on how many robots are asked together.
    R = np.asarray(R_link_imu, np.float64)
    down, rate = (np.einsum("ij,...j->...i", R, np.asarray(value, np.float64)) for value in (gravity, gyro))
    return down, rate


@dataclass(frozen=True, eq=False, slots=True)
class ActionMap:
    """From what a policy says, about -1 to 1 per joint, to joint targets; every array is (n,).

    Attributes:
        centre: target of an action of 0 [rad].
        scale: how far an action of 1 goes from there [rad].
        low: least target [rad].
        high: greatest target [rad].
        blend: share of the way to a new target that is gone in one control period, above 0 and at most 1.
        step: most that a target may change in one control period [rad].

    Raises:
        ValueError: An array is not (n,) or not finite, low > high, scale < 0, or blend or step is out of bounds.
    """

    centre: Array
    scale: Array
    low: Array
    high: Array
    blend: float
    step: float

    def __post_init__(self) -> None:
        shape = np.shape(self.centre)
        for name in ("centre", "scale", "low", "high"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.ndim != 1 or value.size == 0 or value.shape != shape:
                raise ValueError(f"Action {name} must be (n,), one number per joint, got {value.shape} for {shape}.")
            if not np.isfinite(value).all():
                raise ValueError(f"Action {name} must be finite, got {value.tolist()}.")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if (self.low > self.high).any() or (self.scale < 0).any():
            raise ValueError(
                "Action bounds need low <= high and scale >= 0, "
                f"got {self.low.tolist()}, {self.high.tolist()}, {self.scale.tolist()}."
            )
        if not 0.0 < self.blend <= 1.0:
            raise ValueError(f"Action blend must lie in (0, 1], got {self.blend}.")
        if not 0.0 < self.step < np.inf:
            raise ValueError(f"Action step must be finite and > 0 rad, got {self.step}.")

    @property
    def num_joints(self) -> int:
        """How many joints it commands."""
        return int(self.centre.size)

    def arranged(self, order: Sequence[int] | NDArray[np.intp]) -> ActionMap:
        """The same map for joints in another order: its joint k is joint `order[k]` of this one."""
        places = np.asarray(order)
        return replace(self, **{name: getattr(self, name)[places] for name in ("centre", "scale", "low", "high")})

    def targets(self, said: ArrayLike, previous: ArrayLike, centre: ArrayLike | None = None) -> Array:
        """Joint targets (..., n) [rad] for what a policy says (..., n), after the targets `previous` (..., n) [rad].

        q* = q*' + clip(blend (clip(centre + scale clip(said, -1, 1), low, high) - q*'), -step, step); another `centre`
        (..., n) [rad] may stand for this one's, the rhythm of the moment.
        """
        before = np.asarray(previous, dtype=np.float64)
        middle = self.centre if centre is None else np.asarray(centre, dtype=np.float64)
        wanted = np.clip(middle + self.scale * np.clip(said, -1.0, 1.0), self.low, self.high)
        return np.asarray(before + np.clip(self.blend * (wanted - before), -self.step, self.step))


def normaliser(layout: ObservationLayout, actions: ActionMap) -> tuple[Array, Array]:
    """Centre and gain, (size,) each, by which (observation - centre) gain is of order one in every part.

    They are fixed by the robot and not learned from its data, so that the same observation always means the same.
    """
    n, reach = layout.num_joints, np.maximum(actions.scale, 0.1)
    none = [np.zeros(COMMAND_SIZE)] if layout.commanded else []
    one = [np.ones(COMMAND_SIZE)] if layout.commanded else []
    centre = np.concatenate([np.zeros(6), actions.centre, np.zeros(n), actions.centre, *none])
    gain = np.concatenate([
        np.ones(3), np.full(3, 1 / GYRO_SCALE), 1 / reach, np.full(n, 1 / SPEED_SCALE), 1 / reach, *one
    ])  # fmt: skip
    return np.tile(centre, layout.history), np.tile(gain, layout.history)
