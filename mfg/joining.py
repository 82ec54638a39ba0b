"""Ways to bring the two sides of a joint together: across the motor's axis, leaning, turned, or past soft skin."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import MotorSeat, Transform
from mfg.solids import Solid
from mfg.sweep import SPACING
from mfg.ways import TURNS, Leg, Scene, Way, across, blocked_volume, turned

Array = NDArray[np.float64]
SLOPES = (
    math.radians(30),
    math.radians(60),
)  # of leaning directions, out of the plane across the axis, away from the motor
BENDS = (0.5, -0.5, 1.0, -1.0)  # shares of a joint's range, up or down, by which it may be turned while it is joined
ROUGH = 4.0e-3  # spacing of lines while directions are compared [m]
ROUGH_FREE = 1.0e-6  # what thinned solids may seem to overlap along a way that is free [m3]


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
    sloped = [math.cos(s) * d + math.sin(s) * lean for s in SLOPES for d in across(seat, out)[::2]] + [lean]
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
    directions = across(seat, out)
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
