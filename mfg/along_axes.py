"""Linear maps along the axes of small lattices, as matrix products: several times as fast as filters in a loop."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Matrix = NDArray[np.float32]
REACH = 3.0  # of a Gaussian, in its widths


def blurred(values: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    """A Gaussian of some width [samples] over values (nx, ny, nz), which go on beyond the lattice as they end."""
    return _mapped(values, *(_gaussian(n, width) for n in values.shape))


def refined(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The values with a sample half-way between neighbours, along every axis.

    By the cubic through the four samples around it, weights -1, 9, 9, -1 over 16.
    """
    return _mapped(values, *(_cubic(n) for n in values.shape))


def halfway(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The values with the mean of two neighbours half-way between them, along every axis."""
    return _mapped(values, *(_linear(n) for n in values.shape))


def _mapped(values: NDArray[np.float32], a: Matrix, b: Matrix, c: Matrix) -> NDArray[np.float32]:
    """out[i, j, k] = a[i, l] b[j, m] c[k, n] values[l, m, n], summed.

    Plane by plane: products so small are hardly ever shared out over threads, which would cost a hundred times as much
    on a busy machine.
    """
    planes = b @ (values @ c.T)
    out = np.zeros((len(a), len(b), len(c)), np.float32)
    np.matmul(a, planes.transpose(1, 0, 2), out=out.transpose(1, 0, 2))
    return out


@lru_cache(maxsize=256)
def _gaussian(n: int, width: float) -> Matrix:
    return _matrix(ndimage.gaussian_filter1d(np.eye(n), width, axis=0, mode="nearest", truncate=REACH))


@lru_cache(maxsize=256)
def _cubic(n: int) -> Matrix:
    one = np.eye(n)
    ends = np.concatenate([one[:1], one, one[-1:]])
    out = np.zeros((2 * n - 1, n))
    out[::2] = one
    out[1::2] = (9.0 * (ends[1:-2] + ends[2:-1]) - ends[:-3] - ends[3:]) / 16.0
    return _matrix(out)


@lru_cache(maxsize=256)
def _linear(n: int) -> Matrix:
    out = np.zeros((2 * n - 1, n))
    out[::2] = np.eye(n)
    out[1::2] = (out[:-1:2] + out[2::2]) / 2
    return _matrix(out)


def _matrix(values: NDArray[np.float64]) -> Matrix:
    found = np.ascontiguousarray(values, np.float32)
    found.flags.writeable = False
    return found
