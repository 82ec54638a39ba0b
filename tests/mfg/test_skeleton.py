"""Skeleton: one tree or one typed reason, whatever the order in which joints were written down."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from bodies import ellipsoid, painted

from decoder.design import Joint, VoxelDesign
from mfg.blueprint import Blueprint
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.skeleton import SkeletonSolver, contacts

Y = np.array([0.0, 1.0, 0.0])
RANGE = np.array([-1.0, 0.5])


def chain(order: tuple[int, ...] = (0, 1), flip: bool = False) -> VoxelDesign:
    bones = [ellipsoid((x, 32, 32), (7, 6, 6)) for x in (18, 32, 46)]
    links = [(1, 2, 0.25), (2, 3, 0.39)]
    joints = [Joint((x, 0.32, 0.32), Y, RANGE, *((b, a) if flip else (a, b))) for a, b, x in links]
    return painted(bones, tuple(joints[i] for i in order))


def solve(design: VoxelDesign) -> Blueprint | Failure:
    return SkeletonSolver().solve(Blueprint(design, PAPER))


@pytest.mark.parametrize(("order", "flip"), list(itertools.product([(0, 1), (1, 0)], [False, True])))
def test_the_tree_does_not_depend_on_how_joints_are_written(order: tuple[int, ...], flip: bool) -> None:
    solved = solve(chain(order, flip))
    assert isinstance(solved, Blueprint)
    assert solved.tree is not None
    assert solved.tree.segments[0] == max((1, 2, 3), key=lambda s: int((solved.design.segment == s).sum()))
    for body in range(1, 3):
        assert solved.tree.parent[body] < body
    for hinge in solved.hinges:
        joint = solved.design.joints[solved.tree.joint[hinge.body]]
        written_parent = joint.parent == solved.tree.segments[hinge.parent]
        np.testing.assert_array_equal(hinge.axis, Y if written_parent else -Y)
        np.testing.assert_array_equal(hinge.range, RANGE)


def test_no_joint_is_a_reason() -> None:
    failure = solve(painted([ellipsoid((32, 32, 32), (10, 8, 8))], ()))
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.SKELETON, Reason.NO_JOINT)


def test_a_segment_without_a_way_to_the_root_is_disconnected() -> None:
    failure = solve(chain(order=(0,)))
    assert isinstance(failure, Failure)
    assert failure.reason in (Reason.DISCONNECTED, Reason.CYCLE)
    bones = [ellipsoid((x, 32, 32), (6, 6, 6)) for x in (14, 26, 50)]
    failure = solve(painted(bones, (Joint((0.20, 0.32, 0.32), Y, RANGE, 1, 2),)))
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.DISCONNECTED
    assert "[3]" in failure.detail


def test_touching_segments_without_a_joint_close_a_loop() -> None:
    bones = [ellipsoid((x, 32, 32), (8, 6, 6)) for x in (18, 32, 46)]
    joints = (Joint((0.25, 0.32, 0.32), Y, RANGE, 1, 2), Joint((0.25, 0.33, 0.32), Y, RANGE, 1, 3))
    failure = solve(painted(bones, joints))
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.CYCLE
    assert "segments 2 and 3" in failure.detail


def test_a_splinter_is_too_thin() -> None:
    bones = [ellipsoid((20, 32, 32), (8, 6, 6)), ellipsoid((40, 32, 32), (13, 1.6, 1.6))]
    failure = solve(painted(bones, (Joint((0.28, 0.32, 0.32), Y, RANGE, 1, 2),)))
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.TOO_THIN


def test_contacts_count_faces() -> None:
    labels = np.zeros((6, 6, 6), np.int16)
    labels[1:3, 1:4, 1:4], labels[3:5, 1:4, 1:4] = 1, 2
    labels[1, 4, 1] = 3
    assert contacts(labels) == {(1, 2): 9, (1, 3): 1}
