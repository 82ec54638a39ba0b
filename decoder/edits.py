"""Small changes to a body: more bone at a place, a larger body, a cleft, fewer crumbs; a design in, a design out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import DEPTH_LIMIT, DEPTH_UNIT, GRID, Material, VoxelDesign

APART = 2.0  # what grows keeps this far from the bones of other segments [voxels between centres]
FADE = 2.0  # growth in a ball ends within this of its edge [voxels]


def scaled(design: VoxelDesign, factor: float) -> VoxelDesign:
    """The same voxels with another pitch: every length times `factor`, above 0."""
    if not factor > 0.0:
        raise ValueError(f"a body cannot be scaled by {factor:g}; the factor must be above 0")
    joints = tuple(replace(joint, position=joint.position * factor) for joint in design.joints)
    return VoxelDesign(design.material, design.segment, design.pitch * factor, joints, design.depth)


def grown(
    design: VoxelDesign, segment: int, voxels: float, centre: NDArray[np.float64] | None = None, radius: float = np.inf
) -> VoxelDesign:
    """One segment thicker by `voxels` on every side, its soft tissue moved outwards with it.

    Nothing grows nearer to another segment's bone than APART, nearer to it than to its own bone, or out of the grid.

    Args:
        design: the body.
        segment: id of the segment.
        voxels: how far its surface moves out [voxels].
        centre: of a ball within which it grows [m], (3,); None for everywhere.
        radius: of that ball [m].

    Raises:
        ValueError: if there is no such segment.
    """
    if segment not in design.segments:
        raise ValueError(f"there is no segment {segment} to grow; the design has {list(design.segments)}")
    rigid = design.material == Material.RIGID
    own = rigid & (design.segment == segment)
    to_own = np.asarray(ndimage.distance_transform_edt(~own))
    others = rigid & ~own
    to_others = np.asarray(ndimage.distance_transform_edt(~others)) if others.any() else np.full(own.shape, np.inf)
    amount = np.where((to_others >= APART) & (to_others > to_own), voxels, 0.0) * _inner()
    if centre is not None:
        away = np.sqrt(sum((axis - c) ** 2 for axis, c in zip(_centres(), centre / design.pitch, strict=True)))
        amount = amount * np.clip((radius / design.pitch - away) / FADE, 0.0, 1.0)
    if design.depth is None:
        return _grown_voxels(design, segment, own, to_own, amount)
    bone, body = design.depth.astype(np.int16)
    more = np.rint(DEPTH_UNIT * amount).astype(np.int16)
    bone, body = (_stepped(field, more) for field in (bone, body))
    return _from_depth(design, segment, bone, np.maximum(bone, body))


def _grown_voxels(
    design: VoxelDesign, segment: int, own: NDArray[np.bool_], to_own: NDArray[np.float64], amount: NDArray[np.float64]
) -> VoxelDesign:
    material, label = design.material.copy(), design.segment.copy()
    bone = (to_own <= amount) & ~own & (material != Material.RIGID)
    soft_of_own = (material == Material.SOFT) & (amount > 0)
    if soft_of_own.any():
        skin = (np.asarray(ndimage.distance_transform_edt(~(own | soft_of_own))) <= amount) & (material == 0)
        material[skin], label[skin] = Material.SOFT, segment
    material[bone], label[bone] = Material.RIGID, segment
    return VoxelDesign(material, label, design.pitch, design.joints)


def _stepped(depth: NDArray[np.int16], more: NDArray[np.int16]) -> NDArray[np.int16]:
    """Depth moved outwards; never 0, which would be neither inside nor outside."""
    moved = depth + more
    moved = np.where((moved == 0) & (more != 0), 1, moved)
    return np.clip(moved, -DEPTH_LIMIT, DEPTH_LIMIT).astype(np.int16)


def _from_depth(design: VoxelDesign, segment: int, bone: NDArray[np.int16], body: NDArray[np.int16]) -> VoxelDesign:
    """The design of changed depths; what is new belongs to `segment`."""
    material = np.where(bone > 0, Material.RIGID, np.where(body > 0, Material.SOFT, Material.EMPTY)).astype(np.uint8)
    label = design.segment.copy()
    was = design.material
    label[(material == Material.RIGID) & (was != Material.RIGID)] = segment
    label[(material == Material.SOFT) & (was == Material.EMPTY)] = segment
    label[material == Material.EMPTY] = 0
    return VoxelDesign(material, label, design.pitch, design.joints, np.stack([bone, body]).astype(np.int8))


def without_crumbs(design: VoxelDesign) -> VoxelDesign:
    """Only the largest piece of each segment; smaller ones become soft tissue of the nearest bone."""
    return _softened(design, _crumbs(design))


def cleft(design: VoxelDesign, first: int, second: int) -> VoxelDesign:
    """Two segments that touch, parted: bone of either that lies within a voxel of the other becomes soft tissue."""
    rigid = design.material == Material.RIGID
    a, b = rigid & (design.segment == first), rigid & (design.segment == second)
    cube = np.ones((3, 3, 3), bool)
    near = (a & ndimage.binary_dilation(b, cube)) | (b & ndimage.binary_dilation(a, cube))
    return _softened(design, near)


def _crumbs(design: VoxelDesign) -> NDArray[np.bool_]:
    crumbs = np.zeros(design.material.shape, bool)
    rigid = design.material == Material.RIGID
    for segment in design.segments:
        pieces, count = ndimage.label(rigid & (design.segment == segment))
        if count > 1:
            main = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
            crumbs |= (pieces > 0) & (pieces != main)
    return crumbs


def _softened(design: VoxelDesign, where: NDArray[np.bool_]) -> VoxelDesign:
    material = np.where(where, Material.SOFT, design.material).astype(np.uint8)
    label = np.where(where, 0, design.segment).astype(np.int16)
    if design.depth is None:
        return VoxelDesign(material, label, design.pitch, design.joints)
    depth = design.depth.copy()
    depth[0][where] = np.minimum(depth[0][where], -DEPTH_UNIT // 2)
    return VoxelDesign(material, label, design.pitch, design.joints, depth)


def _inner() -> NDArray[np.float64]:
    """1 at voxels that may be filled, 0 at the border of the grid."""
    inner = np.zeros((GRID, GRID, GRID))
    inner[1:-1, 1:-1, 1:-1] = 1.0
    return inner


def _centres() -> list[NDArray[np.floating]]:
    middle = np.arange(GRID) + 0.5
    return [middle[:, None, None], middle[None, :, None], middle[None, None, :]]
