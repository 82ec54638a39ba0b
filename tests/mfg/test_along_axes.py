"""Maps along axes equal the filters that they stand for, and keep what they must keep."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from mfg.along_axes import blurred, refined

SHAPES = [(1, 1, 1), (2, 7, 3), (12, 5, 9), (31, 24, 40)]


def noise(shape: tuple[int, ...]) -> NDArray[np.float32]:
    return np.random.default_rng(shape).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("width", [0.8, 1.7])
def test_a_blur_is_a_gaussian_filter(shape: tuple[int, int, int], width: float) -> None:
    expected = ndimage.gaussian_filter(noise(shape).astype(np.float64), width, mode="nearest", truncate=3.0)
    np.testing.assert_allclose(blurred(noise(shape), width), expected, atol=2e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_refining_keeps_the_samples_and_follows_cubics(shape: tuple[int, int, int]) -> None:
    fine = refined(noise(shape))
    assert fine.shape == tuple(2 * n - 1 for n in shape)
    assert fine.flags.c_contiguous
    np.testing.assert_array_equal(fine[::2, ::2, ::2], noise(shape))
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, n) for n in (12, 9, 14)), indexing="ij")
    u, v, w = np.meshgrid(*(np.linspace(-1, 1, 2 * n - 1) for n in (12, 9, 14)), indexing="ij")
    cubic = (1 + x - 2 * x**3) * (y**2 - y) * (z**3 + 0.5)
    inner = (slice(2, -2),) * 3  # next to the ends, samples beyond are made up
    expected = (1 + u - 2 * u**3) * (v**2 - v) * (w**3 + 0.5)
    np.testing.assert_allclose(refined(cubic.astype(np.float32))[inner], expected[inner], atol=2e-6)
