"""Solver: soft voxels to one outer surface per body, cleared around the joints and kept apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import GRID, Material, VoxelDesign
from mfg.blueprint import Blueprint, Body
from mfg.bones import bounding_window, cut_cylinder, smooth_field
from mfg.fields import OUTSIDE, Field
from mfg.mounts import mount_of
from mfg.outcome import Failure


@dataclass(frozen=True)
class SkinSolver:
    """Turn soft voxels into the outer surface of each body (paper: soft-skin processor).

    The skin itself is the outer surface minus the bone: a hollow shell, cut exactly when the parts are made.

    Attributes:
        joint_clearance: soft voxels nearer than this to a joint are removed [m].
        opening: radius of the erode-dilate that rounds what is left [voxels].
        smoothing: width of the Gaussian that rounds voxel steps [voxels].
        gap: room left between neighbouring skins [m].
        cut_half_length: half length of the motor cylinder, as in the bone processor [m].
    """

    joint_clearance: float = 0.065
    opening: float = 1.5
    smoothing: float = 0.8
    gap: float = 2.0e-3
    cut_half_length: float = 0.080

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `skin` set on every body that has soft tissue."""
        design = blueprint.design
        owner = soft_owner(design)
        owner[self._near_joint(design)] = 0
        outer: list[Field | None] = []
        for body in blueprint.bodies:
            soft = self._opened(owner == body.segment, (design.segment == body.segment) & rigid(design))
            if soft is None:
                outer.append(None)
                continue
            smooth = smooth_field(soft, design.pitch, self.smoothing)
            outer.append(smooth.with_values(np.maximum(smooth.values, body.bone.on_lattice_of(smooth))))
        radius = mount_of(blueprint.catalogue.motor).attach_radius
        bodies = []
        for index, (body, whole) in enumerate(zip(blueprint.bodies, outer, strict=True)):
            if whole is None:
                bodies.append(body)
                continue
            field = _apart(whole, body, index, blueprint.bodies, outer, self.gap)
            for hinge in blueprint.hinges:
                if index in (hinge.parent, hinge.body):
                    field = cut_cylinder(field, hinge.position, hinge.axis, radius, self.cut_half_length)
            bodies.append(replace(body, skin=field))
        return replace(blueprint, bodies=tuple(bodies))

    def _near_joint(self, design: VoxelDesign) -> NDArray[np.bool_]:
        near = np.zeros((GRID, GRID, GRID), bool)
        centres = (np.arange(GRID) + 0.5) * design.pitch
        for joint in design.joints:
            x, y, z = np.square(centres - joint.position[:, None])
            near |= x[:, None, None] + y[:, None] + z < self.joint_clearance**2
        return near

    def _opened(self, soft: NDArray[np.bool_], bone: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
        """Bone and soft tissue together after erode-dilate, or None where no soft tissue is left."""
        if not soft.any():
            return None
        both = soft | bone
        window = bounding_window(both)[1]
        crop = np.pad(both[window], 3)
        # Opening by a ball through two distance transforms: erode by r, then dilate by r.
        core = ndimage.distance_transform_edt(crop) > self.opening
        opened = ndimage.distance_transform_edt(~core) <= self.opening if core.any() else core
        kept = np.zeros_like(both)
        kept[window] = (opened & crop)[3:-3, 3:-3, 3:-3]
        kept |= bone
        return kept if (kept & soft).any() else None


def rigid(design: VoxelDesign) -> NDArray[np.bool_]:
    """Mask of the rigid voxels."""
    return design.material == Material.RIGID


def soft_owner(design: VoxelDesign) -> NDArray[np.int16]:
    """Segment that every soft voxel belongs to, 0 elsewhere: its own id, or the nearest bone where it has none."""
    soft = design.material == Material.SOFT
    owner = np.where(soft, design.segment, 0).astype(np.int16)
    orphan = soft & (design.segment == 0)
    if orphan.any():
        nearest = ndimage.distance_transform_edt(~rigid(design), return_distances=False, return_indices=True)
        owner[orphan] = design.segment[tuple(n[orphan] for n in nearest)]
    return owner


def _apart(
    field: Field, body: Body, index: int, bodies: tuple[Body, ...], outer: list[Field | None], gap: float
) -> Field:
    """Withdraw an outer surface from its neighbours' without ever leaving its own bone bare of itself."""
    values = field.values
    for other_index, other in enumerate(bodies):
        if other_index == index:
            continue
        bone = other.bone.on_lattice_of(field)
        values = np.minimum(values, -bone - np.float32(gap))
        skin = outer[other_index]
        if skin is not None:
            theirs = skin.on_lattice_of(field)
            if (theirs > OUTSIDE).any():
                values = np.minimum(values, 0.5 * (field.values - theirs - np.float32(gap)))
    return field.with_values(np.maximum(values, body.bone.on_lattice_of(field)))
