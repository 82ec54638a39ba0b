from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from mfg.retreat import RETREAT, retreated
from mfg.solids import Solid, ball_chain, box, cylinder
from mfg.stl import LATTICE, MM_PER_M, welded

DEPTH = 1e-4


def stored(solid: Solid) -> Solid:
    """As a file holds it."""
    vertices, triangles = welded(solid)
    return Solid(vertices / MM_PER_M, triangles)


def turned(solid: Solid) -> Solid:
    """Somewhere on no lattice."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.3, -0.7, 0.4]).as_matrix()
    T[:3, 3] = 0.123, 0.456, 0.0789
    return solid.moved(T)


def test_every_face_of_a_box_steps_back_by_the_depth() -> None:
    solid = box((0.0, 0.0, 0.0), (0.01, 0.02, 0.03))
    assert_allclose(retreated(solid, DEPTH).bounds, solid.bounds + DEPTH * np.array([[1.0], [-1.0]]), atol=0.02 * DEPTH)


def test_a_notch_grows_as_the_rest_shrinks() -> None:
    solid = turned(box((0, 0, 0), (0.02, 0.02, 0.02)) - box((0.01, 0.01, -0.01), (0.03, 0.03, 0.03)))
    made = retreated(solid, DEPTH / 10)
    assert (made - solid).volume < 1e-15
    assert_allclose(solid.volume - made.volume, DEPTH / 10 * solid.area, rtol=0.03)


def test_it_does_not_matter_into_what_triangles_a_face_is_cut() -> None:
    solid = box((0.0, 0.0, 0.0), (0.01, 0.02, 0.03))
    for share in ((1 / 3, 1 / 3, 1 / 3), (0.1, 0.1, 0.8), (0.5, 0.45, 0.05)):
        a, b, c = solid.triangles[0]
        new = len(solid.vertices)
        middle = np.array(share) @ solid.vertices[[a, b, c]]
        fan = np.concatenate([[[a, b, new], [b, c, new], [c, a, new]], solid.triangles[1:]])
        cut = Solid(np.concatenate([solid.vertices, middle[None]]), fan)
        assert_allclose(retreated(cut, DEPTH).bounds, retreated(solid, DEPTH).bounds, atol=1e-9 * DEPTH)


def test_a_knife_edge_and_a_sliver_stay_near_where_they_were() -> None:
    wedge = Solid(np.array([[0, 0, 0], [0, 1e-2, 0], [1e-2, 5e-3, 1e-5], [1e-2, 5e-3, -1e-5]]),
                  np.array([[0, 1, 2], [1, 0, 3], [0, 2, 3], [1, 3, 2]]))  # fmt: skip
    same = Solid(wedge.vertices[[0, 1, 2, 2]], wedge.triangles)  # two corners in one place
    for solid in (wedge, same):
        away = np.linalg.norm(retreated(solid, RETREAT).vertices - solid.vertices, axis=1)
        assert (away < 5.1 * RETREAT).all()


def test_a_corner_moves_by_more_than_rounding_moves_it() -> None:
    assert 2 * np.sqrt(3) * LATTICE / 2 / MM_PER_M < RETREAT


@pytest.mark.parametrize("depth", [0.0, RETREAT])
def test_what_touches_in_memory_shares_nothing_in_a_file_only_if_it_steps_back(depth: float) -> None:
    """A ball in its socket, cut by one surface into different triangles; and a bolt that is not printed."""
    block, bolt = turned(box((-0.02, -0.02, -0.02), (0.02, 0.02, 0.02))), turned(cylinder(0.005, -0.03, 0.03))
    ball = turned(ball_chain(np.zeros((1, 3)), 0.015, 64))
    socket, inlay = (block - ball - bolt).forgotten(), (ball - bolt).forgotten()
    first, second = (stored(retreated(solid, depth) if depth else solid) for solid in (socket, inlay))
    pairs = [(first, second), (first, bolt), (second, bolt)]
    shared = [max(one.overlap(two), two.overlap(one)) for one, two in pairs]
    assert shared == [0.0, 0.0, 0.0] if depth else max(shared) > 1e-13


def test_no_volume_to_speak_of_is_lost() -> None:
    shell = ball_chain(np.zeros((1, 3)), 0.05, 64) - ball_chain(np.zeros((1, 3)), 0.048, 64)  # a thin skin
    assert 0 < 1 - retreated(shell).volume / shell.volume < 3e-4
