"""Watertight solids and exact booleans: the only importer of the mesh kernel."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import manifold3d as m3
import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage import measure

from mfg.fields import Field

SIMPLIFY = 1.5e-4  # surface error allowed when thinning triangles [m]
SEGMENTS = 48  # sides of a round hardware feature


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed, outward-oriented triangle mesh in metres. Plain arrays, so it crosses processes.

    Attributes:
        vertices: (n, 3) [m].
        triangles: (m, 3) vertex indices, counter-clockwise seen from outside.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    @cached_property
    def _kernel(self) -> m3.Manifold:
        # Copies: the kernel refuses read-only arrays.
        solid = m3.Manifold(m3.Mesh64(np.array(self.vertices, np.float64), np.array(self.triangles, np.uint64)))
        if solid.status() != m3.Error.NoError:
            raise ValueError(f"mesh of {len(self.triangles)} triangles is not a solid: {solid.status()}")
        return solid

    def __getstate__(self) -> dict[str, NDArray[np.generic]]:
        """Leave the kernel's own object behind when pickled."""
        return {"vertices": self.vertices, "triangles": self.triangles}

    def __setstate__(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Restore the two arrays."""
        self.__dict__.update(state)

    def __add__(self, other: Solid) -> Solid:
        """Union."""
        return _of(self._kernel + other._kernel)

    def __sub__(self, other: Solid) -> Solid:
        """Difference."""
        return _of(self._kernel - other._kernel)

    def __xor__(self, other: Solid) -> Solid:
        """Intersection."""
        return _of(self._kernel ^ other._kernel)

    @property
    def is_empty(self) -> bool:
        """True where nothing is left."""
        return len(self.triangles) == 0

    @property
    def volume(self) -> float:
        """Enclosed volume [m3]."""
        return float(self._kernel.volume())

    @property
    def area(self) -> float:
        """Surface [m2]."""
        return float(self._kernel.surface_area())

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner [m], (2, 3)."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    def moved(self, transform: NDArray[np.float64]) -> Solid:
        """The solid under a (4, 4) rigid transform."""
        return _of(self._kernel.transform(np.asarray(transform, np.float64)[:3]))

    def components(self) -> list[Solid]:
        """Connected pieces, largest first."""
        return sorted((_of(piece) for piece in self._kernel.decompose()), key=lambda s: -s.volume)

    def minus(self, cutters: Sequence[Solid]) -> Solid:
        """Subtract all cutters whose boxes meet this solid, in one operation."""
        near = [c for c in cutters if not c.is_empty and _boxes_meet(self.bounds, c.bounds)]
        if self.is_empty or not near:
            return self
        return _of(m3.Manifold.batch_boolean([self._kernel, *(c._kernel for c in near)], m3.OpType.Subtract))

    def simplified(self, tolerance: float = SIMPLIFY) -> Solid:
        """Fewer triangles within `tolerance` of the surface [m]."""
        return _thinned(self._kernel, tolerance)

    def overlap(self, other: Solid) -> float:
        """Volume shared with another solid [m3]; 0 where the boxes do not meet."""
        if self.is_empty or other.is_empty or not _boxes_meet(self.bounds, other.bounds):
            return 0.0
        return max(0.0, float((self._kernel ^ other._kernel).volume()))

    def forgotten(self) -> Solid:
        """The same triangles, known to the kernel by their corners alone.

        It remembers which triangles it found flat or got from one face, and turns edges between them in every later
        operation: two solids that are cut from one another would no longer share the surface between them.
        """
        return Solid(self.vertices, self.triangles)

    def hull(self) -> Solid:
        """Convex hull."""
        return _of(self._kernel.hull())


def union(solids: Sequence[Solid]) -> Solid:
    """The union of all solids, in one operation."""
    return _of(m3.Manifold.batch_boolean([s._kernel for s in solids], m3.OpType.Add))


def from_field(field: Field, simplify: float = SIMPLIFY) -> Solid:
    """The surface phi = 0 as a solid (marching cubes), thinned to within `simplify` [m].

    Raises:
        ValueError: if the field is nowhere positive.
    """
    position, triangles = surface(field)
    kernel = m3.Manifold(m3.Mesh64(np.ascontiguousarray(position), np.ascontiguousarray(triangles, np.uint64)))
    if kernel.status() != m3.Error.NoError:
        raise ValueError(f"marching cubes gave no solid: {kernel.status()}")
    solid = _thinned(kernel, simplify) if simplify > 0 else _of(kernel)
    if solid.volume <= 0:
        raise ValueError(f"marching cubes gave an inside-out solid of volume {solid.volume:.3g} m3")
    return solid


def surface(field: Field) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The surface phi = 0 as bare vertices (n, 3) [m] and triangles (m, 3), without the kernel (marching cubes).

    Raises:
        ValueError: if the field is nowhere positive.
    """
    padded = np.pad(field.values, 1, constant_values=-np.float32(field.spacing))
    padded = np.where(padded == 0, np.float32(1e-9), padded)  # a sample on the level makes degenerate triangles
    if not (padded > 0).any():
        raise ValueError("the field is nowhere positive: there is no surface to mesh")
    vertices, triangles, _, _ = measure.marching_cubes(
        padded, 0.0, spacing=(1.0, 1.0, 1.0), method="lorensen", gradient_direction="ascent", allow_degenerate=False
    )
    # vertices - 1 undoes the padding.
    position = (vertices.astype(np.float64) - 1.0 + np.asarray(field.corner)) * field.spacing
    return position, triangles.astype(np.int64)


def cylinder(radius: float, low: float, high: float, segments: int = SEGMENTS) -> Solid:
    """A cylinder about z between heights low and high [m]."""
    return _of(m3.Manifold.cylinder(high - low, radius, radius, segments).translate((0.0, 0.0, low)))


def tube(outer: float, inner: float, low: float, high: float, segments: int = SEGMENTS) -> Solid:
    """A pipe about z between heights low and high [m]."""
    return cylinder(outer, low, high, segments) - cylinder(inner, low - 1e-3, high + 1e-3, segments)


def box(low: ArrayLike, high: ArrayLike) -> Solid:
    """An axis-aligned box between two corners [m]."""
    corner = np.asarray(low, np.float64)
    x, y, z = (float(v) for v in np.asarray(high, np.float64) - corner)
    return _of(m3.Manifold.cube((x, y, z)).translate((float(corner[0]), float(corner[1]), float(corner[2]))))


def ball_chain(path: NDArray[np.float64], radius: float, segments: int = 12) -> Solid:
    """A round tunnel along a polyline (k, 3): the union of the hulls of neighbouring balls, valid for any bend."""
    ball = m3.Manifold.sphere(radius, segments)
    balls = [ball.translate(tuple(float(v) for v in p)) for p in path]
    links = [m3.Manifold.batch_hull([a, b]) for a, b in itertools.pairwise(balls)]
    return _of(m3.Manifold.batch_boolean(links or balls, m3.OpType.Add))


def _thinned(kernel: m3.Manifold, tolerance: float) -> Solid:
    """Fewer triangles within `tolerance` [m]; the kernel forgets which of them it found flat to within so much."""
    return _of(kernel.simplify(tolerance)).forgotten()


def _of(kernel: m3.Manifold) -> Solid:
    status = kernel.status()
    if status != m3.Error.NoError:
        raise ValueError(f"mesh kernel: {status}")
    mesh = kernel.to_mesh64()
    solid = Solid(np.asarray(mesh.vert_properties)[:, :3], _ordered(np.asarray(mesh.tri_verts).astype(np.int64)))
    solid.__dict__["_kernel"] = kernel
    return solid


def _ordered(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same triangles in an order of their own: the kernel's tells which of its objects was made first."""
    if len(triangles) == 0:
        return triangles
    count = int(triangles.max()) + 1
    first = triangles.argmin(1)[:, None]
    turned = np.take_along_axis(triangles, (first + np.arange(3)) % 3, 1)
    return turned[np.argsort((turned[:, 0] * count + turned[:, 1]) * count + turned[:, 2])]


def _boxes_meet(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return bool((a[0] <= b[1]).all() and (b[0] <= a[1]).all())
