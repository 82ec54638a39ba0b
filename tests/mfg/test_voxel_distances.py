"""Distances in whole numbers: against every pair of voxels, and against scipy to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from mfg.voxel_distances import SIDE, distances


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_is_the_least_over_all_false_voxels(share):
    rng = np.random.default_rng(int(100 * share))
    for _ in range(20):
        voxels = rng.random(rng.integers(1, 8, 3)) < share
        voxels.flat[rng.integers(voxels.size)] = False
        there = np.argwhere(~voxels)
        here = np.argwhere(np.ones_like(voxels))
        nearest = np.linalg.norm(here[:, None] - there[None], axis=-1).min(axis=1)
        np.testing.assert_allclose(distances(voxels).ravel(), nearest, rtol=1e-15)


def test_has_the_bits_of_the_feature_transform():
    rng = np.random.default_rng(2)
    for _ in range(60):
        noise = ndimage.gaussian_filter(rng.normal(size=rng.integers(2, 30, 3)), rng.uniform(0.1, 4.0))
        voxels = noise > np.quantile(noise, rng.uniform(0, 1))
        np.testing.assert_array_equal(distances(voxels), ndimage.distance_transform_edt(voxels))


def test_one_false_voxel_in_the_far_corner_of_the_largest_grid():
    voxels = np.ones((SIDE, SIDE, SIDE), bool)
    voxels[-1, -1, -1] = False
    found = distances(voxels)
    assert found[0, 0, 0] == np.sqrt(3 * (SIDE - 1) ** 2)
    assert found[0, -1, -1] == SIDE - 1
    assert found[-1, -1, -1] == 0


@pytest.mark.parametrize("voxels", [np.ones((3, 4, 5), bool), np.zeros((SIDE + 1, 1, 1), bool)])
def test_refuses_what_it_has_no_answer_for(voxels):
    with pytest.raises(ValueError, match="false voxel and sides"):
        distances(voxels)


@pytest.mark.parametrize("most", [1, 3, 8])
def test_no_distance_beyond_the_most_is_told(most):
    rng = np.random.default_rng(most)
    for _ in range(20):
        voxels = ndimage.gaussian_filter(rng.normal(size=(20, 17, 23)), 3.0) > -0.05
        np.testing.assert_array_equal(distances(voxels, most), np.minimum(distances(voxels), most))
