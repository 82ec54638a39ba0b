"""Solver: rigid voxels to one depth field per bone, kept apart, with the motor's cylinder cut at every joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mfg.blueprint import Blueprint, Body
from mfg.fields import Field, cylinder_depth, cylindrical
from mfg.miss import Miss
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.voxel_fields import between_centres, bone_field, bounding_window, halved, opened_min


@dataclass(frozen=True)
class BoneSolver:
    """Turn the voxels of each segment into a smooth depth field (paper: rigid-bone processor).

    Attributes:
        smoothing: width of the Gaussian that rounds voxel steps [voxels].
        gap: room left between neighbouring bones [m].
        cut_half_length: half length of the cylinder cut along each joint axis [m].
        max_loss: largest share of a bone that the cut may leave floating; more means the bone is severed.
        fine: surfaces are rounded and kept apart at half the pitch, and depth is metric far inside, which hardware
            needs; else at voxel centres, and depth ends where the design's own does: enough to weigh and to touch.
    """

    smoothing: float = 0.8
    gap: float = 2.0e-3
    cut_half_length: float = 0.080
    max_loss: float = 0.15
    fine: bool = True

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `bodies` (bones only), or a skeleton failure."""
        design = blueprint.design
        if blueprint.tree is None:
            raise ValueError("the bone solver needs the tree of the skeleton solver")
        whole = [bone_field(design, segment, self.smoothing, self.fine) for segment in blueprint.tree.segments]
        apart = [
            separated(field, [other for j, other in enumerate(whole) if j != i], self.gap)
            for i, field in enumerate(whole)
        ]
        if not self.fine:
            apart = [halved(field) for field in apart]
        radius = mount_of(blueprint.catalogue.motor).attach_radius
        for hinge in blueprint.hinges:
            for body in (hinge.parent, hinge.body):
                apart[body] = cut_cylinder(
                    apart[body], hinge.position, hinge.axis, radius, self.cut_half_length, snug=not self.fine
                )
        bodies = []
        for index, (segment, field) in enumerate(zip(blueprint.tree.segments, apart, strict=True)):
            kept, lost = largest_piece(field)
            if lost > self.max_loss:
                return Failure(
                    Stage.SKELETON,
                    Reason.BONE_SEVERED,
                    f"the motor cylinders cut {100 * lost:.0f} % off segment {segment}, at most "
                    f"{100 * self.max_loss:.0f} % may go",
                    Miss("share of a bone that is kept", "1", 1 - lost, 1 - self.max_loss,
                         tuple(k for k, h in enumerate(blueprint.hinges) if index in (h.parent, h.body)), (index,)),
                )  # fmt: skip
            bodies.append(Body(f"body_{index}", segment, kept))
        return replace(blueprint, bodies=tuple(bodies))


def separated(field: Field, others: list[Field], gap: float) -> Field:
    """Withdraw a body from the surface half-way to each of its neighbours, leaving `gap` between them [m]."""
    values = field.values.copy()
    for other in others:
        shared = other.shared(field)
        if shared is not None:
            theirs, ours = shared
            half_way = 0.5 * (field.values[ours] - other.values[theirs] - np.float32(gap))
            values[ours] = np.minimum(values[ours], half_way)
    return field.with_values(values)


def cut_cylinder(
    field: Field, centre: NDArray[np.float64], axis: NDArray[np.float64], radius: float, half_length: float,
    opening: float = 0.0, snug: bool = False,
) -> Field:  # fmt: skip
    """Subtract a cylinder about a joint axis from a field, and open the rim by a ball of radius `opening` [m].

    Depth further than that from the cylinder is the distance to it, too, or with `snug` not touched.
    """
    reach = np.full(3, np.hypot(radius, half_length))
    if snug:
        reach = np.abs(axis) * half_length + np.sqrt(np.maximum(1.0 - np.square(axis), 0.0)) * radius
    window = field.window(centre, reach + 2 * max(opening, field.spacing))
    if window is None:
        return field
    if opening > 0:
        window = between_centres(window)
    depth = cylinder_depth(*cylindrical(field.axes(window), centre, axis), radius, -half_length, half_length)
    values = field.values.copy()
    values[window] = opened_min(values[window], -depth, opening)
    return field.with_values(values)


def largest_piece(field: Field) -> tuple[Field, float]:
    """Keep the largest connected piece of phi > 0; also return the share of the volume that was dropped."""
    inside = field.values > 0
    if not inside.any():
        return field, 1.0
    window = bounding_window(inside)[1]
    pieces, count = ndimage.label(inside[window])
    if count <= 1:
        return field, 0.0
    sizes = np.bincount(pieces.ravel())[1:]
    main = int(np.argmax(sizes)) + 1
    dropped = (pieces > 0) & (pieces != main)
    # Also push down the samples just outside a dropped piece's surface, so that no sliver of it is meshed.
    values = field.values.copy()
    values[window][dropped] = np.minimum(values[window][dropped], -field.spacing)
    return field.with_values(values), float(1 - sizes[main - 1] / sizes.sum())
