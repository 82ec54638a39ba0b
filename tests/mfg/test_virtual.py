"""The virtual robot, made at voxel centres, is the one that the solvers of hardware start from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from decoder.design import VoxelDesign
from decoder.latent import make_decoder, sample_latents
from decoder.sketch import load_design
from mfg.blueprint import Blueprint
from mfg.description import Description, describe
from mfg.parts import PAPER
from mfg.pipeline import BODIES, run, virtual

EXAMPLES = Path(__file__).parents[2] / "experiments" / "examples"


Pair = tuple[Description, Description]


@pytest.fixture(scope="module")
def designs() -> list[VoxelDesign]:
    drawn = make_decoder("vae").decode(sample_latents(6, np.random.default_rng(5)))
    return [*drawn, *(load_design(EXAMPLES / f"{name}.vox") for name in ("crawler", "inchworm"))]


@pytest.fixture(scope="module")
def pairs(designs: list[VoxelDesign]) -> list[Pair]:
    """Every robot made at voxel centres, and at half the pitch."""
    return [(describe(virtual(d).blueprint), describe(run(BODIES, Blueprint(d, PAPER)).blueprint)) for d in designs]


def test_it_weighs_and_balances_as_the_fine_one(pairs: list[Pair]) -> None:
    for coarse, fine in pairs:
        assert_allclose(coarse.mass, fine.mass, rtol=5e-3)
        assert_allclose(coarse.standing_height, fine.standing_height, atol=3e-3)
        for a, b, p, q in zip(coarse.links, fine.links, coarse.origins(), fine.origins(), strict=True):
            assert_allclose(a.mass, b.mass, rtol=0.01)
            assert_allclose(a.com + p, b.com + q, atol=1e-3)
            assert np.linalg.norm(a.inertia - b.inertia, 2) < 0.03 * np.linalg.norm(b.inertia, 2)
            assert_allclose(a.skin_thickness, b.skin_thickness, atol=2e-3)


def test_its_hulls_reach_as_far_as_the_fine_ones(pairs: list[Pair]) -> None:
    ways = np.random.default_rng(0).normal(size=(300, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    apart = []
    for coarse, fine in pairs:
        for a, b, p, q in zip(coarse.links, fine.links, coarse.origins(), fine.origins(), strict=True):
            reach = [((link.hull + origin) @ ways.T).max(axis=0) for link, origin in ((a, p), (b, q))]
            apart.append(np.sqrt(np.square(reach[0] - reach[1]).mean()))
    assert np.median(apart) < 1e-3
    assert max(apart) < 5e-3  # a crumb of skin that one of them has


def test_it_is_the_same_twice(designs: list[VoxelDesign]) -> None:
    one, two = (describe(virtual(designs[0]).blueprint) for _ in range(2))
    for a, b in zip(one.links, two.links, strict=True):
        assert np.array_equal(a.hull, b.hull)
        assert np.array_equal(a.inertia, b.inertia)
