"""Cables as elastic bands: least bending between their straight ends, pushed out of whatever they come too near to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from mfg.route_field import RouteField
from mfg.wires import resampled

Array = NDArray[np.float64]
MARGIN = 4e-4  # by how much farther than it must a band keeps from everything [m]
TENSION = 0.003  # weight of length against bending, per square of the step


def relaxed(
    way: Array, field: RouteField, others: Array, apart: float, step: float, schedule: tuple[tuple[float, int], ...]
) -> Array:
    """Bend as little as the field and the other tunnels allow: alternating directions of multipliers.

    Each round smooths the band towards targets, and takes as targets the nearest points that keep clear; what the two
    disagree on is carried over, so that in the end they agree.

    Args:
        way: (k, 3), the ends of its straight approaches second and last but one [m].
        field: of the free room.
        others: points of other tunnels, at most a few millimetres apart, (m, 3) [m].
        apart: least distance to their centre lines [m].
        step: between points of the band [m].
        schedule: weight of bending against closeness to the targets, in steps to the fourth, and how many rounds.

    Returns:
        The band's points, (n, 3); it may come too near to things where there is no room.
    """
    head, tail = _evenly(way[0], way[1], step), _evenly(way[-2], way[-1], step)
    middle = resampled(way[1:-1], step)[1:-1]
    points = np.concatenate([head, middle, tail])
    free = slice(len(head), len(head) + len(middle))
    low, high = points.min(axis=0) - apart - 0.01, points.max(axis=0) + apart + 0.01
    others = others[((others >= low) & (others <= high)).all(axis=1)]
    moving, carried, before = middle, np.zeros((len(middle), 3)), 0.0
    points[free] = 0.0
    steady = _force(points)[free]  # of the straight ends alone
    for weight, rounds in schedule:
        # What is carried over is a force over the weight of closeness.
        carried *= weight / before if before else 0.0
        before = weight
        stiff = cholesky_banded(_stiffness(len(middle), weight), check_finite=False)
        for _ in range(rounds):
            target = moving + carried
            target += _pushed(target, others, field, apart)
            carried += moving - target
            moving = cho_solve_banded((stiff, False), target - carried - weight * steady, check_finite=False)
    points[free] = moving
    return points


def _force(points: Array) -> Array:
    """Gradient of half the squares of second differences, and of first ones by `TENSION`, but for the ends: (n, 3)."""
    bend = np.diff(points, n=2, axis=0)
    force = np.zeros_like(points)
    force[2:-2] = np.diff(bend, n=2, axis=0) - TENSION * bend[1:-1]
    return force


def _stiffness(count: int, weight: float) -> Array:
    """1 + `weight` times what `_force` is of so many points in a row, its upper diagonals, the main one last."""
    rows = np.zeros((3, count))
    rows[0, 2:] = weight
    rows[1, 1:] = weight * (-4 - TENSION)
    rows[2] = 1 + weight * (6 + 2 * TENSION)
    return rows


def _pushed(points: Array, others: Array, field: RouteField, apart: float) -> Array:
    """By how much points (n, 3) must move to keep clear [m]."""
    push = np.zeros_like(points)
    short = MARGIN - field.clearance.sample(points).astype(np.float64)
    low = np.flatnonzero(short > 0)
    if len(low):
        push[low] = np.minimum(short[low], field.clearance.spacing)[:, None] * field.slope(points[low])
    if len(others):
        away, nearest = nearest_of(points, others)
        gap = apart + MARGIN - away
        close = np.flatnonzero(gap > 0)
        out = (points[close] - others[nearest[close]]) / np.maximum(away[close], 1e-6)[:, None]
        push[close] += gap[close][:, None] * out
    return push


def nearest_of(points: Array, others: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distance from each point (n, 3) to the nearest of others (m, 3), and which one that is."""
    nearest = ((others**2).sum(axis=1) - 2 * points @ others.T).argmin(axis=1)
    return np.linalg.norm(points - others[nearest], axis=1), nearest


def _evenly(a: Array, b: Array, step: float) -> Array:
    count = max(2, round(float(np.linalg.norm(b - a)) / step)) + 1
    return a + np.linspace(0, 1, count)[:, None] * (b - a)
