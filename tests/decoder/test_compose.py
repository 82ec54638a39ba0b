"""Putting parts together: linked bones melt, others keep a cleft, and depths agree with the labels."""

from __future__ import annotations

import numpy as np
import pytest

from decoder.compose import Window, centres, compose, window_of
from decoder.design import Material
from mfg.skeleton import contacts


def ball(x: float, radius: float = 6.0) -> Window:
    """A round bone in the middle of the grid but for x, in a skin of 2 voxels."""
    middle = np.array([x, 32.0, 32.0])
    first, count = window_of(middle - radius - 5, middle + radius + 5)
    bone = np.linalg.norm(centres(first, count) - middle, axis=-1).astype(np.float32) - np.float32(radius)
    return Window(first, bone, bone - np.float32(2.0))


@pytest.mark.parametrize("apart", [4.0, 8.0, 11.0])
def test_bones_without_a_common_hinge_are_kept_apart(apart: float):
    balls = [ball(32 - apart / 2), ball(32 + apart / 2)]
    material, segment, depth = compose(balls, set())
    rigid = np.where(material == Material.RIGID, segment, 0)
    assert set(np.unique(rigid)) == {0, 1, 2}
    assert not contacts(rigid)
    linked = compose(balls, {(0, 1)})
    joined = np.where(linked[0] == Material.RIGID, linked[1], 0)
    assert contacts(joined)
    assert (joined > 0).sum() > (rigid > 0).sum()
    for found, depths in ((material, depth), (linked[0], linked[2])):
        assert ((depths[0] > 0) == (found == Material.RIGID)).all()
        assert ((depths[1] > 0) == (found != Material.EMPTY)).all()


def test_a_bone_alone_is_its_field():
    material, segment, _ = compose([ball(32.0)], set())
    distance = np.linalg.norm(centres(np.zeros(3, np.intp), np.full(3, 64)) - 32.0, axis=-1)
    assert ((material == Material.RIGID) == (distance < 6.0)).all()
    assert ((material != Material.EMPTY) == (distance < 8.0)).all()
    assert (segment[material != Material.EMPTY] == 1).all()
