"""Solver: rigid voxels to one depth field per bone, kept apart, with the motor's cylinder cut at every joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import Material
from mfg.blueprint import Blueprint, Body
from mfg.fields import OUTSIDE, Field, Window, cylinder_depth, cylindrical
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage

PAD = 3  # voxels around a segment in its field


@dataclass(frozen=True)
class BoneSolver:
    """Turn the voxels of each segment into a smooth depth field (paper: rigid-bone processor).

    Attributes:
        smoothing: width of the Gaussian that rounds voxel steps [voxels].
        gap: room left between neighbouring bones [m].
        cut_half_length: half length of the cylinder cut along each joint axis [m].
        max_loss: largest share of a bone that the cut may leave floating; more means the bone is severed.
    """

    smoothing: float = 0.8
    gap: float = 2.0e-3
    cut_half_length: float = 0.080
    max_loss: float = 0.15

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `bodies` (bones only), or a skeleton failure."""
        design = blueprint.design
        if blueprint.tree is None:
            raise ValueError("the bone solver needs the tree of the skeleton solver")
        labels = np.where(design.material == Material.RIGID, design.segment, 0)
        whole = [smooth_field(labels == s, design.pitch, self.smoothing) for s in blueprint.tree.segments]
        apart = [
            separated(field, [other for j, other in enumerate(whole) if j != i], self.gap)
            for i, field in enumerate(whole)
        ]
        radius = mount_of(blueprint.catalogue.motor).attach_radius
        for hinge in blueprint.hinges:
            for body in (hinge.parent, hinge.body):
                apart[body] = cut_cylinder(apart[body], hinge.position, hinge.axis, radius, self.cut_half_length)
        bodies = []
        for index, (segment, field) in enumerate(zip(blueprint.tree.segments, apart, strict=True)):
            kept, lost = largest_piece(field)
            if lost > self.max_loss:
                return Failure(
                    Stage.SKELETON,
                    Reason.BONE_SEVERED,
                    f"the motor cylinders cut {100 * lost:.0f} % off segment {segment}, at most "
                    f"{100 * self.max_loss:.0f} % may go",
                )
            bodies.append(Body(f"body_{index}", segment, kept))
        return replace(blueprint, bodies=tuple(bodies))


def smooth_field(occupied: NDArray[np.bool_], pitch: float, smoothing: float) -> Field:
    """Smooth signed depth of a voxel set on the half-voxel lattice, keeping its volume.

    The Euclidean depth at voxel centres is smoothed, interpolated to half the pitch (cubic), and shifted so that the
    region phi > 0 has the volume of the voxels.

    Args:
        occupied: (64, 64, 64); at least one voxel, none within `PAD` voxels of the array border is required: the
            crop is padded.
        pitch: edge of a voxel [m].
        smoothing: Gaussian width [voxels].
    """
    low, window = bounding_window(occupied)
    crop = np.pad(occupied[window], PAD)
    depth = ndimage.distance_transform_edt(crop) - ndimage.distance_transform_edt(~crop)
    depth = (depth - np.where(crop, 0.5, -0.5)).astype(np.float32)
    rounded = ndimage.gaussian_filter(depth, smoothing, mode="nearest", truncate=3.0)
    # Only the surface needs rounding; deep inside, smoothing would flatten the ridge where clearance is measured.
    depth += np.clip((3.0 - np.abs(depth)) / 1.5, 0.0, 1.0) * (rounded - depth)
    for axis in range(3):
        depth = _halved(depth, axis)
    target = int(crop.sum()) * 8  # Samples per voxel on the fine lattice.
    level = float(np.partition(depth.ravel(), -target)[-target]) if target < depth.size else 0.0
    depth = (depth - np.clip(level, -0.5, 0.5)) * np.float32(pitch)
    # Centre of voxel i is lattice index 2 i + 1; refining keeps the first sample.
    corner = tuple(int(v) for v in 2 * (low - PAD) + 1)
    return Field(np.ascontiguousarray(depth, np.float32), corner, pitch / 2)  # type: ignore[arg-type]


def bounding_window(occupied: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Window]:
    """Lowest corner and slices of the box around the true voxels of a grid; at least one must be true."""
    spans = [np.flatnonzero(occupied.any(axis=tuple(b for b in range(3) if b != a))) for a in range(3)]
    x, y, z = (slice(int(s[0]), int(s[-1]) + 1) for s in spans)
    return np.array([x.start, y.start, z.start]), (x, y, z)


def separated(field: Field, others: list[Field], gap: float) -> Field:
    """Withdraw a body from the surface half-way to each of its neighbours, leaving `gap` between them [m]."""
    values = field.values
    for other in others:
        theirs = other.on_lattice_of(field)
        if (theirs > OUTSIDE).any():
            values = np.minimum(values, 0.5 * (field.values - theirs - np.float32(gap)))
    return field.with_values(values)


def cut_cylinder(
    field: Field, centre: NDArray[np.float64], axis: NDArray[np.float64], radius: float, half_length: float
) -> Field:
    """Subtract a cylinder about a joint axis from a field."""
    window = field.window(centre, float(np.hypot(radius, half_length)) + 2 * field.spacing)
    if window is None:
        return field
    depth = cylinder_depth(*cylindrical(field.axes(window), centre, axis), radius, -half_length, half_length)
    values = field.values.copy()
    values[window] = np.minimum(values[window], -depth)
    return field.with_values(values)


def largest_piece(field: Field) -> tuple[Field, float]:
    """Keep the largest connected piece of phi > 0; also return the share of the volume that was dropped."""
    pieces, count = ndimage.label(field.values > 0)
    if count <= 1:
        return field, 0.0 if count else 1.0
    sizes = np.bincount(pieces.ravel())[1:]
    main = int(np.argmax(sizes)) + 1
    dropped = (pieces > 0) & (pieces != main)
    # Also push down the samples just outside a dropped piece's surface, so that no sliver of it is meshed.
    values = np.where(dropped, np.minimum(field.values, -field.spacing), field.values)
    return field.with_values(values), float(1 - sizes[main - 1] / sizes.sum())


def _halved(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Insert a sample half-way between neighbours along one axis (cubic Lagrange weights -1, 9, 9, -1 over 16)."""
    v = np.moveaxis(values, axis, 0)
    out = np.zeros((2 * len(v) - 1, *v.shape[1:]), np.float32)
    out[::2] = v
    e = np.concatenate([v[:1], v, v[-1:]])
    out[1::2] = (9.0 * (e[1:-2] + e[2:-1]) - e[:-3] - e[3:]) / 16.0
    return np.moveaxis(out, 0, axis)
