"""A triangle mesh of one colour, smooth except over creases: what pictures are made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Colour = tuple[float, float, float]
F32 = NDArray[np.float32]

CREASE = float(np.cos(np.radians(38.0)))  # faces that bend less than this are shaded as one smooth surface


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh of one colour.

    Attributes:
        vertices: (n, 3) [m].
        triangles: (m, 3) vertex indices, counter-clockwise seen from outside.
        colour: red, green, blue in [0, 1], as on a screen.
        alpha: 1 is opaque, 0 invisible.
        ghost: how much of an opaque shape shows through opaque ones before it, 0 nothing.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    colour: Colour
    alpha: float = 1.0
    ghost: float = 0.0

    @cached_property
    def normals(self) -> F32:
        """Unit normal at each corner of each triangle, smooth except over creases, (m, 3, 3)."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        weighted = np.cross(b - a, c - a)
        facet = weighted / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-30)
        # Each corner adds up the faces around its vertex, by area, that do not lie beyond a crease.
        vertex = self.triangles.ravel()
        around = np.argsort(vertex, kind="stable")
        degree = np.bincount(vertex, minlength=len(self.vertices))
        first = np.cumsum(degree) - degree
        count = degree[vertex]
        corner = np.repeat(np.arange(len(vertex)), count)
        step = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count)
        face = around[first[vertex[corner]] + step] // 3
        smooth = np.einsum("ij,ij->i", facet[corner // 3], facet[face]) > CREASE
        corner, face = corner[smooth], face[smooth]
        total = np.stack([np.bincount(corner, weighted[face, k], len(vertex)) for k in range(3)], axis=1)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        normal = np.where(length > 0, total / np.maximum(length, 1e-30), np.repeat(facet, 3, axis=0))
        return normal.reshape(-1, 3, 3).astype(np.float32)

    def moved(self, transform: NDArray[np.float64]) -> Shape:
        """The shape under a (4, 4) rigid transform; its normals are turned with it, not computed again."""
        rotation = np.asarray(transform, np.float64)[:3, :3]
        shape = replace(self, vertices=self.vertices @ rotation.T + transform[:3, 3])
        shape.__dict__["normals"] = self.normals @ rotation.T.astype(np.float32)
        return shape
