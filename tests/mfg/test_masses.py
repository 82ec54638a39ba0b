from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from decoder.sketch import load_design
from mfg.catalogue import Filament
from mfg.masses import body_masses, component_moments, printed_by_body, wire_stretches
from mfg.moments import (
    Moments,
    box_moments,
    cylinder_moments,
    polyline_moments,
    printed_moments,
    shell_moments,
    total,
    volume_moments,
)
from mfg.parts import PLA
from mfg.pipeline import Outcome, Rules, build, score, virtual
from mfg.solids import Solid, ball_chain, box, cylinder

CRAWLER = Path(__file__).parents[2] / "experiments" / "examples" / "crawler.vox"
WIDTH = 0.0006
SPARSE = Filament("sparse", 1000.0, 1e9, 2, 0.1, "gyroid", "#FFFFFF", "made up")


def pose(turn: float, place: tuple[float, float, float]) -> NDArray[np.float64]:
    c, s = np.cos(turn), np.sin(turn)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    T[:3, 3] = place
    return T


def of(solid: Solid) -> Moments:
    return volume_moments(solid.vertices, solid.triangles)


def ball(radius: float, segments: int = 96) -> Solid:
    return ball_chain(np.zeros((1, 3)), radius, segments)


def test_a_solid_box_has_the_inertia_of_a_box_wherever_it_lies() -> None:
    T, size = pose(0.7, (0.3, -0.2, 0.5)), (0.1, 0.06, 0.03)
    half = [s / 2 for s in size]
    made = of(box([-h for h in half], half).moved(T)).properties()
    stated = box_moments(made.mass, size, T).properties()
    assert_allclose(made.mass, np.prod(size), rtol=1e-12)
    assert_allclose(made.com, T[:3, 3], atol=1e-12)
    assert_allclose(made.inertia, stated.inertia, rtol=1e-9, atol=1e-15)
    expected = np.diag([size[1] ** 2 + size[2] ** 2, size[0] ** 2 + size[2] ** 2, size[0] ** 2 + size[1] ** 2]) / 12
    assert_allclose(T[:3, :3].T @ stated.inertia @ T[:3, :3], made.mass * expected, atol=1e-15)


def test_a_fine_cylinder_has_the_inertia_of_a_cylinder() -> None:
    made = of(cylinder(0.04, -0.03, 0.03, 512)).properties()
    stated = cylinder_moments(made.mass, 0.04, 0.06, np.eye(4)).properties()
    assert_allclose(made.inertia, stated.inertia, rtol=1e-4, atol=1e-12)


def test_the_shell_of_a_box_has_the_closed_form_inertia() -> None:
    a, b, c = 0.2, 0.1, 0.06
    solid = box((0, 0, 0), (a, b, c))
    made = shell_moments(solid.vertices, solid.triangles).properties()
    faces = [(b * c, 0, a, (a, b, c)), (a * c, 1, b, (a, b, c)), (a * b, 2, c, (a, b, c))]
    spread = np.zeros(3)
    for area, axis, apart, size in faces:
        for other in range(3):
            spread[other] += 2 * area * ((apart / 2) ** 2 if other == axis else size[other] ** 2 / 12)
    assert_allclose(made.mass, 2 * (a * b + b * c + c * a), rtol=1e-12)
    assert_allclose(np.diag(made.inertia), spread.sum() - spread, rtol=1e-12)


def test_a_thin_printed_ball_has_the_inertia_of_shell_plus_infill() -> None:
    R = 0.05
    solid = ball(R)
    made = printed_moments(solid.vertices, solid.triangles, SPARSE, WIDTH).properties()
    t = SPARSE.walls * WIDTH
    wall = SPARSE.density * t * solid.area
    assert_allclose(made.mass, wall + SPARSE.density * SPARSE.infill * (solid.volume - t * solid.area), rtol=1e-12)
    # The infill counts all through the ball, the rest of the wall on a sphere half a wall below the surface.
    infill = SPARSE.density * SPARSE.infill * solid.volume
    expected = 0.4 * infill * R**2 + 2 / 3 * (1 - SPARSE.infill) * wall * (R - t / 2) ** 2
    assert_allclose(np.diag(made.inertia), expected, rtol=3e-3)


def test_the_printed_inertia_agrees_with_a_dense_sampling_of_walls_and_infill() -> None:
    half = np.array([0.08, 0.05, 0.04])
    solid = box((-half).tolist(), half.tolist())
    made = printed_moments(solid.vertices, solid.triangles, SPARSE, WIDTH).properties()
    # One octant, in cells of a third of the wall.
    x, y, z = np.meshgrid(*[(np.arange(round(h / 4e-4)) + 0.5) * 4e-4 for h in half], indexing="ij", sparse=True)
    depth = np.minimum(np.minimum(half[0] - x, half[1] - y), half[2] - z)
    density = np.where(depth < SPARSE.walls * WIDTH, SPARSE.density, SPARSE.infill * SPARSE.density) * 8 * 4e-4**3
    assert_allclose(made.mass, density.sum(), rtol=0.015)  # the model counts the walls' edges twice
    inertia = [(density * (p**2 + q**2)).sum() for p, q in ((y, z), (x, z), (x, y))]
    assert_allclose(np.diag(made.inertia), inertia, rtol=0.03)


@given(scale=st.floats(1e-3, 5e-2), infill=st.floats(0, 1), walls=st.integers(0, 30))
@settings(max_examples=40, deadline=None)
def test_a_part_never_weighs_more_than_solid_nor_less_than_its_infill(scale: float, infill: float, walls: int) -> None:
    solid = box((0, 0, 0), (scale, 2 * scale, scale / 2))
    filament = replace(PLA, infill=infill, walls=walls)
    mass = printed_moments(solid.vertices, solid.triangles, filament, WIDTH).mass
    assert filament.density * infill * solid.volume * (1 - 1e-9) <= mass <= filament.density * solid.volume * (1 + 1e-9)


def test_moments_do_not_depend_on_where_the_origin_is() -> None:
    solid = box((0, 0, 0), (0.1, 0.05, 0.02)) + ball(0.04, 24)
    near, T = of(solid).properties(), pose(0.4, (3.0, -2.0, 5.0))
    far = of(solid.moved(T)).properties()
    assert_allclose(far.com, T[:3, :3] @ near.com + T[:3, 3], atol=1e-9)
    assert_allclose(far.inertia, T[:3, :3] @ near.inertia @ T[:3, :3].T, rtol=1e-6, atol=1e-12)


def test_a_cable_weighs_its_length_and_balances_at_its_middle() -> None:
    path = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]])
    made = polyline_moments(0.05, path).properties()
    assert_allclose([made.mass, *made.com], [0.015, 0.15, 0, 0], atol=1e-12)
    assert_allclose(np.diag(made.inertia), [0, 0.015 * 0.09 / 12, 0.015 * 0.09 / 12], atol=1e-12)


def test_nothing_has_no_centre_of_mass() -> None:
    with pytest.raises(ValueError, match="every body needs a printed part"):
        total([]).properties()


def test_bodies_together_weigh_what_parts_and_components_weigh(built: Outcome) -> None:
    blueprint = built.blueprint
    catalogue = blueprint.catalogue
    printed = sum(
        printed_moments(
            p.solid.vertices, p.solid.triangles, catalogue.rigid if p.material == "rigid" else catalogue.soft,
            catalogue.printer.line_width,
        ).mass
        for p in blueprint.parts
    )  # fmt: skip
    bought = catalogue.motor.mass * len(blueprint.seats) + catalogue.battery.mass + catalogue.computer.mass
    cable = catalogue.wire.mass_per_metre * sum(wire.cable_length for wire in blueprint.wires)
    assert_allclose(sum(m.mass for m in blueprint.masses), printed + bought + cable, rtol=1e-9)


@pytest.mark.parametrize("stage", ["virtual", "scored", "built"])
def test_body_sums_keep_mass_centre_and_inertia_at_every_stage(stage: str, built: Outcome) -> None:
    made = {"virtual": virtual, "scored": score, "built": lambda _: built}[stage](built.design).blueprint
    bodies = body_masses(made)
    assert len(bodies) == len(made.bodies)
    whole = total(m for _, m in printed_by_body(made) + component_moments(made)).properties()
    mass = np.array([b.mass for b in bodies])
    com = np.array([b.com for b in bodies])
    assert_allclose(mass.sum(), whole.mass, rtol=1e-12)
    assert_allclose(mass @ com / mass.sum(), whole.com, atol=1e-12)
    arm = com - whole.com
    steiner = sum(m * ((a @ a) * np.eye(3) - np.outer(a, a)) for m, a in zip(mass, arm, strict=True))
    assert_allclose(sum(b.inertia for b in bodies) + steiner, whole.inertia, rtol=1e-9, atol=1e-12)
    for b in bodies:
        low, middle, high = np.linalg.eigvalsh(b.inertia)
        assert low > 0
        assert high < low + middle


@pytest.fixture(scope="module")
def thick_walled() -> Outcome:
    """A sketch whose mounts need many walls, which line its cavities, too."""
    outcome = build(load_design(CRAWLER))
    assert outcome.blueprint.catalogue.rigid.walls >= 7
    return outcome


@pytest.mark.parametrize(("made", "rules"), [("built", "search"), ("plain", "paper"), ("thick_walled", "search")])
def test_masses_from_fields_are_close_to_those_of_the_parts(
    made: str, rules: Rules, request: pytest.FixtureRequest
) -> None:
    outcome: Outcome = request.getfixturevalue(made)
    fast, exact = body_masses(score(outcome.design, rules=rules).blueprint), outcome.blueprint.masses
    assert sum(b.mass for b in fast) == pytest.approx(sum(b.mass for b in exact), rel=0.03)
    assert_allclose([b.mass for b in fast], [b.mass for b in exact], rtol=0.10)
    assert_allclose([b.com for b in fast], [b.com for b in exact], atol=0.006)


def test_every_stretch_of_a_cable_belongs_to_one_body_and_none_is_lost(built: Outcome) -> None:
    blueprint = built.blueprint
    for wire in blueprint.wires:
        stretches = wire_stretches(wire, blueprint)
        assert_allclose(np.concatenate([path[:-1] for _, path in stretches]), wire.path[:-1])
        assert stretches[0][0] == blueprint.box("controller").body
        assert all(a[0] != b[0] for a, b in itertools.pairwise(stretches))


def test_the_motor_weighs_on_the_body_that_holds_it(built: Outcome) -> None:
    blueprint = built.blueprint
    swapped = replace(
        blueprint, seats=tuple(replace(s, holder=s.connector, connector=s.holder) for s in blueprint.seats)
    )
    moved = np.array([b.mass for b in body_masses(swapped)]) - [b.mass for b in blueprint.masses]
    for seat in blueprint.seats:
        moved[seat.holder] += blueprint.catalogue.motor.mass
        moved[seat.connector] -= blueprint.catalogue.motor.mass
    assert_allclose(moved, 0, atol=1e-9)
