"""All triangles of some shapes, and what rays meet of them: the only importer of embreex."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfg.shape import F32, Shape

NOTHING = -1  # what a ray met where it met no shape


class Soup:
    """All triangles of some shapes, ready to be hit."""

    def __init__(self, shapes: Sequence[Shape], ids: Sequence[int]) -> None:
        """Hand the triangles of the shapes to the ray caster; `ids` are what the shapes are told apart by."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        counts = [len(s.triangles) for s in shapes]
        start = np.cumsum([0, *(len(s.vertices) for s in shapes)])
        self.owner = np.repeat(np.asarray(ids, np.int32), counts)
        self.shapes = shapes
        self.scene: Any = EmbreeScene()
        if shapes:
            vertices = np.concatenate([s.vertices for s in shapes]).astype(np.float32)
            triangles = np.concatenate([s.triangles + k for s, k in zip(shapes, start, strict=False)]).astype(np.int32)
            TriangleMesh(self.scene, vertices, triangles)

    @cached_property
    def normals(self) -> F32:
        """Of all triangles' corners, (m, 3, 3)."""
        return np.concatenate([s.normals for s in self.shapes])

    def owners(self, origin: F32, ray: F32) -> NDArray[np.int32]:
        """Which shape each ray meets first, by its id, or NOTHING."""
        if not self.shapes:
            return np.full(len(ray), NOTHING, np.int32)
        triangle = self.scene.run(np.ascontiguousarray(origin), np.ascontiguousarray(ray))
        return np.where(triangle >= 0, self.owner[triangle], np.int32(NOTHING)).astype(np.int32)

    def hit(self, origin: F32, ray: F32) -> tuple[NDArray[np.int32], F32, F32]:
        """What each ray meets first: index of the triangle or -1, how far along the ray, normal there (k, 3)."""
        if not self.shapes or not len(ray):
            far = np.full(len(ray), np.inf, np.float32)
            return np.full(len(ray), -1, np.int32), far, np.zeros((len(ray), 3), np.float32)
        answer = self.scene.run(np.ascontiguousarray(origin), np.ascontiguousarray(ray), output=1)
        triangle = answer["primID"]
        met = triangle >= 0
        far = np.where(met, answer["tfar"], np.float32(np.inf))
        u, v = answer["u"][met, None], answer["v"][met, None]
        corner = self.normals[triangle[met]]
        normal = np.zeros((len(ray), 3), np.float32)
        normal[met] = unit(corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v)
        return triangle, far, normal

    def blocked(self, origin: F32, ray: F32, reach: float) -> NDArray[np.bool_]:
        """True where a ray meets anything within `reach` [m]."""
        if not self.shapes or not len(ray):
            return np.zeros(len(ray), bool)
        limit = np.full(len(ray), reach, np.float32)
        return np.asarray(self.scene.run(np.ascontiguousarray(origin), ray, dists=limit, query="OCCLUDED")) >= 0


def unit(vectors: F32) -> F32:
    """Each vector (n, 3) at length 1; a zero one stays."""
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return vectors / np.maximum(length, np.float32(1e-12))[:, None]
