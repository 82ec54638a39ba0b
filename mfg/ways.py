"""Straight ways in for motors and boxes, and room for the tools that drive screws, proved on the printed solids."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, MotorSeat, Transform
from mfg.exact import LIFT, box_solid, motor_solid
from mfg.mounts import Mount, mount_of
from mfg.solids import Solid, cylinder, union
from mfg.sweep import SPACING, Lattice, crossings, obstruction, window_of

Array = NDArray[np.float64]

FREE = 1.0e-8  # overlap that a way may have: a cube of 2 mm, what rounding leaves between parts that touch [m3]
TURNS = 24  # directions tried across a motor's axis
ROUGH_ERROR = 1.0e-3  # of the surfaces of thinned solids, on which directions are compared [m]
TOOLS = (0.120, 0.060, 0.035, 0.020)  # room for a tool above a screw head: a driver, a stubby one, keys [m]
HEAD = 4.0e-3  # height of an M4 cap screw's head [m]


@dataclass(frozen=True, eq=False, slots=True)
class Leg:
    """One straight piece of a way in: the direction in which the thing moves, design frame, and how far [m]."""

    direction: Array
    travel: float


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """A way in.

    Attributes:
        legs: first leg first; before the first the thing is outside, after the last in place.
        blocked: volume that is met on it [m3]; the first leg is judged as if it began infinitely far away.
        angle: of the joint while it is joined [rad].
        soft: whether soft skin stands in the way, which bends; it is not counted in `blocked` then.
        by: what is in the way, empty if nothing is.
    """

    legs: tuple[Leg, ...]
    blocked: float
    angle: float = 0.0
    soft: bool = False
    by: str = ""

    @property
    def free(self) -> bool:
        """Whether nothing hard is in the way."""
        return self.blocked <= FREE

    @property
    def trouble(self) -> str:
        """Why the way is not free, for people; empty where it is."""
        return "" if self.free else f"{self.by} stands in the way by {1e6 * self.blocked:.2f} cm3"


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """The solids of a built robot, design frame: bones and skins by body, motors by seat, boxes and lids by index."""

    blueprint: Blueprint
    mount: Mount
    rigid: list[list[Solid]]
    soft: list[list[Solid]]
    rough: list[list[Solid]]
    motors: list[Solid]
    boxes: list[Solid]
    lids: list[Solid]

    @classmethod
    def of(cls, blueprint: Blueprint) -> Scene:
        """The scene of a blueprint with parts."""
        lids = {lid.part for lid in blueprint.lids}
        printed = [p for p in blueprint.parts if p.name not in lids]
        parts = [[p for p in printed if p.body == b] for b in range(len(blueprint.bodies))]
        return cls(
            blueprint,
            mount_of(blueprint.catalogue.motor),
            [[p.solid for p in of_body if p.material == "rigid"] for of_body in parts],
            [[p.solid for p in of_body if p.material == "soft"] for of_body in parts],
            [[p.solid.simplified(ROUGH_ERROR) for p in of_body] for of_body in parts],
            [motor_solid(blueprint, seat) for seat in blueprint.seats],
            [box_solid(box) for box in blueprint.boxes],
            [p.solid for lid in blueprint.lids for p in blueprint.parts if p.name == lid.part],
        )

    def printed(self, bodies: Iterable[int], *, soft: bool = True) -> list[Solid]:
        """Bones, and skins if `soft`, of some bodies."""
        return [s for b in sorted(bodies) for s in (*self.rigid[b], *(self.soft[b] if soft else ()))]

    def held(self, bodies: Iterable[int], but: int = -1) -> list[Solid]:
        """The motors that some bodies hold, without one."""
        inside = set(bodies)
        return [m for k, m in enumerate(self.motors) if k != but and self.blueprint.seats[k].holder in inside]

    def side(self, seat: int, group: frozenset[int]) -> frozenset[int]:
        """The bodies of a group that hang on a joint's child, with the child."""
        side = {self.blueprint.hinges[self.blueprint.seats[seat].hinge].body}
        for hinge in self.blueprint.hinges:  # A parent always comes before its children.
            if hinge.parent in side and hinge.body in group:
                side.add(hinge.body)
        return frozenset(side)

    def culprit(
        self, moved: Sequence[Solid], out: Array, bodies: Iterable[int], but: int = -1, travel: float = np.inf
    ) -> str:
        """Name of what is most in the way of something that leaves along `out`, by so much [m]."""
        found: list[tuple[float, str]] = []
        for b in sorted(bodies):
            name = self.blueprint.bodies[b].name
            found.append((blocked_volume(moved, self.rigid[b], out, travel), f"the bone of {name}"))
            found.append((blocked_volume(moved, self.soft[b], out, travel), f"the skin of {name}"))
        for k, seat in enumerate(self.blueprint.seats):
            if k != but and seat.holder in bodies:
                joint = self.blueprint.hinges[seat.hinge].name
                found.append((blocked_volume(moved, [self.motors[k]], out, travel), f"the motor of {joint}"))
        return max(found, key=lambda row: row[0])[1]


def blocked_volume(
    moved: Sequence[Solid], fixed: Sequence[Solid], out: Array, travel: float = np.inf, spacing: float = SPACING
) -> float:
    """Volume of `fixed` that `moved` runs through while it travels along `out` [m3]; inf: away for good."""
    lattice = Lattice.along(out, spacing)
    window, low = window_of(moved, lattice)
    return obstruction(crossings(moved, lattice), crossings(fixed, lattice, window, low), travel, spacing)


def box_way(scene: Scene, index: int, group: frozenset[int], others: Iterable[int]) -> Way:
    """A box's way down its shaft, past everything in a group of joined bodies and the other boxes in it."""
    seat, solid = scene.blueprint.boxes[index], [scene.boxes[index]]
    out = seat.T_design_box[:3, 2]
    beside = [scene.boxes[k] for k in sorted(others) if scene.blueprint.boxes[k].body in group]
    hard = scene.printed(group, soft=False) + scene.held(group) + beside
    legs = (Leg(-out, seat.shaft + seat.size[2] / 2),)
    blocked = blocked_volume(solid, hard, out)
    soft = blocked_volume(solid, [s for b in sorted(group) for s in scene.soft[b]], out) > FREE
    return Way(legs, blocked, soft=soft, by="" if blocked <= FREE else scene.culprit(solid, out, group))


def lid_way(scene: Scene, index: int, group: frozenset[int]) -> Way:
    """A lid's way onto its opening, past everything in a group of joined bodies."""
    solid, seat = [scene.lids[index]], scene.blueprint.boxes[scene.blueprint.lids[index].box]
    out = seat.T_design_box[:3, 2]
    hard = scene.printed(group, soft=False) + scene.held(group)
    blocked = blocked_volume(solid, hard, out)
    soft = blocked_volume(solid, [s for b in sorted(group) for s in scene.soft[b]], out) > FREE
    by = "" if blocked <= FREE else scene.culprit(solid, out, group)
    return Way((Leg(-out, max(seat.shaft - seat.size[2] / 2, 0.03)),), blocked, soft=soft, by=by)


def motor_way(scene: Scene, k: int) -> Way:
    """A motor's way into the empty cup of its holder alone: straight down, or sideways over the cup, then down."""
    seat, solid = scene.blueprint.seats[k], [scene.motors[k]]
    z = seat.T_design_motor[:3, 2]
    lift = scene.mount.motor.length + LIFT
    blocked = []
    for soft in (True, False):  # Soft skin counts as an obstacle unless there is no way past it.
        fixed = scene.printed([seat.holder], soft=soft) + scene.held([seat.holder], but=k)
        blocked.append(blocked_volume(solid, fixed, z))
        if blocked[-1] <= FREE:
            return Way((Leg(-z, lift),), blocked[-1], soft=not soft)
        if blocked_volume(solid, fixed, z, lift) > FREE:
            continue
        T = np.eye(4)
        T[:3, 3] = lift * z
        raised = [scene.motors[k].moved(T)]
        side = [scene.mount.motor.diameter, *(np.ptp(s.vertices, axis=0).max() for s in scene.rigid[seat.holder])]
        for direction in across(seat, seat.T_design_motor[:3, 0]):
            if blocked_volume(raised, fixed, direction) <= FREE:
                return Way((Leg(-direction, float(max(side))), Leg(-z, lift)), 0.0, soft=not soft)
    return Way((Leg(-z, lift),), blocked[1], soft=blocked[0] > blocked[1] + FREE,
               by=scene.culprit(solid, z, [seat.holder], but=k))  # fmt: skip


def turned(position: Array, axis: Array, angle: float) -> Transform:
    """Turn about a line by the right-hand rule (Rodrigues), design frame."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)
    T[:3, 3] = position - T[:3, :3] @ position
    return T


def tool_room(scene: Scene, k: int, bodies: Iterable[int], *, output: bool) -> tuple[float, str]:
    """Free height above the heads of a joint's screws, as one of `TOOLS` [m], and what ends it; 0 is too little."""
    seat, mount = scene.blueprint.seats[k], scene.mount
    pattern = mount.motor.output_screws if output else mount.motor.body_screws
    sign = 1.0 if output else -1.0
    seat_height = mount.connector_low + 6e-3 if output else mount.base_low
    low, high = (seat_height + 1e-4, seat_height + HEAD) if output else (seat_height - HEAD, seat_height - 1e-4)
    heads = []
    for j in range(pattern.count):
        angle = 2 * math.pi * j / pattern.count
        T = np.eye(4)
        T[:2, 3] = pattern.circle_radius * math.cos(angle), pattern.circle_radius * math.sin(angle)
        # A little slimmer than the counterbore that the head sits in.
        heads.append(cylinder(pattern.head_diameter / 2 - 2e-4, low, high, 12).moved(seat.T_design_motor @ T))
    inside = set(bodies)
    fixed = scene.printed(inside) + scene.held(inside)
    out, moved = sign * seat.T_design_motor[:3, 2], [union(heads)]
    lattice = Lattice.along(out, 1e-3)
    window, bottom = window_of(moved, lattice)
    above = crossings(moved, lattice), crossings(fixed, lattice, window, bottom)
    for room in TOOLS:
        if obstruction(*above, room, lattice.spacing) <= FREE / 4:
            return room, ""
    return 0.0, scene.culprit(moved, out, inside, travel=TOOLS[-1])


def across(seat: MotorSeat, first: Array) -> list[Array]:
    """Unit vectors all around a motor's axis, beginning with one across it."""
    z = seat.T_design_motor[:3, 2]
    other = np.cross(z, first)
    angles = [2 * math.pi * k / TURNS for k in range(TURNS)]
    return [math.cos(a) * first + math.sin(a) * other for a in angles]
