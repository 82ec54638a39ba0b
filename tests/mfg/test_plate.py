from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mfg.plate import SPACING, arrange, fits_printer, print_rotation

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
