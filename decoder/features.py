"""What the learned encoder sees of a voxel design: poses and smoothed lattices of its parts, measured in the voxels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import Joint, Material, VoxelDesign
from decoder.parts import (
    ATTACH,
    DIRECTION,
    DISTANCE,
    MAX_PARTS,
    MIDDLE,
    NODES,
    POSE,
    RANGE,
    REACH,
    SMOOTHING,
    SPREAD,
    TENSOR,
    box_of,
    frames_along,
    lattice_points,
    order_key,
    tensor_of,
    torso_frame,
)

_BLUR = 0.7  # standard deviation of the smoothing [voxels]; sampling and voxels themselves smooth a little more
_PAD = 4  # voxels around a part that the smoothing reaches


@dataclass(frozen=True, eq=False)
class Features:
    """One design as the encoder sees it.

    Attributes:
        alive: which places of the eight hold a part, (8,).
        lattices: smoothed bone and body of each of the p parts, less 0.2, (p, 4608).
        pose: existence, carrier, pose and centre of each part, (8, 30).
        segments: ids of the design's segments in this order.
    """

    alive: NDArray[np.bool_]
    lattices: NDArray[np.float32]
    pose: NDArray[np.float32]
    segments: tuple[int, ...]


def features(design: VoxelDesign) -> Features:
    """Measure a design.

    The torso is the segment that no joint carries, the largest if there are several; only the tree that it carries is
    seen, and of that the eight parts nearest to it.
    """
    centre, covariance, size = _moments(design)
    order, carrier, joints = _tree(design, centre, size)
    owner = _owners(design)
    lattices = np.zeros((len(order), 2 * NODES), np.float32)
    pose = np.zeros((MAX_PARTS, 1 + MAX_PARTS + POSE + 3), np.float32)
    frames: list[NDArray[np.float64]] = []
    boxes: list[NDArray[np.float64]] = []
    middles: list[NDArray[np.float64]] = []
    for k, segment in enumerate(order):
        row = pose[k, 1 + MAX_PARTS : 1 + MAX_PARTS + POSE]
        c = centre[segment]
        frame = torso_frame().astype(np.float64)
        if k:
            joint = joints[segment]
            hinge = joint.position / design.pitch
            distance = max(float(np.linalg.norm(c - hinge)), 1.0)
            direction = (c - hinge) / distance
            frame = frames_along(direction, np)
            row[ATTACH] = frames[carrier[k]].T @ (hinge - middles[carrier[k]]) / boxes[carrier[k]]
            row[DIRECTION] = direction
            row[DISTANCE] = np.log(distance / 8.0)
            row[TENSOR] = tensor_of(frame.T @ joint.axis, np)
            row[RANGE] = joint.range
        else:
            row[ATTACH] = (c - MIDDLE) / REACH
        spread = np.sqrt(np.maximum(np.einsum("ia,ij,ja->a", frame, covariance[segment], frame) + SMOOTHING, 0.25))
        row[SPREAD] = np.log(spread / 3.0)
        box = box_of(spread)
        lattices[k] = _sampled(design, owner, segment, c, frame, box) - 0.2
        pose[k, 0] = 1.0
        pose[k, 1 + carrier[k]] = 1.0
        pose[k, -3:] = (c - MIDDLE) / REACH
        frames.append(frame)
        boxes.append(box)
        middles.append(c)
    return Features(np.arange(MAX_PARTS) < len(order), lattices, pose, tuple(order))


def _moments(
    design: VoxelDesign,
) -> tuple[dict[int, NDArray[np.float64]], dict[int, NDArray[np.float64]], dict[int, int]]:
    """Centre [voxels], covariance and number of the rigid voxels of every segment."""
    where = np.argwhere(design.material == Material.RIGID)
    label = design.segment[design.material == Material.RIGID]
    centre, covariance, size = {}, {}, {}
    for segment in design.segments:
        points = where[label == segment] + 0.5
        centre[segment] = points.mean(0)
        away = points - centre[segment]
        covariance[segment] = away.T @ away / len(points)
        size[segment] = len(points)
    return centre, covariance, size


def _tree(
    design: VoxelDesign, centre: Mapping[int, NDArray[np.float64]], size: Mapping[int, int]
) -> tuple[list[int], list[int], dict[int, Joint]]:
    """Segments in canonical order, the place of each one's carrier, and the joint towards it."""
    carried = {joint.child for joint in design.joints}
    torso = max((s for s in design.segments if s not in carried), key=lambda s: size[s], default=design.segments[0])
    depth, before, joints = {torso: 0}, {torso: torso}, {}
    ring = [torso]
    while ring:
        following = []
        for segment in ring:
            for joint in design.joints:
                for near, far in ((joint.parent, joint.child), (joint.child, joint.parent)):
                    if near == segment and far not in depth:
                        depth[far], before[far], joints[far] = depth[segment] + 1, segment, joint
                        following.append(far)
        ring = following
    keys = {s: float(order_key(float(depth[s]), centre[s], centre[torso], np)) for s in depth}
    keys[torso] = -1.0
    order = sorted(depth, key=lambda s: (keys[s], s))[:MAX_PARTS]
    return order, [order.index(before[s]) for s in order], joints


def _owners(design: VoxelDesign) -> NDArray[np.int16]:
    """Segment of every voxel that is not empty; soft ones without one belong to the nearest bone."""
    lost = (design.material == Material.SOFT) & (design.segment == 0)
    if not lost.any():
        return design.segment
    nearest = ndimage.distance_transform_edt(
        design.material != Material.RIGID, return_distances=False, return_indices=True
    )
    return np.where(lost, design.segment[tuple(nearest)], design.segment)


def _sampled(
    design: VoxelDesign, owner: NDArray[np.int16], segment: int, centre: NDArray[np.float64],
    frame: NDArray[np.float64], box: NDArray[np.float64],
) -> NDArray[np.float32]:  # fmt: skip
    """Smoothed bone and body of one segment at the nodes of its lattice, (4608,)."""
    points = centre + (lattice_points() * box) @ frame.T
    low = np.clip(np.floor(points.min(0)).astype(int) - _PAD, 0, len(owner) - 1)
    high = np.clip(np.ceil(points.max(0)).astype(int) + _PAD, low + 1, len(owner))
    window = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    mine = owner[window] == segment
    at = (points - 0.5 - low).T
    layers = (mine & (design.material[window] == Material.RIGID), mine & (design.material[window] != Material.EMPTY))
    return np.concatenate([
        ndimage.map_coordinates(ndimage.gaussian_filter(layer.astype(np.float32), _BLUR, mode="constant"), at, order=1)
        for layer in layers
    ]).astype(np.float32)  # fmt: skip
