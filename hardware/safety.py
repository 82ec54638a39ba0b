"""Guards: pure functions from what was measured to the first reason to stop.

Every guard that trips is latched by the caller; there is no way back but a new start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.bundle import Bundle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Limits:
    """What the guards allow beyond the motor's and the joint's own limits, which the bundle states."""

    position_margin: float = 0.15  # measured beyond the joint's range; targets never leave the range itself [rad]
    velocity_ratio: float = 1.1  # of the motor's greatest speed
    torque_ratio: float = 1.1  # of the motor's peak torque
    tracking_error: float = 0.6  # between target and measurement [rad] ...
    tracking_time: float = 0.5  # ... for this long without a break: a stall [s]
    derating_temperature: float = 80.0  # from here stiffness fades [C] ...
    stop_temperature: float = 110.0  # ... to nothing here, before the motor's own faults at 120 and 125 [C]
    reply_age: float = 0.1  # since a motor last answered [s]
    tilt: float = 1.4  # from the attitude in which the policy took over [rad]
    overruns: int = 10  # late periods in a row


DEFAULT_LIMITS = Limits()


@dataclass(frozen=True, slots=True)
class Trip:
    """Why the robot was stopped."""

    guard: str
    joint: str | None
    value: float
    bound: float

    def as_json(self) -> dict[str, Any]:
        """The contract's form; JSON has no NaN or infinity, so such a value is null."""
        value = self.value if math.isfinite(self.value) else None
        return {"guard": self.guard, "joint": self.joint, "value": value, "bound": self.bound}


@dataclass(frozen=True, eq=False, slots=True)
class Sample:
    """What the guards look at in one period; joint vectors are (n,) in the bundle's order."""

    position: Array  # [rad]
    velocity: Array  # [rad/s]
    torque: Array  # [N.m]
    temperature: Array  # the hotter of each motor's sensors [C]
    age: Array  # since the last reply [s]
    faults: NDArray[np.int64]  # status words
    overruns: int = 0  # late periods in a row
    tilt: float | None = None  # None without an IMU, or before there is a reference [rad]


def worst(guard: str, names: tuple[str, ...], value: Array, bound: Array) -> Trip | None:
    """Trip for the joint that exceeds its bound by most; a NaN exceeds every bound."""
    excess = np.where(np.isnan(value), np.inf, value - bound)
    index = int(np.argmax(excess))
    if not excess[index] > 0.0:
        return None
    return Trip(guard, names[index], float(value[index]), float(bound[index]))


def check_sample(sample: Sample, bundle: Bundle, limits: Limits) -> Trip | None:
    """Look at the measurements of one period; the first guard that trips, in order of severity."""
    names, n = bundle.names, len(bundle.joints)
    low, high = bundle.column("range").T
    over = sample.position > high
    past = np.where(over, sample.position - high, low - sample.position)
    beyond = worst("position", names, past, np.full(n, limits.position_margin))
    if beyond is not None:
        # Say where the joint is, not how far beyond: that is what one can look up.
        index = names.index(beyond.joint or "")
        bound = high[index] + limits.position_margin if over[index] else low[index] - limits.position_margin
        beyond = Trip("position", beyond.joint, float(sample.position[index]), float(bound))
    return (
        worst("fault", names, sample.faults.astype(np.float64), np.zeros(n))
        or worst("reply_age", names, sample.age, np.full(n, limits.reply_age))
        or worst("temperature", names, sample.temperature, np.full(n, limits.stop_temperature))
        or beyond
        or worst("velocity", names, np.abs(sample.velocity), limits.velocity_ratio * bundle.column("max_speed"))
        or worst("torque", names, np.abs(sample.torque), limits.torque_ratio * bundle.column("peak_torque"))
        or _scalar("tilt", sample.tilt, limits.tilt)
        or _scalar("overrun", float(sample.overruns), float(limits.overruns))
    )


def _scalar(guard: str, value: float | None, bound: float) -> Trip | None:
    if value is None or value <= bound:
        return None
    return Trip(guard, None, value, bound)


def check_action(action: Array, names: tuple[str, ...]) -> Trip | None:
    """Refuse a policy output that is not finite."""
    for name, value in zip(names, action, strict=True):
        if not math.isfinite(value):
            return Trip("nan", name, float(value), 0.0)
    return None


def check_step(target: Array, previous: Array, bundle: Bundle, seconds: float) -> Trip | None:
    """Refuse targets that jump further than the motor could turn in the `seconds` since the previous ones."""
    return worst("target_step", bundle.names, np.abs(target - previous), bundle.column("max_speed") * seconds)


def check_stall(
    seconds: Array, target: Array, position: Array, bundle: Bundle, limits: Limits
) -> tuple[Array, Trip | None]:
    """Count for how long each joint has been away from its target; trips when one stays away too long.

    Args:
        seconds: Counts so far, (n,) [s].
        target: Where the joints should be, (n,) [rad].
        position: Where they are, (n,) [rad].
        bundle: The robot.
        limits: The bounds.

    Returns:
        The new counts, and the trip with the error as its value.
    """
    error = np.abs(target - position)
    counted = np.where(error > limits.tracking_error, seconds + bundle.dt, 0.0)
    stalled = worst("tracking", bundle.names, counted, np.full(len(bundle.joints), limits.tracking_time - 1e-9))
    if stalled is None:
        return counted, None
    index = bundle.names.index(stalled.joint or "")
    return counted, Trip("tracking", stalled.joint, float(error[index]), limits.tracking_error)


def derating(temperature: Array, limits: Limits) -> Array:
    """Share of the stiffness that a motor may use, 1 when cool and 0 at the stop temperature, (n,)."""
    span = limits.stop_temperature - limits.derating_temperature
    return np.asarray(np.clip((limits.stop_temperature - temperature) / span, 0.0, 1.0))


def within_torque(target: Array, position: Array, velocity: Array, bundle: Bundle) -> Array:
    """Move targets towards the measurement until kp (target - q) - kd qd asks for no more than the peak torque, (n,).

    The wire would pass on twice the motor's peak.
    """
    kp, peak = bundle.column("kp"), bundle.column("peak_torque")
    damping = -bundle.column("kd") * velocity
    safe_kp = np.where(kp > 0.0, kp, 1.0)
    low, high = position + (-peak - damping) / safe_kp, position + (peak - damping) / safe_kp
    return np.where(kp > 0.0, np.clip(target, low, high), target)


def angle_between(a: Array, b: Array) -> float:
    """Angle between two directions, NaN if one has no direction [rad]."""
    # The arc tangent stays accurate where the arc cosine does not, near 0 and pi.
    cross, dot = float(np.linalg.norm(np.cross(a, b))), float(a @ b)
    return math.atan2(cross, dot) if math.isfinite(cross + dot) and cross + abs(dot) > 0.0 else math.nan
