"""The five manufacturability scores: every equation of the paper's metrics, and the constants that bring it to [0, 1].

Each score is monotone in what it measures. The constants are derived where they are defined.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from mfg.blueprint import Blueprint
from mfg.catalogue import Catalogue, Size
from mfg.fields import Field, about_axis
from mfg.mounts import Mount, mount_of

CABLE_ALPHA = 0.5  # weight of curvature against length: a sharp bend can be pulled through, a missing metre cannot
CABLE_LENGTH = 2.0  # 1 / lambda_L: cable of one drum-side harness, at which the length term has fallen to 1/e [m]
BEND_MARGIN = 1.0  # 1 / lambda_kappa in units of 1 / (least bend radius of the cable)
OVERLAP_VOLUME = 1.7e-4  # lambda of Eq. 9: the ring around one J60, all that its mount can share with a bone [m3]
# Places from which the largest ball is looked for, and of them those that are looked at closely each time. The score of
# 29 robots is within 0.007 of that on solids by these, within 0.06 by 60 and 4, and costs 2 ms of CPU more.
STARTS, KEPT = 300, 6
NEAR_TIE = 0.05  # excess volume at which an oriented box counts 1/e of the least one
SIZE_SHARE = 0.8  # share of the printer's volume, in its tightest direction, above which a body counts as large


def mount_balance(V_h: float, V_c: float, alpha: float) -> float:
    """Weigh a mount: g = sqrt(V_h V_c) + alpha (V_h + V_c), volumes in [m3] (paper Eq. 3)."""
    return math.sqrt(V_h * V_c) + alpha * (V_h + V_c)


def motor_scale(mount: Mount, alpha: float) -> float:
    """Give g where both bodies fill half of the ring in which mounts and bones can overlap [m3].

    Bones that face each other across the hinge share the ring, so half of it each is the best of both.
    """
    inner = mount.attach_radius**2
    V_h = math.pi * (mount.holder_radius**2 - inner) * (mount.holder_top - mount.base_low)
    V_c = math.pi * (mount.connector_radius**2 - inner) * (mount.connector_high - mount.connector_low)
    return mount_balance(V_h / 2, V_c / 2, alpha)


def motor_score(scores: Sequence[float], mount: Mount, alpha: float) -> float:
    """S_motor = mean over joints of S_j(delta_j*), divided by `motor_scale` and clipped to 1 (paper Eq. 5)."""
    return _unit(float(np.mean(scores)) / motor_scale(mount, alpha)) if len(scores) else 0.0


def size_penalty(extents: NDArray[np.float64], volume: Size, share: float = SIZE_SHARE) -> float:
    """p_obb in (0, 1]: 1 while an oriented box needs at most `share` of the printer, then share over need (Eq. 6).

    Args:
        extents: of the body's oriented bounding box [m], (3,).
        volume: of the printer [m].
        share: threshold on the need, which is the largest ratio of a sorted extent to the printer's sorted side.
    """
    need = float((np.sort(extents) / np.sort(volume)).max())
    return min(1.0, share / need)


def largest_clearance(depth: Field) -> float:
    """d_max = max phi over a body's interior [m]: the radius of the largest ball that fits inside (paper Eq. 6).

    The field ranks the places; the radius itself is the distance to the surface phi = 0, so that a field smoothed deep
    inside does not matter, as long as the place is among the first `STARTS`. Exact up to the curvature of the surface
    between lattice lines.
    """
    surface = cKDTree(crossings(depth), compact_nodes=False, balanced_tree=False)  # built twice as fast
    deep = np.argwhere(depth.values > max(0.0, float(depth.values.max()) - 2 * depth.spacing))
    order = np.argsort(-depth.values[tuple(deep.T)], kind="stable")[:STARTS]
    tried = np.asarray((deep[order] + depth.corner) * depth.spacing, np.float64)
    steps = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    radius = np.asarray(surface.query(tried)[0], np.float64)
    for scale in (2, 4, 8):
        best = tried[np.argsort(-radius, kind="stable")[:KEPT]]
        tried = (best + steps * (depth.spacing / scale)).reshape(-1, 3)
        radius = np.asarray(surface.query(tried)[0], np.float64)
    return float(radius.max())


def crossings(depth: Field) -> NDArray[np.float64]:
    """Points where the surface phi = 0 crosses the lattice lines, in the design frame [m], (n, 3)."""
    v = depth.values
    points = []
    for axis in range(3):
        a, b = np.moveaxis(v, axis, 0)[:-1], np.moveaxis(v, axis, 0)[1:]
        where = np.nonzero((a > 0) != (b > 0))
        first, second = a[where].astype(np.float64), b[where].astype(np.float64)
        index = np.stack(where, axis=-1).astype(np.float64)
        index[:, 0] += first / (first - second)
        # Undo the moveaxis: the crossed axis came first.
        points.append(np.insert(index[:, 1:], axis, index[:, 0], axis=1))
    return (np.concatenate(points) + depth.corner) * depth.spacing


def oriented_extents(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sorted extents of the oriented box of least volume around points (n, 3), not all in one plane [m], (3,).

    The boxes tried are flush with a face and an edge of the hull. Boxes that are nearly as small count too, with
    weight exp(-(V / V_min - 1) / `NEAR_TIE`): the answer does not jump where two boxes change places.
    """
    count = 200
    turn = np.arange(count) * (np.pi * (3 - np.sqrt(5)))  # Directions all around, on a golden spiral.
    z = 1 - (2 * np.arange(count) + 1) / count
    ring = np.sqrt(1 - z**2)
    around = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
    # The hull of the extreme points in these directions stands for the hull of all.
    along = around.astype(np.float32) @ np.ascontiguousarray(points.T, np.float32)
    extreme = points[np.unique(along.argmax(axis=1))]
    hull = ConvexHull(extreme)
    corner, normal = extreme[hull.simplices], hull.equations[:, :3]
    x = (np.roll(corner, -1, axis=1) - corner).reshape(-1, 3)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z = np.repeat(normal, 3, axis=0)
    spread = np.stack([x, np.cross(z, x), z], axis=1).reshape(-1, 3) @ extreme.T
    extents = (spread.max(axis=1) - spread.min(axis=1)).reshape(-1, 3)
    volume = extents.prod(axis=1)
    weight = np.exp(-(volume / volume.min() - 1) / NEAR_TIE)
    return np.asarray(weight @ np.sort(extents, axis=1) / weight.sum(), np.float64)


def electronics_scale(catalogue: Catalogue) -> float:
    """Clearance at which the battery fits in every orientation: half of its diagonal [m]."""
    return float(np.linalg.norm(catalogue.battery.size)) / 2


def electronics_score(d_max: float, p_obb: float, catalogue: Catalogue) -> float:
    """S_elec = d_max p_obb, divided by `electronics_scale` and clipped to 1 (paper Eq. 6)."""
    return _unit(d_max * p_obb / electronics_scale(catalogue))


def cable_score(length: float, curvature: float, catalogue: Catalogue) -> float:
    """S_cable = exp(-lambda_L L_tot) + alpha exp(-lambda_kappa kappa_max), divided by 1 + alpha (paper Eq. 7).

    Args:
        length: L_tot, sum over all tunnels [m].
        curvature: kappa_max over all tunnels [1/m].
        catalogue: its cable's least bend radius sets lambda_kappa.
    """
    lambda_kappa = catalogue.wire.bend_radius / BEND_MARGIN
    raw = math.exp(-length / CABLE_LENGTH) + CABLE_ALPHA * math.exp(-lambda_kappa * curvature)
    return _unit(raw / (1 + CABLE_ALPHA))


def insertion_scale(catalogue: Catalogue) -> float:
    """Lambda of Eq. 8: the volume of the two modules that must pass [m3]."""
    return float(np.prod(catalogue.battery.size) + np.prod(catalogue.computer.size))


def electronics_install_score(V_cap: float, catalogue: Catalogue) -> float:
    """S_elec-inst = exp(-V_cap / lambda), V_cap in [m3] (paper Eq. 8)."""
    return _unit(math.exp(-max(V_cap, 0.0) / insertion_scale(catalogue)))


def body_install_score(V_overlap: float) -> float:
    """S_body-inst = exp(-V_overlap / lambda), V_overlap in [m3] (paper Eq. 9)."""
    return _unit(math.exp(-max(V_overlap, 0.0) / OVERLAP_VOLUME))


def body_overlap(blueprint: Blueprint) -> float:
    """V_overlap: volume that the rigid bodies share, summed over all pairs [m3] (paper Eq. 9).

    A body is its bone with the mounts that motor integration adds to it: the holder (with the motor in it) where it
    holds one, the connector where it is screwed to one. Clearances that are carved later are not taken off: they are
    the remedy, this is the disease. Mounts do not meet each other (the motor solver sees to it).
    """
    mount = mount_of(blueprint.catalogue.motor)
    bones = [body.bone for body in blueprint.bodies]
    total = sum(shared_volume(a, b) for i, a in enumerate(bones) for b in bones[i + 1 :])
    cup = mount.holder_radius, mount.base_low, mount.connector_low
    disc = mount.connector_radius, mount.connector_low, mount.connector_high
    for seat in blueprint.seats:
        for owner, (radius, low, high) in ((seat.holder, cup), (seat.connector, disc)):
            others = [bone for index, bone in enumerate(bones) if index != owner]
            total += _volume_in_cylinder(others, seat.T_design_motor, mount.attach_radius, radius, low, high)
    return total


def shared_volume(a: Field, b: Field) -> float:
    """Volume of the intersection of two fields on one lattice [m3].

    In a cell that both surfaces cross, the share that lies in both depends on how they face: it is the smaller one
    where the normals agree, what exceeds the cell together where they oppose, and the product where they are
    perpendicular; between these it is interpolated in the cosine.
    """
    low = np.maximum(a.corner, b.corner)
    high = np.minimum(np.add(a.corner, a.values.shape), np.add(b.corner, b.values.shape))
    if (high - low < 2).any():
        return 0.0
    first, second = (
        f.values[tuple(slice(p, q) for p, q in zip(low - f.corner, high - f.corner, strict=True))] for f in (a, b)
    )
    h = np.float32(a.spacing)
    near = np.minimum(first, second) > -h / 2
    if not near.any():
        return 0.0
    # Work in the box around the cells that both bodies reach.
    found = [np.flatnonzero(near.any(axis=tuple(o for o in range(3) if o != axis))) for axis in range(3)]
    window = tuple(slice(max(int(f[0]) - 1, 0), int(f[-1]) + 2) for f in found)
    first, second, near = first[window], second[window], near[window]
    p, q = np.clip(first[near] / h + 0.5, 0, 1), np.clip(second[near] / h + 0.5, 0, 1)
    m, n = _normals(first, near), _normals(second, near)
    cosine = np.clip((m * n).sum(axis=0), -1, 1)
    extreme = np.where(cosine > 0, np.minimum(p, q), np.maximum(p + q - 1, 0))
    share = np.abs(cosine) * extreme + (1 - np.abs(cosine)) * p * q
    return float(share.sum(dtype=np.float64)) * a.spacing**3


def _volume_in_cylinder(
    bones: Sequence[Field], T: NDArray[np.float64], inner: float, outer: float, low: float, high: float
) -> float:
    """Volume of all bones in a cylinder about z of frame T, sampled in rings that split at the radius `inner` [m3]."""
    edges = np.concatenate([np.linspace(0, inner, 5), np.linspace(inner, outer, 4)[1:]])
    radius, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    count = math.ceil((high - low) / 3.5e-3)
    height = low + (np.arange(count) + 0.5) * (high - low) / count
    angle = (np.arange(48) + 0.5) * (2 * np.pi / 48)
    points = about_axis(T, radius[:, None, None], angle[:, None], height)
    cell = radius * width * (2 * np.pi / 48) * (high - low) / count
    total = 0.0
    middle = T[:3, 3] + (low + high) / 2 * T[:3, 2]
    reach = np.abs(T[:3, 2]) * (high - low) / 2 + np.sqrt(np.maximum(1 - T[:3, 2] ** 2, 0)) * outer
    for bone in bones:
        end = bone.origin + (np.array(bone.values.shape) - 1) * bone.spacing
        if (middle + reach > bone.origin).all() and (middle - reach < end).all():
            share = np.clip(bone.sample_at(*points) / width[:, None, None] + 0.5, 0.0, 1.0)
            total += float((share.sum(axis=(1, 2)) * cell).sum())
    return total


def _normals(depth: NDArray[np.float32], where: NDArray[np.bool_]) -> NDArray[np.float32]:
    slope = np.stack([np.asarray(d)[where] for d in np.gradient(depth)])
    return slope / np.maximum(np.linalg.norm(slope, axis=0), np.float32(1e-9))


def _unit(value: float) -> float:
    return min(1.0, max(0.0, value))
