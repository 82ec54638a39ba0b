"""Whether a person gets at a motor: room to lower it into its cup and to drive the screws of both halves of its mount.

What is in the way for good is what the same body prints for another motor, for it is there before any motor is. So a
seat needs, past the mounts that its bodies carry for others:

- below the base plate, a ring as wide as the screw heads and a screwdriver's reach deep, past the mounts of the holder;
- above the disc the same, past the mounts of both bodies, for they are joined by then;
- above the cup, the motor's own room once more, past the mounts of the holder.

Bones and skins of both bodies are cut there anyway; other bodies come later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import MotorSeat
from mfg.catalogue import ScrewPattern
from mfg.exact import ACCESS, LIFT
from mfg.mounts import Mount, cup_depth, disc_depth

Array = NDArray[np.float64]
SPACING = 5.0e-3  # between the points that stand for a room [m]
MARGIN = 2.0e-3  # by which a mount is grown to make up for that [m]
RIM = math.sqrt(2) * MARGIN  # by which the rim of a grown mount is farther out [m]
ANGLES = 36  # points around; the screws may be anywhere on their circle, for a motor is turned last


@dataclass(frozen=True, eq=False, slots=True)
class _Room:
    """Points of a room that a seat needs, in the frame of its motor, and how far each is from where the room begins.

    Attributes:
        points: (n, 3) [m].
        away: (n,) [m].
        length: of the room [m].
        both: whether what the connector's body carries counts too.
        can: middle of the cylinder that all points lie in, on the motor's axis, its half length and radius [m].
    """

    points: Array
    away: Array
    length: float
    both: bool
    can: tuple[float, float, float]


def shortfall(seat: MotorSeat, other: MotorSeat, mount: Mount) -> float:
    """By how much the rooms that either seat needs are too short past the other's mount, 0 where both are free [m]."""
    return max(_shortfall(seat, other, mount), _shortfall(other, seat, mount))


def reach(mount: Mount) -> float:
    """Two mounts that are so far apart are in nobody's way [m]."""
    return max(room.length for room in _rooms(mount)) + MARGIN


def _shortfall(seat: MotorSeat, other: MotorSeat, mount: Mount) -> float:
    worst = 0.0
    for room in _rooms(mount):
        bodies = (seat.holder, seat.connector) if room.both else (seat.holder,)
        cup, disc = other.holder in bodies, other.connector in bodies
        if not cup and not disc:
            continue
        T, U = seat.T_design_motor, other.T_design_motor
        low = mount.base_low if cup else mount.connector_low
        high = mount.connector_high if disc else mount.connector_low
        # Most rooms are nowhere near: a look at their cylinders tells.
        if _clear_of(T, room.can, U, ((low + high) / 2, (high - low) / 2, mount.envelope_radius)):
            continue
        local = (room.points @ T[:3, :3].T + (T[:3, 3] - U[:3, 3])) @ U[:3, :3]
        radial = np.hypot(local[:, 0], local[:, 1]).astype(np.float32)
        along = local[:, 2].astype(np.float32)
        met = np.zeros(len(local), bool)
        for there, depth in ((cup, cup_depth), (disc, disc_depth)):
            if there:
                met |= depth(radial, along, mount) > -MARGIN
        if met.any():
            worst = max(worst, room.length - float(room.away[met].min()))
    return worst


def _clear_of(T: Array, can: tuple[float, float, float], U: Array, other: tuple[float, float, float]) -> bool:
    """Whether two cylinders about the z axes of two frames (middle, half length, radius) are a margin apart for sure.

    That is so if the shadows that they cast on one axis, on the other, or on the line between their middles are.
    """
    (m, h, r), (n, k, q) = can, other
    z, w = T[:3, 2].tolist(), U[:3, 2].tolist()
    d = [b - a + n * v - m * u for a, b, u, v in zip(T[:3, 3].tolist(), U[:3, 3].tolist(), z, w, strict=True)]
    cosine = abs(z[0] * w[0] + z[1] * w[1] + z[2] * w[2])
    ahead, back = abs(d[0] * z[0] + d[1] * z[1] + d[2] * z[2]), abs(d[0] * w[0] + d[1] * w[1] + d[2] * w[2])
    sine = math.sqrt(max(1 - cosine * cosine, 0.0))
    if max(ahead - h - k * cosine - q * sine, back - k - h * cosine - r * sine) > RIM:
        return True
    away = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    if away <= RIM:
        return False
    a, b = min(ahead / away, 1.0), min(back / away, 1.0)
    return away - h * a - r * math.sqrt(1 - a * a) - k * b - q * math.sqrt(1 - b * b) > RIM


@lru_cache(maxsize=8)
def _rooms(mount: Mount) -> tuple[_Room, ...]:
    motor = mount.motor
    way_in = mount.holder_top + motor.length + LIFT - mount.connector_low
    return (
        _room(_ring(motor.body_screws), mount.base_low, -ACCESS, both=False),
        _room(_ring(motor.output_screws), mount.connector_high, ACCESS, both=True),
        _room([0.0, mount.housing_radius / 2, mount.housing_radius], mount.connector_low, way_in, both=False),
    )


def _room(radii: list[float], start: float, length: float, *, both: bool) -> _Room:
    """Circles about the axis at some radii, all along a length from a start on, whose sign says which way [m]."""
    angle = np.arange(ANGLES) * (2 * np.pi / ANGLES)
    # The first points stand off by the margin, so that a mount beside the start is not met.
    away = np.linspace(MARGIN, abs(length), round(abs(length) / SPACING) + 1)
    r, a, h = (grid.ravel() for grid in np.meshgrid(radii, angle, away, indexing="ij"))
    points = np.stack([r * np.cos(a), r * np.sin(a), start + np.sign(length) * h], axis=1)
    return _Room(points, h, abs(length), both, (start + length / 2, abs(length) / 2, max(radii)))


def _ring(pattern: ScrewPattern) -> list[float]:
    half = pattern.head_diameter / 2
    return [pattern.circle_radius - half, pattern.circle_radius, pattern.circle_radius + half]
