"""Comparing designs: perfect with itself, as computed by hand when shifted, blind to names and senses."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.comparison import angle_between, change, compare
from decoder.design import GRID, Joint, Material, VoxelDesign
from decoder.genome import GenomeDecoder
from decoder.latent import sample_latents

PITCH = 0.01
Y = np.array([0.0, 1.0, 0.0])


def chain(
    start: int = 10, *, lengths: tuple[int, ...] = (10, 10, 10), names: tuple[int, ...] = (1, 2, 3), skin: int = 0
) -> VoxelDesign:
    """Boxes of 10 x 10 voxels in a row along x, a hinge about y at every contact."""
    material = np.zeros((GRID,) * 3, np.uint8)
    segment = np.zeros((GRID,) * 3, np.int16)
    ends = np.cumsum((start, *lengths)).tolist()
    if skin:
        material[start - skin : ends[-1] + skin, 20 - skin : 30 + skin, 20 - skin : 30 + skin] = Material.SOFT
    for name, (low, high) in zip(names, pairwise(ends), strict=True):
        material[low:high, 20:30, 20:30], segment[low:high, 20:30, 20:30] = Material.RIGID, name
    joints = tuple(
        Joint(np.array([x, 25.0, 25.0]) * PITCH, Y, np.array([-0.5, 1.0]), a, b)
        for x, (a, b) in zip(ends[1:-1], pairwise(names), strict=True)
    )
    return VoxelDesign(material, segment, joints=joints)


def with_joints(design: VoxelDesign, **changes: object) -> VoxelDesign:
    joints = tuple(replace(joint, **changes) for joint in design.joints)  # type: ignore[arg-type]
    return VoxelDesign(design.material, design.segment, joints=joints)


def turned(angle: float) -> NDArray[np.float64]:
    return np.array([np.sin(angle), np.cos(angle), 0.0])


def test_a_design_is_its_own_perfect_copy() -> None:
    for design in GenomeDecoder().decode(sample_latents(6, np.random.default_rng(3))):
        same = compare(design, design)
        assert same.body_iou == same.bone_iou == same.segment_iou == 1.0
        assert same.same_count
        assert same.same_tree
        assert len(same.distance) == same.joints == same.copied_joints == len(design.joints)
        assert not same.distance.any()
        assert not same.axis_error.any()
        assert not same.range_error.any()


@pytest.mark.parametrize("shift", [1, 2, 4])
def test_a_shift_costs_what_it_moves_out(shift: int) -> None:
    moved = compare(chain(), chain(10 + shift))
    assert moved.body_iou == moved.bone_iou == pytest.approx((30 - shift) / (30 + shift))
    assert moved.segment_iou == pytest.approx((10 - shift) / (10 + shift))
    assert len(moved.distance) == (2 if shift <= 2 else 0)
    assert moved.distance == pytest.approx([shift] * len(moved.distance))
    assert moved.same_tree


def test_skin_counts_for_the_body_only() -> None:
    bare = compare(chain(skin=1), chain())
    assert bare.body_iou == pytest.approx(3000 / (32 * 12 * 12))
    assert bare.bone_iou == bare.segment_iou == 1.0


def test_names_of_segments_do_not_matter() -> None:
    renamed = compare(chain(), chain(names=(7, 1, 300)))
    assert renamed.segment_iou == 1.0
    assert renamed.same_tree
    assert not renamed.range_error.any()


def test_a_segment_too_many_or_too_few_counts_nothing() -> None:
    whole, cut = chain(lengths=(10, 20), names=(1, 2)), chain()
    for a, b in ((whole, cut), (cut, whole)):
        halved = compare(a, b)
        assert halved.body_iou == halved.bone_iou == 1.0
        assert halved.segment_iou == pytest.approx((1.0 + 0.5 + 0.0) / 3)
        assert not halved.same_count
        assert not halved.same_tree
    assert compare(whole, cut).copied_joints == compare(cut, whole).joints == 2
    assert len(compare(whole, cut).distance) == len(compare(cut, whole).distance) == 1


def test_segments_are_paired_for_the_greatest_sum() -> None:
    # The likeliest pair alone, a's second with b's first (6 of 14 voxels), would leave nothing for the other two.
    a, b = chain(lengths=(10, 10), names=(1, 2)), chain(16, lengths=(10, 4), names=(1, 2))
    assert compare(a, b).segment_iou == pytest.approx((4 / 16 + 4 / 10) / 2)


def test_a_joint_serves_one_joint_only() -> None:
    near = chain(lengths=(10, 1, 10))
    lone = chain(lengths=(10, 11), names=(1, 2))
    found = compare(near, lone)
    assert (found.joints, found.copied_joints, len(found.distance)) == (2, 1, 1)
    assert found.distance[0] == 0.0
    assert len(compare(lone, near).distance) == 1


def test_most_joints_are_found_before_the_nearest() -> None:
    # Joints at 20 and 21, found again at 21 and 22.5: nearest first would lose the one at 20 (22.5 is too far from it).
    a = chain(lengths=(10, 1, 10))
    first, second = a.joints
    b = VoxelDesign(a.material, a.segment, joints=(
        replace(first, position=np.array([0.21, 0.25, 0.25])), replace(second, position=np.array([0.225, 0.25, 0.25])),
    ))  # fmt: skip
    assert compare(a, b).distance == pytest.approx([1.0, 1.5])


@pytest.mark.parametrize("angle", [0.0, 0.1, 1.0, np.pi / 2])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_sense_of_an_axis_does_not_count(angle: float, sense: float) -> None:
    error = compare(chain(), with_joints(chain(), axis=sense * turned(angle))).axis_error
    assert error == pytest.approx([angle, angle])


def test_angles_are_exact_at_zero() -> None:
    rng = np.random.default_rng(0)
    axes = rng.standard_normal((100, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    assert angle_between(axes, -axes).max() < 1e-15
    assert angle_between(axes, axes[::-1]).max() <= np.pi / 2


def test_a_range_is_seen_along_the_same_axis_and_from_the_same_side() -> None:
    design = chain()
    flipped = np.array([-1.0, 0.5])
    assert compare(design, with_joints(design, axis=-Y, range=flipped)).range_error == pytest.approx([0, 0])
    assert compare(design, with_joints(design, axis=-Y)).range_error == pytest.approx([0.5, 0.5])
    swapped = VoxelDesign(design.material, design.segment, joints=tuple(
        replace(joint, parent=joint.child, child=joint.parent, range=flipped) for joint in design.joints
    ))  # fmt: skip
    assert compare(design, swapped).range_error == pytest.approx([0, 0])
    wider = with_joints(design, range=np.array([-0.7, 1.1]))
    assert compare(design, wider).range_error == pytest.approx([0.15, 0.15])


def test_another_tree_on_the_same_segments_is_noticed() -> None:
    design = chain()
    star = VoxelDesign(design.material, design.segment, joints=(
        replace(design.joints[0], parent=1, child=2), replace(design.joints[1], parent=1, child=3),
    ))  # fmt: skip
    assert compare(design, star).same_count
    assert not compare(design, star).same_tree
    assert not change(design, star).same_tree
    assert len(change(design, star).axis) == 0


def test_pitch_is_a_unit_and_not_a_size() -> None:
    fine = chain()
    joints = tuple(replace(joint, position=joint.position * 2) for joint in fine.joints)
    coarse = VoxelDesign(fine.material, fine.segment, 2 * PITCH, joints)
    assert compare(fine, coarse).distance == pytest.approx([0, 0])


def test_a_step_follows_joints_by_what_they_link() -> None:
    step = change(chain(), with_joints(chain(13, names=(3, 2, 1)), axis=-turned(0.2)))
    assert step.same_tree
    assert step.position == pytest.approx([3.0, 3.0])
    assert step.axis == pytest.approx([0.2, 0.2])
    assert step.body_iou == pytest.approx(27 / 33)


def test_designs_without_joints_compare() -> None:
    lone = chain(lengths=(10,), names=(1,))
    assert compare(lone, chain()).joints == 0
    assert len(compare(lone, chain()).distance) == len(compare(chain(), lone).distance) == 0
    assert change(lone, lone).same_tree


def test_bodies_apart_share_nothing() -> None:
    apart = compare(chain(5), chain(40, lengths=(5, 5, 5)))
    assert apart.body_iou == apart.bone_iou == apart.segment_iou == 0.0
    assert apart.same_count
    assert not apart.same_tree
