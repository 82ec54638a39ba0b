"""What a design's joints link: the tree, its shape without names, and whether the bones carry it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from decoder.design import Material, VoxelDesign

EVERY_NEIGHBOUR = np.ones((3, 3, 3), bool)
REACH = 2.0  # linked segments have rigid voxels whose centres are at most this far apart [voxels]
WHOLE = 0.95  # least share of a segment's rigid voxels in its largest piece
LEAST_JOINTS = 2
Link = tuple[int, int]


def is_one_tree(design: VoxelDesign, least_joints: int = LEAST_JOINTS) -> bool:
    """Whether the design is one connected tree with at least that many joints.

    Four things hold together: there are enough joints; they link all rigid segments into a single tree; the rigid
    voxels of every linked pair come within `REACH` voxels of each other; and of every segment's rigid voxels at least
    the share `WHOLE` forms one piece, where voxels that share a corner count as joined.
    """
    return (
        len(design.joints) >= least_joints
        and is_linked(design)
        and all(is_whole(design, segment) for segment in design.segments)
        and all(touch(design, joint.parent, joint.child) for joint in design.joints)
    )


def is_linked(design: VoxelDesign) -> bool:
    """Whether the joints link all rigid segments. A design never has a loop, so counting is enough."""
    return len(design.joints) == len(design.segments) - 1


def is_whole(design: VoxelDesign, segment: int) -> bool:
    """Whether a segment's rigid voxels form one piece, but for crumbs."""
    bone = _cropped(_bone(design, segment))
    pieces, count = ndimage.label(bone, EVERY_NEIGHBOUR)
    return count == 1 or bool(np.bincount(pieces.ravel())[1:].max() >= WHOLE * np.count_nonzero(bone))


def touch(design: VoxelDesign, a: int, b: int) -> bool:
    """Whether rigid voxels of two segments have centres at most `REACH` voxels apart."""
    first, second = (np.argwhere(_bone(design, segment)) for segment in (a, b))
    # Only what lies near the other one's box can touch it.
    near = first[((first >= second.min(0) - REACH) & (first <= second.max(0) + REACH)).all(axis=1)]
    if not len(near):
        return False
    distance, _ = cKDTree(second).query(near, distance_upper_bound=REACH + 1e-9)
    return bool(np.isfinite(distance).any())


def tree_shape(design: VoxelDesign) -> str | None:
    """The shape of the design's tree of segments, or None where the joints do not link all segments."""
    if not is_linked(design):
        return None
    return free_tree_shape(design.segments, [(joint.parent, joint.child) for joint in design.joints])


def free_tree_shape(nodes: Sequence[int], links: Iterable[Link]) -> str:
    """Canonical form of a free tree: two trees have the same one exactly if they are equal but for names.

    The tree is hung up by its centre and written from there as nested brackets, children in order (Aho, Hopcroft,
    Ullman); where it has two centres, the smaller of the two writings counts. Nodes and links must form one tree.
    """
    neighbours: dict[int, set[int]] = {node: set() for node in nodes}
    for a, b in links:
        neighbours[a].add(b)
        neighbours[b].add(a)
    return min(_written(centre, None, neighbours) for centre in _centres(neighbours))


def _centres(neighbours: dict[int, set[int]]) -> set[int]:
    """The one or two nodes that are left when leaves are plucked layer by layer."""
    left = {node: set(others) for node, others in neighbours.items()}
    while len(left) > 2:
        leaves = [node for node, others in left.items() if len(others) == 1]
        for leaf in leaves:
            left[left[leaf].pop()].discard(leaf)
            del left[leaf]
    return set(left)


def _written(node: int, above: int | None, neighbours: dict[int, set[int]]) -> str:
    return "(" + "".join(sorted(_written(n, node, neighbours) for n in neighbours[node] if n != above)) + ")"


def _bone(design: VoxelDesign, segment: int) -> NDArray[np.bool_]:
    return (design.segment == segment) & (design.material == Material.RIGID)


def _cropped(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return mask[ndimage.find_objects(mask.astype(np.uint8))[0]]
