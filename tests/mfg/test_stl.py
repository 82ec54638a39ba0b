from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from mfg.solids import Solid, ball_chain, box
from mfg.stl import LATTICE, MM_PER_M, stl_bytes, torn_edges, welded


def read(data: bytes) -> trimesh.Trimesh:
    return trimesh.load(io.BytesIO(data), file_type="stl", force="mesh")


@pytest.fixture(scope="module")
def ball() -> Solid:
    return ball_chain(np.array([[0.3, 0.2, 0.1]]), 0.04, 64)


def test_a_written_ball_is_read_back_as_the_same_solid(ball: Solid) -> None:
    vertices, triangles = welded(ball)
    mesh = read(stl_bytes(vertices, triangles, "ball"))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert_allclose(mesh.volume / 1e9, ball.volume, rtol=1e-6)
    assert {tuple(v) for v in np.asarray(mesh.vertices)} == {tuple(v) for v in vertices}


def test_the_lattice_survives_single_precision(ball: Solid) -> None:
    vertices, _ = welded(ball)
    assert np.array_equal(vertices.astype(np.float32).astype(np.float64), vertices)
    assert_allclose(vertices / LATTICE, np.round(vertices / LATTICE), rtol=0)


def test_welding_moves_nothing_by_more_than_half_a_step(ball: Solid) -> None:
    vertices, _ = welded(ball)
    gap = np.abs(ball.vertices[:, None] * MM_PER_M - vertices[None]).max(-1).min(1)
    assert gap.max() <= LATTICE / 2 + 1e-12


def test_corners_nearer_than_the_lattice_become_one() -> None:
    cube = box((0, 0, 0), (0.01, 0.01, 0.01))
    far = np.array([0.02, 0.02, 0.02])
    twin = Solid(
        np.concatenate([cube.vertices, cube.vertices + 1e-12, far[None]]),
        np.concatenate([cube.triangles[:6], cube.triangles[6:] + 8]),
    )
    vertices, triangles = welded(twin)
    assert len(vertices) == 8
    assert not len(torn_edges(triangles))


def test_a_hole_and_a_pinch_are_torn() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    assert len(torn_edges(cube.triangles)) == 0
    assert len(torn_edges(cube.triangles[1:])) == 3
    assert len(torn_edges(np.concatenate([cube.triangles[1:], cube.triangles[:1, ::-1]]))) == 3
    other = box((1, 1, 0), (2, 2, 1))  # touches the first along one edge
    both = Solid(np.concatenate([cube.vertices, other.vertices]), np.concatenate([cube.triangles, other.triangles + 8]))
    vertices, triangles = welded(both)
    torn = vertices[torn_edges(triangles)]
    assert_allclose(torn[..., :2], 1000.0)
    assert len(torn) == 1


def test_the_same_mesh_gives_the_same_bytes(ball: Solid) -> None:
    vertices, triangles = welded(ball)
    data = stl_bytes(vertices, triangles, "a")
    assert data == stl_bytes(vertices.copy(), triangles.copy(), "a")
    assert len(data) == 84 + 50 * len(triangles)
    assert not data.startswith(b"solid")
