"""Binary STL, and the weld that makes a solid survive it: the first place where metres end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfg.solids import Solid

MM_PER_M = 1000.0
# Corners are snapped to 2^-14 mm. A 32-bit float holds every such number up to 1024 mm exactly, so a mesh that is closed
# on this lattice is still closed after it has been written as STL and welded again by whoever reads it.
LATTICE = 2.0**-14  # [mm]
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def welded(solid: Solid) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Snap to the lattice, merge equal corners, drop collapsed triangles: vertices [mm] (n, 3), triangles (m, 3)."""
    snapped = np.round(solid.vertices * (MM_PER_M / LATTICE)).astype(np.int64)
    unique, index = np.unique(snapped, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[solid.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    used, index = np.unique(triangles, return_inverse=True)
    return unique[used] * LATTICE, index.reshape(-1, 3)


def is_closed(triangles: NDArray[np.int64]) -> bool:
    """Every edge belongs to exactly two triangles that run along it in opposite directions."""
    if not len(triangles):
        return False
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = int(triangles.max()) + 1
    forward = np.sort(edges[:, 0] * count + edges[:, 1])
    backward = np.sort(edges[:, 1] * count + edges[:, 0])
    return bool((forward[1:] != forward[:-1]).all() and np.array_equal(forward, backward))


def stl_bytes(vertices: NDArray[np.float64], triangles: NDArray[np.int64], name: str) -> bytes:
    """A binary STL of a mesh in the units of `vertices`; same input, same bytes."""
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    records = np.zeros(len(triangles), _RECORD)
    records["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    records["corners"] = corners
    # A binary file must not begin with "solid": readers would take it for text.
    header = f"bodyplan {name}".encode("ascii", "replace")[:80].ljust(80)
    return header + np.uint32(len(triangles)).tobytes() + records.tobytes()
