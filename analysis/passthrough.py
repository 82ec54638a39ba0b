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


@dataclass(frozen=True, slots=True)
class Paired:
    """Two rules on the same designs.

    Attributes:
        both: designs that pass by both.
        first: that pass by the first only.
        second: that pass by the second only.
        neither: that pass by none.
    """

    both: int
    first: int
    second: int
    neither: int

    @property
    def n(self) -> int:
        """How many designs there are."""
        return self.both + self.first + self.second + self.neither

    @property
    def difference(self) -> float | None:
        """Pass rate by the second rule less that by the first; None without designs."""
        return (self.second - self.first) / self.n if self.n else None

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the difference: Newcombe's hybrid score interval for paired data, method 10 (1998)."""
        if self.n == 0:
            return -1.0, 1.0
        n, a, b, c, d = self.n, self.both, self.second, self.first, self.neither
        p, q = (a + b) / n, (a + c) / n
        (p_low, p_high), (q_low, q_high) = wilson(a + b, n), wilson(a + c, n)
        margins = (a + b) * (c + d) * (a + c) * (b + d)
        covariance = float(a * d - b * c)
        if covariance > 0:  # Newcombe's continuity correction; it never turns the sign.
            covariance = max(covariance - n / 2, 0.0)
        phi = covariance / math.sqrt(margins) if margins else 0.0
        down, up = _hypotenuse(p - p_low, q_high - q, phi), _hypotenuse(p_high - p, q - q_low, phi)
        return max(-1.0, p - q - down), min(1.0, p - q + up)

    @property
    def p_value(self) -> float:
        """McNemar's exact test of no difference, two-sided: the designs that pass by one rule only, as coin tosses."""
        tosses, fewer = self.first + self.second, min(self.first, self.second)
        return min(1.0, 2 * sum(math.comb(tosses, k) for k in range(fewer + 1)) / 2**tosses)


def paired(first: Iterable[str], second: Iterable[str]) -> Paired:
    """Compare two rules by their outcomes of the same designs, in the same order.

    Raises:
        ValueError: if they are not equally many.
    """
    counts = Counter((a == PASSED, b == PASSED) for a, b in zip(first, second, strict=True))
    return Paired(counts[True, True], counts[True, False], counts[False, True], counts[False, False])


def _hypotenuse(a: float, b: float, phi: float) -> float:
    """Of two sides with correlation phi between them."""
    return math.sqrt(max(a * a - 2 * phi * a * b + b * b, 0.0))
