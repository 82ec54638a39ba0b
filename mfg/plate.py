"""How printed bodies lie on the printer: which way down, and where on which plate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from mfg.blueprint import Transform
from mfg.catalogue import Size

SPACING = 0.008  # between objects on a plate [m]
OVERHANG = np.deg2rad(40)  # a surface that faces down and is less steep than this needs support [rad]
HEIGHT_COST = 4.0e-3  # support that takes as long to print as one metre of height, changes of nozzle and all [m3/m]
_ON_PLATE = 5e-4  # what is nearer to the plate than this lies on it [m]
_FACETS = 24  # hull facets tried as the bottom, largest first
_SLACK = 1e-6  # so that a body of exactly the printer's size does not depend on rounding [m]


@dataclass(frozen=True, eq=False, slots=True)
class Lay:
    """One body on a plate.

    Attributes:
        plate: index of the plate, 0, 1, ...
        T_plate_design: pose that brings the body from the design frame onto that plate, whose corner is the origin [m].
        size: extents on the plate [m], (3,).
    """

    plate: int
    T_plate_design: Transform
    size: NDArray[np.float64]


def fits_printer(points: NDArray[np.float64], volume: Size) -> bool:
    """Whether points (n, 3) fit the printer's volume in some orientation [m]."""
    if (np.sort(np.ptp(points, axis=0)) <= np.sort(volume) + 1e-6).all():
        return True
    return print_rotation(points, volume) is not None


def print_rotation(
    points: NDArray[np.float64], volume: Size, surface: NDArray[np.float64] | None = None
) -> NDArray[np.float64] | None:
    """The rotation (3, 3) that lays points (n, 3) best within the printer's volume; None if none fits.

    Best is the least `lay_cost` where the surface is given, else the least height. Bottoms tried: the six of the
    design's axes, the six of the principal axes, and the largest facets of the convex hull; each with every yaw that
    lays an edge of the footprint's outline along x. Of the yaws that fit, the one with the smallest rectangle is taken:
    that body stands on the plate as a box that just holds it.

    Args:
        points: [m].
        volume: of the printer [m].
        surface: corners of the triangles that face the air, (m, 3, 3) [m].
    """
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    corners = points[hull.vertices]
    bottoms = np.stack(_bottoms(hull, corners))
    height = np.ptp(corners @ bottoms.T, axis=0)
    cost = height if surface is None else lay_cost(surface, bottoms, (corners @ bottoms.T).max(0), height)
    best: tuple[float, NDArray[np.float64]] | None = None
    margin = _SLACK if surface is None else _SLACK * float(cost.max())  # so that equals go to the first
    for down, high, price in zip(bottoms, height, cost, strict=True):
        if high > volume[2] + _SLACK or (best is not None and price > best[0] - margin):
            continue
        turned = _facing_down(down)
        yaw = _yaw((corners @ turned.T)[:, :2], volume)
        if yaw is not None:
            best = (float(price), yaw @ turned)
    return None if best is None else best[1]


def lay_cost(
    surface: NDArray[np.float64], bottoms: NDArray[np.float64], low: NDArray[np.float64], height: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What it takes to print with each of some bottoms (k, 3) down, as a volume of support [m3], (k,).

    cost = sum of a z over overhanging triangles + HEIGHT_COST h: a is a triangle's area seen from below, z its height
    above the plate, h the whole height. Support that ends on the body itself is shorter than z, so this is a bound.

    Args:
        surface: corners of the triangles that face the air, (m, 3, 3) [m].
        bottoms: unit vectors that may point to the plate.
        low: distance of the plate along each [m], (k,).
        height: along each [m], (k,).
    """
    doubled = np.cross(surface[:, 1] - surface[:, 0], surface[:, 2] - surface[:, 0])
    facing = doubled @ bottoms.T / 2  # area seen from below, (m, k)
    above = low - surface.mean(axis=1) @ bottoms.T
    steep = facing < np.cos(OVERHANG) * np.linalg.norm(doubled, axis=1)[:, None] / 2
    needed = np.where(steep | (above < _ON_PLATE), 0.0, facing * above)
    return np.asarray(needed.sum(0) + HEIGHT_COST * height)


def arrange(
    bodies: Sequence[NDArray[np.float64]], volume: Size, surfaces: Sequence[NDArray[np.float64]] | None = None
) -> list[Lay]:
    """Lay bodies (points (n, 3) of each, design frame) on as few plates as rows of rectangles allow.

    Each lies as `print_rotation` says; `surfaces` are what it takes for the least support, one for each body.

    Raises:
        ValueError: if a body does not fit the printer at all.
    """
    rotations, sizes = [], []
    for index, points in enumerate(bodies):
        rotation = print_rotation(points, volume, None if surfaces is None else surfaces[index])
        if rotation is None:
            raise ValueError(f"body {index} does not fit the printer's volume of {volume} m in any orientation")
        rotations.append(rotation)
        sizes.append(np.ptp(points @ rotation.T, axis=0))
    lays: dict[int, Lay] = {}
    plate, x, y, depth = 0, 0.0, 0.0, 0.0
    for index in sorted(range(len(bodies)), key=lambda i: (-sizes[i][1], i)):
        width, length = sizes[index][:2]
        if x > 0 and x + width > volume[0] + 1e-6:
            x, y, depth = 0.0, y + depth + SPACING, 0.0
        if y > 0 and y + length > volume[1] + 1e-6:
            plate, x, y, depth = plate + 1, 0.0, 0.0, 0.0
        T = np.eye(4)
        T[:3, :3] = rotations[index]
        T[:3, 3] = np.array([x, y, 0.0]) - (bodies[index] @ rotations[index].T).min(0)
        lays[index] = Lay(plate, T, sizes[index])
        x, depth = x + width + SPACING, max(depth, length)
    return [lays[i] for i in range(len(bodies))]


def _bottoms(hull: ConvexHull, corners: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Outward normals that may face the plate, the design's own bottom first."""
    axes = [-np.eye(3)[2], np.eye(3)[2], -np.eye(3)[0], np.eye(3)[0], -np.eye(3)[1], np.eye(3)[1]]
    centred = corners - corners.mean(axis=0)
    _, principal = np.linalg.eigh(centred.T @ centred)
    axes += [sign * column for column in principal.T for sign in (1.0, -1.0)]
    facets = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), axis=1)
    normals = hull.equations[:, :3]
    # Coplanar triangles of one flat facet count together.
    _, first, index = np.unique(np.round(normals, 4), axis=0, return_index=True, return_inverse=True)
    totals = np.bincount(index.reshape(-1), area)
    order = np.lexsort((np.arange(len(first)), -np.round(totals, 12)))[:_FACETS]
    return axes + [normals[first[k]] / np.linalg.norm(normals[first[k]]) for k in order]


def _facing_down(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """A rotation that takes `normal` to -z, the identity where it already points there."""
    z = -normal
    helper = np.eye(3)[int(np.argmin(np.abs(z)))] if abs(z[2]) < 0.999999 else np.eye(3)[0]
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _yaw(footprint: NDArray[np.float64], volume: Size) -> NDArray[np.float64] | None:
    """The rotation about z with the smallest rectangle around points (n, 2) that fits the plate; 0 if as good."""
    outline = footprint[ConvexHull(footprint).vertices]
    edges = np.roll(outline, -1, axis=0) - outline
    along = np.unique(np.round(-np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2), 9))
    angles = np.concatenate([[0.0, np.pi / 2], along, along + np.pi / 2])
    c, s = np.cos(angles), np.sin(angles)
    width = np.ptp(outline[:, 0] * c[:, None] - outline[:, 1] * s[:, None], axis=1)
    length = np.ptp(outline[:, 0] * s[:, None] + outline[:, 1] * c[:, None], axis=1)
    area = np.where((width <= volume[0] + _SLACK) & (length <= volume[1] + _SLACK), width * length, np.inf)
    if not np.isfinite(area).any():
        return None
    best = 0 if area[0] <= area.min() * (1 + 1e-6) else int(np.argmin(np.round(area, 12)))
    return np.array([[c[best], -s[best], 0.0], [s[best], c[best], 0.0], [0.0, 0.0, 1.0]])
