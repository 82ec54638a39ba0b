"""How many designs each stage lets through (paper Table I), as integer counts that add up."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from mfg.outcome import Stage

PASSED = "passed"
STAGES = tuple(str(stage) for stage in Stage)
OUTCOMES = (*STAGES, PASSED)
# A design whose worker was lost says nothing about any stage, so it leaves before the first.
ORDER = (str(Stage.WORKER), *(stage for stage in STAGES if stage != Stage.WORKER))
PAPER_REMAINING = {"motor": 0.8924, "electronics": 0.7785, "wire": 0.9987, PASSED: 0.6696}  # paper Table I, n = 1000
_Z = 1.959963984540054  # 97.5 % quantile of the normal law


@dataclass(frozen=True, slots=True)
class StageRow:
    """One line of the table.

    Attributes:
        stage: failure class.
        reached: designs that came to it.
        failed: those it stopped.
        remaining: share of those that reached it which passed it; None if none did.
    """

    stage: str
    reached: int
    failed: int

    @property
    def remaining(self) -> float | None:
        """Remaining ratio (paper Table I)."""
        return None if self.reached == 0 else (self.reached - self.failed) / self.reached


@dataclass(frozen=True, slots=True)
class PassThrough:
    """Counts of every outcome; they add up to n by construction.

    Attributes:
        counts: designs by outcome, every one of `OUTCOMES`.
    """

    counts: dict[str, int]

    @property
    def n(self) -> int:
        """How many designs there are."""
        return sum(self.counts.values())

    @property
    def passed(self) -> int:
        """How many can be built."""
        return self.counts[PASSED]

    @property
    def rate(self) -> float | None:
        """R_pass = N_succ / N_tot (paper Eq. 4); None without designs."""
        return self.passed / self.n if self.n else None

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the pass rate."""
        return wilson(self.passed, self.n)

    def rows(self) -> list[StageRow]:
        """Stage by stage; their remaining ratios multiply to the pass rate."""
        rows, reached = [], self.n
        for stage in ORDER:
            rows.append(StageRow(stage, reached, self.counts[stage]))
            reached -= self.counts[stage]
        return rows


def pass_through(outcomes: Iterable[str]) -> PassThrough:
    """Count outcomes, each a failure class or "passed".

    Raises:
        ValueError: if one is neither.
    """
    counts = Counter(str(outcome) for outcome in outcomes)
    unknown = sorted(set(counts) - set(OUTCOMES))
    if unknown:
        raise ValueError(f"outcome is {unknown[0]!r}; it must be one of {', '.join(OUTCOMES)}")
    return PassThrough({outcome: counts[outcome] for outcome in OUTCOMES})


def wilson(successes: float, n: int) -> tuple[float, float]:
    """95 % Wilson score interval of a proportion; (0, 1) when nothing was counted.

    Raises:
        ValueError: if successes do not lie in [0, n].
    """
    if not 0 <= successes <= n:
        raise ValueError(f"successes are {successes}; they must lie in [0, {n}]")
    if n == 0:
        return 0.0, 1.0
    p, z2 = successes / n, _Z * _Z
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    # Rounding must not push a bound past the proportion that it bounds.
    return max(0.0, min(middle - half, p)), min(1.0, max(middle + half, p))
