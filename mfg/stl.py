"""Binary STL, and the weld that makes a solid survive it: the first place where metres end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfg.solids import Solid

MM_PER_M = 1000.0
# Corners are snapped to 2^-14 mm. A 32-bit float holds every such number up to 1024 mm exactly, so a mesh that is
# closed on this lattice is still closed after it has been written as STL and welded again by whoever reads it.
LATTICE = 2.0**-14  # [mm]
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def welded(solid: Solid) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Snap to the lattice, merge equal corners, drop collapsed triangles: vertices [mm] (n, 3), triangles (m, 3)."""
    snapped = np.round(solid.vertices * (MM_PER_M / LATTICE)).astype(np.int64)
    unique, index = _distinct(snapped)
    triangles = index[solid.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    used, index = np.unique(triangles, return_inverse=True)
    return unique[used] * LATTICE, index.reshape(-1, 3)


def _distinct(rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """The distinct rows (n, 3) in a fixed order, and where each row went (twice a one-dimensional search: fast)."""
    low = rows.min(0)
    x, y, z = (rows - low).T
    span = int((rows.max(0) - low).max()) + 1
    _, pair = np.unique(x * span + y, return_inverse=True)
    _, first, index = np.unique(pair * span + z, return_index=True, return_inverse=True)
    return rows[first], index


def torn_edges(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Edges (k, 2) that do not belong to exactly two triangles running along them in opposite directions."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = int(edges.max(initial=0)) + 1
    forward = np.sort(edges[:, 0] * count + edges[:, 1])
    backward = np.sort(edges[:, 1] * count + edges[:, 0])
    if np.array_equal(forward, backward) and (forward[1:] != forward[:-1]).all():
        return np.zeros((0, 2), np.int64)
    low, high = edges.min(1), edges.max(1)
    undirected, inverse, uses = np.unique(low * count + high, return_inverse=True, return_counts=True)
    balance = np.bincount(inverse, np.where(edges[:, 0] < edges[:, 1], 1, -1))
    torn = undirected[(uses != 2) | (balance != 0)]
    return np.stack([torn // count, torn % count], axis=1)


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
