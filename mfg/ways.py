"""Straight ways in for motors, boxes and bodies: searched on thinned solids, proved on the printed ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

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
SLOPES = (math.radians(30), math.radians(60))  # and leaning away from the motor
BENDS = (0.5, -0.5, 1.0, -1.0)  # shares of a joint's range, up or down, by which it may be turned while it is joined
ROUGH, ROUGH_ERROR = 4.0e-3, 1.0e-3  # spacing of lines and surface error while directions are compared [m]
ROUGH_FREE = 1.0e-6  # what thinned solids may seem to overlap along a way that is free [m3]
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
        for direction in _across(seat, seat.T_design_motor[:3, 0]):
            if blocked_volume(raised, fixed, direction) <= FREE:
                return Way((Leg(-direction, float(max(side))), Leg(-z, lift)), 0.0, soft=not soft)
    return Way((Leg(-z, lift),), blocked[1], soft=blocked[0] > blocked[1] + FREE,
               by=scene.culprit(solid, z, [seat.holder], but=k))  # fmt: skip


def join_way(scene: Scene, k: int, group: frozenset[int], *, thorough: bool) -> Way:
    """How the child's side of a joint comes onto the parent's.

    Directions across the motor's axis first: the disc slides onto the output face. If `thorough`, also leaning ones,
    with the joint turned, and past soft skin; of all, the way that meets least if none is free.
    """
    seat = scene.blueprint.seats[k]
    hinge = scene.blueprint.hinges[seat.hinge]
    away = scene.side(k, group)
    pair = _Pair(scene, away, group - away)
    out = pair.outward(seat)
    best = _level(pair, seat, out, None, 0.0)
    if best.free or not thorough:
        return best
    z, near = seat.T_design_motor[:3, 2], -best.legs[0].direction
    for part in (1 / 2, -1 / 2, 1 / 4, -1 / 4):  # Between the directions tried, beside the best of them.
        angle = part * 2 * math.pi / TURNS
        best = min(best, pair.way(math.cos(angle) * near + math.sin(angle) * np.cross(z, near), None, 0.0),
                   key=lambda w: w.blocked)  # fmt: skip
        if best.free:
            return best
    lean = z * (1.0 if seat.connector in away else -1.0)
    sloped = [math.cos(s) * d + math.sin(s) * lean for s in SLOPES for d in _across(seat, out)[::2]] + [lean]
    for direction in sloped:
        if pair.blocked(direction, None, rough=True) <= ROUGH_FREE:
            way = pair.way(direction, None, 0.0)
            best = min(best, way, key=lambda w: w.blocked)
            if best.free:
                return best
    for share in BENDS:
        angle = float(share * hinge.range[1] if share > 0 else -share * hinge.range[0])
        if abs(angle) < 0.05:
            continue
        T = turned(hinge.position, hinge.axis, angle)
        way = _level(pair, seat, out, T, angle)
        best = min(best, way, key=lambda w: w.blocked)
        if best.free:
            return best
    way = _level(replace(pair, soft=False), seat, out, None, 0.0)
    if way.blocked < best.blocked:
        best = replace(way, soft=True)
    if not best.free:
        T = turned(hinge.position, hinge.axis, best.angle)
        moved = [s.moved(T) for s in pair.solids(away, rough=False)]
        best = replace(best, by=scene.culprit(moved, -best.legs[0].direction, group - away))
    return best


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


@dataclass(frozen=True, eq=False, slots=True)
class _Pair:
    """What moves away in a join, taken apart, and what stays."""

    scene: Scene
    away: frozenset[int]
    stay: frozenset[int]
    soft: bool = True

    def solids(self, side: frozenset[int], *, rough: bool) -> list[Solid]:
        scene = self.scene
        if rough and self.soft:
            return [s for b in sorted(side) for s in scene.rough[b]] + scene.held(side)
        return scene.printed(side, soft=self.soft) + scene.held(side)

    def blocked(self, out: Array, T: Transform | None, *, rough: bool) -> float:
        moved = self.solids(self.away, rough=rough)
        if T is not None:
            moved = [s.moved(T) for s in moved]
        return blocked_volume(moved, self.solids(self.stay, rough=rough), out, spacing=ROUGH if rough else SPACING)

    def way(self, out: Array, T: Transform | None, angle: float) -> Way:
        """The way along a direction, measured on the printed solids."""
        here = np.concatenate([s.vertices for s in self.scene.printed(self.away)]) @ out
        there = np.concatenate([s.vertices for s in self.scene.printed(self.stay)]) @ out
        return Way((Leg(-out, float(max(there.max() - here.min(), 0.05))),), self.blocked(out, T, rough=False), angle)

    def outward(self, seat: MotorSeat) -> Array:
        """Across the motor's axis, from what stays to what leaves."""

        def centre(side: frozenset[int]) -> Array:
            boxes = [s.bounds.mean(0) for s in self.scene.printed(side, soft=False)]
            return np.mean(boxes, axis=0)

        middle = centre(self.stay), centre(self.away)
        z = seat.T_design_motor[:3, 2]
        out = middle[1] - middle[0]
        out = out - (out @ z) * z
        length = float(np.linalg.norm(out))
        return out / length if length > 1e-3 else seat.T_design_motor[:3, 0]


def _level(pair: _Pair, seat: MotorSeat, out: Array, T: Transform | None, angle: float) -> Way:
    """The way across the axis in the middle of the widest run of free directions, tried from `out` to both sides."""
    directions = _across(seat, out)
    rough: dict[int, float] = {}
    for step in _outwards(TURNS):
        rough[step] = pair.blocked(directions[step], T, rough=True)
        if _closed(rough):
            break
    free = [k for k, volume in rough.items() if volume <= ROUGH_FREE]
    depth = {k: min(_steps(k, b) for b in rough if rough[b] > ROUGH_FREE) if len(free) < len(rough) else TURNS
             for k in free}  # fmt: skip
    order = sorted(free, key=lambda k: (-depth[k], _steps(k, 0), k)) or [min(rough, key=lambda k: (rough[k], k))]
    best = pair.way(directions[order[0]], T, angle)
    for k in order[1:5]:
        if best.free:
            break
        best = min(best, pair.way(directions[k], T, angle), key=lambda w: w.blocked)
    return best


def _closed(rough: dict[int, float]) -> bool:
    """Whether a run of free directions is known with a blocked one at either end."""
    for k, volume in rough.items():
        if volume > ROUGH_FREE:
            continue
        ends = 0
        for way in (1, -1):
            at = k
            while rough.get(at, np.inf) <= ROUGH_FREE and _steps(at, k) < TURNS // 2:
                at = (at + way) % TURNS
            ends += at in rough and rough[at] > ROUGH_FREE
        return ends == 2
    return False


def _steps(a: int, b: int) -> int:
    """How many directions lie between two."""
    return min((a - b) % TURNS, (b - a) % TURNS)


def _outwards(count: int) -> Iterator[int]:
    """0, 1, -1, 2, -2, ... modulo count, each once."""
    yield 0
    for k in range(1, count // 2 + 1):
        yield k
        if k != count - k:
            yield count - k


def _across(seat: MotorSeat, first: Array) -> list[Array]:
    """Unit vectors all around a motor's axis, beginning with one across it."""
    z = seat.T_design_motor[:3, 2]
    other = np.cross(z, first)
    angles = [2 * math.pi * k / TURNS for k in range(TURNS)]
    return [math.cos(a) * first + math.sin(a) * other for a in angles]
