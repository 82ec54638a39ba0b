from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull

from decoder.design import VoxelDesign
from mfg.blueprint import Blueprint
from mfg.description import FULL_HULL, HULL_VERTICES, PAPER_SKIN, Description, _mean_cover, describe
from mfg.hulls import thinned
from mfg.outline import outline
from mfg.parts import PAPER
from mfg.pipeline import Outcome, score, virtual


@pytest.fixture(scope="module", params=["virtual", "scored", "built"])
def made(request: pytest.FixtureRequest, built: Outcome) -> Blueprint:
    return {"virtual": virtual, "scored": score, "built": lambda _: built}[request.param](built.design).blueprint


def test_links_stand_where_their_hinges_are(made: Blueprint) -> None:
    robot = describe(made)
    origins = robot.origins()
    assert [link.name for link in robot.links] == [body.name for body in made.bodies]
    assert_allclose(origins[1:], [hinge.position for hinge in made.hinges], atol=1e-12)
    assert_allclose(robot.links[0].com, 0, atol=1e-12)
    assert [joint.link for joint in robot.joints] == [hinge.body for hinge in made.hinges]
    assert all(link.parent < index for index, link in enumerate(robot.links))


def test_the_robot_stands_on_the_ground(made: Blueprint) -> None:
    robot = describe(made)
    above = robot.origins()[:, 2] - robot.origins()[0, 2] + robot.standing_height
    assert_allclose(min(z + link.hull[:, 2].min() for z, link in zip(above, robot.links, strict=True)), 0, atol=1e-12)


def test_hulls_are_small_and_hold_the_body(made: Blueprint) -> None:
    robot = describe(made)
    for index, (link, body, origin) in enumerate(zip(robot.links, made.bodies, robot.origins(), strict=True)):
        assert 4 <= len(link.hull) <= HULL_VERTICES
        hull = ConvexHull(link.hull)
        field = body.skin or body.bone
        inside = (np.argwhere(field.values > 0) + field.corner) * field.spacing
        if made.parts:
            inside = np.concatenate([part.solid.vertices for part in made.parts if part.body == index])
        outside = ((inside[::5] - origin) @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        assert outside.max() < 0.004  # what thinning to 128 vertices may cut off


def test_the_source_says_whether_hardware_has_its_place(built: Outcome) -> None:
    assert describe(virtual(built.design).blueprint).source == "design"
    assert describe(score(built.design).blueprint).source == "blueprint"


def test_the_imu_is_at_the_centre_of_the_controller(built: Outcome) -> None:
    blueprint, robot = built.blueprint, describe(built.blueprint)
    box = blueprint.box("controller")
    T = robot.T_link_imu.copy()
    T[:3, 3] += robot.origins()[robot.imu_link]
    assert robot.imu_link == box.body
    assert_allclose(T, box.T_design_box, atol=1e-12)


def test_describing_changes_nothing_and_repeats_itself(built: Outcome) -> None:
    before = built.blueprint.box("controller").T_design_box.copy()
    one, two = describe(built.blueprint), describe(built.blueprint)
    assert_allclose(built.blueprint.box("controller").T_design_box, before, rtol=0)
    for a, b in zip(one.links, two.links, strict=True):
        assert np.array_equal(a.hull, b.hull)
        assert np.array_equal(a.inertia, b.inertia)


def test_virtual_and_built_robot_share_their_skeleton(built: Outcome) -> None:
    a: Description = describe(virtual(built.design).blueprint)
    b = describe(built.blueprint)
    assert_allclose(a.origins()[1:], b.origins()[1:], atol=1e-12)
    assert_allclose([j.axis for j in a.joints], [j.axis for j in b.joints], atol=1e-12)
    assert_allclose(a.mass, b.mass, rtol=0.25)


def test_signs_and_ids_are_those_of_the_seats(built: Outcome) -> None:
    blueprint = built.blueprint
    seat = blueprint.seats[1]
    seats = (blueprint.seats[0], replace(seat, holder=seat.connector, connector=seat.holder))
    ours, turned = describe(blueprint).joints, describe(replace(blueprint, seats=seats)).joints
    assert [joint.can_id for joint in turned] == [1, 2]
    assert (turned[0].sign, turned[1].sign) == (ours[0].sign, -ours[1].sign)
    drawn = describe(virtual(built.design).blueprint).joints
    assert [(joint.can_id, joint.sign) for joint in drawn] == [(1, 1), (2, 1)]


def test_a_blueprint_without_bodies_cannot_be_described(creature: VoxelDesign) -> None:
    with pytest.raises(ValueError, match="run the skeleton and bone solvers first"):
        describe(Blueprint(creature, PAPER))


def test_thinning_keeps_the_extremes_along_the_axes() -> None:
    points = np.random.default_rng(0).normal(size=(4000, 3))
    kept = thinned(points, 40)
    assert len(kept) <= 40
    assert_allclose([kept.min(0), kept.max(0)], [points.min(0), points.max(0)])


def test_skin_is_as_thick_as_the_gap_between_bone_and_hull(made: Blueprint) -> None:
    robot = describe(made)
    assert robot.skin == PAPER_SKIN
    for link, body in zip(robot.links, made.bodies, strict=True):
        assert body.skin is not None
        # The creature's soft tissue reaches 15 to 20 mm beyond its bones, less where joints and neighbours clear it.
        assert 0.004 < link.skin_thickness < 0.03


def test_a_body_without_skin_is_bare(elbow: VoxelDesign) -> None:
    assert [link.skin_thickness for link in describe(virtual(elbow).blueprint).links] == [0.0, 0.0]


def test_cover_is_measured_far_from_the_bone_too(built: Outcome) -> None:
    bone = built.blueprint.bodies[0].bone
    surface = bone.origin + np.argwhere(np.abs(bone.values) < 0.2 * bone.spacing)[:40] * bone.spacing
    middle = bone.centroid()
    out = (surface - middle) / np.linalg.norm(surface - middle, axis=1, keepdims=True)
    near, far = (_mean_cover(bone, surface + reach * out, outline(bone).sparse()) for reach in (0.02, 0.10))
    assert 0.012 < near < 0.022
    assert 0.07 < far < 0.102


def test_all_corners_of_a_hull_can_be_had(built: Outcome) -> None:
    few, all_of_them = describe(built.blueprint), describe(built.blueprint, hull_vertices=FULL_HULL)
    for some, full in zip(few.links, all_of_them.links, strict=True):
        assert len(some.hull) <= HULL_VERTICES < len(full.hull)
        assert ConvexHull(some.hull).volume == pytest.approx(ConvexHull(full.hull).volume, rel=0.05)
