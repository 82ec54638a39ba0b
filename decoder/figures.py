"""Measured figures with their 95 % intervals, the goals they are held against, and which of two sets is better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 1000
_Z = 1.959963984540054  # 97.5 % quantile of the normal law
_MOST_RATIO = 2.0  # beyond twice as good as its goal, a figure no longer speaks for its set
Direction = Literal["at least", "at most"]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured figure.

    Attributes:
        value: the estimate; nan where nothing could be measured.
        low: lower end of its 95 % interval.
        high: upper end.
        n: how many observations it rests on.
    """

    value: float
    low: float
    high: float
    n: int


NOTHING = Figure(math.nan, math.nan, math.nan, 0)


def share_of(outcomes: Sequence[bool] | NDArray[np.bool_]) -> Figure:
    """Share of true outcomes, with its Wilson score interval."""
    n = len(outcomes)
    if not n:
        return NOTHING
    p, z2 = float(np.count_nonzero(outcomes)) / n, _Z * _Z
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    # Rounding must not push a bound past the share that it bounds.
    return Figure(p, max(0.0, min(middle - half, p)), min(1.0, max(middle + half, p)), n)


def mean_of(groups: Sequence[Floats], seed: int) -> Figure:
    """Mean of all observations, with a bootstrap interval over groups: those of one body are drawn together."""
    return _pooled(groups, None, seed)


def quantile_of(groups: Sequence[Floats], q: float, seed: int) -> Figure:
    """The least observation with at least the share q of all at or below it; interval as for `mean_of`."""
    return _pooled(groups, q, seed)


def ratio_of(parts: Sequence[float], wholes: Sequence[float], seed: int) -> Figure:
    """Sum of the parts over the sum of the wholes, with a bootstrap interval over them; n is the sum of the wholes."""
    top, bottom = np.asarray(parts, np.float64), np.asarray(wholes, np.float64)
    if not bottom.sum() > 0:
        return NOTHING
    weights = _resamples(len(bottom), seed)
    drawn = weights @ bottom
    low, high = np.quantile((weights @ top)[drawn > 0] / drawn[drawn > 0], (0.025, 0.975))
    return Figure(float(top.sum() / bottom.sum()), float(low), float(high), round(float(bottom.sum())))


def _pooled(groups: Sequence[Floats], q: float | None, seed: int) -> Figure:
    values = np.concatenate([np.asarray(group, np.float64).ravel() for group in groups]) if len(groups) else np.zeros(0)
    if not len(values):
        return NOTHING
    owner = np.repeat(np.arange(len(groups)), [np.size(group) for group in groups])
    order = np.argsort(values, kind="stable")
    values, owner = values[order], owner[order]
    drawn = [_weighted(values, w[owner], q) for w in _resamples(len(groups), seed) if w[owner].any()]
    low, high = np.quantile(drawn, (0.025, 0.975))
    return Figure(_weighted(values, np.ones(len(values), np.int64), q), float(low), float(high), len(values))


def _resamples(n: int, seed: int) -> NDArray[np.int64]:
    """How often each of n groups is drawn in every bootstrap sample, (RESAMPLES, n)."""
    return np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), RESAMPLES)


def _weighted(values: Floats, weights: NDArray[np.int64], q: float | None) -> float:
    """Mean (q None) or q-quantile of ascending values, each counted as often as its weight says."""
    if q is None:
        return float((values * weights).sum() / weights.sum())
    total = np.cumsum(weights)
    return float(values[int(np.searchsorted(total, q * total[-1] * (1 - 1e-12)))])


@dataclass(frozen=True, slots=True)
class Bound:
    """One goal and what was measured.

    Attributes:
        name: of the figure, as the card prints it.
        goal: the value to reach, in `unit`, above 0.
        direction: whether a figure must be at least or at most its goal.
        value: what was measured, in `unit`; nan (nothing measured) never reaches a goal.
        n: how many observations that rests on.
        unit: "", "%", "°", "s", "MiB".
        weighed: whether `better` looks at it. What a machine takes says nothing about weights.
    """

    name: str
    goal: float
    direction: Direction
    value: float
    n: int
    unit: str = ""
    weighed: bool = True

    @property
    def reached(self) -> bool:
        """Whether the goal is met."""
        return self.value >= self.goal if self.direction == "at least" else self.value <= self.goal

    @property
    def ratio(self) -> float:
        """How much of the goal is met: 1 at the goal, more beyond it (at most 2), 0 where nothing was measured."""
        if math.isnan(self.value):
            return 0.0
        if self.direction == "at least":
            return min(max(self.value / self.goal, 0.0), _MOST_RATIO)
        return min(self.goal / self.value, _MOST_RATIO) if self.value > 0 else _MOST_RATIO


def merit(bounds: Sequence[Bound]) -> tuple[float, float]:
    """What `better` compares: the sum of the weighed ratios, each capped at 1, then the sum of the ratios.

    So falling short of one goal cannot be paid for by exceeding another, and every goal weighs the same; among sets
    that reach all goals, the one that exceeds them by more is better.
    """
    ratios = [bound.ratio for bound in bounds if bound.weighed]
    return round(sum(min(1.0, ratio) for ratio in ratios), 9), round(sum(ratios), 9)


def better(new: Sequence[Bound], old: Sequence[Bound]) -> bool:
    """Whether a new set of weights replaces the old one: its `merit` is greater. A tie keeps the old.

    Both must have been measured alike: same goals, same held-out bodies, same seed.

    Raises:
        ValueError: if their goals differ.
    """
    ours, theirs = ([(b.name, b.goal, b.direction) for b in bounds if b.weighed] for bounds in (new, old))
    if ours != theirs:
        odd = sorted({name for name, _, _ in set(ours) ^ set(theirs)})
        raise ValueError(f"the two sets were held against different goals ({', '.join(odd)}); measure both alike")
    return merit(new) > merit(old)
