"""Sweeps on lines against exact booleans of the swept solid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mfg.solids import Solid, ball_chain, box, cylinder, union
from mfg.sweep import SPACING, Lattice, crossings, obstruction, window_of
from mfg.ways import blocked_volume

MM3 = 1e-9


def moved(solid: Solid, shift: np.ndarray) -> Solid:
    T = np.eye(4)
    T[:3, 3] = shift
    return solid.moved(T)


def swept(solid: Solid, way: np.ndarray) -> Solid:
    """All that a solid passes through, exactly: both ends and the prism of every triangle."""
    corners = solid.vertices[solid.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ way
    prisms = []
    for triangle in corners[across > 1e-12]:
        points = np.concatenate([triangle, triangle + way])
        hull = Solid(points, np.array([[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3],
                                       [2, 3, 5]]))  # fmt: skip
        prisms.append(hull.hull())
    return union([solid, moved(solid, way), *prisms])


def blob(rng: np.random.Generator, centre: np.ndarray) -> Solid:
    path = centre + np.cumsum(rng.normal(0, 0.012, (4, 3)), axis=0)
    return ball_chain(path, float(rng.uniform(0.008, 0.014)), 10)


def direction(rng: np.random.Generator) -> np.ndarray:
    way = rng.normal(size=3)
    return way / np.linalg.norm(way)


@given(st.integers(0, 10_000))
@settings(max_examples=25)
def test_lines_measure_the_volume_of_any_solid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = blob(rng, np.zeros(3))
    found = crossings([solid], Lattice.along(direction(rng), 1e-3))
    assert_allclose(-(found.height * found.sign).sum() * 1e-6, solid.volume, rtol=0.02)


@given(st.integers(0, 10_000))
@settings(max_examples=25)
def test_what_is_met_on_the_way_is_what_the_swept_solid_overlaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way, travel = direction(rng), float(rng.uniform(0.01, 0.09))
    mover = blob(rng, np.zeros(3))
    fixed = blob(rng, 0.05 * way + rng.normal(0, 0.012, 3)) - swept(mover, 1e-4 * way)
    shared = swept(mover, travel * way) ^ fixed
    found = blocked_volume([mover], [fixed], way, travel, 1e-3)
    assert abs(found - shared.volume) <= 1e-3 * shared.area / 2 + 5 * MM3


@given(st.integers(0, 10_000))
@settings(max_examples=15)
def test_a_motor_and_a_box_agree_with_exact_booleans_on_both_verdicts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way = direction(rng)
    for mover in (cylinder(0.038, -0.03, 0.03), box([-0.05, -0.02, -0.01], [0.05, 0.02, 0.01])):
        fixed = blob(rng, 0.08 * way + rng.normal(0, 0.04, 3)).minus([mover])
        shared = union([mover, moved(mover, 0.5 * way)]).hull() ^ fixed  # a convex solid sweeps its hull
        found = blocked_volume([mover], [fixed], way)
        assert abs(found - shared.volume) <= SPACING * shared.area / 2 + 5 * MM3  # a line at a rim counts or does not
        if shared.is_empty:
            assert found == 0


def test_nothing_is_met_sideways_or_behind() -> None:
    mover, ahead = box([0, 0, 0], [0.02, 0.02, 0.02]), box([0, 0, 0.05], [0.02, 0.02, 0.06])
    z = np.array([0.0, 0.0, 1.0])
    assert blocked_volume([mover], [ahead], z) == pytest.approx(4000 * MM3, rel=0.15)
    assert blocked_volume([mover], [ahead], -z) == 0
    assert blocked_volume([mover], [ahead], np.array([1.0, 0, 0])) == 0
    assert blocked_volume([mover], [ahead], z, 0.0299) == 0
    assert blocked_volume([mover], [ahead], z, 0.035) == pytest.approx(2000 * MM3, rel=0.15)


def test_a_hook_cannot_be_lifted_off_a_bar_but_slides_along_it() -> None:
    bar = cylinder(0.005, -0.1, 0.1)
    hook = box([-0.02, -0.02, -0.01], [0.02, 0.02, 0.01]) - cylinder(0.006, -0.02, 0.02)
    z, x = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    assert blocked_volume([hook], [bar], z) == 0
    assert blocked_volume([hook], [bar], x) > 500 * MM3


def test_leaving_lines_out_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    mover, fixed, way = blob(rng, np.zeros(3)), [blob(rng, rng.normal(0, 0.05, 3)) for _ in range(6)], direction(rng)
    fixed = [f.minus([mover]) for f in fixed]
    lattice = Lattice.along(way)
    everything = obstruction(crossings([mover], lattice), crossings(fixed, lattice), np.inf)
    window, low = window_of([mover], lattice)
    assert obstruction(crossings([mover], lattice), crossings(fixed, lattice, window, low), np.inf) == everything
