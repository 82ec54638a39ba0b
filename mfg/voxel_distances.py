"""Exact Euclidean distances between voxels of small grids, in whole numbers: several times as fast as by features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SIDE = 72  # longest side that a grid may have [voxels]
NOWHERE = 126  # distance where nothing is near; beyond any in a grid, and sums of its square stay within 16 bits


def distances(voxels: NDArray[np.bool_], most: int = NOWHERE) -> NDArray[np.float64]:
    """Distance of every true voxel of a grid to the nearest false one, between centres [voxels]; 0 at false ones.

    A square distance is a sum over axes, so its least is found axis by axis, over voxels further and further away until
    none of them can be nearer.

    Args:
        voxels: (nx, ny, nz), no side beyond `SIDE`; at least one must be false.
        most: distance from which on all are as far as this, which takes less time [voxels].
    """
    if max(voxels.shape) > SIDE or voxels.all():
        raise ValueError(f"needs a false voxel and sides of {SIDE} voxels at most, got a grid of {voxels.shape}")
    square = np.square(np.minimum(_along(voxels), np.int16(most)))
    for _ in range(2):
        # Along the first axis whole planes are compared; then the next axis comes first.
        square = _least_along(np.ascontiguousarray(square.transpose(1, 2, 0)))
    return np.ascontiguousarray(np.sqrt(square, dtype=np.float64).transpose(1, 2, 0))


def _along(voxels: NDArray[np.bool_]) -> NDArray[np.int16]:
    """Distance to the nearest false voxel of the same line along the first axis, at most `NOWHERE` [voxels]."""
    place = np.arange(len(voxels), dtype=np.int16)[:, None, None]
    before = np.maximum.accumulate(np.where(voxels, np.int16(-NOWHERE), place), axis=0)
    after = np.minimum.accumulate(np.where(voxels, np.int16(SIDE + NOWHERE), place)[::-1], axis=0)[::-1]
    return np.minimum(np.minimum(place - before, after - place), np.int16(NOWHERE))


def _least_along(square: NDArray[np.int16]) -> NDArray[np.int16]:
    """Least of square[j] + (i - j)^2 over j, for every i of the first axis."""
    least = square.copy()
    for step in range(1, len(square)):
        if step * step >= int(least.max()):
            break
        beyond = square + np.int16(step * step)
        np.minimum(least[step:], beyond[:-step], out=least[step:])
        np.minimum(least[:-step], beyond[step:], out=least[:-step])
    return least
