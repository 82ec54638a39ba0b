"""Pictures: every kind of part shows in its colour, the same input gives the same bytes, sheets keep their order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decoder.design import Material, VoxelDesign
from mfg import picture
from mfg.pipeline import virtual
from mfg.render import render


def test_a_design_picture_is_deterministic_and_not_empty(elbow: VoxelDesign) -> None:
    first, second = (picture.picture_of_design(elbow, (120, 90)) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert first.shape == (90, 120, 3)
    assert np.ptp(first.reshape(-1, 3).astype(int), axis=0).min() > 60


def test_shapes_cover_bones_skins_and_axes(creature: VoxelDesign) -> None:
    shapes = picture.design_shapes(creature)
    colours = [shape.colour for shape in shapes]
    assert colours.count(picture.SKIN) == 3
    assert colours.count(picture.AXIS) == 2
    assert set(picture.SEGMENTS[:3]) <= set(colours)
    assert all(shape.alpha < 1 for shape in shapes if shape.colour == picture.SKIN)


def test_colours_of_segments_skin_and_axes_lie_far_apart() -> None:
    colours = [*picture.SEGMENTS, picture.SKIN, picture.AXIS]
    apart = [np.linalg.norm(np.subtract(a, b)) for k, a in enumerate(colours) for b in colours[:k]]
    assert min(apart) > 0.2


def test_an_axis_sticks_out_of_the_bones_that_it_joins(creature: VoxelDesign) -> None:
    rods = [shape for shape in picture.design_shapes(creature) if shape.colour == picture.AXIS]
    bones = (np.argwhere(creature.material == Material.RIGID) + 0.5) * creature.pitch
    owner = creature.segment[creature.material == Material.RIGID]
    for joint, rod in zip(creature.joints, rods, strict=True):
        mine = bones[np.isin(owner, (joint.parent, joint.child))] - joint.position
        along = mine @ joint.axis
        core = along[np.linalg.norm(mine - along[:, None] * joint.axis, axis=1) < picture.AXIS_RADIUS + creature.pitch]
        ends = (rod.vertices - joint.position) @ joint.axis
        assert ends.min() < core.min() - creature.pitch
        assert ends.max() > core.max() + creature.pitch


def test_a_ghost_shows_through_what_hides_it_and_nothing_else_does() -> None:
    wall = picture._shape(picture.box([-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]), (0.9, 0.9, 0.9))
    hidden = picture._shape(picture.box([-0.02, -0.02, -0.02], [0.02, 0.02, 0.02]), picture.AXIS)
    plain, solid, ghost = (
        render(shapes, (60, 60)) for shapes in ([wall], [wall, hidden], [wall, replace(hidden, ghost=0.5)])
    )
    np.testing.assert_array_equal(plain, solid)
    changed = (ghost != plain).any(axis=2)
    assert changed[30, 30]
    assert 0.005 < changed.mean() < 0.1
    assert int(ghost[30, 30, 0]) > int(ghost[30, 30, 1]) + 30


def test_exploding_moves_bodies_apart_from_the_root(creature: VoxelDesign) -> None:
    blueprint = virtual(creature).blueprint
    still, apart = (picture.blueprint_shapes(blueprint, e) for e in (0.0, 0.5))
    span = [np.ptp(np.concatenate([s.vertices for s in shapes]), axis=0).max() for shapes in (still, apart)]
    assert span[1] > span[0] + 0.02


def test_a_sheet_keeps_order_and_size() -> None:
    images = [np.full((20, 30, 3), 40 * k, np.uint8) for k in range(5)]
    sheet = picture.contact_sheet(images, list("abcde"), columns=2)
    assert sheet.shape == (3 * (20 + picture.LABEL_HEIGHT), 60, 3)
    assert (sheet[:20, 30:60] == 40).all()
    with pytest.raises(ValueError, match="5 pictures and 4 labels"):
        picture.contact_sheet(images, list("abcd"))


def test_a_blueprint_without_bodies_draws_nothing_but_does_not_fail(elbow: VoxelDesign) -> None:
    empty = replace(virtual(elbow).blueprint, bodies=(), hinges=())
    assert picture.blueprint_shapes(empty) == []
