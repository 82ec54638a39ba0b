"""Solids: booleans conserve volume, pickling keeps the shape, tunnels hold for any bend."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfg.fields import Field
from mfg.solids import Solid, ball_chain, box, cylinder, from_field, tube, union

SIZE = st.floats(0.01, 0.2)


@given(a=st.tuples(SIZE, SIZE, SIZE), shift=st.tuples(*[st.floats(-0.1, 0.1)] * 3))
@settings(max_examples=30, deadline=None)
def test_inclusion_and_exclusion(a: tuple[float, float, float], shift: tuple[float, float, float]) -> None:
    A = box((0, 0, 0), a)
    B = cylinder(0.05, -0.06, 0.07).moved(np.block([[np.eye(3), np.array(shift)[:, None]], [np.zeros(3), 1.0]]))
    both = (A ^ B).volume
    assert (A + B).volume == pytest.approx(A.volume + B.volume - both, rel=1e-6)
    assert (A - B).volume == pytest.approx(A.volume - both, rel=1e-6, abs=1e-12)
    assert A.overlap(B) == pytest.approx(both, abs=1e-12)
    assert A.minus([B]).volume == pytest.approx((A - B).volume, rel=1e-9, abs=1e-12)


def test_pickle_keeps_the_solid() -> None:
    solid = tube(0.05, 0.04, 0.0, 0.1)
    copy = pickle.loads(pickle.dumps(solid))
    assert copy.volume == solid.volume
    np.testing.assert_array_equal(copy.triangles, solid.triangles)


def test_components_come_largest_first() -> None:
    pieces = union([box((0, 0, 0), (0.01,) * 3), box((0.05, 0, 0), (0.08, 0.03, 0.03))]).components()
    assert [round(p.volume * 1e6, 3) for p in pieces] == [27.0, 1.0]


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.5, 3.0])
def test_a_tunnel_has_the_volume_of_its_bends(turn: float) -> None:
    path = np.array([[0, 0, 0], [0.05, 0, 0], [0.05 + 0.05 * np.cos(turn), 0.05 * np.sin(turn), 0]])
    solid = ball_chain(path, 0.003, segments=32)
    assert len(solid.components()) == 1
    # At least one straight leg, at most both legs and three balls.
    leg = np.pi * 0.003**2 * 0.05
    assert 0.95 * leg < solid.volume < 2 * leg + 3 * 4 / 3 * np.pi * 0.003**3


def test_meshing_a_field_refuses_the_empty_one() -> None:
    with pytest.raises(ValueError, match="nowhere positive"):
        from_field(Field(np.full((4, 4, 4), -1, np.float32), (0, 0, 0), 0.005))


def test_a_body_at_the_edge_of_its_array_is_closed() -> None:
    solid = from_field(Field(np.ones((4, 4, 4), np.float32) * 0.002, (0, 0, 0), 0.005))
    assert solid.volume > 0
    assert len(solid.components()) == 1


def test_an_open_mesh_is_not_a_solid() -> None:
    good = box((0, 0, 0), (1, 1, 1))
    with pytest.raises(ValueError, match="not a solid"):
        _ = Solid(good.vertices, good.triangles[1:]).volume


def test_the_same_solid_has_the_same_bytes_whichever_operand_was_made_first() -> None:
    def made(cutter_first: bool) -> Solid:
        makers = [lambda: box([0, 0, 0], [1, 1, 1]), lambda: cylinder(0.3, -1, 2)]
        pair = [make() for make in (makers[::-1] if cutter_first else makers)]
        block, cutter = pair[::-1] if cutter_first else pair
        return block - cutter

    one, two = made(False), made(True)
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.triangles.tobytes() == two.triangles.tobytes()
