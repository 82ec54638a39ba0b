"""What every rung of the fitness study says about a body and costs, and how well rungs rank bodies.

The gold was chosen before any result was seen: the best speed without exploration that the long training reached at
any of its checkpoints. Beside it stands the speed in randomised episodes at the end of the same training.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

Array = NDArray[np.float64]
Row = dict[str, Any]  # a line of bodies.jsonl; one of an older version may lack fields

RESAMPLES, SEED = 2000, 0  # of the bootstrap over bodies
LEAST = 3  # bodies that a correlation needs
BASELINE = "open-loop gait, thorough: score"


@dataclass(frozen=True, slots=True)
class Rung:
    """A cheap answer to how fast a body will be.

    Attributes:
        name: in tables.
        value: of a body, the more the better.
        needs: names of all that has to be run for it, as they stand in the rows after "cpu_".
        cost: CPU seconds beyond those [s].
    """

    name: str
    value: Callable[[Row], Any]
    needs: tuple[str, ...]
    cost: Callable[[Row], float] = lambda _: 0.0

    def values(self, rows: Sequence[Row]) -> Array:
        """Of every body; NaN where a row does not say."""
        return np.array([_number(self.value, row) for row in rows])

    def seconds(self, rows: Sequence[Row]) -> float:
        """Median CPU seconds; NaN where no row says."""
        found = np.array(
            [_number(lambda r: sum(r[f"cpu_{name}"] for name in self.needs) + self.cost(r), r) for r in rows]
        )
        return float(np.median(found[np.isfinite(found)])) if np.isfinite(found).any() else float("nan")


def _number(value: Callable[[Row], Any], row: Row) -> float:
    try:
        return float(value(row))
    except (KeyError, IndexError, TypeError, ValueError):
        return float("nan")


def gold(row: Row) -> float:
    """What rungs are measured by: the best speed without exploration that the long training reached [m/s]."""
    return _number(lambda r: max(point["speed"] for point in r["training"]), row)


def robust_gold(row: Row) -> float:
    """The speed in randomised episodes when the long training ended [m/s]."""
    return _number(lambda r: r["training"][-1]["robust"], row)


def cheap_rungs() -> tuple[Rung, ...]:
    """What needs no learning: random gaits and the search for a gait."""

    def speeds(row: Row) -> Array:  # a body of which every random gait explodes stands still
        return np.sort([gait["speed"] for gait in row["random"]] or [0.0])[::-1]

    def steady(row: Row) -> float:
        return max((gait["speed"] * gait["upright"] for gait in row["random"]), default=0.0)

    once = ("random",)
    return (
        Rung("random gaits: greatest", lambda r: speeds(r)[0], once),
        Rung("random gaits: greatest, upright", steady, once),
        Rung("random gaits: mean of the best 3", lambda r: speeds(r)[:3].mean(), once),
        Rung("random gaits: 75 % quantile", lambda r: np.quantile(speeds(r), 0.75), once),
        Rung("random gaits: mean", lambda r: speeds(r).mean(), once),
        Rung("random gaits: median", lambda r: np.median(speeds(r)), once),
        Rung("open-loop gait, screening: score", lambda r: r["screening"]["score"], ("screening",)),
        Rung("open-loop gait, screening: speed", lambda r: r["screening"]["speed"], ("screening",)),
        Rung(BASELINE, lambda r: r["thorough"]["score"], ("thorough",)),
        Rung("open-loop gait, thorough: speed", lambda r: r["thorough"]["speed"], ("thorough",)),
    )


def rungs(rows: Sequence[Row]) -> tuple[Rung, ...]:
    """All rungs of the study; what builds on a gait counts the search for it."""
    found = list(cheap_rungs())
    starts = max((len(row.get("race") or ()) for row in rows), default=0)
    for k in range(starts):

        def share(row: Row) -> float:
            return float(row["cpu_race"]) / len(row["race"])

        what = "corrected gait" if k == 0 else f"free, heading {k} of {starts - 1}"
        found.append(Rung(f"short PPO: {what}", lambda r, k=k: r["race"][k], ("thorough",), share))  # type: ignore[misc]
    if starts:
        found.append(Rung(f"short PPO: best of {starts}", lambda r: max(r["race"]), ("thorough", "race")))
    points = max((len(row.get("training") or ()) for row in rows), default=0)
    for k in range(points):
        for what, key in (("exploring", "exploring"), ("the policy itself", "speed"), ("randomised", "robust")):

            def cost(row: Row, k: int = k, key: str = key) -> float:
                learning = [float(p["cpu"]) for p in row["training"]]
                judging = (float(row["cpu_training"]) - sum(learning)) / len(learning)  # once, not at every point
                return sum(learning[: k + 1]) + judging * (key != "exploring")

            name = f"PPO at {100 * (k + 1) / points:.0f} %: {what}"
            value = lambda r, k=k, key=key: r["training"][k][key]  # noqa: E731
            found.append(Rung(name, value, ("thorough", "race"), cost))
    return tuple(found)


def rank(fitness: Array, truth: Array) -> float:
    """Spearman's correlation over the bodies where both are known; 0 where either says the same of every body."""
    known = np.isfinite(fitness) & np.isfinite(truth)
    return float(ranks(fitness[known][None], truth[known][None])[0]) if known.sum() >= LEAST else float("nan")


def ranks(fitness: Array, truth: Array) -> Array:
    """Spearman's correlation of every row of (m, n); ties share their mean rank."""
    x, y = (rankdata(values, axis=1) for values in (fitness, truth))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    spread = np.sqrt((x * x).sum(axis=1) * (y * y).sum(axis=1))
    return np.asarray((x * y).sum(axis=1) / np.where(spread > 0, spread, 1.0))


def interval(fitness: Array, truth: Array) -> tuple[float, float]:
    """95 % bootstrap interval of `rank` over bodies."""
    known = np.isfinite(fitness) & np.isfinite(truth)
    fitness, truth = fitness[known], truth[known]
    if len(truth) < LEAST:
        return float("nan"), float("nan")
    picks = np.random.default_rng(SEED).integers(0, len(truth), (RESAMPLES, len(truth)))
    low, high = np.quantile(ranks(fitness[picks], truth[picks]), [0.025, 0.975])
    return float(low), float(high)
