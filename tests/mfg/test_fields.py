"""Fields: sampling, volumes and lattice arithmetic against closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mfg.fields import BLOCK, MANY, OUTSIDE, Field, about_axis, box_depth, coverage, cylinder_depth, cylindrical
from mfg.mounts import motor_pose


def ball(
    radius: float, corner: tuple[int, int, int] = (-12, -12, -12), size: int = 25, spacing: float = 0.005
) -> Field:
    axis = [(corner[a] + np.arange(size)) * spacing for a in range(3)]
    points = np.stack(np.meshgrid(*axis, indexing="ij"), axis=-1)
    return Field((radius - np.linalg.norm(points, axis=-1)).astype(np.float32), corner, spacing)


@pytest.mark.parametrize("radius", [0.02, 0.031, 0.05])
def test_volume_of_a_ball(radius: float) -> None:
    assert ball(radius).volume() == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.015)


def test_sampling_is_exact_on_the_lattice_and_outside_beyond_it() -> None:
    field = ball(0.03)
    np.testing.assert_allclose(field.sample(field.points()), field.values, atol=1e-7)
    assert field.sample(np.array([[1.0, 0.0, 0.0]]))[0] == OUTSIDE


@pytest.mark.parametrize("count", [1, MANY - 1, MANY, 3 * BLOCK + 1])
def test_sampling_is_trilinear_however_many_points_are_asked_for(count: int) -> None:
    rng = np.random.default_rng(count)
    field = Field(rng.normal(size=(5, 7, 4)).astype(np.float32), (3, -2, 11), 0.005)
    index = rng.uniform(-1, 1, (count, 3)) * (4, 6, 5) + (2, 3, 1.5)
    edges = rng.integers(0, 4, (count, 3)) == 0
    index[edges] = rng.choice([0.0, 1.0], edges.sum()) * np.broadcast_to((4.0, 6.0, 3.0), index.shape)[edges]
    points = (index + field.corner) * field.spacing
    index = (points - field.origin) / field.spacing  # as rounding leaves it
    if count >= MANY:
        index = index.astype(np.float32).astype(np.float64)
    expected = np.full(count, OUTSIDE)
    inside = np.flatnonzero(((index >= 0) & (index <= (4, 6, 3))).all(axis=1))
    low = np.minimum(np.floor(index[inside]).astype(int), (3, 5, 2))
    share = index[inside] - low
    expected[inside] = 0.0
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.where(corner, share, 1 - share).prod(axis=1)
        expected[inside] += weight * field.values[tuple((low + corner).T)]
    np.testing.assert_allclose(field.sample(points), expected, atol=1e-6)
    np.testing.assert_array_equal(field.sample(points.reshape(1, count, 1, 3))[0, :, 0], field.sample(points))


def test_sampling_a_grid_about_an_axis_is_sampling_its_points() -> None:
    rng = np.random.default_rng(5)
    field = Field(rng.normal(size=(9, 7, 8)).astype(np.float32), (3, -2, 11), 0.005)
    T = motor_pose(field.origin + 0.5 * 0.005 * np.array([8, 6, 7]), np.array([0.6, 0.0, -0.8]), 0.003)
    radius, angle, height = rng.uniform(0, 0.02, 5), rng.uniform(-9, 9, 40), rng.uniform(-0.03, 0.03, 60)
    found = field.sample_at(*about_axis(T, radius[:, None, None], angle[:, None], height))
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(40)], axis=-1)
    local = radius[:, None, None, None] * circle[:, None] + height[:, None] * np.array([0.0, 0.0, 1.0])
    expected = field.sample(local @ T[:3, :3].T + T[:3, 3])
    assert found.shape == (5, 40, 60)
    assert ((found == OUTSIDE) != (expected == OUTSIDE)).mean() < 1e-4  # but for those on the very edge
    both = (found != OUTSIDE) & (expected != OUTSIDE)
    assert 0.2 < both.mean() < 0.9
    np.testing.assert_allclose(found[both], expected[both], atol=1e-4)  # of differences of a few between samples


@pytest.mark.parametrize("count", [0, 5, BLOCK + 3])
def test_the_slope_is_that_of_the_sampled_depth(count: int) -> None:
    rng = np.random.default_rng(count)
    field = Field(rng.normal(size=(6, 5, 7)).astype(np.float32), (2, -3, 4), 0.005)
    cell, share = rng.integers(0, (5, 4, 6), (count, 3)), rng.uniform(0.1, 0.9, (count, 3))
    points = (cell + share + field.corner) * field.spacing
    depth, slope = field.sloped(points)
    np.testing.assert_allclose(depth, field.sample(points), atol=1e-6)
    step = 0.05 * field.spacing  # within the cell, where the depth is linear along every axis
    for axis, way in enumerate(np.eye(3) * step):
        rise = field.sample(points + way) - field.sample(points - way)
        np.testing.assert_allclose(slope[:, axis], rise / (2 * step), atol=0.02)
    beyond = field.sloped(points[:1] + 1.0)
    assert (beyond[0] == OUTSIDE).all()
    assert (beyond[1] == 0).all()


def test_points_far_beyond_a_lattice_are_outside() -> None:
    far = np.array([[1.0, -1.0, 0.0], [1e6, 1e6, 1e6], [-1e6, 3.0, 2.0]]).repeat(MANY, axis=0)
    assert (ball(0.03).sample(far) == OUTSIDE).all()


def test_lattice_transfer_agrees_with_sampling() -> None:
    a, b = ball(0.03), ball(0.02, corner=(-5, -14, 3), size=20)
    moved = a.on_lattice_of(b)
    inside = moved != OUTSIDE
    assert inside.any()
    assert not inside.all()
    sampled = a.sample(b.points())
    exact = inside & (sampled > 0.5 * OUTSIDE)  # Rounding puts a few border samples just beyond the lattice.
    assert exact.sum() > 0.9 * inside.sum()
    np.testing.assert_allclose(moved[exact], sampled[exact], atol=1e-6)


def test_centroid_follows_the_body() -> None:
    field = ball(0.03, corner=(-12, -12, -12))
    shifted = Field(field.values, (-10, -14, 8), field.spacing)
    np.testing.assert_allclose(shifted.centroid(), np.array([2, -2, 20]) * 0.005, atol=1e-9)


def test_depths_of_primitives() -> None:
    points = np.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0, 0.09], [0.02, 0, 0.02]])
    x, y, z = points.T
    depth = cylinder_depth(*cylindrical((x, y, z), np.zeros(3), np.array([0, 0, 1.0])), 0.03, -0.05, 0.05)
    np.testing.assert_allclose(depth, [0.03, -0.02, -0.04, 0.01], atol=1e-7)
    box = box_depth(points, np.eye(4), np.array([0.03, 0.03, 0.05]))
    np.testing.assert_allclose(box, [0.03, -0.02, -0.04, 0.01], atol=1e-7)


def test_coverage_is_monotone_and_bounded() -> None:
    depth = np.linspace(-1, 1, 101, dtype=np.float32)
    share = coverage(depth, 0.1)
    assert share.min() == 0.0
    assert share.max() == 1.0
    assert (np.diff(share) >= 0).all()
