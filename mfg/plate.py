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
_FACETS = 24  # hull facets tried as the bottom, largest first


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


def print_rotation(points: NDArray[np.float64], volume: Size) -> NDArray[np.float64] | None:
    """The rotation (3, 3) that lays points (n, 3) as low as possible within the printer's volume; None if none fits.

    Bottoms tried: the six of the design's axes and the largest facets of the convex hull; the yaw is that of the
    smallest rectangle around the footprint, so a body is turned as a box that just holds it.
    """
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    corners = points[hull.vertices]
    best: tuple[float, NDArray[np.float64]] | None = None
    for down in _bottoms(hull):
        turned = _facing_down(down)
        footprint = corners @ turned.T
        yaw = _yaw(footprint[:, :2])
        for quarter in (np.eye(3), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])):
            rotation = quarter @ yaw @ turned
            size = np.ptp(corners @ rotation.T, axis=0)
            # A micrometre of slack, so that a body of exactly the printer's height does not depend on rounding.
            if (size <= np.asarray(volume) + 1e-6).all() and (best is None or size[2] < best[0] - 1e-6):
                best = (float(size[2]), rotation)
    return None if best is None else best[1]


def arrange(bodies: Sequence[NDArray[np.float64]], volume: Size) -> list[Lay]:
    """Lay bodies (points (n, 3) of each, design frame) on as few plates as rows of rectangles allow.

    Raises:
        ValueError: if a body does not fit the printer at all.
    """
    rotations, sizes = [], []
    for index, points in enumerate(bodies):
        rotation = print_rotation(points, volume)
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


def _bottoms(hull: ConvexHull) -> list[NDArray[np.float64]]:
    """Outward normals that may face the plate, the design's own bottom first."""
    axes = [-np.eye(3)[2], np.eye(3)[2], -np.eye(3)[0], np.eye(3)[0], -np.eye(3)[1], np.eye(3)[1]]
    corners = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
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


def _yaw(footprint: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation about z under which the rectangle around points (n, 2) is smallest; 0 where nothing beats it."""
    outline = footprint[ConvexHull(footprint).vertices]
    edges = np.roll(outline, -1, axis=0) - outline
    angles = np.concatenate([[0.0], np.unique(np.round(-np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2), 9))])
    c, s = np.cos(angles), np.sin(angles)
    width = np.ptp(outline[:, 0] * c[:, None] - outline[:, 1] * s[:, None], axis=1)
    length = np.ptp(outline[:, 0] * s[:, None] + outline[:, 1] * c[:, None], axis=1)
    area = width * length
    best = int(np.argmin(np.round(area, 12))) if area.min() < area[0] * (1 - 1e-6) else 0
    return np.array([[c[best], -s[best], 0.0], [s[best], c[best], 0.0], [0.0, 0.0, 1.0]])
