"""Fitness made of several cheap numbers: chosen on one half of the bodies, judged on the other.

A combination is the mean of the ranks of a few numbers among the bodies compared, as evolution can form it in a
generation. Which numbers, and whether a number of the body counts up or down, is chosen on a random half of the bodies
by rank correlation with the gold; what it is worth is its correlation on the other half, next to the thorough search
for a gait on that same half. Many halves make the comparison steady; the one chosen on all bodies is named, not judged.
Three pools are tried, from few candidates to many, because many fit noise. As the halves are of the same bodies, the
spread of the gain is no interval for new bodies.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from experiments.fitness_rungs import BASELINE, SEED, Row, Rung, cheap_rungs, gold, ranks

Array = NDArray[np.float64]

HALVES = 500  # random splits
ENOUGH = 8  # bodies below which halves say nothing
MORPHOLOGY = {"joints": "joints", "mass": "mass_kg", "body length": "body_length_m"}
POOLS = {  # name: most numbers of a combination, and whether a body's own may be among them
    "one gait number": (1, False),
    "up to two gait numbers": (2, False),
    "up to three numbers, the body's own too": (3, True),
}


@dataclass(frozen=True, eq=False)
class Candidates:
    """All combinations of some numbers of bodies.

    Attributes:
        names: of the combinations.
        members: indices into the numbers, of every combination.
        values: the numbers, known everywhere, (numbers, bodies).
    """

    names: tuple[str, ...]
    members: tuple[tuple[int, ...], ...]
    values: Array

    def of(self, bodies: NDArray[np.intp]) -> Array:
        """Every combination's fitness of some bodies, by their ranks among each other, (combinations, bodies)."""
        return self.shares @ np.nan_to_num(rankdata(self.values[:, bodies], axis=1))

    @cached_property
    def shares(self) -> Array:
        """The weight of every number in every combination, (combinations, numbers)."""
        found = np.zeros((len(self.members), len(self.values)))
        for row, member in zip(found, self.members, strict=True):
            row[list(member)] = 1.0 / len(member)
        return found


def candidates(rows: Sequence[Row], most: int, morphology: bool) -> Candidates:
    """Up to `most` numbers of which at least one is a gait's; a body's own numbers may count up or down."""
    numbers = [(r.name, r.values(rows)) for r in cheap_rungs()]
    gaits = len(numbers)
    for name, key in MORPHOLOGY.items() if morphology else ():
        value = Rung(name, lambda r, key=key: r[key], ()).values(rows)  # type: ignore[misc]
        numbers += [(f"more {name}", value), (f"less {name}", -value)]
    usable = [k for k, (_, value) in enumerate(numbers) if np.isfinite(value).all()]
    members = tuple(
        some for size in range(1, most + 1) for some in itertools.combinations(usable, size) if some[0] < gaits
    )
    names = tuple(" + ".join(numbers[k][0] for k in some) for some in members)
    return Candidates(names, members, np.array([value for _, value in numbers]))


def combinations(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """What choosing from each pool is worth; none for too few bodies, or if the baseline is not known of all."""
    truth = np.array([gold(row) for row in rows])
    rows, truth = [row for row, t in zip(rows, truth, strict=True) if np.isfinite(t)], truth[np.isfinite(truth)]
    if len(rows) < ENOUGH:
        return []
    pools = {name: candidates(rows, *limits) for name, limits in POOLS.items()}
    return [_worth(name, found, rows, truth) for name, found in pools.items() if BASELINE in found.names]


def _worth(pool: str, found: Candidates, rows: Sequence[Row], truth: Array) -> dict[str, Any]:
    base, rng = found.names.index(BASELINE), np.random.default_rng(SEED)  # the same halves for every pool
    chosen: Counter[str] = Counter()
    told = np.zeros((HALVES, 3))
    for split in range(HALVES):
        order = rng.permutation(len(rows))
        here, there = order[: len(rows) // 2], order[len(rows) // 2 :]
        best, score = _best(found, here, truth)
        tested = ranks(found.of(there)[[best, base]], np.repeat(truth[None, there], 2, axis=0))
        told[split] = score, *tested
        chosen[found.names[best]] += 1
    best, score = _best(found, np.arange(len(rows)), truth)
    selected, tested, baseline = told.mean(axis=0)
    gain = told[:, 1] - told[:, 2]
    return {
        "pool": pool, "bodies": len(rows), "candidates": len(found.names), "halves": HALVES,
        "selected_on": float(selected), "tested_on": float(tested), "baseline_tested_on": float(baseline),
        "gain": float(gain.mean()), "gain_quantiles": [float(q) for q in np.quantile(gain, [0.1, 0.5, 0.9])],
        "better_share": float((gain > 0).mean()),
        "chosen_most": [[name, times / HALVES] for name, times in chosen.most_common(3)],
        "chosen_on_all": found.names[best], "chosen_on_all_rank": score, "cpu_s": _seconds(found, best, rows),
    }  # fmt: skip


def _best(found: Candidates, bodies: NDArray[np.intp], truth: Array) -> tuple[int, float]:
    """The combination that ranks some bodies best; of equals the one with fewer numbers."""
    scores = ranks(found.of(bodies), np.repeat(truth[None, bodies], len(found.names), axis=0))
    best = int(np.argmax(np.round(scores, 9)))
    return best, float(scores[best])


def _seconds(found: Candidates, index: int, rows: Sequence[Row]) -> float:
    """Median CPU seconds of a combination; what two of its numbers share is run once."""
    cheap = cheap_rungs()
    needs = {name for k in found.members[index] if k < len(cheap) for name in cheap[k].needs}
    return Rung(found.names[index], gold, tuple(sorted(needs))).seconds(rows)
