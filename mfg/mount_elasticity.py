"""The stress of one half of a motor mount in its bone by finite elements; `mfg.strength` estimates the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mfg.fields import Field, coverage, cylinder_depth
from mfg.mounts import BORE, WALL, Mount
from mfg.strength import BODY_SHARE, PIECE, POISSON, Half, Plastic, keepout, load_cases, safety_factor, span, superposed
from mfg.voxel_elasticity import VoxelModel, von_mises

Array = NDArray[np.float64]
FAR = 0.040  # beyond this distance from the mount, the bone is held [m]
SEEN = 0.30  # least filled share of an element
CRITICAL = 1.0e-7  # the stress of a mount is what this volume of plastic exceeds: a corner of 5 mm [m3]


@dataclass(frozen=True, eq=False, slots=True)
class MountStress:
    """What finite elements say about one half of a mount.

    Attributes:
        stress: von Mises stress of the plastic that `CRITICAL` exceeds [Pa]; infinite where nothing holds the mount.
        safety: strength over stress.
        elements: number of elements.
        twist: of the mount under the peak torque alone [rad].
    """

    stress: float
    safety: float
    elements: int
    twist: float


def mount_stress(
    bone: Field, T_design_motor: Array, mount: Mount, half: Half, plastic: Plastic, spacing: float = 4.0e-3
) -> MountStress:
    """Load one half of a mount by the peak torque and a couple across it, and hold its bone far away.

    The grid lies in the motor's frame. The mount is united with the bone, out of which the joint's cylinder and the
    room for the other half are cut; elements are as stiff as walls and infill make them. The couples act as forces on
    the screws' ring. Held is the bone beyond `FAR`, or what lies beyond the distance within which half of it lies;
    pieces less than `PIECE` of it are lumps that nothing holds.

    Args:
        bone: depth field of the bone, design frame.
        T_design_motor: pose of the motor.
        mount: its mount.
        half: the half of it that this bone carries.
        plastic: what both are printed of.
        spacing: edge of an element [m].
    """
    outer, low, high = span(mount, half)
    reach = FAR + 2 * spacing
    across = np.ceil((outer + reach) / spacing)
    x = (np.arange(2 * across) + 0.5 - across) * spacing
    z = np.arange(np.floor((low - reach) / spacing), np.ceil((high + reach) / spacing)) * spacing + spacing / 2
    local = np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1)
    radial = np.hypot(local[..., 0], local[..., 1]).astype(np.float32)
    along = local[..., 2].astype(np.float32)
    around = bone.sample(local @ T_design_motor[:3, :3].T + T_design_motor[:3, 3])
    far = np.maximum(np.maximum(radial - outer, low - along), along - high)
    limit = _body(coverage(around, spacing), far, bone.volume() / spacing**3)
    hub = _hub(radial, along, mount, half)
    cut = np.maximum(
        np.float32(mount.attach_radius) - radial,
        cylinder_depth(radial, along, *keepout(mount, half)).astype(np.float32),
    )
    depth = np.maximum(np.minimum(around, -cut), hub)
    modulus = plastic.modulus * plastic.stiffness(depth, spacing)
    modulus[(coverage(depth, spacing) < SEEN) | (far > limit + 2 * spacing)] = 0.0
    pieces, _ = ndimage.label(modulus > 0)
    touched = np.unique(pieces[(hub > 0) & (modulus > 0)])
    if len(touched) != 1:
        return MountStress(np.inf, 0.0, 0, np.inf)
    modulus[pieces != touched[0]] = 0.0
    model = VoxelModel.of(modulus, spacing, POISSON)
    points = model.points() + np.array([x[0], x[0], z[0]]) - spacing / 2
    far_nodes = np.maximum(
        np.maximum(np.hypot(points[:, 0], points[:, 1]) - outer, low - points[:, 2]), points[:, 2] - high
    )
    held = (far_nodes > limit) & _body_at(
        bone, T_design_motor, mount, half, limit, points @ T_design_motor[:3, :3].T + T_design_motor[:3, 3]
    )
    ring = _screw_ring(points, mount, half, spacing)
    if held.sum() < 4 or not ring.any():
        return MountStress(np.inf, 0.0, len(model.cells), np.inf)
    forces = np.stack([_couple(points, ring, couple) for couple in load_cases(mount.motor.peak_torque)])
    moved = model.displacements(forces, held)
    if moved is None:
        return MountStress(np.inf, 0.0, len(model.cells), np.inf)
    # The mount itself is the same in every robot; its bone and where the two meet is what differs.
    counts = (radial[tuple(model.cells.T)] > mount.attach_radius) & ~held[model.corner].any(axis=1)
    strain = superposed(model.strains(moved)[:, counts])
    each = von_mises(strain, plastic.modulus, POISSON).max(axis=0)
    volume = np.repeat(coverage(depth[tuple(model.cells[counts].T)], spacing) * spacing**3 / 8, 8)
    order = np.argsort(-each.ravel(), kind="stable")
    at = int(np.searchsorted(np.cumsum(volume[order]), CRITICAL))
    stress = float(each.ravel()[order[min(at, len(order) - 1)]]) if len(order) else 0.0
    arm = points[ring] - points[ring].mean(axis=0)
    twist = float(np.cross(arm, moved[0, ring])[:, 2].sum() / np.square(arm[:, :2]).sum())
    return MountStress(stress, safety_factor(stress, plastic.strength), len(model.cells), twist)


def _body(filled: NDArray[np.float32], far: NDArray[np.float32], volume: float) -> float:
    """Distance from the mount beyond which the bone is held: `FAR`, or where half of it lies nearer [m].

    Args:
        filled: share of every cell in the bone.
        far: distance of every cell from the mount [m].
        volume: of the whole bone [cells].
    """
    outside = far > 0
    distance, share = far[outside], filled[outside]
    order = np.argsort(distance, kind="stable")
    at = int(np.searchsorted(np.cumsum(share[order], dtype=np.float64), BODY_SHARE * volume))
    return min(FAR, float(distance[order[at]])) if at < len(order) else FAR


def _body_at(
    bone: Field, T_design_motor: Array, mount: Mount, half: Half, limit: float, points: Array
) -> NDArray[np.bool_]:
    """Whether points (n, 3) of the design frame are next to a large piece of the bone beyond `limit` of the mount."""
    local = (bone.points() - T_design_motor[:3, 3]) @ T_design_motor[:3, :3]
    outer, low, high = span(mount, half)
    far = np.maximum(np.maximum(np.hypot(local[..., 0], local[..., 1]) - outer, low - local[..., 2]),
                     local[..., 2] - high)  # fmt: skip
    solid = bone.values > 0
    pieces, _ = ndimage.label(solid & (far > limit - bone.spacing))
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    large = ndimage.binary_dilation(sizes[pieces] >= PIECE * solid.sum(), iterations=2)
    index = np.rint((points - bone.origin) / bone.spacing).astype(int).clip(0, np.asarray(bone.values.shape) - 1)
    return np.asarray(large[tuple(index.T)], bool)


def _hub(radial: NDArray[np.float32], along: NDArray[np.float32], mount: Mount, half: Half) -> NDArray[np.float32]:
    """Depth inside one half of the mount as it is printed, screw holes filled [m]."""
    if half == "connector":
        return cylinder_depth(radial, along, *span(mount, half))
    cup = cylinder_depth(radial, along, *span(mount, half))
    cup = np.minimum(cup, radial - np.float32(mount.cavity_radius))
    base = cylinder_depth(radial, along, mount.holder_radius - WALL / 2, mount.base_low, mount.housing_low)
    return np.maximum(cup, np.minimum(base, radial - np.float32(BORE)))


def _screw_ring(points: Array, mount: Mount, half: Half, spacing: float) -> NDArray[np.bool_]:
    """The nodes about the screws' circle that the motor pulls on."""
    pattern = mount.motor.body_screws if half == "holder" else mount.motor.output_screws
    low, high = (
        (mount.base_low, mount.housing_low) if half == "holder" else (mount.connector_low, mount.connector_low + 6e-3)
    )
    near = np.abs(np.hypot(points[:, 0], points[:, 1]) - pattern.circle_radius) < max(
        spacing, pattern.head_diameter / 2
    )
    return near & (points[:, 2] > low - spacing) & (points[:, 2] < high + spacing)


def _couple(points: Array, loaded: NDArray[np.bool_], couple: Array) -> Array:
    """Forces on some of the nodes (m, 3) that sum to nothing but this couple, as a rigid turn spreads them [N]."""
    arm = points[loaded] - points[loaded].mean(axis=0)
    spread = arm.T @ arm
    turn = np.linalg.solve(np.trace(spread) * np.eye(3) - spread, couple)
    forces = np.zeros_like(points)
    forces[loaded] = np.cross(turn, arm)
    return forces
