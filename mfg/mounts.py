"""The parametric motor mount: a holder around the housing and a connector on the output face.

Everything is round about the hinge axis, so the room that one side must leave for the other is a plain cylinder
whatever the joint angle. Frame of this file: the motor frame, origin at the housing's centre, z along the hinge axis
towards the output face.

      z                    r = 0         cavity   holder   connector
    connector_high  +-----------------------------------------+
                    |        disc, screwed to the output      |
    connector_low   +-------------------------+---------------+   = housing_high
    holder_top      |                         |  wall  |
                    |     motor housing       |  (cup) |
    housing_low     +-------------------------+        |
    base_low        +--- base plate, screws, bore -----+
"""

from __future__ import annotations

import atexit
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mfg.catalogue import Motor, ScrewPattern
from mfg.fields import cylinder_depth, cylindrical
from mfg.solids import Solid, cylinder, tube

FIT = 4e-4  # radial gap between housing and cup, a sliding fit in PLA [m]
WALL = 7.5e-3  # of the cup [m]
BASE = 6e-3  # thickness of the base plate [m]
DISC = 14e-3  # thickness of the connector [m]
RIM = 9.5e-3  # how far the connector reaches beyond the housing [m]
GAP = 1.0e-3  # running gap between parts that move against each other [m]
MIN_OVERLAP = (
    5.0e-6  # tau: least volume that each half of a mount must share with its bone, a seventh of a disc rim [m3]
)
BORE = 9e-3  # radius of the cable bore in the base plate [m]


@dataclass(frozen=True, slots=True)
class Mount:
    """Radii and heights of the mount of one motor [m], motor frame."""

    motor: Motor
    housing_radius: float
    housing_low: float
    housing_high: float
    cavity_radius: float
    holder_radius: float
    base_low: float
    holder_top: float
    connector_radius: float
    connector_low: float
    connector_high: float
    clearance: float

    @property
    def envelope_radius(self) -> float:
        """Radius that nothing else may enter, without the running gap."""
        return max(self.holder_radius, self.connector_radius)

    @property
    def attach_radius(self) -> float:
        """Radius of the cylinder that the bone processor cuts: the mount and the bone fuse outside it."""
        return self.cavity_radius


def mount_of(motor: Motor) -> Mount:
    """Size the mount of a motor."""
    radius, half = motor.diameter / 2, motor.length / 2
    return Mount(
        motor=motor,
        housing_radius=radius,
        housing_low=-half,
        housing_high=half,
        cavity_radius=radius + FIT,
        holder_radius=radius + FIT + WALL,
        base_low=-half - BASE,
        holder_top=half - GAP,
        connector_radius=radius + FIT + RIM,
        connector_low=half,
        connector_high=half + DISC,
        clearance=GAP,
    )


@lru_cache(maxsize=8)
def housing(mount: Mount) -> Solid:
    """The motor itself."""
    return cylinder(mount.housing_radius, mount.housing_low, mount.housing_high)


@lru_cache(maxsize=8)
def holder(mount: Mount) -> Solid:
    """The cup around the housing, with screw holes and a cable bore in its base plate."""
    cup = tube(mount.holder_radius, mount.cavity_radius, mount.base_low, mount.holder_top)
    base = cylinder(mount.holder_radius - WALL / 2, mount.base_low, mount.housing_low)
    bore = cylinder(BORE, mount.base_low - GAP, mount.housing_low + GAP)
    holes = screw_holes(mount.motor.body_screws, mount.base_low - GAP, mount.housing_low + GAP)
    return (cup + base).minus([bore, *holes])


@lru_cache(maxsize=8)
def connector(mount: Mount) -> Solid:
    """The disc on the output face, with counterbored screw holes."""
    pattern = mount.motor.output_screws
    heads = _ring(pattern, pattern.head_diameter / 2, mount.connector_low + 6e-3, mount.connector_high + GAP)
    holes = screw_holes(pattern, mount.connector_low - GAP, mount.connector_high + GAP)
    return cylinder(mount.connector_radius, mount.connector_low, mount.connector_high).minus([*holes, *heads])


@lru_cache(maxsize=8)
def holder_keepout(mount: Mount) -> Solid:
    """What the connector's body must leave free: the holder with its running gap."""
    return cylinder(mount.holder_radius + mount.clearance, mount.base_low - mount.clearance, mount.connector_low)


@lru_cache(maxsize=8)
def connector_keepout(mount: Mount) -> Solid:
    """What the holder's body must leave free: the turning connector with its running gap."""
    return cylinder(mount.connector_radius + mount.clearance, mount.holder_top, mount.connector_high + mount.clearance)


@lru_cache(maxsize=8)
def cavity(mount: Mount) -> Solid:
    """The hole that the housing slides into, from the base plate to the connector."""
    return cylinder(mount.cavity_radius, mount.housing_low, mount.connector_low)


@lru_cache(maxsize=8)
def envelope(mount: Mount, gap: float = GAP) -> Solid:
    """Holder, motor and connector as one round solid grown by `gap`: what any third body must leave free."""
    low = cylinder(mount.holder_radius + gap, mount.base_low - gap, mount.connector_low + 1e-6)
    return low + cylinder(mount.connector_radius + gap, mount.connector_low - gap, mount.connector_high + gap)


def screw_holes(pattern: ScrewPattern, low: float, high: float) -> list[Solid]:
    """Clearance holes of a screw pattern between two heights [m]."""
    return _ring(pattern, pattern.hole_diameter / 2, low, high)


def envelope_depth(
    points: NDArray[np.float64], T_design_motor: NDArray[np.float64], mount: Mount, gap: float = 0.0
) -> NDArray[np.float32]:
    """Depth inside the envelope grown by `gap`, at points (..., 3) of the design frame [m]."""
    radial, along = _about(points, T_design_motor)
    return np.maximum(cup_depth(radial, along, mount), disc_depth(radial, along, mount)) + np.float32(gap)


def cup_depth(radial: NDArray[np.float32], along: NDArray[np.float32], mount: Mount) -> NDArray[np.float32]:
    """Depth inside the filled cup, from the distance to the motor axis and the height along it [m]."""
    return cylinder_depth(radial, along, mount.holder_radius, mount.base_low, mount.connector_low)


def disc_depth(radial: NDArray[np.float32], along: NDArray[np.float32], mount: Mount) -> NDArray[np.float32]:
    """Depth inside the connector disc, from the distance to the motor axis and the height along it [m]."""
    return cylinder_depth(radial, along, mount.connector_radius, mount.connector_low, mount.connector_high)


def motor_pose(position: NDArray[np.float64], axis: NDArray[np.float64], offset: float) -> NDArray[np.float64]:
    """T_design_motor with z along `axis`, its origin at position + offset * axis, x chosen by a fixed rule."""
    z = np.asarray(axis, np.float64)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2] = x, np.cross(z, x), z
    T[:3, 3] = position + offset * z
    return T


def _about(
    points: NDArray[np.float64], T_design_motor: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    x, y, z = (points[..., axis] for axis in range(3))
    return cylindrical((x, y, z), T_design_motor[:3, 3], T_design_motor[:3, 2])


def _ring(pattern: ScrewPattern, radius: float, low: float, high: float) -> list[Solid]:
    holes = []
    for k in range(pattern.count):
        angle = 2 * math.pi * k / pattern.count
        T = np.eye(4)
        T[:2, 3] = pattern.circle_radius * math.cos(angle), pattern.circle_radius * math.sin(angle)
        holes.append(cylinder(radius, low, high, 16).moved(T))
    return holes


@atexit.register
def _forget() -> None:
    """Drop the cached solids before the interpreter ends: the mesh kernel reports objects that outlive it."""
    for make in (housing, holder, connector, holder_keepout, connector_keepout, cavity, envelope):
        make.cache_clear()
