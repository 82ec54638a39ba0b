"""Bones: volume is kept, neighbours stay apart, the motor's cylinder is really gone."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import ellipsoid
from hypothesis import given, settings
from hypothesis import strategies as st

from decoder.design import VoxelDesign
from mfg.blueprint import Blueprint
from mfg.bones import BoneSolver, cut_cylinder, largest_piece
from mfg.fields import cylinder_depth, cylindrical
from mfg.mounts import mount_of
from mfg.parts import J60_6, PAPER
from mfg.skeleton import SkeletonSolver
from mfg.solids import from_field
from mfg.voxel_fields import smooth_field


@given(
    radii=st.tuples(*[st.floats(4, 12)] * 3),
    shift=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
)
@settings(max_examples=25, deadline=None)
def test_smoothing_keeps_the_volume(radii: tuple[float, float, float], shift: tuple[float, float, float]) -> None:
    mask = ellipsoid((32 + shift[0], 32 + shift[1], 32 + shift[2]), radii)
    field = smooth_field(mask, 0.01, 0.8)
    assert (field.values > 0).sum() * field.spacing**3 == pytest.approx(mask.sum() * 1e-6, rel=0.03)
    solid = from_field(field)
    assert solid.volume == pytest.approx(mask.sum() * 1e-6, rel=0.05)
    assert len(solid.components()) == 1


def test_a_ball_becomes_a_ball() -> None:
    field = smooth_field(ellipsoid((32, 32, 32), (8, 8, 8)), 0.01, 0.8)
    points = np.random.default_rng(0).normal(size=(500, 3))
    points = 0.32 + 0.08 * points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.abs(field.sample(points)).max() < 0.003  # Within a third of a voxel of the true surface.
    np.testing.assert_allclose(field.centroid(), 0.32, atol=1e-3)
    assert field.values.max() == pytest.approx(0.08, abs=0.009)  # No voxel centre lies at the centre of an even ball.


def test_solver_leaves_bones_apart_and_cylinders_empty(creature: VoxelDesign) -> None:
    blueprint = SkeletonSolver().solve(Blueprint(creature, PAPER))
    assert isinstance(blueprint, Blueprint)
    solved = BoneSolver().solve(blueprint)
    assert isinstance(solved, Blueprint)
    solids = [from_field(body.bone) for body in solved.bodies]
    for i, a in enumerate(solids):
        assert len(a.components()) == 1
        for b in solids[:i]:
            assert a.overlap(b) == 0.0
    radius = mount_of(J60_6).attach_radius
    for hinge in solved.hinges:
        for index in (hinge.parent, hinge.body):
            field = solved.bodies[index].bone
            depth = cylinder_depth(*cylindrical(field.axes(), hinge.position, hinge.axis), radius, -0.08, 0.08)
            assert (field.values[depth > 1e-6] <= 0).all()


def test_cutting_twice_changes_nothing() -> None:
    field = smooth_field(ellipsoid((32, 32, 32), (12, 8, 8)), 0.01, 0.8)
    args = (np.array([0.32, 0.32, 0.36]), np.array([0.0, 1.0, 0.0]), 0.03, 0.05)
    once = cut_cylinder(field, *args)
    np.testing.assert_array_equal(cut_cylinder(once, *args).values, once.values)
    assert once.volume() < field.volume()


def test_largest_piece_reports_what_it_dropped() -> None:
    mask = ellipsoid((20, 32, 32), (8, 8, 8)) | ellipsoid((45, 32, 32), (4, 4, 4))
    field, lost = largest_piece(smooth_field(mask, 0.01, 0.8))
    assert lost == pytest.approx(1 / 9, abs=0.02)
    assert len(from_field(field).components()) == 1
