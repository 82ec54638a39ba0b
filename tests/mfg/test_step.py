"""STEP files: read back strictly, by a reader that knows only the format, they are the closed solid they came from."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from mfg.pipeline import Outcome
from mfg.solids import Solid, box, cylinder
from mfg.step import FLAT, step_bytes, without_flat
from mfg.stl import MM_PER_M, torn_edges, welded

ENTITY = re.compile(r"#(\d+)=([A-Z0-9_]+)?\((.*)\);", re.DOTALL)


class Reader:
    """Entities by number, each reference checked as it is followed."""

    def __init__(self, data: bytes) -> None:
        text = data.decode("ascii")
        assert text.startswith("ISO-10303-21;\nHEADER;")
        assert text.endswith("ENDSEC;\nEND-ISO-10303-21;\n")
        self.kind, self.args = {}, {}
        for line in text.partition("DATA;\n")[2].split("ENDSEC;")[0].strip().split("\n"):
            match = ENTITY.fullmatch(line)
            assert match, line
            number = int(match[1])
            assert number not in self.kind
            self.kind[number], self.args[number] = match[2], match[3]
        for args in self.args.values():
            assert {int(n) for n in re.findall(r"#(\d+)", args)} <= set(self.kind)

    def all(self, kind: str) -> list[int]:
        return [number for number, k in self.kind.items() if k == kind]

    def follow(self, number: int, kind: str) -> list[int]:
        assert self.kind[number] == kind
        return [int(n) for n in re.findall(r"#(\d+)", self.args[number])]

    def numbers(self, number: int, kind: str) -> NDArray[np.float64]:
        assert self.kind[number] == kind
        inner = self.args[number].rpartition("(")[2].rstrip(")")
        return np.array([float(v) for v in inner.split(",")])

    def sense(self, number: int) -> bool:
        return self.args[number].endswith(".T.")

    def loops(self) -> list[NDArray[np.float64]]:
        """The corners (3, 3) of every face of the one shell, checked against its plane and its edges' lines."""
        (solid,) = self.all("MANIFOLD_SOLID_BREP")
        (shell,) = self.follow(solid, "MANIFOLD_SOLID_BREP")
        uses: Counter[tuple[int, bool]] = Counter()
        found = []
        for face in self.follow(shell, "CLOSED_SHELL"):
            bound, plane = self.follow(face, "ADVANCED_FACE")
            assert self.sense(face)
            (loop,) = self.follow(bound, "FACE_OUTER_BOUND")
            assert self.sense(bound)
            steps = []
            for oriented in self.follow(loop, "EDGE_LOOP"):
                (edge,) = self.follow(oriented, "ORIENTED_EDGE")
                a, b, line = self.follow(edge, "EDGE_CURVE")
                uses[edge, self.sense(oriented)] += 1
                steps.append((a, b) if self.sense(oriented) else (b, a))
                self._on_line(a, b, line)
            assert [b for _, b in steps] == [a for a, _ in (*steps[1:], steps[0])]
            corners = np.array([self._place(a) for a, _ in steps])
            (frame,) = self.follow(plane, "PLANE")
            origin, normal, tangent = self.follow(frame, "AXIS2_PLACEMENT_3D")
            z, x = self.numbers(normal, "DIRECTION"), self.numbers(tangent, "DIRECTION")
            assert abs(z @ x) < 1e-9
            assert np.abs((corners - self.numbers(origin, "CARTESIAN_POINT")) @ z).max() < 1e-6
            assert z @ np.cross(corners[1] - corners[0], corners[2] - corners[0]) > 0
            found.append(corners)
        edges = self.all("EDGE_CURVE")
        assert uses == Counter({(edge, sense): 1 for edge in edges for sense in (True, False)})
        return found

    def _place(self, vertex: int) -> NDArray[np.float64]:
        (point,) = self.follow(vertex, "VERTEX_POINT")
        return self.numbers(point, "CARTESIAN_POINT")

    def _on_line(self, a: int, b: int, line: int) -> None:
        point, vector = self.follow(line, "LINE")
        (direction,) = self.follow(vector, "VECTOR")
        start, along = self.numbers(point, "CARTESIAN_POINT"), self.numbers(direction, "DIRECTION")
        assert_allclose(start, self._place(a), atol=0)
        offset = self._place(b) - start
        assert offset @ along > 0
        assert np.linalg.norm(offset - (offset @ along) * along) < 1e-7


def volume(corners: list[NDArray[np.float64]]) -> float:
    a, b, c = np.array(corners).transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


SHAPES: dict[str, Callable[[], Solid]] = {
    "block": lambda: box((0, 0, 0), (0.03, 0.02, 0.01)),
    "holed": lambda: box((0, 0, 0), (0.03, 0.02, 0.01)) - cylinder(0.004, -1, 1).moved(shifted(0.015, 0.01, 0)),
    "ring": lambda: cylinder(0.02, 0, 0.01) - cylinder(0.012, -1, 1),
    "hollow": lambda: box((0, 0, 0), (0.03, 0.03, 0.03)) - box((0.01, 0.01, 0.01), (0.02, 0.02, 0.02)),
}


def shifted(*by: float) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, 3] = by
    return T


@pytest.mark.parametrize("name", sorted(SHAPES))
def test_a_shape_comes_back_closed_and_of_its_volume(name: str) -> None:
    solid = SHAPES[name]()
    faces = Reader(step_bytes(*welded(solid), name)).loops()
    assert volume(faces) == pytest.approx(solid.volume * MM_PER_M**3, rel=1e-6)


def test_the_bones_of_a_robot_come_back_closed_and_of_their_volume(built: Outcome) -> None:
    part = min((p for p in built.blueprint.parts if p.material == "rigid"), key=lambda p: len(p.solid.triangles))
    faces = Reader(step_bytes(*welded(part.solid), part.name)).loops()
    assert volume(faces) == pytest.approx(part.solid.volume * MM_PER_M**3, rel=1e-6)


def test_the_same_solid_gives_the_same_bytes_and_a_quote_in_its_name_is_told_apart() -> None:
    mesh = welded(SHAPES["holed"]())
    assert step_bytes(*mesh, "a") == step_bytes(*mesh, "a")
    assert b"PRODUCT('it''s','it''s'" in step_bytes(*mesh, "it's")


def test_an_open_mesh_is_refused() -> None:
    vertices, triangles = welded(SHAPES["block"]())
    for part in (triangles[1:], triangles[:0]):
        with pytest.raises(ValueError, match="closed mesh"):
            step_bytes(vertices, part, "open")


def test_flat_triangles_are_turned_away_without_a_hole() -> None:
    points, triangles = welded(SHAPES["block"]())
    # A corner in the middle of an edge of the block, joined to one side of it only: a triangle without height.
    a, b = triangles[0, :2].tolist()
    c, middle = int(triangles[0, 2]), len(points)
    points = np.concatenate([points, [(points[a] + points[b]) / 2]])
    bad = np.concatenate([triangles[1:], [(a, middle, c), (middle, b, c), (a, b, middle)]])
    assert len(torn_edges(bad)) == 0
    mended = without_flat(points, bad)
    assert len(mended) == len(bad)
    assert len(torn_edges(mended)) == 0
    corners = points[mended]
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert twice.min() > FLAT
    assert volume(list(corners)) == pytest.approx(6000)
    assert volume(Reader(step_bytes(points, bad, "bad")).loops()) == pytest.approx(6000)
