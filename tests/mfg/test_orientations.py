"""The 64 orientations: proper rotations, none a half turn of another, axis-aligned and principal ones among them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mfg.orientations import COUNT, along, orientations

PRINCIPAL = Rotation.from_euler("xyz", [0.4, 0.3, 0.5]).as_matrix()
HALF_TURNS = [np.diag(d) for d in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Angle of the least rotation between two ways to put a box down [rad], by trying all of its half turns."""
    return min(Rotation.from_matrix(a.T @ b @ turn).magnitude() for turn in HALF_TURNS)


def test_there_are_64_proper_rotations() -> None:
    turns = orientations(PRINCIPAL)
    assert turns.shape == (64, 3, 3)
    assert len(turns) == COUNT
    assert np.swapaxes(turns, 1, 2) @ turns == pytest.approx(np.broadcast_to(np.eye(3), turns.shape), abs=1e-12)
    assert np.linalg.det(turns) == pytest.approx(np.ones(64))


def test_no_two_are_the_same_for_a_box() -> None:
    turns = orientations(PRINCIPAL)
    least = min(apart(a, b) for a, b in itertools.combinations(np.delete(turns, range(6, 12), axis=0), 2))
    assert least > np.radians(25)


def test_every_axis_aligned_rotation_is_one_of_the_first_six_turned_over() -> None:
    turns = orientations(PRINCIPAL)[:6]
    for turn in Rotation.create_group("O").as_matrix():
        assert min(apart(turn, other) for other in turns) < 1e-7


def test_the_principal_axes_carry_every_order_of_sides() -> None:
    turns = orientations(PRINCIPAL)[6:12]
    assert turns == pytest.approx(along(PRINCIPAL))
    lying = {tuple(np.abs(PRINCIPAL.T @ turn).argmax(axis=0)) for turn in turns}
    assert lying == set(itertools.permutations(range(3)))


def test_any_box_orientation_is_near_one_of_them() -> None:
    turns = orientations(np.eye(3))
    random = Rotation.random(300, rng=np.random.default_rng(0)).as_matrix()
    assert max(min(apart(r, turn) for turn in turns) for r in random) < np.radians(40)


def test_the_set_does_not_change() -> None:
    assert (orientations(PRINCIPAL) == orientations(PRINCIPAL)).all()
    assert orientations(np.eye(3))[12:] == pytest.approx(orientations(PRINCIPAL)[12:])
