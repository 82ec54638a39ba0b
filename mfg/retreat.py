"""A solid that steps back from its own surface, by less than anything can print, so that it meets nothing it touches.

Corners in a file are rounded to a lattice, and two parts with one surface between them have different triangles on
either side of it: rounded, they share a film about as thick as the lattice is fine. And what two surfaces share that
coincide to within the error of a boolean is not even well told. Parts that first step back by more than rounding moves
a corner share nothing, neither with one another nor with the hardware and the cables that they touch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfg.solids import Solid
from mfg.stl import LATTICE, MM_PER_M

# A quarter of a micrometre. Rounding moves a corner by 0.87 steps of the lattice at most; the rest is for corners that
# cannot step back from all of their faces alike.
RETREAT = 4 * LATTICE / MM_PER_M  # [m]
_STIFFNESS = 1e-2  # of a corner against ways that its faces hardly ask for: none goes farther than five depths


def retreated(solid: Solid, depth: float = RETREAT) -> Solid:
    """The solid with all of its faces moved inwards by `depth` [m]: the same triangles between other corners.

    Each corner goes the way d that minimises the sum of w (n . d - depth)^2 over the faces about it, which is what they
    all ask for on a flat face, an edge and the corner of a box. n points inwards, and w is the face's angle there
    [rad], so that it does not matter into what triangles a flat face is cut. A corner nearer than `depth` to an edge
    that it is not on may end up beyond that edge: what parts still share in a file lies there.
    """
    x, y, z, angles = _faces(solid)
    slot = solid.triangles.T.ravel()

    def about(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(slot, (angles * values).ravel(), len(solid.vertices)).astype(np.float64, copy=False)

    stiff = _STIFFNESS * about(np.ones_like(x)) + 1e-12  # a corner of nothing but slivers stays where it is
    xx, yy, zz = about(x * x) + stiff, about(y * y) + stiff, about(z * z) + stiff
    xy, xz, yz = about(x * y), about(x * z), about(y * z)
    a, b, c = about(x), about(y), about(z)
    # The inverse of the symmetric matrix (xx xy xz, xy yy yz, xz yz zz), written out: a general solver takes longer.
    A, B, C = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    D, E, F = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    way = np.stack([A * a + B * b + C * c, B * a + D * b + E * c, C * a + E * b + F * c], axis=1)
    way *= (depth * (1 + _STIFFNESS) / (xx * A + xy * B + xz * C))[:, None]
    return Solid(solid.vertices + way, solid.triangles)


def _faces(solid: Solid) -> tuple[NDArray[np.float64], ...]:
    """Of every triangle the inward normal's x, y and z (m,), and its angles [rad] (3, m)."""
    a, b, c = (solid.vertices[corner].T for corner in solid.triangles.T)
    edges = np.stack([b - a, c - b, a - c])
    u, v = edges[0], edges[1]
    normal = np.stack([u[2] * v[1] - u[1] * v[2], u[0] * v[2] - u[2] * v[0], u[1] * v[0] - u[0] * v[1]])
    double_area = np.sqrt((normal * normal).sum(0))
    normal /= np.maximum(double_area, 1e-300)
    return *normal, np.arctan2(double_area, -(edges * edges[[2, 0, 1]]).sum(1))
