"""Every score against a brute-force or exact reference; each one monotone and within [0, 1]."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from blueprints import SPACING, ball_bone, blueprint_of, box_bone, sampled
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from mfg import scores
from mfg.mounts import connector, holder, housing, mount_of
from mfg.parts import PAPER
from mfg.solids import from_field, union

MOUNT = mount_of(PAPER.motor)
volume = st.floats(0, 1e-3)


@given(volume, volume, volume, st.floats(0, 1))
def test_mount_balance_grows_with_both_volumes_and_prefers_balance(
    a: float, b: float, more: float, alpha: float
) -> None:
    assert scores.mount_balance(a + more, b, alpha) >= scores.mount_balance(a, b, alpha) - 1e-15
    assert scores.mount_balance(a, b, alpha) == scores.mount_balance(b, a, alpha)
    half = (a + b) / 2
    assert scores.mount_balance(half, half, alpha) >= scores.mount_balance(a, b, alpha) - 1e-15


@given(st.lists(volume, min_size=1, max_size=8), volume)
def test_motor_score_is_the_scaled_mean(per_joint: list[float], more: float) -> None:
    score = scores.motor_score(per_joint, MOUNT, 0.25)
    mean = sum(per_joint) / len(per_joint) / scores.motor_scale(MOUNT, 0.25)
    assert score == pytest.approx(min(1.0, mean))
    assert 0 <= score <= scores.motor_score([s + more for s in per_joint], MOUNT, 0.25) <= 1


def test_motor_scale_is_reached_when_both_bodies_fill_half_of_the_ring() -> None:
    ring_h = math.pi * (MOUNT.holder_radius**2 - MOUNT.cavity_radius**2) * (MOUNT.holder_top - MOUNT.base_low)
    ring_c = (
        math.pi * (MOUNT.connector_radius**2 - MOUNT.cavity_radius**2) * (MOUNT.connector_high - MOUNT.connector_low)
    )
    assert scores.motor_score([scores.mount_balance(ring_h / 2, ring_c / 2, 0.25)], MOUNT, 0.25) == pytest.approx(1)


@given(st.floats(1e-3, 0.1), st.floats(1e-3, 0.1), st.floats(0.05, 1), st.floats(0.05, 1))
def test_electronics_score_grows_with_clearance_and_with_the_penalty_factor(
    d: float, more: float, p: float, q: float
) -> None:
    low, high = sorted((p, q))
    score = scores.electronics_score(d, low, PAPER)
    assert 0 <= score <= scores.electronics_score(d + more, low, PAPER) <= 1
    assert score <= scores.electronics_score(d, high, PAPER)


@given(st.lists(st.floats(0.01, 0.6), min_size=3, max_size=3), st.floats(0, 0.2), st.integers(0, 2))
def test_size_penalty_is_one_below_the_threshold_and_falls_beyond(extents: list[float], more: float, side: int) -> None:
    e = np.array(extents)
    penalty = scores.size_penalty(e, PAPER.printer.volume)
    fits = (np.sort(e) <= scores.SIZE_SHARE * np.sort(PAPER.printer.volume)).all()
    assert (penalty == 1.0) == bool(fits)
    e[side] += more
    assert 0 < scores.size_penalty(e, PAPER.printer.volume) <= penalty
    assert penalty == scores.size_penalty(np.array(extents[::-1]), PAPER.printer.volume)


@given(st.floats(0, 10), st.floats(0, 10), st.floats(0, 300), st.floats(0, 300))
def test_cable_score_falls_with_length_and_curvature(length: float, more: float, bend: float, sharper: float) -> None:
    score = scores.cable_score(length, bend, PAPER)
    assert 0 <= scores.cable_score(length + more, bend, PAPER) <= score <= 1
    assert scores.cable_score(length, bend + sharper, PAPER) <= score
    assert scores.cable_score(0.0, 0.0, PAPER) == pytest.approx(1.0)


@given(volume, volume)
def test_installability_decays_with_volume(V: float, more: float) -> None:
    for score in (lambda v: scores.electronics_install_score(v, PAPER), scores.body_install_score):
        assert score(0.0) == 1.0
        assert 0 <= score(V + more) <= score(V) <= 1


def test_installability_is_one_over_e_at_its_scale() -> None:
    scale = scores.insertion_scale(PAPER)
    assert scores.electronics_install_score(scale, PAPER) == pytest.approx(math.exp(-1))
    assert scores.body_install_score(scores.OVERLAP_VOLUME) == pytest.approx(math.exp(-1))


@pytest.mark.parametrize("turn", [np.eye(3), Rotation.from_euler("xyz", [0.3, 0.7, 0.2]).as_matrix()])
def test_largest_clearance_of_a_box_is_half_its_least_side(turn: np.ndarray) -> None:
    assert scores.largest_clearance(box_bone((0.2, 0.2, 0.2), (0.16, 0.12, 0.09), turn)) == pytest.approx(
        0.045, abs=3e-4
    )


@pytest.mark.parametrize("centre", [(0.2, 0.2, 0.2), (0.2013, 0.1987, 0.2022)])
def test_largest_clearance_of_a_ball_is_its_radius(centre: tuple[float, float, float]) -> None:
    assert scores.largest_clearance(ball_bone(centre, 0.052)) == pytest.approx(0.052, abs=1.2e-3)


def test_largest_clearance_matches_dense_sampling() -> None:
    # Two balls in one body: the distance to the surface is sampled on a grid ten times finer than the lattice.
    a, b = ball_bone((0.2, 0.2, 0.2), 0.05), ball_bone((0.26, 0.21, 0.2), 0.04)
    both = b.with_values(b.values).on_lattice_of(a)
    body = a.with_values(np.maximum(a.values, both))
    surface = from_field(body, simplify=0).vertices
    axis = np.arange(-0.006, 0.0061, 0.0005)
    grid = np.array([0.2, 0.2, 0.2]) + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    dense = max(np.linalg.norm(surface - p, axis=1).min() for p in grid[::7])
    assert scores.largest_clearance(body) == pytest.approx(dense, abs=1.0e-3)


def test_a_field_that_is_too_flat_deep_inside_does_not_change_the_clearance() -> None:
    ball = ball_bone((0.2, 0.2, 0.2), 0.05)
    flat = ball.with_values(np.where(ball.values > 0, ball.values / (1 + 20 * ball.values), ball.values))
    assert flat.values.max() < 0.03
    assert scores.largest_clearance(flat) == pytest.approx(0.05, abs=1.2e-3)


def test_the_largest_ball_is_found_behind_many_places_that_look_deeper() -> None:
    """A slab that a ball would not fit between, and a ball whose field is smoothed to less than the slab's."""
    slab, ball = box_bone((0.2, 0.2, 0.2), (0.1, 0.1, 0.054)), ball_bone((0.35, 0.2, 0.2), 0.032)
    flat = ball.with_values(np.where(ball.values > 0, 0.8 * ball.values, ball.values))
    body = sampled(lambda p: np.maximum(slab.sample(p), flat.sample(p)), (0.14, 0.14, 0.16), (0.39, 0.26, 0.24))
    assert (body.values > 0.8 * 0.032).sum() > 60
    assert scores.largest_clearance(body) == pytest.approx(0.032, abs=1.2e-3)


@given(st.integers(0, 50), st.tuples(*[st.floats(0.02, 0.3)] * 3))
def test_oriented_extents_of_a_turned_box_are_its_sides(seed: int, size: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(seed)
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    inner = rng.uniform(-0.5, 0.5, (40, 3)) * size
    turned = np.concatenate([corners, inner]) @ Rotation.random(rng=rng).as_matrix().T + 0.1
    assert np.sort(scores.oriented_extents(turned)) == pytest.approx(np.sort(size), rel=1e-6)


@settings(max_examples=40)
@given(st.integers(0, 50))
def test_oriented_extents_hold_the_points_tightly_however_they_are_turned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(300, 3)) * [3, 2, 1]
    extents = scores.oriented_extents(points)
    assert extents.prod() <= 1.1 * np.ptp(points, axis=0).prod()
    assert extents.prod() >= ConvexHull(points).volume
    turned = scores.oriented_extents(points @ Rotation.random(rng=rng).as_matrix().T)
    assert turned == pytest.approx(extents, rel=0.1)


@pytest.mark.parametrize(
    ("gap", "shift"), [(-0.02, 0.0), (-0.004, 0.0013), (-0.001, 0.002), (0.0, 0.0), (0.002, 0.001), (0.02, 0.0)]
)
def test_shared_volume_of_facing_boxes(gap: float, shift: float) -> None:
    a = box_bone((0.2 + shift, 0.2, 0.2), (0.1, 0.1, 0.1))
    b = box_bone((0.3 + shift + gap, 0.2, 0.2), (0.1, 0.08, 0.1))
    exact = from_field(a, 0).overlap(from_field(b, 0))
    assert scores.shared_volume(a, b) == pytest.approx(max(-gap, 0) * 0.08 * 0.1, abs=6e-6)
    assert scores.shared_volume(a, b) == pytest.approx(exact, abs=6e-6)
    assert scores.shared_volume(a, b) == pytest.approx(scores.shared_volume(b, a), abs=1e-9)


@settings(max_examples=20)
@given(st.floats(0.03, 0.11), st.floats(0, 0.005))
def test_shared_volume_of_two_balls_is_the_lens(distance: float, shift: float) -> None:
    R, r = 0.05, 0.04
    a, b = ball_bone((0.2 + shift, 0.2, 0.2), R), ball_bone((0.2 + shift + distance, 0.2, 0.2), r)
    lens = 0.0
    if distance < R + r:
        d = distance
        lens = math.pi * (R + r - d) ** 2 * (d * d + 2 * d * (R + r) - 3 * (R - r) ** 2) / (12 * d)
    assert scores.shared_volume(a, b) == pytest.approx(lens, rel=0.02, abs=1.5e-6)


def test_body_overlap_equals_exact_booleans_of_bones_with_their_mounts() -> None:
    # The connector's body reaches into the holder's cup, and a third body into both.
    bones = [
        box_bone((0.20, 0.30, 0.30), (0.16, 0.12, 0.10)),
        box_bone((0.37, 0.32, 0.30), (0.14, 0.10, 0.09)),
        box_bone((0.29, 0.30, 0.39), (0.10, 0.08, 0.08)),
    ]
    blueprint = blueprint_of(bones, [(0, 1, (0.29, 0.29, 0.30), (0.1, 1.0, 0.2))])
    T = blueprint.seats[0].T_design_motor
    solids = [from_field(bone, 0) for bone in bones]
    filled = [holder(MOUNT).hull(), connector(MOUNT).hull(), housing(MOUNT)]
    solids[0] = union([solids[0], filled[0].moved(T), filled[2].moved(T)])
    solids[1] = union([solids[1], filled[1].moved(T)])
    exact = sum(a.overlap(b) for a, b in itertools.combinations(solids, 2))
    assert exact > 1e-4
    assert scores.body_overlap(blueprint) == pytest.approx(exact, rel=0.04)


def test_crossings_lie_on_the_surface() -> None:
    points = scores.crossings(ball_bone((0.2, 0.2, 0.2), 0.05))
    assert np.abs(np.linalg.norm(points - 0.2, axis=1) - 0.05).max() < 0.15 * SPACING
