"""Solver: soft voxels to one outer surface per body, cleared around the joints and kept apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import GRID, Material, VoxelDesign
from mfg.blueprint import Blueprint, Body
from mfg.bones import cut_cylinder
from mfg.fields import OUTSIDE, Field
from mfg.mounts import mount_of
from mfg.outcome import Failure
from mfg.voxel_fields import bounding_window, smooth_field, whole_field


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
        if design.depth is None:
            owner[self._near_joint(design)] = 0
            outer = [self._from_labels(design, owner == body.segment, body) for body in blueprint.bodies]
        else:
            outer = [self._from_depth(design, owner == body.segment, body) for body in blueprint.bodies]
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

    def _from_labels(self, design: VoxelDesign, soft: NDArray[np.bool_], body: Body) -> Field | None:
        """Surface of a body with soft voxels clear of joints, or None where no soft tissue is left."""
        kept = self._opened(soft, (design.segment == body.segment) & rigid(design))
        if kept is None:
            return None
        smooth = smooth_field(kept, design.pitch, self.smoothing)
        return smooth.with_values(np.maximum(smooth.values, body.bone.on_lattice_of(smooth)))

    def _from_depth(self, design: VoxelDesign, soft: NDArray[np.bool_], body: Body) -> Field | None:
        """The same from the design's own depth and all soft voxels: cleared and opened as a field."""
        if not soft.any():
            return None
        whole = whole_field(design, body.segment, soft, self.smoothing)
        values, bone = whole.values, body.bone.on_lattice_of(whole)
        for joint in design.joints:
            x, y, z = (np.square(a - np.float32(c)) for a, c in zip(whole.axes(), joint.position, strict=True))
            values = np.minimum(values, np.sqrt(x + y + z) - np.float32(self.joint_clearance))
        values = np.maximum(values, bone)
        radius = self.opening * design.pitch
        core = values > radius
        if not core.any():
            return None
        # Opening by a ball; the slack of a lattice diagonal spares every surface that the ball touches from inside.
        reach = np.float32(radius + np.sqrt(3.0) * whole.spacing)
        values = np.minimum(values, reach - np.float32(whole.spacing) * ndimage.distance_transform_edt(~core))
        opened = whole.with_values(np.maximum(values, bone))
        centres = (np.argwhere(soft).astype(np.float64) + 0.5) * design.pitch
        return opened if (opened.sample(centres) > 0).any() else None

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
