"""Fields: sampling, volumes and lattice arithmetic against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from mfg.fields import OUTSIDE, Field, box_depth, coverage, cylinder_depth, cylindrical


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
