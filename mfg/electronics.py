"""Solver: the battery and the controller box inside bones large enough for them (paper: electronics solver node)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, BoxSeat
from mfg.box_host import KINDS, Host, Kind, scored
from mfg.catalogue import Size
from mfg.insertion import Room, interference_above
from mfg.miss import Miss
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage

Array = NDArray[np.float64]
ORDERS = np.array(list(itertools.permutations(range(3))))  # which side of a box lies along which axis of the frame
WAYS = tuple((axis, sign) for axis in range(3) for sign in (1, -1))  # openings: along +x, -x, +y, ... of the frame
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class ElectronicsSolver:
    """Place battery and controller at the centre of mass of a bone, scanning orientations.

    The bodies are tried from the largest bone down. In each, the boxes take the 24 orientations along the design axes
    and the 24 along the bone's principal axes; both together (side by side along any axis, their common centre at the
    centre of mass) where one bone takes them, else one each in the two largest bones that do. Of the accepted
    orientations the one with the least interference above the modules wins; ties go to the shorter insertion shafts,
    then to the earlier orientation. The principal axes are tried only where the design axes leave interference.

    Attributes:
        clearance: gap between a box and its cavity [m].
        wall: least depth of a cavity in the bone, away from every motor mount too, and between two cavities [m].
        containment: share of a cavity's sampled points that must be that deep; 1 means all of them.
        sample: greatest distance between sampled points of a cavity [m].
        grid: resolution at which orientations are compared by the room above the modules [m].
    """

    clearance: float = 0.001
    wall: float = 0.003
    containment: float = 1.0
    sample: float = 0.008
    grid: float = 0.010

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `boxes` and the two electronics scores, or a failure with the closest miss."""
        sizes: dict[Kind, Size] = {
            "battery": blueprint.catalogue.battery.size,
            "controller": blueprint.catalogue.computer.size,
        }
        hosts = [Host(blueprint, index, mount_of(blueprint.catalogue.motor)) for index in range(len(blueprint.bodies))]
        hosts.sort(key=lambda host: (-host.samples, host.index))
        together = []
        for host in hosts:
            found = self._seat(host, KINDS, sizes)
            if found.boxes:
                return scored(blueprint, found.boxes, [host])
            together.append(found)
        alone = {kind: [self._seat(host, (kind,), sizes) for host in hosts] for kind in KINDS}
        for small in range(1, len(hosts)):
            for large in range(small):
                for b, c in ((large, small), (small, large)):
                    boxes = alone["battery"][b].boxes, alone["controller"][c].boxes
                    if all(boxes):
                        return scored(blueprint, boxes[0] + boxes[1], [hosts[b], hosts[c]])
        tries: dict[str, list[_Found]] = {
            "both": together,
            "battery": alone["battery"],
            "controller": alone["controller"],
        }
        best = {what: max(found, key=lambda f: f.margin) for what, found in tries.items()}
        short = ", ".join(
            f"{what} fits {found.host.name}" if found.boxes else
            f"{what} {-1e3 * found.margin:.1f} mm short in {found.host.name}"
            for what, found in best.items()
        )  # fmt: skip
        detail = f"no bones take the boxes with walls of {1e3 * self.wall:.0f} mm (closest: {short})"
        lacking = [found for found in best.values() if not found.boxes]
        nearest = max(lacking, key=lambda f: f.margin)
        miss = Miss(
            "depth of the boxes in their bones", "m", self.wall + nearest.margin, self.wall,
            bodies=tuple(sorted({found.host.index for found in best.values()})), grow=-nearest.margin,
            remedy="grow_body",
        )  # fmt: skip
        return Failure(Stage.ELECTRONICS, Reason.NO_ROOM, detail, miss)

    def _seat(self, host: Host, kinds: tuple[Kind, ...], sizes: dict[Kind, Size]) -> _Found:
        """The best accepted orientation of one or both boxes in a host, or how far the closest one is from it."""
        if not (host.free.values > 0).any():
            return _Found(host, (), -max(sizes["battery"]))
        layouts = side_by_side(tuple(sizes[kind] for kind in kinds), self.clearance, self.wall)
        best: tuple[float, float, tuple[BoxSeat, ...]] | None = None
        margin = -math.inf
        for frame in host.frames:
            accepted, margins = self._contained(host, frame, layouts, kinds, sizes)
            margin = max(margin, margins)
            if not len(accepted.order):
                continue
            seats = self._openings(host, frame, accepted, kinds)
            interference = sum(interference_above(replace(host.blueprint, boxes=seats), seat) for seat in seats)
            shafts = sum(seat.shaft for seat in seats)
            if best is None or (interference, shafts) < best[:2]:
                best = (interference, shafts, seats)
            if interference == 0.0:
                break
        return _Found(host, best[2] if best else (), margin)

    def _contained(
        self, host: Host, frame: Array, layouts: Arrangements, kinds: tuple[Kind, ...], sizes: dict[Kind, Size]
    ) -> tuple[Arrangements, float]:
        """The layouts whose cavities are deep enough in the bone, and the greatest least depth past the wall [m]."""
        corners = layouts.centre[..., None, :] + CORNERS * layouts.half[..., None, :]
        depth = host.free.sample(host.anchor + corners @ frame.T) - np.float32(self.wall)
        outer = depth.min(axis=(1, 2))
        if self.containment >= 1.0:
            keep = np.flatnonzero(outer >= 0)
            if not len(keep):
                return layouts.only(keep), float(outer.max())
        else:
            keep = np.arange(len(outer))
        layouts = layouts.only(keep)
        share, least = np.ones(len(keep)), np.full(len(keep), np.inf)
        for slot, kind in enumerate(kinds):
            # Many layouts put a box at the same place: look at every place once.
            rows = np.column_stack([layouts.order[:, slot], np.round(1e6 * layouts.centre[:, slot]).astype(int)])
            _, first, same = np.unique(rows, axis=0, return_index=True, return_inverse=True)
            grid = _box_grid(np.array(sizes[kind]) + 2 * self.clearance, self.sample)
            turned = np.stack([grid[:, ORDERS[k]] for k in layouts.order[first, slot]])
            points = host.anchor + (layouts.centre[first, slot][:, None, :] + turned) @ frame.T
            depth = host.free.sample(points) - np.float32(self.wall)
            same = same.reshape(-1)
            share = np.minimum(share, (depth >= 0).mean(axis=1)[same])
            least = np.minimum(least, depth.min(axis=1)[same])
        return layouts.only(np.flatnonzero(share >= self.containment)), float(least.max())

    def _openings(
        self, host: Host, frame: Array, layouts: Arrangements, kinds: tuple[Kind, ...]
    ) -> tuple[BoxSeat, ...]:
        """Choose the layout, and for each box the opening, with the least interference as measured on the grid."""
        room = Room(host.blueprint, host.index, host.anchor, frame, self.grid, layouts.centre, layouts.half)
        n, k = layouts.order.shape
        cost = np.zeros((n, k, len(WAYS)))
        for slot in range(k):
            centre, half = layouts.centre[:, slot], layouts.half[:, slot]
            rows = np.round(1e6 * np.column_stack([centre, half])).astype(int)
            _, first, same = np.unique(rows, axis=0, return_index=True, return_inverse=True)
            same = same.reshape(-1)
            for way, (axis, sign) in enumerate(WAYS):
                low, high, shaft = room.shafts(centre[first], half[first], axis, sign)
                volume = room.blocked(low, high)[same]
                for other in range(k):
                    if other != slot:
                        beside, size = layouts.centre[:, other], layouts.half[:, other] - self.clearance
                        shared = np.minimum(high[same], beside + size) - np.maximum(low[same], beside - size)
                        volume += np.maximum(shared, 0).prod(axis=1)
                # A millimetre of shaft weighs less than the smallest volume that counts, 1 mm3.
                cost[:, slot, way] = np.round(volume, 9) + 1e-10 * shaft[same]
        way = cost.argmin(axis=2)
        best = int(cost.min(axis=2).sum(axis=1).argmin())
        return tuple(
            host.seat(kind, frame, layouts.centre[best, slot], layouts.half[best, slot] - self.clearance,
                      WAYS[way[best, slot]], self.clearance)
            for slot, kind in enumerate(kinds)
        )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class _Found:
    """What the search in one host came to; `margin` is the closest layout's least depth past the wall [m]."""

    host: Host
    boxes: tuple[BoxSeat, ...]
    margin: float


@dataclass(frozen=True, eq=False, slots=True)
class Arrangements:
    """n ways to put k boxes into a frame: `order` (n, k) indexes ORDERS, cavities have `centre`, `half` (n, k, 3)."""

    order: NDArray[np.int64]
    centre: Array
    half: Array

    def only(self, rows: NDArray[np.int64]) -> Arrangements:
        """Some of the layouts."""
        return Arrangements(self.order[rows], self.centre[rows], self.half[rows])


@lru_cache(maxsize=16)
def side_by_side(sizes: tuple[Size, ...], clearance: float, wall: float) -> Arrangements:
    """All orders of one box at the origin, or of two side by side along any axis, centred together."""
    halves = [np.array(size)[ORDERS] / 2 + clearance for size in sizes]
    if len(sizes) == 1:
        return Arrangements(np.arange(6)[:, None], np.zeros((6, 1, 3)), halves[0][:, None])
    order, centre, half = [], [], []
    for axis, a, b, side in itertools.product(range(3), range(6), range(6), (1.0, -1.0)):
        pair = np.stack([halves[0][a], halves[1][b]])
        total = pair[:, axis].sum() + wall / 2  # Half of what both take along the axis.
        place = np.zeros((2, 3))
        place[0, axis], place[1, axis] = side * (pair[0, axis] - total), side * (total - pair[1, axis])
        order.append((a, b))
        centre.append(place)
        half.append(pair)
    return Arrangements(np.array(order), np.array(centre), np.array(half))


def _box_grid(size: Array, step: float) -> Array:
    """Points all through a box about the origin, its surface included, at most `step` apart: (n, 3)."""
    axes = [np.linspace(-s / 2, s / 2, math.ceil(s / step) + 1) for s in size]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
