"""Cables as elastic bands: least bending between their straight ends, pushed out of whatever they come too near to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.route_field import RouteField
from mfg.wires import resampled

Array = NDArray[np.float64]
MARGIN = 4e-4  # by how much farther than it must a band keeps from everything [m]
TENSION = 0.003  # weight of length against bending, per square of the step


@dataclass(frozen=True, eq=False, slots=True)
class Band:
    """One cable as a chain of points about one step apart.

    Attributes:
        points: (n, 3) [m].
        fixed: how many points at either end stay where they are.
        smoothing: (n - 2 fixed, n) matrix that maps targets of the free points and the fixed points to the chain of
            least bending near them.
    """

    points: Array
    fixed: tuple[int, int]
    smoothing: Array

    @staticmethod
    def of(way: Array, step: float, stiffness: float) -> Band:
        """A band along a way whose first and last stretch stay straight.

        Args:
            way: (k, 3), the ends of the straight stretches second and last but one [m].
            step: between points [m].
            stiffness: weight of bending against closeness to the targets, in steps to the fourth.
        """
        head = _evenly(way[0], way[1], step)
        tail = _evenly(way[-2], way[-1], step)
        middle = resampled(way[1:-1], step)
        points = np.concatenate([head[:-1], middle, tail[1:]])
        a, b = len(head), len(tail)
        n = len(points)
        bend = np.diff(np.eye(n), n=2, axis=0)
        pull = np.diff(np.eye(n), axis=0)
        energy = stiffness * (bend.T @ bend + TENSION * pull.T @ pull)
        free = slice(a, n - b)
        inverse = np.linalg.inv(np.eye(n - a - b) + energy[free, free])
        smoothing = np.concatenate([-inverse @ energy[free, :a], inverse, -inverse @ energy[free, n - b :]], axis=1)
        return Band(points, (a, b), smoothing)


def relaxed(
    way: Array, field: RouteField, others: Array, apart: float, step: float, stiffness: float, rounds: int
) -> Array:
    """Bend as little as the field and the other tunnels allow: alternating directions of multipliers.

    Each round smooths the band towards targets, and takes as targets the nearest points that keep clear; what the two
    disagree on is carried over, so that in the end they agree.

    Args:
        way: see `Band.of`.
        field: of the free room.
        others: points of other tunnels, at most a few millimetres apart, (m, 3) [m].
        apart: least distance to their centre lines [m].
        step: between points of the band [m].
        stiffness: weight of bending against closeness to the targets, in steps to the fourth.
        rounds: how many.

    Returns:
        The band's points, (n, 3); it may come too near to things where there is no room.
    """
    band = Band.of(way, step, stiffness)
    points = band.points.copy()
    head, tail = band.fixed
    free = slice(head, len(points) - tail)
    box = band.points.min(axis=0) - apart - 0.01, band.points.max(axis=0) + apart + 0.01
    others = others[((others >= box[0]) & (others <= box[1])).all(axis=1)]
    carried = np.zeros_like(points[free])
    for _ in range(rounds):
        target = points[free] + carried
        target += _pushed(target, others, field, apart)
        carried += points[free] - target
        wanted = np.concatenate([points[:head], target - carried, points[len(points) - tail :]])
        points[free] = band.smoothing @ wanted
    return points


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
    squared = ((points[:, None] - others) ** 2).sum(axis=2)
    nearest = squared.argmin(axis=1)
    return np.sqrt(squared[np.arange(len(points)), nearest]), nearest


def _evenly(a: Array, b: Array, step: float) -> Array:
    count = max(2, round(float(np.linalg.norm(b - a)) / step)) + 1
    return a + np.linspace(0, 1, count)[:, None] * (b - a)
