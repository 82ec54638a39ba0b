"""Crossings of a lattice with a surface: the sums that formulas give, nearer than triangles come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from mfg.catalogue import Filament
from mfg.fields import Field
from mfg.masses import body_masses, printed_by_body
from mfg.moments import Moments, covering_moments, outline_moments, printed_moments
from mfg.outline import Outline, outline
from mfg.pipeline import Outcome, score
from mfg.solids import surface

Points = NDArray[np.float64]
SPACING = 0.005
WIDTH = 0.0006
SPARSE = Filament("sparse", 1000.0, 1e9, 2, 0.1, "gyroid", "#FFFFFF", "made up")
WHOLE = Filament("whole", 1000.0, 1e9, 1, 1.0, "solid", "#FFFFFF", "made up")  # so that mass is volume
CENTRE = np.array([0.1013, 0.0977, 0.1041])


def field(depth: Callable[[Points], Points], low: float = 0.0, high: float = 0.2) -> Field:
    first, last = round(low / SPACING), round(high / SPACING)
    axis = np.arange(first, last + 1) * SPACING
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return Field(depth(points).astype(np.float32), (first, first, first), SPACING)


def ball(radius: float, centre: Points = CENTRE) -> Callable[[Points], Points]:
    return lambda points: radius - np.linalg.norm(points - centre, axis=-1)


def turned_box(points: Points) -> Points:
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    return np.asarray((np.array([0.06, 0.035, 0.045]) - np.abs((points - CENTRE) @ turn)).min(axis=-1))


def volume_of(shape: Outline) -> Moments:
    return outline_moments(shape, WHOLE, WIDTH).scaled(1e-3)


def test_a_ball_has_its_area_volume_centre_and_inertia() -> None:
    radius = 0.05
    shape = outline(field(ball(radius)))
    made = volume_of(shape).properties()
    assert_allclose(shape.area.sum(), 4 * np.pi * radius**2, rtol=4e-3)
    assert_allclose(made.mass, 4 / 3 * np.pi * radius**3, rtol=2e-3)
    assert_allclose(made.com, CENTRE, atol=1e-4)
    assert_allclose(made.inertia, 0.4 * made.mass * radius**2 * np.eye(3), rtol=0, atol=4e-3 * made.mass * radius**2)
    assert_allclose(np.linalg.norm(shape.points - CENTRE, axis=1), radius, atol=1e-4)
    assert_allclose(shape.normals, (shape.points - CENTRE) / radius, atol=0.05)


def test_edges_are_not_cut_off_as_triangles_cut_them() -> None:
    solid = field(turned_box)
    volume, area = 8 * 0.06 * 0.035 * 0.045, 8 * (0.06 * 0.035 + 0.06 * 0.045 + 0.035 * 0.045)
    shape = outline(solid)
    assert_allclose(volume_of(shape).mass, volume, rtol=4e-3)
    assert_allclose(shape.area.sum(), area, rtol=3e-2)
    true = 1e3 * (0.1 * volume + 0.9 * 2 * WIDTH * area)
    ours = outline_moments(shape, SPARSE, WIDTH).mass / true
    triangles = printed_moments(*surface(solid), SPARSE, WIDTH).mass / true
    assert abs(ours - 1) < 0.6 * abs(triangles - 1)


def test_a_cover_weighs_its_two_walls_and_what_lies_between() -> None:
    outer, inner = (outline(field(ball(radius))) for radius in (0.06, 0.04))
    everywhere = (np.ones(len(outer.points), bool), np.ones(len(inner.points), bool))
    made = covering_moments(outer, inner, everywhere, SPARSE, WIDTH)
    t, R, r = 2 * WIDTH, 0.06, 0.04
    walls = 4 * np.pi * t * (R**2 + r**2)
    assert_allclose(made.mass, 1e3 * (0.1 * (4 / 3 * np.pi * (R**3 - r**3) - walls) + walls), rtol=4e-3)
    assert_allclose(made.properties().com, CENTRE, atol=1e-4)


def test_a_surface_that_covers_nothing_weighs_nothing() -> None:
    bare = outline(field(ball(0.05)))
    nowhere = np.zeros(len(bare.points), bool)
    assert covering_moments(bare, bare, (nowhere, nowhere), SPARSE, WIDTH).mass == 0.0


def test_a_body_cut_off_by_its_lattice_ends_there() -> None:
    shape = outline(field(lambda points: 0.02 - np.abs(points[..., 2] - 0.1), 0.08, 0.12))
    assert shape.area.sum() == pytest.approx(2 * 0.045**2 + 4 * 0.045 * 0.04, rel=0.06)


def test_nothing_has_no_outline() -> None:
    assert len(outline(field(ball(-0.01))).points) == 0


def test_bodies_weigh_what_their_triangles_do_but_for_what_those_cut_off(built: Outcome) -> None:
    blueprint = replace(
        score(built.design).blueprint, seats=(), boxes=(), wires=()
    )  # bones and skins alone, without mounts
    rigid, width = blueprint.catalogue.rigid, blueprint.catalogue.printer.line_width
    bones = [moments.mass for body, moments in printed_by_body(blueprint)][::2]
    meshes = [printed_moments(*surface(body.bone), rigid, width).mass for body in blueprint.bodies]
    assert_allclose(bones, meshes, rtol=0.03)
    assert (np.array(bones) > meshes).all()
    assert len(body_masses(blueprint)) == len(bones)
