"""The surface of a depth field as a sum over the points where the lines of its lattice cross it.

A line along axis a stands for h^2 of cross-section, so every crossing stands for h^2 |n_a| of surface with unit normal
n: the lines along all three axes together count every patch h^2 (n_x^2 + n_y^2 + n_z^2) / h^2 times, once. What is
enclosed follows from each axis by the divergence theorem; the three agree but for the lattice, and are averaged. The
triangles of marching cubes cut off what bulges between their corners and every edge; this sum does not, and is quicker.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.fields import Field
from mfg.voxel_fields import bounding_window

_EDGE = 0.7  # a surface is less steep than this at its edges only
_MARGIN = 2  # samples around what is inside: a crossing's outer end and its neighbour


@dataclass(frozen=True, eq=False, slots=True)
class Outline:
    """Where lattice lines cross the surface phi = 0.

    Attributes:
        points: the crossings in the design frame [m], (n, 3).
        normals: unit vectors that point out of the body, (n, 3).
        area: of the patch that each crossing stands for [m2], (n,).
        flow: h^2 times the coordinate along the crossing line, above 0 where it leaves the body upwards [m3], (n,).
        axis: of each crossing line, (n,), in ascending order.
        steepness: |grad phi|, about 1, but less at edges, where slopes of two sides are mixed, (n,).
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    area: NDArray[np.float64]
    flow: NDArray[np.float64]
    axis: NDArray[np.int64]
    steepness: NDArray[np.float64]

    def sparse(self) -> NDArray[np.float64]:
        """Some of the points that show the whole shape: every third, and every one at an edge, (n, 3)."""
        kept = self.steepness < _EDGE
        kept[::3] = True
        return self.points[kept]


def outline(field: Field) -> Outline:
    """The crossings of a field's lattice lines with its surface; none where it is nowhere positive."""
    values, low = _cropped(field)
    flat = values.ravel()
    inside = flat > 0
    found = [_along(axis, flat, inside, values.shape) for axis in range(3)]
    start, share, slope = (np.concatenate([f[k] for f in found]) for k in range(3))
    axis = np.repeat(np.arange(3), [len(f[0]) for f in found])
    row = np.arange(len(axis))
    points = np.stack(np.unravel_index(start, values.shape), axis=1).astype(np.float64) + low + np.asarray(field.corner)
    points[row, axis] += share
    points *= field.spacing
    rise = np.sqrt(np.square(slope).sum(1))
    normals = slope / -np.maximum(rise, np.finfo(np.float64).tiny)[:, None]
    cell = field.spacing**2
    flow = cell * np.where(inside[start], 1.0, -1.0) * points[row, axis]
    return Outline(points, normals, cell * np.abs(normals[row, axis]), flow, axis, rise / field.spacing)


def _along(
    axis: int, flat: NDArray[np.float32], inside: NDArray[np.bool_], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Sample before each crossing along one axis, share of the way to the next one, and slope there (n, 3)."""
    strides = (shape[1] * shape[2], shape[2], 1)
    step = strides[axis]
    start = np.flatnonzero(inside[:-step] != inside[step:])  # rows end outside, so no step from row to row counts
    end = start + step
    first, last = flat[start].astype(np.float64), flat[end].astype(np.float64)
    share = first / (first - last)
    slope = np.zeros((len(start), 3))
    for other, width in enumerate(strides):
        if other == axis:
            slope[:, other] = last - first
        else:
            here, there = (flat[at + width] - flat[at - width] for at in (start, end))
            slope[:, other] = 0.5 * (here + share * (there - here))
    return start, share, slope


def _cropped(field: Field) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """The values around what is inside, with a margin outside all around, and the lowest sample."""
    low, window = bounding_window(field.values > 0)
    wide = tuple(slice(max(s.start - _MARGIN, 0), s.stop + _MARGIN) for s in window)
    short = [(max(_MARGIN - s.start, 0), max(s.stop + _MARGIN - n, 0))
             for s, n in zip(window, field.values.shape, strict=True)]  # fmt: skip
    values = field.values[wide]
    if any(map(any, short)):
        values = np.pad(values, short, constant_values=-np.float32(field.spacing))
    return np.ascontiguousarray(values), low - _MARGIN
