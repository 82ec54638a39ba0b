"""Solver: soft voxels to one outer surface per body, cleared around the joints and kept apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import GRID, Material, VoxelDesign
from mfg.along_axes import refined
from mfg.blueprint import Blueprint, Body
from mfg.bones import cut_cylinder
from mfg.fields import Field
from mfg.mounts import mount_of
from mfg.outcome import Failure
from mfg.voxel_distances import distances
from mfg.voxel_fields import (
    at_centres,
    between_centres,
    bounding_window,
    halved,
    opened_min,
    smooth_field,
    whole_field,
)

SLACK = 1.0  # how far an opened field may err inwards: distances are taken between voxel centres [voxels]


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
        fine: as in the bone processor.
    """

    joint_clearance: float = 0.065
    opening: float = 1.5
    smoothing: float = 0.8
    gap: float = 2.0e-3
    cut_half_length: float = 0.080
    fine: bool = True

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `skin` set on every body that has soft tissue."""
        design = blueprint.design
        owner = soft_owner(design)
        bones = blueprint.bodies
        if not self.fine:
            bones = tuple(replace(body, bone=at_centres(body.bone)) for body in bones)
        if design.depth is None:
            owner[self._near_joint(design)] = 0
            outer = [self._from_labels(design, owner == body.segment, body) for body in bones]
        else:
            outer = [self._from_depth(design, owner == body.segment, body) for body in bones]
        radius = mount_of(blueprint.catalogue.motor).attach_radius
        opening = 0.0 if design.depth is None else self._ball * design.pitch
        bodies = []
        for index, (body, whole) in enumerate(zip(blueprint.bodies, outer, strict=True)):
            if whole is None:
                bodies.append(body)
                continue
            field = _apart(whole, bones[index], index, bones, outer, self.gap)
            if not self.fine:
                field = halved(field)
            for hinge in blueprint.hinges:
                if index in (hinge.parent, hinge.body):
                    field = cut_cylinder(
                        field, hinge.position, hinge.axis, radius, self.cut_half_length, opening, not self.fine
                    )
            if opening > 0 or not self.fine:  # It may have taken thin bone along.
                field = field.with_values(np.maximum(field.values, body.bone.on_lattice_of(field)))
            bodies.append(replace(body, skin=field))
        return replace(blueprint, bodies=tuple(bodies))

    @property
    def _ball(self) -> float:
        """Radius of a ball that reaches as far as `opening` does between voxel centres [voxels]."""
        return max(0.0, self.opening - 0.5)

    @property
    def _stride(self) -> int:
        """Samples to a voxel."""
        return 2 if self.fine else 1

    def _from_labels(self, design: VoxelDesign, soft: NDArray[np.bool_], body: Body) -> Field | None:
        """Surface of a body with soft voxels clear of joints, or None where no soft tissue is left."""
        kept = self._opened(soft, (design.segment == body.segment) & rigid(design))
        if kept is None:
            return None
        smooth = smooth_field(kept, design.pitch, self.smoothing, self.fine)
        return smooth.with_values(np.maximum(smooth.values, body.bone.on_lattice_of(smooth)))

    def _from_depth(self, design: VoxelDesign, soft: NDArray[np.bool_], body: Body) -> Field | None:
        """The same from the design's own depth and all soft voxels: cleared and opened as a field."""
        if not soft.any():
            return None
        cleared = whole = whole_field(design, body.segment, soft, self.smoothing, self._ball, self.fine)
        for joint in design.joints:
            cleared = _cleared(cleared, joint.position, self.joint_clearance, self._ball * design.pitch, self._stride)
        bone = body.bone.on_lattice_of(whole)
        values = np.maximum(cleared.values, bone)
        opened = _opened_field(values, self._ball * design.pitch, design.pitch, self._stride)
        if opened is None:
            return None
        field = whole.with_values(np.maximum(opened, bone))
        low, window = bounding_window(soft)
        # The first sample is a voxel's centre, and the field holds every soft voxel.
        first = [round(v) for v in (low + 0.5) * design.pitch / field.spacing - np.asarray(field.corner)]
        here = tuple(slice(f, None, self._stride) for f in first)
        n, m, k = soft[window].shape
        return field if (field.values[here][:n, :m, :k][soft[window]] > 0).any() else None

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
        core = distances(crop) > self.opening
        opened = distances(~core) <= self.opening if core.any() else core
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
        around = bounding_window(design.material != Material.EMPTY)[1]
        bare, orphan = ~rigid(design)[around], orphan[around]
        nearest = ndimage.distance_transform_edt(bare, return_distances=False, return_indices=True)
        owner[around][orphan] = design.segment[around][tuple(n[orphan] for n in nearest)]
    return owner


def _opened_field(values: NDArray[np.float32], radius: float, pitch: float, stride: int) -> NDArray[np.float32] | None:
    """Depth less what lies far from all places where a ball fits, or None where none fits anywhere."""
    coarse = values[::stride, ::stride, ::stride]  # at voxel centres
    core = coarse > radius
    if not core.any():
        return None
    distance, nearest = ndimage.distance_transform_edt(~core, return_indices=True)
    # The core begins before its nearest sample does, by as much as that sample is deeper than the radius.
    beyond = np.float32(pitch) * distance.astype(np.float32) - (coarse[tuple(nearest)] - np.float32(radius))
    room = np.float32(radius + SLACK * pitch) - np.where(core, np.float32(0), beyond)
    if stride > 1:
        room = refined(room)
    return np.minimum(values, np.where(values > radius, values, room))


def _cleared(field: Field, centre: NDArray[np.float64], clearance: float, radius: float, stride: int) -> Field:
    """Subtract a ball about a joint from a field; what is left is opened along the rim by a ball of `radius` [m]."""
    window = field.window(centre, clearance + 2 * radius)
    if window is None:
        return field
    if stride > 1:
        window = between_centres(window)
    elif not (field.values[window] > 0).any():  # at voxel centres, only the surface counts
        return field
    u, v, w = (np.square(axis - np.float32(c)) for axis, c in zip(field.axes(window), centre, strict=True))
    values = field.values.copy()
    values[window] = opened_min(values[window], np.sqrt(u + v + w) - np.float32(clearance), radius, stride)
    return field.with_values(values)


def _apart(
    field: Field, body: Body, index: int, bodies: tuple[Body, ...], outer: list[Field | None], gap: float
) -> Field:
    """Withdraw an outer surface from its neighbours' without ever leaving its own bone bare of itself."""
    values = field.values.copy()
    for other_index, other in enumerate(bodies):
        if other_index == index:
            continue
        shared = other.bone.shared(field)
        if shared is not None:
            theirs, ours = shared
            values[ours] = np.minimum(values[ours], -other.bone.values[theirs] - np.float32(gap))
        skin = outer[other_index]
        shared = None if skin is None else skin.shared(field)
        if skin is not None and shared is not None:
            theirs, ours = shared
            half_way = 0.5 * (field.values[ours] - skin.values[theirs] - np.float32(gap))
            values[ours] = np.minimum(values[ours], half_way)
    return field.with_values(np.maximum(values, body.bone.on_lattice_of(field)))
