"""Convex hulls of few corners: the shapes that a simulator collides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

TOUCH = 1e-6  # a point that stands out by less adds nothing, and single precision tells no less [m]
_ROUND = 40  # corners added at a time
# Of many points on a face square to an axis, a tilt finds a corner, where the axis itself would find any.
_TILT = np.array([3e-7, 2e-7, 1e-7])


def thinned(points: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """At most `most` corners of the convex hull of points (n, 3), in a fixed order, that leave out little.

    The points extreme in spread directions come first, those of the axes among them; then, in a few rounds, whichever
    points stand out farthest from the hull of the chosen ones. All are corners of the whole hull, which is never made.
    """
    if most >= len(points):
        return points[np.sort(ConvexHull(points).vertices)]
    axes = np.concatenate([np.eye(3), -np.eye(3)]) + _TILT
    directions = np.concatenate([axes, _spread_directions(max(most // 2 - 6, 1))])
    chosen = np.unique((directions @ points.T).argmax(1))
    middle = points[chosen].mean(axis=0)
    near = np.concatenate([(points - middle).T, np.ones((1, len(points)))]).astype(np.float32)
    left = np.arange(len(points))  # what may still stand out
    while len(chosen) < most:
        facets = ConvexHull(points[chosen] - middle).equations
        outside = facets.astype(np.float32) @ near
        farthest = outside.argmax(1)  # of each facet
        reach = outside[np.arange(len(facets)), farthest]
        rank = [int(k) for k in np.argsort(-reach, kind="stable") if reach[k] > TOUCH]
        fresh = list(dict.fromkeys(left[farthest[rank]].tolist()))
        if not fresh:
            break
        chosen = np.sort(np.concatenate([chosen, fresh[: min(_ROUND, most - len(chosen))]]).astype(np.int64))
        out = outside.max(0) > TOUCH
        left, near = left[out], near[:, out]
    return points[chosen]


def _spread_directions(count: int) -> NDArray[np.float64]:
    """Unit vectors spread evenly over the sphere (Fibonacci lattice), (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
