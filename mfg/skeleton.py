"""Solver: one kinematic tree of rigid segments, root first, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import Material, VoxelDesign
from mfg.blueprint import Blueprint, Hinge, Tree
from mfg.outcome import Failure, Reason, Stage
from mfg.voxel_fields import bounding_window


@dataclass(frozen=True)
class SkeletonSolver:
    """Check the kinematic tree and choose its root (the segment with most rigid voxels).

    Attributes:
        min_voxels: least rigid voxels of a segment; smaller ones are too thin to be a bone.
        min_depth: least half thickness of a segment at its thickest place [voxels].
        max_fragment: largest share of a segment that may float apart from its main piece.
        contact_faces: voxel faces that two segments must share to count as touching; touching segments without a
            joint would be printed as one piece and close a loop.
    """

    min_voxels: int = 60
    min_depth: float = 1.5
    max_fragment: float = 0.1
    contact_faces: int = 8

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `tree` and `hinges`, or a skeleton failure."""
        design = blueprint.design
        if not design.joints:
            return _fail(
                Reason.NO_JOINT,
                f"{len(design.segments)} segment(s) and no joint: nothing can move; a joint between "
                "two segments would mend it",
            )
        labels = np.where(design.material == Material.RIGID, design.segment, 0)
        labels = labels[bounding_window(labels > 0)[1]]
        thin = self._too_thin(labels, design.segments)
        if thin is not None:
            return thin
        linked = {frozenset((j.parent, j.child)) for j in design.joints}
        for (a, b), faces in sorted(contacts(labels).items()):
            if faces >= self.contact_faces and frozenset((a, b)) not in linked:
                return _fail(
                    Reason.CYCLE,
                    f"segments {a} and {b} touch over {faces} voxel faces without a joint; empty voxels "
                    "between them, or a joint, would mend it",
                )
        root = max(design.segments, key=lambda s: (int((labels == s).sum()), -s))
        tree = _grow(design, root)
        lost = sorted(set(design.segments) - set(tree.segments))
        if lost:
            return _fail(
                Reason.DISCONNECTED,
                f"segments {lost} hang on no joint that leads to the root {root}; joints to the rest, "
                "or leaving them out, would mend it",
            )
        return replace(blueprint, tree=tree, hinges=_hinges(design, tree))

    def _too_thin(self, labels: NDArray[np.integer], segments: tuple[int, ...]) -> Failure | None:
        boxes = ndimage.find_objects(labels)
        for segment in segments:
            crop = np.pad(labels[boxes[segment - 1]] == segment, 1)
            pieces, count = ndimage.label(crop)
            sizes = np.bincount(pieces.ravel())[1:]
            if sizes.max() < self.min_voxels:
                return _fail(
                    Reason.TOO_THIN,
                    f"segment {segment} has {sizes.max()} connected voxels, needs {self.min_voxels}; "
                    f"{self.min_voxels - sizes.max()} more voxels would mend it",
                )
            if count > 1 and 1 - sizes.max() / sizes.sum() > self.max_fragment:
                return _fail(
                    Reason.DISCONNECTED,
                    f"segment {segment} falls into {count} pieces of {sizes.tolist()} voxels; "
                    "bone between them, or keeping the largest alone, would mend it",
                )
            if self.min_depth <= 1.5 and _has_core(crop):
                continue
            depth = float(ndimage.distance_transform_edt(crop).max()) - 0.5
            if depth < self.min_depth:
                return _fail(
                    Reason.TOO_THIN,
                    f"segment {segment} is {depth:.1f} voxels deep at its thickest, needs {self.min_depth:g}; "
                    f"thickening it by {int(np.ceil(self.min_depth - depth))} voxel(s) all around would mend it",
                )
        return None


def _has_core(occupied: NDArray[np.bool_]) -> bool:
    """Whether some voxel has all 26 neighbours: then it lies 2 voxels from the nearest empty one, or more."""
    for axis in range(3):
        if occupied.shape[axis] < 3:
            return False
        low, middle, high = (occupied.take(range(k, occupied.shape[axis] - 2 + k), axis) for k in range(3))
        occupied = low & middle & high
    return bool(occupied.any())


def contacts(labels: NDArray[np.integer]) -> dict[tuple[int, int], int]:
    """Number of voxel faces that each pair of touching segments shares."""
    found: dict[tuple[int, int], int] = {}
    for axis in range(3):
        a = labels.take(range(labels.shape[axis] - 1), axis).ravel()
        b = labels.take(range(1, labels.shape[axis]), axis).ravel()
        touch = (a != b) & (a > 0) & (b > 0)
        pairs = np.sort(np.stack([a[touch], b[touch]], axis=1).astype(np.int64), axis=1)
        for (low, high), faces in zip(*np.unique(pairs, axis=0, return_counts=True), strict=True):
            key = (int(low), int(high))
            found[key] = found.get(key, 0) + int(faces)
    return found


def _grow(design: VoxelDesign, root: int) -> Tree:
    segments, parent, joint, flipped = [root], [-1], [-1], [False]
    for body, segment in enumerate(segments):  # The list grows while it is walked: breadth first.
        for index, j in enumerate(design.joints):
            if segment not in (j.parent, j.child):
                continue
            other = j.child if j.parent == segment else j.parent
            if other in segments:
                continue
            segments.append(other)
            parent.append(body)
            joint.append(index)
            flipped.append(j.parent != segment)
    return Tree(tuple(segments), tuple(parent), tuple(joint), tuple(flipped))


def _hinges(design: VoxelDesign, tree: Tree) -> tuple[Hinge, ...]:
    hinges = []
    for body in range(1, len(tree.segments)):
        j = design.joints[tree.joint[body]]
        # Seen from the other side, a turn by q about a is a turn by q about -a.
        axis = -j.axis if tree.flipped[body] else j.axis
        hinges.append(Hinge(body, tree.parent[body], j.position, axis, j.range))
    return tuple(hinges)


def _fail(reason: Reason, detail: str) -> Failure:
    return Failure(Stage.SKELETON, reason, detail)
