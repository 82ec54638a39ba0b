"""Trees of segments: their shapes without names, and what makes a design one tree."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decoder.design import GRID, Joint, Material, VoxelDesign
from decoder.kinematics import free_tree_shape, is_linked, is_one_tree, is_whole, touch, tree_shape

Box = tuple[slice, slice, slice]


def boxes(*bones: Box, links: tuple[tuple[int, int], ...] = ()) -> VoxelDesign:
    material = np.zeros((GRID,) * 3, np.uint8)
    segment = np.zeros((GRID,) * 3, np.int16)
    for number, box in enumerate(bones, start=1):
        material[box], segment[box] = Material.RIGID, number
    middle = (np.argwhere(material > 0).mean(axis=0) + 0.5) * 0.01
    joints = tuple(Joint(middle, np.array([0.0, 1.0, 0.0]), np.array([-1.0, 1.0]), a, b) for a, b in links)
    return VoxelDesign(material, segment, joints=joints)


def row_of_boxes(gap: int, links: tuple[tuple[int, int], ...] = ((1, 2), (2, 3))) -> VoxelDesign:
    """Three boxes along x, ten voxels long, `gap` empty voxels between them."""
    starts = [4 + k * (10 + gap) for k in range(3)]
    return boxes(*(np.s_[s : s + 10, 20:30, 20:30] for s in starts), links=links)


def all_trees(n: int) -> Iterator[list[tuple[int, int]]]:
    """Every labelled tree on n nodes in which the parent has the smaller label."""
    for parents in itertools.product(*(range(k) for k in range(1, n))):
        yield [(parent, child) for child, parent in enumerate(parents, start=1)]


@pytest.mark.parametrize(("n", "shapes"), [*enumerate([1, 1, 1, 2, 3, 6, 11, 23], start=1)])
def test_there_are_as_many_shapes_as_free_trees(n: int, shapes: int) -> None:
    assert len({free_tree_shape(range(n), tree) for tree in all_trees(n)}) == shapes


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=10), st.randoms(use_true_random=False))
def test_names_do_not_change_a_shape(draws: list[int], random: object) -> None:
    links = [(draw % child, child) for child, draw in enumerate(draws, start=1)]
    names = list(range(100, 101 + len(draws)))
    random.shuffle(names)  # type: ignore[attr-defined]
    renamed = [(names[b], names[a]) for a, b in links[::-1]]
    assert free_tree_shape(names, renamed) == free_tree_shape(range(len(draws) + 1), links)


def test_a_chain_and_a_star_are_written_from_their_centres() -> None:
    assert free_tree_shape([7], []) == "()"
    assert free_tree_shape([1, 2, 3], [(1, 2), (2, 3)]) == "(()())"
    assert free_tree_shape([4, 3, 2, 1], [(1, 2), (3, 2), (2, 4)]) == "(()()())"
    assert free_tree_shape([1, 2, 3, 4], [(1, 2), (2, 3), (3, 4)]) == "((())())"


def test_the_shape_of_a_design_does_not_depend_on_its_root() -> None:
    assert tree_shape(row_of_boxes(0)) == tree_shape(row_of_boxes(0, ((3, 2), (2, 1)))) == "(()())"
    assert tree_shape(row_of_boxes(0, ((1, 2),))) is None


@pytest.mark.parametrize(("gap", "touches"), [(0, True), (1, True), (2, False), (8, False)])
def test_linked_segments_touch_within_two_voxels(gap: int, touches: bool) -> None:
    design = row_of_boxes(gap)  # Centres of the nearest voxels are gap + 1 apart.
    assert touch(design, 1, 2) is touch(design, 2, 1) is touches
    assert is_one_tree(design) is touches


def test_a_diagonal_counts_with_its_length() -> None:
    near = boxes(np.s_[10:20, 10:20, 10:20], np.s_[20:30, 20:30, 10:20])
    far = boxes(np.s_[10:20, 10:20, 10:20], np.s_[21:30, 21:30, 10:20])
    assert touch(near, 1, 2)
    assert not touch(far, 1, 2)


def test_one_tree_asks_for_two_joints_and_every_segment() -> None:
    assert is_one_tree(row_of_boxes(0))
    assert not is_one_tree(row_of_boxes(0, ((1, 2),)))  # Segment 3 hangs on nothing.
    pair = boxes(np.s_[4:14, 20:30, 20:30], np.s_[14:24, 20:30, 20:30], links=((1, 2),))
    assert is_linked(pair)
    assert not is_one_tree(pair)
    assert is_one_tree(pair, least_joints=1)


def broken(crumb: int) -> VoxelDesign:
    """Two boxes linked, segment 1 of 1000 voxels and `crumb` more that float."""
    design = boxes(np.s_[4:14, 20:30, 20:30], np.s_[14:24, 20:30, 20:30], links=((1, 2),))
    material, segment = design.material.copy(), design.segment.copy()
    material[40, 40, 2 : 2 + crumb], segment[40, 40, 2 : 2 + crumb] = Material.RIGID, 1
    return VoxelDesign(material, segment, joints=design.joints)


@pytest.mark.parametrize(("crumb", "whole"), [(0, True), (1, True), (52, True), (53, False)])
def test_a_segment_may_shed_a_twentieth(crumb: int, whole: bool) -> None:
    assert is_whole(broken(crumb), 1) is whole
    assert is_one_tree(broken(crumb), least_joints=1) is whole


def test_voxels_that_share_a_corner_are_one_piece() -> None:
    material = np.zeros((GRID,) * 3, np.uint8)
    material[10:20, 10:20, 10:20] = material[20:30, 20:30, 20:30] = Material.RIGID
    assert is_whole(VoxelDesign(material, (material > 0).astype(np.int16)), 1)


def test_soft_tissue_neither_joins_nor_breaks() -> None:
    design = row_of_boxes(4)
    material, segment = design.material.copy(), design.segment.copy()
    soft = np.zeros(material.shape, bool)
    soft[3:45, 19:31, 19:31] = True
    material[soft & (material == 0)] = Material.SOFT
    padded = VoxelDesign(material, segment, joints=design.joints)
    assert not touch(padded, 1, 2)
    assert is_whole(padded, 1)
