"""What a robot's control loop goes by and leaves: its states, how long they last, and what one period did."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from hardware.safety import Trip

Array = NDArray[np.float64]
Imu = tuple[Array, Array]  # gravity's direction (3,), angular velocity (3,) [rad/s], in the IMU frame


class State(StrEnum):
    """Where the robot is on its one-way road."""

    PASSIVE = "passive"
    ENABLE = "enable"
    RAMP = "ramp"
    HOLD = "hold"
    POLICY = "policy"
    DAMPING = "damping"
    OFF = "off"


@dataclass(frozen=True, slots=True)
class Schedule:
    """How long each state lasts [s]."""

    policy: float = 10.0
    passive: float = 0.1
    ramp: float = 2.0  # at least; longer if a joint has far to go
    ramp_speed: float = 1.0  # no joint is asked to be faster on the ramp [rad/s]
    hold: float = 0.5
    blend: float = 0.5  # within which the policy takes over from the hold pose
    damping: float = 1.0
    damping_gain: float = 2.0  # kd while braking, on the wire's grid [N.m.s/rad]


DEFAULT_SCHEDULE = Schedule()


@dataclass(frozen=True, eq=False, slots=True)
class Tick:
    """What one period did; joint vectors are (n,), NaN where nothing was measured yet."""

    index: int
    state: State
    target: Array  # what was commanded, within the joint's range [rad]
    previous_target: Array  # what was in force until now, to compare `position` with [rad]
    position: Array  # [rad]
    velocity: Array  # [rad/s]
    torque: Array  # [N.m]
    temperature: Array  # [C]
    imu: Imu | None
    trip: Trip | None
