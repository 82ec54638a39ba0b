"""Where a box fits inside a depth field: centres all over the volume, each in many orientations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mfg.fields import OUTSIDE, Field

Array = NDArray[np.float64]
CENTRES = 900  # centres looked at in one bone; a bone with more has room, and every second sample will do
CELL = 0.020  # edge of the cells over which the places that are kept are spread [m]
KEPT = 160  # places kept for one box in one bone
LOOKED_AT = 1200  # places of one box whose corners are sampled between the samples
SURFACE = 0.012  # greatest distance between points on the surface of a box while places are compared [m]
ACROSS = (0, 7, 3, 4, 5, 2, 6, 1)  # the corners, opposite ones in turn: they rule places out soonest
_SIGNS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True, eq=False, slots=True)
class Places:
    """n places for one box.

    Attributes:
        half: half extents of the cavity [m], (3,).
        centre: (n, 3) in the design frame [m].
        turn: R_design_box, (n, 3, 3).
        margin: least depth on the cavity's surface, beyond the wall [m], (n,); negative by as much as is missing.
    """

    half: Array
    centre: Array
    turn: Array
    margin: Array

    def __len__(self) -> int:
        """How many."""
        return len(self.margin)

    def only(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Places:
        """Some of the places."""
        return Places(self.half, self.centre[rows], self.turn[rows], self.margin[rows])


def box_points(half: Array, step: float) -> Array:
    """Points all through a box, its surface included, neighbours at most `step` apart [m]: (n, 3)."""
    axes = [np.linspace(-h, h, math.ceil(2 * h / step) + 1) for h in half]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def box_surface(half: Array, step: float) -> Array:
    """Those of `box_points` on the surface, corners first."""
    return _surface((float(half[0]), float(half[1]), float(half[2])), step)


@lru_cache(maxsize=32)
def _surface(half: tuple[float, float, float], step: float) -> Array:
    points = box_points(np.array(half), step)
    extreme = (np.abs(points) > np.array(half) - 1e-9).sum(axis=1)
    found = points[np.argsort(-extreme, kind="stable")][: int((extreme > 0).sum())]
    found.flags.writeable = False
    return found


def least_depth(depth: Field, half: Array, centre: Array, turn: Array, step: float) -> Array:
    """Least depth on the surface of a box at every place, trilinear: (n,) [m]."""
    points = centre[:, None] + box_surface(half, step) @ np.swapaxes(turn, 1, 2)
    return depth.sample(points).min(axis=1).astype(np.float64)


def places(depth: Field, half: Array, turns: Array, wall: float, slack: float) -> Places:
    """Places where a box is as deep as `wall`, or misses it by less than `slack`: spread out, the deepest first.

    Args:
        depth: distance to all that a cavity keeps away from [m].
        half: half extents of the cavity [m], (3,).
        turns: orientations to try, (k, 3, 3).
        wall: least depth of the cavity [m].
        slack: greatest miss of interest [m].
    """
    least = np.float32(wall - slack)
    h = depth.spacing
    # The middle of a box is at least half its least side below its surface.
    middles = np.argwhere(depth.values >= least + np.float32(half.min()))
    if len(middles) > CENTRES:
        middles = middles[((middles + np.rint(depth.corner).astype(int)) % 2 == 0).all(axis=1)]
    nothing = Places(half, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0))
    if not len(middles):
        return nothing
    # Corners on the nearest sample first: cheap, and wrong by no more than the distance to it.
    pad = math.ceil(float(np.linalg.norm(half)) / h) + 1
    values = np.pad(depth.values, pad, constant_values=OUTSIDE)
    strides = np.array([values.shape[1] * values.shape[2], values.shape[2], 1])
    flat, base = values.ravel(), (middles + pad) @ strides
    corners = (_SIGNS * half) @ np.swapaxes(turns, 1, 2) / h  # (k, 8, 3)
    nearest = np.rint(corners)
    step, error = nearest.astype(int) @ strides, h * np.linalg.norm(corners - nearest, axis=-1).astype(np.float32)
    middle, turn = np.nonzero(flat[base[:, None] + step[:, 0]] >= least - error[:, 0])
    about = flat[base[middle] + step[turn, 0]]
    for k in ACROSS[1:]:
        value = flat[base[middle] + step[turn, k]]
        ok = np.flatnonzero(value >= least - error[turn, k])
        middle, turn, about = middle[ok], turn[ok], np.minimum(about[ok], value[ok])
    if not len(middle):
        return nothing
    centre = np.asarray((middles + depth.corner) * h, np.float64)
    # In a bone with much more room than it takes, only the most promising are looked at closely.
    kept = spread(centre[middle], about, LOOKED_AT)
    middle, turn = middle[kept], turn[kept]
    margin: Array = np.full(len(middle), np.inf)
    for pair in (ACROSS[:2], ACROSS[2:4], ACROSS[4:]):
        points = centre[middle][:, None] + (h * corners[:, pair])[turn]
        margin = np.minimum(margin, depth.sample(points).min(axis=1).astype(np.float64) - wall)
        ok = np.flatnonzero(margin >= -slack)
        middle, turn, margin = middle[ok], turn[ok], margin[ok]
    kept = spread(centre[middle], margin, KEPT)
    found = Places(half, centre[middle[kept]], turns[turn[kept]], margin[kept])
    margin = least_depth(depth, half, found.centre, found.turn, SURFACE) - wall
    found = Places(half, found.centre, found.turn, margin).only(margin >= -slack)
    return found.only(np.argsort(-found.margin, kind="stable"))


def spread(centre: Array, room: NDArray[np.floating], count: int) -> NDArray[np.int64]:
    """Which at most `count` of some places to keep: the best of every cell before the second best of any.

    Args:
        centre: (n, 3) [m].
        room: what is best where it is greatest, all within half a metre, (n,) [m].
        count: most to keep.
    """
    n = np.arange(len(room))
    if len(room) <= count:
        return n
    place = np.floor(centre / CELL)
    size = (place := place - place.min(axis=0)).max(axis=0) + 1
    cell = (place[:, 0] * size[1] + place[:, 1]) * size[2] + place[:, 2]
    order = np.argsort(cell - room, kind="stable")
    first = np.concatenate([[True], np.diff(cell[order]) > 0])
    rank = n - np.maximum.accumulate(np.where(first, n, 0))
    best = np.argsort(rank - room[order], kind="stable")[:count]
    return np.asarray(order[best], np.int64)


def separation(half_a: Array, centre_a: Array, turn_a: Array, half_b: Array, centre_b: Array, turn_b: Array) -> Array:
    """Width of the widest slab between two boxes along a face of either [m]: at most their distance, below 0 if none.

    All arguments broadcast: half, centre (..., 3), turn (..., 3, 3).
    """
    # Component by component: numpy multiplies many small matrices slowly.
    between = np.moveaxis(centre_b - centre_a, -1, 0)
    a, b = np.moveaxis(turn_a, (-2, -1), (0, 1)), np.moveaxis(turn_b, (-2, -1), (0, 1))
    half_a, half_b = np.moveaxis(half_a, -1, 0), np.moveaxis(half_b, -1, 0)
    found: Array = np.array(-np.inf)
    beyond_b: list[Array] = [-half_b[j] for j in range(3)]
    for i in range(3):
        beyond = -half_a[i]
        for j in range(3):
            alike = np.abs(a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j])
            beyond = beyond - alike * half_b[j]
            beyond_b[j] = beyond_b[j] - alike * half_a[i]
        along = np.abs(between[0] * a[0, i] + between[1] * a[1, i] + between[2] * a[2, i]) + beyond
        found = np.maximum(found, along)
    for j in range(3):
        along = np.abs(between[0] * b[0, j] + between[1] * b[1, j] + between[2] * b[2, j]) + beyond_b[j]
        found = np.maximum(found, along)
    return np.asarray(found, np.float64)
