"""The 64 orientations in which a box is tried: none of them is another one turned over."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
COUNT = 64
_POOL = 1500  # rotations that the spread ones are picked from
# A box looks the same after these half turns about its own axes.
_HALF_TURNS = np.array([(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)])


def orientations(principal: Array) -> Array:
    """The rotations R_design_box in which a box is tried, (64, 3, 3).

    The 6 ways along the design's axes stand for all 24 axis-aligned ones, which half turns of the box make of them;
    then 6 along a bone's principal axes (columns of `principal`, right-handed), then 52 spread evenly between.
    """
    return np.concatenate([_fixed()[:6], along(principal), _fixed()[6:]])


def along(frame: Array) -> Array:
    """The 6 ways to lay the sides of a box along the axes (columns) of a right-handed frame, (6, 3, 3)."""
    ways = []
    for order in itertools.permutations(range(3)):
        turn = np.eye(3)[list(order)]  # axis i of the frame carries side order[i]
        turn[:, 0] *= np.linalg.det(turn)
        ways.append(frame @ turn)
    return np.stack(ways)


@lru_cache(maxsize=1)
def _fixed() -> Array:
    """The 6 ways along the design's axes, then 52 of which each is the farthest from all before it."""
    pool = _spread(_POOL)
    chosen = list(along(np.eye(3)))
    nearest = np.max([_likeness(pool, turn) for turn in chosen], axis=0)
    while len(chosen) < COUNT - 6:
        farthest = pool[int(np.argmin(np.round(nearest, 9)))]
        chosen.append(farthest)
        nearest = np.maximum(nearest, _likeness(pool, farthest))
    return np.stack(chosen)


def _likeness(turns: Array, other: Array) -> Array:
    """Trace of the least rotation from each of `turns` (n, 3, 3) to `other`, half turns of the box being free: (n,)."""
    diagonal = np.einsum("nij,ij->nj", turns, other)
    return (diagonal @ _HALF_TURNS.T).max(axis=1)


def _spread(count: int) -> Array:
    """Rotations all over SO(3) (super-Fibonacci spiral of quaternions, Alexa, CVPR 2022), (count, 3, 3)."""
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1 - s / count)
    a, b = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    x, y, z, w = inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), -1, 0)
