"""What faces the air, and which hollows are closed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone

from mfg.blueprint import PrintedPart
from mfg.pipeline import Outcome
from mfg.print_notes import air_surface, closed_hollows, print_notes
from mfg.retreat import RETREAT, retreated
from mfg.solids import Solid, ball_chain, box, cylinder, union
from mfg.splitting import pieces


def area(corners: np.ndarray) -> float:
    return float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    )


def test_a_face_between_bone_and_skin_is_not_in_the_air() -> None:
    bone, skin = box_bone((0.3, 0.3, 0.3), (0.1, 0.1, 0.1)), box_bone((0.3, 0.3, 0.32), (0.1, 0.1, 0.14))
    inner, outer = box((0.25, 0.25, 0.25), (0.35, 0.35, 0.35)), box((0.25, 0.25, 0.25), (0.35, 0.35, 0.39))
    parts = (PrintedPart("body_0_bone", 0, "rigid", inner), PrintedPart("body_0_skin_1", 0, "soft", outer - inner))
    blueprint = replace(blueprint_of([bone], skins=[skin]), parts=parts)
    (piece,) = pieces(blueprint)
    assert area(air_surface(blueprint, piece)) == pytest.approx(outer.area, rel=1e-9)
    bare = replace(blueprint, parts=parts[:1])
    assert area(air_surface(bare, pieces(bare)[0])) == pytest.approx(inner.area, rel=1e-9)


def test_what_faces_the_air_is_the_surface_of_the_whole_body(built: Outcome) -> None:
    blueprint = built.blueprint
    for piece in pieces(blueprint):
        # Grown until they meet: finished parts step back from one another.
        whole = union([retreated(part.solid, -2 * RETREAT) for part in piece.parts]).area
        apart = sum(part.solid.area for part in piece.parts)
        # The union has slivers of air between bone and skin that nothing covers; the bulk of the shared faces is gone.
        found = area(air_surface(blueprint, piece))
        assert abs(found - whole) < 0.15 * whole, piece.name
        assert abs(found - whole) < 0.35 * abs(apart - whole) or apart < 1.05 * whole, piece.name


def test_only_a_hollow_without_a_way_out_is_closed() -> None:
    block, ball = box((0, 0, 0), (0.06, 0.06, 0.06)), ball_chain(np.full((1, 3), 0.03), 0.01, 24)
    assert closed_hollows(block) == []
    assert closed_hollows(block - ball) == [pytest.approx(ball.volume)]
    bore = np.eye(4)
    bore[:2, 3] = 0.03
    assert closed_hollows(block - ball - cylinder(0.002, 0.03, 0.1).moved(bore)) == []


def test_the_sheet_names_parts_with_closed_hollows(built: Outcome) -> None:
    part = built.blueprint.parts[0]
    assert any("none is closed" in line for line in print_notes(built.blueprint))
    holed: Solid = box((0, 0, 0), (0.1, 0.1, 0.1)) - ball_chain(np.full((1, 3), 0.05), 0.01, 24)
    lines = print_notes(replace(built.blueprint, parts=(replace(part, solid=holed),)))
    assert any(line.strip().startswith(f"{part.name}: 1, 4.") for line in lines), lines
    assert not any("none is closed" in line for line in lines)
