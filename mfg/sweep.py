"""Whether a solid can be pushed along a straight line past others: the overlap of what it sweeps, line by line.

A translation moves every point along one direction, so it can be judged on each line of that direction alone: there a
solid is a set of intervals, its sweep is the same set stretched by the travel, and what is in the way is where the two
overlap. The lines form a square lattice across the direction; along them everything is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.solids import Solid

SPACING = 2.0e-3  # between lines [m]
PHASE = (0.381966, 0.618034)  # of the lattice, so that no line runs along the flat faces of hardware [spacings]
GRAZE = 1.0e-4  # shorter overlaps on one line are rounding: mounts touch by design [m]
_WIDE = 1 << 20  # more lines than one side of the lattice has


@dataclass(frozen=True, eq=False, slots=True)
class Lattice:
    """Parallel lines.

    Attributes:
        axes: two unit vectors across, then the direction, as rows (3, 3).
        spacing: between lines [m].
    """

    axes: NDArray[np.float64]
    spacing: float = SPACING

    @classmethod
    def along(cls, direction: NDArray[np.float64], spacing: float = SPACING) -> Lattice:
        """Lines along a direction, turned about it by a fixed rule."""
        d = np.asarray(direction, np.float64) / np.linalg.norm(direction)
        helper = np.eye(3)[int(np.argmin(np.abs(d)))]
        u = helper - (helper @ d) * d
        u /= np.linalg.norm(u)
        return cls(np.stack([u, np.cross(d, u), d]), spacing)


@dataclass(frozen=True, eq=False, slots=True)
class Crossings:
    """Where lines enter (+1) and leave (-1) a solid, sorted by line and height; every line leaves what it entered."""

    line: NDArray[np.int64]
    height: NDArray[np.float64]
    sign: NDArray[np.int64]


def crossings(
    solids: Sequence[Solid], lattice: Lattice, window: NDArray[np.float64] | None = None, above: float = -np.inf
) -> Crossings:
    """All crossings of the lattice's lines with solids that do not overlap.

    Args:
        solids: what is crossed.
        lattice: the lines.
        window: least and greatest coordinates across the direction (2, 2) [m]; lines outside it are left out.
        above: solids that end below this height along the direction are left out [m].
    """
    found = [_of_solid(solid, lattice, window, above) for solid in solids]
    found = [f for f in found if len(f[0])]
    if not found:
        return Crossings(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64))
    line, height, sign = (np.concatenate([f[k] for f in found]) for k in range(3))
    order = np.lexsort((height, line))
    return Crossings(line[order], height[order], sign[order])


def window_of(solids: Sequence[Solid], lattice: Lattice) -> tuple[NDArray[np.float64], float]:
    """Extent across the lattice's direction (2, 2), and the lowest height along it [m]."""
    seen = [solid.vertices @ lattice.axes.T for solid in solids]
    low, high = np.min([s.min(0) for s in seen], axis=0), np.max([s.max(0) for s in seen], axis=0)
    return np.stack([low[:2], high[:2]]), float(low[2])


def obstruction(moved: Crossings, fixed: Crossings, travel: float, spacing: float = SPACING) -> float:
    """Volume of `fixed` that `moved` meets while it travels along the lines' direction [m3]; inf travels away.

    On each line the moved solid sweeps its intervals stretched by the travel. The error is that of a lattice of lines:
    what lies between two of them is not seen.
    """
    if not len(moved.line) or not len(fixed.line):
        return 0.0
    shift = np.where(moved.sign < 0, travel, 0.0)
    line = np.concatenate([moved.line, fixed.line])
    height = np.concatenate([moved.height + shift, fixed.height])
    of_moved = np.concatenate([moved.sign, np.zeros_like(fixed.sign)])
    of_fixed = np.concatenate([np.zeros_like(moved.sign), fixed.sign])
    both = np.isin(line, np.intersect1d(moved.line, fixed.line))
    line, height, of_moved, of_fixed = line[both], height[both], of_moved[both], of_fixed[both]
    if not len(line):
        return 0.0
    order = np.lexsort((height, line))
    line, height = line[order], height[order]
    inside = (np.cumsum(of_moved[order]) > 0) & (np.cumsum(of_fixed[order]) > 0)
    here = np.flatnonzero(inside[:-1] & (line[1:] == line[:-1]))
    length = height[here + 1] - height[here]
    return float(length[length > GRAZE].sum()) * spacing**2


def _of_solid(
    solid: Solid, lattice: Lattice, window: NDArray[np.float64] | None, above: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    nothing = np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64)
    seen = solid.vertices @ lattice.axes.T
    if not len(seen) or seen[:, 2].max() <= above:
        return nothing
    s = lattice.spacing
    grid = seen[:, :2] / s - np.array(PHASE)  # lines stand at whole numbers
    first, last = np.ceil(grid.min(0)).astype(np.int64), np.floor(grid.max(0)).astype(np.int64)
    if window is not None:
        first = np.maximum(first, np.ceil(window[0] / s - PHASE).astype(np.int64))
        last = np.minimum(last, np.floor(window[1] / s - PHASE).astype(np.int64))
    if (last < first).any():
        return nothing
    # Row by row: between two edges of a triangle, a row of lines meets it from one column to another.
    rows = grid[:, 0][solid.triangles]
    low = np.maximum(np.ceil(rows.min(1)), first[0]).astype(np.int64)
    count = np.minimum(np.floor(rows.max(1)), last[0]).astype(np.int64) - low + 1
    met = np.flatnonzero(count > 0)
    which, step = _expanded(count[met])
    row = low[met][which] + step
    corner = solid.triangles[met][which]  # vertices of the triangle, once per row, (n, 3)
    column, height = np.zeros((2, len(row))), np.zeros((2, len(row)))
    seen_before = np.zeros(len(row), np.int64)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        # Both triangles at an edge take it from the same end, so that they agree to the last bit.
        one, two = np.minimum(corner[:, a], corner[:, b]), np.maximum(corner[:, a], corner[:, b])
        start, end = grid[one, 0], grid[two, 0]
        cuts = np.flatnonzero((start < row) != (end < row))
        one, two = one[cuts], two[cuts]
        share = (row[cuts] - start[cuts]) / (end[cuts] - start[cuts])
        column[seen_before[cuts], cuts] = grid[one, 1] + share * (grid[two, 1] - grid[one, 1])
        height[seen_before[cuts], cuts] = seen[one, 2] + share * (seen[two, 2] - seen[one, 2])
        seen_before[cuts] += 1
    swap = column[0] > column[1]
    column[:, swap], height[:, swap] = column[::-1, swap], height[::-1, swap]
    begin = np.maximum(np.ceil(column[0]), first[1]).astype(np.int64)
    count = np.minimum(np.ceil(column[1]) - 1, last[1]).astype(np.int64) - begin + 1
    hit = np.flatnonzero((count > 0) & (seen_before == 2))
    if not len(hit):
        return nothing
    index, step = _expanded(count[hit])
    index = hit[index]
    j = begin[index] + step
    share = (j - column[0, index]) / np.maximum(column[1, index] - column[0, index], 1e-300)
    where = height[0, index] + share * (height[1, index] - height[0, index])
    line = (row[index] + _WIDE) * (2 * _WIDE) + j + _WIDE
    # A face whose corners turn clockwise is seen from below: an entry.
    c = grid[solid.triangles[met]]
    area = _cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
    sign = np.where(area[which[index]] < 0, 1, -1).astype(np.int64)
    # A line along a face may enter and never leave; it is left out rather than counted wrong.
    names, index = np.unique(line, return_inverse=True)
    whole = np.bincount(index, sign, len(names)) == 0
    keep = whole[index]
    return line[keep], where[keep], sign[keep]


def _expanded(count: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For every one of count[k] copies of k: k itself, and which copy it is."""
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
