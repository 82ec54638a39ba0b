from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mfg.plate import HEIGHT_COST, SPACING, arrange, fits_printer, lay_cost, print_rotation
from mfg.solids import Solid, box, cylinder

PRINTER = (0.300, 0.320, 0.320)


def block(*size: float) -> NDArray[np.float64]:
    return np.array(list(itertools.product(*[(0.0, s) for s in size])))


@given(seed=st.integers(0, 2**31))
@settings(max_examples=25, deadline=None)
def test_a_block_that_just_fits_is_found_whatever_way_it_is_turned(seed: int) -> None:
    turn = Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    points = block(0.299, 0.319, 0.1) @ turn.T
    rotation = print_rotation(points, PRINTER)
    assert rotation is not None
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert_allclose(np.linalg.det(rotation), 1)
    assert_allclose(np.sort(np.ptp(points @ rotation.T, axis=0)), [0.1, 0.299, 0.319], atol=1e-4)


def test_the_lowest_way_that_fits_is_taken() -> None:
    rotation = print_rotation(block(0.05, 0.2, 0.25), PRINTER)
    assert rotation is not None
    assert_allclose(np.ptp(block(0.05, 0.2, 0.25) @ rotation.T, axis=0)[2], 0.05, atol=1e-9)


def test_what_no_turn_can_fit_is_refused() -> None:
    assert print_rotation(block(0.33, 0.33, 0.1), PRINTER) is None
    assert not fits_printer(block(0.33, 0.33, 0.1), PRINTER)
    assert fits_printer(block(0.32, 0.1, 0.32), PRINTER)
    with pytest.raises(ValueError, match="body 0 does not fit"):
        arrange([block(0.5, 0.01, 0.01)], PRINTER)


@given(seed=st.integers(0, 2**31), count=st.integers(1, 9))
@settings(max_examples=20, deadline=None)
def test_bodies_lie_on_plates_apart_from_each_other(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    bodies = [block(*rng.uniform(0.03, 0.28, 3)) + rng.normal(size=3) for _ in range(count)]
    lays = arrange(bodies, PRINTER)
    boxes = []
    for lay, points in zip(lays, bodies, strict=True):
        laid = points @ lay.T_plate_design[:3, :3].T + lay.T_plate_design[:3, 3]
        assert_allclose(laid[:, 2].min(), 0, atol=1e-9)
        assert (laid.min(0) >= -1e-9).all()
        assert (laid.max(0) <= np.array(PRINTER) + 1e-5).all()
        boxes.append((lay.plate, laid.min(0)[:2], laid.max(0)[:2]))
    for (p, low, high), (q, other_low, other_high) in itertools.combinations(boxes, 2):
        apart = np.maximum(low - other_high, other_low - high).max()
        assert p != q or apart >= SPACING - 1e-9
    assert sorted({p for p, _, _ in boxes}) == list(range(max(p for p, _, _ in boxes) + 1))


def surface(solid: Solid) -> NDArray[np.float64]:
    return solid.vertices[solid.triangles]


def cost(solid: Solid, down: NDArray[np.float64]) -> float:
    height = solid.vertices @ down
    return float(lay_cost(surface(solid), down[None], np.array([height.max()]), np.array([np.ptp(height)]))[0])


DOWN = -np.eye(3)[2]


def test_support_is_the_shadow_of_an_overhang_times_its_height() -> None:
    table = box((0, 0, 0.05), (0.1, 0.08, 0.06)) + box((0.04, 0.03, 0), (0.06, 0.05, 0.055))
    assert_allclose(cost(table, DOWN), (0.1 * 0.08 - 0.02 * 0.02) * 0.05 + HEIGHT_COST * 0.06, rtol=1e-9)
    assert_allclose(cost(table, -DOWN), HEIGHT_COST * 0.06, rtol=1e-9)  # upside down nothing hangs


@pytest.mark.parametrize(("degrees", "held"), [(30, True), (39, True), (41, False), (60, False)])
def test_only_what_is_less_steep_than_the_limit_is_held_up(degrees: float, held: bool) -> None:
    turn = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    plate = surface(box((0, 0, 0), (0.1, 0.1, 0.001))) @ turn.T
    height = plate.reshape(-1, 3) @ DOWN
    found = lay_cost(plate, DOWN[None], np.array([height.max()]), np.zeros(1))[0]
    # The narrow side below is steep where the plate is not, and the other way round; it is a hundredth of it.
    slab = 0.1 * 0.1 * np.cos(np.deg2rad(degrees)) * 0.05 * np.sin(np.deg2rad(degrees))
    assert bool(found > 0.5 * slab) is held


@given(seed=st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_no_bottom_of_the_design_costs_less_than_the_one_taken(seed: int) -> None:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    table = (box((-0.03, -0.04, 0.05), (0.07, 0.04, 0.06)) + cylinder(0.01, 0, 0.055)).moved(turn)
    rotation = print_rotation(table.vertices, PRINTER, surface(table))
    assert rotation is not None
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    taken = cost(table, -rotation[2])
    assert all(taken <= cost(table, side) * (1 + 1e-4) for side in (*np.eye(3), *-np.eye(3)))
    # Upside down the table needs no support, whatever way it was turned; its top is the largest facet of the hull.
    assert_allclose(taken, HEIGHT_COST * 0.06, rtol=1e-3)


def test_a_way_up_that_does_not_fit_is_not_taken_however_cheap() -> None:
    table = box((0, 0, 0.05), (0.31, 0.31, 0.06)) + box((0.1, 0.1, 0), (0.12, 0.12, 0.055))
    low = (0.4, 0.4, 0.03)
    assert print_rotation(table.vertices, low, surface(table)) is None
    standing = print_rotation(table.vertices, (0.1, 0.4, 0.4), surface(table))
    assert standing is not None
    assert (np.ptp(table.vertices @ standing.T, axis=0) <= np.array([0.1, 0.4, 0.4]) + 1e-6).all()
