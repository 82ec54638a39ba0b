"""How much one design is like another: volumes, segments and joints, whatever the segments are called."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from decoder.design import Joint, Material, VoxelDesign

REACH = 2.0  # a joint is found if one lies within this distance of it [voxels]
_NEVER = 1e6  # cost of a pair of joints that are too far apart: more than all others together
Pairs = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """A design beside its copy. Where the m found joints are listed, they stand in the order of the design's joints.

    Attributes:
        body_iou: intersection over union of what is not empty.
        bone_iou: the same of what is rigid.
        segment_iou: mean IoU of the rigid segments, paired one to one so that their sum is greatest; a segment of
            either side that is left over counts 0.
        same_count: whether both have equally many segments.
        same_tree: whether, with segments so paired, the same pairs of segments are linked.
        joints: number of the design's joints.
        copied_joints: number of the copy's joints.
        distance: between the found joints, paired one to one, most pairs first, then least distance [voxels], (m,).
        axis_error: angle between their axes, whose sense does not count [rad], (m,), 0 to pi/2.
        range_error: mean error of the two ends of their ranges, seen along the same axis [rad], (m,).
    """

    body_iou: float
    bone_iou: float
    segment_iou: float
    same_count: bool
    same_tree: bool
    joints: int
    copied_joints: int
    distance: Floats
    axis_error: Floats
    range_error: Floats


@dataclass(frozen=True, eq=False, slots=True)
class Change:
    """What changes from one design to the next of a series.

    Attributes:
        body_iou: intersection over union of what is not empty.
        same_tree: whether the same pairs of segments are linked; if not, the next two are empty.
        axis: angle between the axes of each joint before and after, whose sense does not count [rad], (m,).
        position: distance that each joint moves [voxels], (m,).
    """

    body_iou: float
    same_tree: bool
    axis: Floats
    position: Floats


def compare(design: VoxelDesign, copy: VoxelDesign, reach: float = REACH) -> Comparison:
    """Compare a design with its copy; a joint within `reach` voxels counts as found."""
    overlap, sizes, copied_sizes = _overlaps(design, copy)
    iou = overlap / (sizes[:, None] + copied_sizes[None, :] - overlap)
    pairs = _paired_segments(iou)
    matched = _near(_positions(design), _positions(copy), reach)
    distance, axis, span = _differences(design, copy, matched, _named(design, copy, pairs))
    return Comparison(
        body_iou=_body_iou(design, copy),
        bone_iou=float(overlap.sum() / (sizes.sum() + copied_sizes.sum() - overlap.sum())),
        segment_iou=float(iou[tuple(pairs.T)].sum() / max(iou.shape)),
        same_count=iou.shape[0] == iou.shape[1],
        same_tree=_linked_alike(design, copy, pairs) is not None,
        joints=len(design.joints),
        copied_joints=len(copy.joints),
        distance=distance,
        axis_error=axis,
        range_error=span,
    )


def change(before: VoxelDesign, after: VoxelDesign) -> Change:
    """Compare neighbours of a series; a joint is the same if it links the same two segments."""
    overlap, sizes, later_sizes = _overlaps(before, after)
    pairs = _paired_segments(overlap / (sizes[:, None] + later_sizes[None, :] - overlap))
    alike = _linked_alike(before, after, pairs)
    same = np.zeros((0, 2), np.int64) if alike is None else alike
    position, axis, _ = _differences(before, after, same, _named(before, after, pairs))
    return Change(_body_iou(before, after), alike is not None, axis, position)


def angle_between(a: Floats, b: Floats) -> Floats:
    """Angle between lines along unit vectors (..., 3) [rad], 0 to pi/2; exact where they are equal."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.abs((a * b).sum(axis=-1)))


def _body_iou(a: VoxelDesign, b: VoxelDesign) -> float:
    first, second = a.material > 0, b.material > 0
    return float(np.count_nonzero(first & second) / np.count_nonzero(first | second))


def _overlaps(a: VoxelDesign, b: VoxelDesign) -> tuple[Floats, Floats, Floats]:
    """Rigid voxels that segment i of a and segment j of b share (na, nb), and their sizes (na,) and (nb,)."""
    rows, columns = _numbered(a), _numbered(b)
    shape = (len(a.segments) + 1, len(b.segments) + 1)
    table = np.bincount(rows * shape[1] + columns, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
    return table[1:, 1:], table.sum(axis=1)[1:], table.sum(axis=0)[1:]


def _numbered(design: VoxelDesign) -> NDArray[np.int64]:
    """Number of the rigid segment that each voxel belongs to, counted from 1 in the order of `segments`; 0: none."""
    number = np.zeros(int(design.segment.max()) + 1, np.int64)
    number[list(design.segments)] = np.arange(1, len(design.segments) + 1)
    return np.where(design.material == Material.RIGID, number[design.segment], 0).ravel()


def _paired_segments(iou: Floats) -> Pairs:
    """Rows and columns (k, 2) of the one-to-one pairing whose IoU adds up to the most; only pairs that overlap."""
    rows, columns = linear_sum_assignment(iou, maximize=True)
    pairs = np.stack([rows, columns], axis=1).astype(np.int64)
    return pairs[iou[rows, columns] > 0]


def _near(a: Floats, b: Floats, reach: float) -> Pairs:
    """One-to-one pairs (k, 2) of points at most `reach` apart: as many as possible, then as near as possible."""
    distance = np.linalg.norm(a[:, None, :] - b[None, :, :], axis=-1)
    rows, columns = linear_sum_assignment(np.where(distance <= reach, distance, _NEVER))
    pairs = np.stack([rows, columns], axis=1).astype(np.int64)
    return pairs[distance[rows, columns] <= reach]


def _named(a: VoxelDesign, b: VoxelDesign, pairs: Pairs) -> dict[int, int]:
    """The segment of b that stands for each paired segment of a, by id."""
    return {a.segments[i]: b.segments[j] for i, j in pairs.tolist()}


def _linked_alike(a: VoxelDesign, b: VoxelDesign, pairs: Pairs) -> Pairs | None:
    """Joints of a and b (k, 2) that link the same segments, or None unless all segments and all links agree."""
    if not len(pairs) == len(a.segments) == len(b.segments) or len(a.joints) != len(b.joints):
        return None
    name = _named(a, b, pairs)
    there = {frozenset((joint.parent, joint.child)): k for k, joint in enumerate(b.joints)}
    found = [there.get(frozenset((name[joint.parent], name[joint.child])), -1) for joint in a.joints]
    return None if -1 in found else np.array([*enumerate(found)], np.int64).reshape(-1, 2)


def _positions(design: VoxelDesign) -> Floats:
    """Positions of the joints [voxels], (n, 3)."""
    return np.array([joint.position for joint in design.joints], np.float64).reshape(-1, 3) / design.pitch


def _differences(a: VoxelDesign, b: VoxelDesign, joints: Pairs, name: dict[int, int]) -> tuple[Floats, Floats, Floats]:
    """Distance [voxels], angle between axes [rad] and error of the range [rad] of pairs of joints, (k,) each."""
    i, j = joints.T
    apart = np.linalg.norm(_positions(a)[i] - _positions(b)[j], axis=1)
    axes, others = (np.array([k.axis for k in d.joints], np.float64).reshape(-1, 3) for d in (a, b))
    spans = [_range_error(a.joints[p], b.joints[q], name) for p, q in joints.tolist()]
    return apart, angle_between(axes[i], others[j]), np.array(spans, np.float64)


def _range_error(joint: Joint, other: Joint, name: dict[int, int]) -> float:
    """Mean absolute error of both ends. A hinge turns backwards if its axis, or its parent and child, are swapped."""
    backwards = float(joint.axis @ other.axis) < 0
    if name.get(joint.parent) == other.child or name.get(joint.child) == other.parent:
        backwards = not backwards
    span = -other.range[::-1] if backwards else other.range
    return float(np.abs(span - joint.range).mean())
