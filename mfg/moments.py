"""Integrals of mass over shapes in closed form: meshes, shells, prints, boxes, cylinders, cables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import MassProperties, Transform
from mfg.catalogue import Filament, Size
from mfg.outline import Outline

# Second moments of uniform shapes over mass: a triangle's and a tetrahedron's vertices weigh like this.
_TRIANGLE = 1.0 / 12.0
_TETRAHEDRON = 1.0 / 20.0


@dataclass(frozen=True, eq=False, slots=True)
class Moments:
    """Integrals of mass over the design frame; they add, so a body is the sum of its parts.

    Attributes:
        mass: integral of dm [kg].
        first: integral of x dm [kg.m], (3,).
        second: integral of x x^T dm [kg.m2], (3, 3).
    """

    mass: float
    first: NDArray[np.float64]
    second: NDArray[np.float64]

    def __add__(self, other: Moments) -> Moments:
        """Both together."""
        return Moments(self.mass + other.mass, self.first + other.first, self.second + other.second)

    def scaled(self, factor: float) -> Moments:
        """The same shape at `factor` times the density."""
        return Moments(self.mass * factor, self.first * factor, self.second * factor)

    def properties(self) -> MassProperties:
        """Mass, centre and the inertia about it.

        Raises:
            ValueError: if there is no mass.
        """
        if not self.mass > 0:
            raise ValueError(f"a body of mass {self.mass:g} kg has no centre of mass; every body needs a printed part")
        com = self.first / self.mass
        spread = self.second - self.mass * np.outer(com, com)
        spread = (spread + spread.T) / 2
        return MassProperties(self.mass, com, np.trace(spread) * np.eye(3) - spread)


NOTHING = Moments(0.0, np.zeros(3), np.zeros((3, 3)))


def total(moments: Iterable[Moments]) -> Moments:
    """The sum of all."""
    return sum(moments, NOTHING)


def volume_moments(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> Moments:
    """Moments of the inside of a closed mesh at density 1 kg/m3 (tetrahedra from the first vertex, closed form)."""
    facets = _Facets.of(vertices, triangles)
    return _shifted(facets.inside(), facets.anchor)


def shell_moments(vertices: NDArray[np.float64], triangles: NDArray[np.int64], depth: float = 0.0) -> Moments:
    """Moments of a surface at 1 kg/m2, each triangle moved inward by `depth` [m] (closed form)."""
    facets = _Facets.of(vertices, triangles)
    return _shifted(facets.shell(depth, facets.area), facets.anchor)


def printed_moments(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], filament: Filament, line_width: float
) -> Moments:
    """What the slicer lays down: walls along the surface, infill inside.

    m = rho (t A + infill (V - t A)) with t = walls * line_width, the wall taken as a shell half its thickness below the
    surface. Where walls would fill more than the part (t A > V) it is solid: t shrinks to V / A.
    """
    facets = _Facets.of(vertices, triangles)
    return _shifted(_laid_down([facets], [facets.area], filament, line_width), facets.anchor)


def outline_moments(shape: Outline, filament: Filament, line_width: float) -> Moments:
    """As `printed_moments`, of the inside of a depth field."""
    return _laid_down([_Patches(shape)], [shape.area], filament, line_width)


def covering_moments(
    outer: Outline,
    inner: Outline,
    covered: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    filament: Filament,
    line_width: float,
) -> Moments:
    """What the slicer lays down between two surfaces, of which the outer one holds the inner one.

    As `printed_moments` of outer less inner, whose walls run along both surfaces where these are apart.

    Args:
        outer: the surface towards the air.
        inner: that of the hollow.
        covered: for the crossings of each, whether the other surface is farther than a printed line.
        filament: what is printed.
        line_width: of a printed line [m].
    """
    lined = [outer.area * covered[0], inner.area * covered[1]]
    return _laid_down([_Patches(outer), _Patches(inner, -1.0)], lined, filament, line_width)


def box_moments(mass: float, size: Size, pose: Transform) -> Moments:
    """A uniform box centred on its frame."""
    return _at(mass, np.diag(np.square(size)) / 12.0, pose)


def cylinder_moments(mass: float, radius: float, length: float, pose: Transform) -> Moments:
    """A uniform cylinder centred on its frame, along z."""
    return _at(mass, np.diag([radius**2 / 4, radius**2 / 4, length**2 / 12]), pose)


def point_moments(mass: float, position: NDArray[np.float64]) -> Moments:
    """A small thing at a point (3,) [m]."""
    return Moments(mass, mass * position, mass * np.outer(position, position))


def polyline_moments(
    mass_per_metre: float, path: NDArray[np.float64], there: NDArray[np.bool_] | None = None
) -> Moments:
    """A thin cable along points (k, 3) [m], or those of its pieces that are `there`, (k - 1,)."""
    start, end = (path[:-1], path[1:]) if there is None else (path[:-1][there], path[1:][there])
    pieces = np.stack([start.T, end.T])
    length = np.linalg.norm(end - start, axis=1)
    return _of_simplices(pieces, length, 2, 1.0 / 6.0).scaled(mass_per_metre)


def placed(moments: Moments, pose: Transform) -> Moments:
    """The moments of a shape in the frame that its pose is given in."""
    turn = pose[:3, :3]
    return _shifted(Moments(moments.mass, turn @ moments.first, turn @ moments.second @ turn.T), pose[:3, 3])


@dataclass(frozen=True, eq=False, slots=True)
class _Facets:
    """The triangles of a closed surface, by coordinate, so that sums over them run through memory.

    Attributes:
        corners: less the anchor [m], (corner, axis, triangle).
        normal: pointing out, twice the area long [m2], (axis, triangle).
        area: [m2], (triangle,).
        anchor: a point near the surface [m], (3,).
    """

    corners: NDArray[np.float64]
    normal: NDArray[np.float64]
    area: NDArray[np.float64]
    anchor: NDArray[np.float64]

    @staticmethod
    def of(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> _Facets:
        anchor = vertices[0] if len(vertices) else np.zeros(3)
        axes = np.ascontiguousarray((vertices - anchor).T)
        corners = np.stack([axes[:, corner] for corner in triangles.T])
        (ax, ay, az), (bx, by, bz) = corners[1] - corners[0], corners[2] - corners[0]
        normal = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
        return _Facets(corners, normal, np.sqrt(np.square(normal).sum(0)) / 2.0, anchor)

    def inside(self) -> Moments:
        """Moments about the anchor of what the surface encloses at 1 kg/m3."""
        volume = (self.corners[0] * self.normal).sum(0) / 6.0
        return _of_simplices(self.corners, volume, 4, _TETRAHEDRON)

    def shell(self, depth: float, mass: NDArray[np.float64]) -> Moments:
        """Moments about the anchor of the triangles, of masses (triangle,) [kg], moved inward by `depth` [m]."""
        inward = self.normal * (depth / np.maximum(2.0 * self.area, 1e-300))
        return _of_simplices(self.corners - inward, mass, 3, _TRIANGLE)


@dataclass(frozen=True, eq=False, slots=True)
class _Patches:
    """An outline, whose inside is not there where `sign` is -1: the surface of a hollow."""

    shape: Outline
    sign: float = 1.0

    def inside(self) -> Moments:
        """Moments of what the surface encloses at 1 kg/m3, negative for a hollow."""
        volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
        edges = np.searchsorted(self.shape.axis, np.arange(4))
        for axis in range(3):
            along = slice(int(edges[axis]), int(edges[axis + 1]))
            points, mass = self.shape.points[along], self.shape.flow[along] * (self.sign / 3.0)
            # The integral of x^k along the line is x^(k + 1) / (k + 1).
            power = np.ones(3)
            power[axis] = 2.0
            volume += float(mass.sum())
            first += mass @ points / power
            second += points.T @ (mass[:, None] * points) / (power[:, None] + power - 1.0)
        return Moments(volume, first, second)

    def shell(self, depth: float, mass: NDArray[np.float64]) -> Moments:
        """Moments of the patches, of masses (n,) [kg], moved by `depth` [m] away from the air."""
        points = self.shape.points - (self.sign * depth) * self.shape.normals
        return Moments(float(mass.sum()), mass @ points, points.T @ (mass[:, None] * points))


def _laid_down(
    facets: Sequence[_Facets | _Patches], lined: list[NDArray[np.float64]], filament: Filament, line_width: float
) -> Moments:
    """Walls along the share of every patch that is lined [m2], infill between; moments about the anchor."""
    inside = total(f.inside() for f in facets)
    area = float(sum(a.sum() for a in lined))
    if not inside.mass > 0 or not area > 0:
        return NOTHING
    thickness = min(filament.walls * line_width, inside.mass / area)
    wall = total(f.shell(thickness / 2, a) for f, a in zip(facets, lined, strict=True))
    return inside.scaled(filament.density * filament.infill) + wall.scaled(
        filament.density * (1.0 - filament.infill) * thickness
    )


def _of_simplices(corners: NDArray[np.float64], mass: NDArray[np.float64], count: int, weight: float) -> Moments:
    """Uniform simplices with the given corners (k, 3, n); a tetrahedron's fourth corner is the origin."""
    centre = corners.sum(0)
    second = sum((points @ (mass * points).T for points in (*corners, centre)), np.zeros((3, 3)))
    return Moments(float(mass.sum()), (centre @ mass) / count, second * weight)


def _shifted(moments: Moments, offset: NDArray[np.float64]) -> Moments:
    cross = np.outer(offset, moments.first)
    second = moments.second + cross + cross.T + moments.mass * np.outer(offset, offset)
    return Moments(moments.mass, moments.first + moments.mass * offset, second)


def _at(mass: float, spread: NDArray[np.float64], pose: Transform) -> Moments:
    """A body with covariance `spread` (mean of x x^T) in its own centred frame."""
    turn, centre = pose[:3, :3], pose[:3, 3]
    return Moments(mass, mass * centre, mass * (turn @ spread @ turn.T + np.outer(centre, centre)))
