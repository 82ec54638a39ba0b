"""What evolution wants: task fitness combined with manufacturability by a stated rule, and how the rest is ordered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from mfg.outcome import Failure, Scores, Stage

MAX_S_MFG = 5.0  # five scores of at most 1 each (paper Eq. 10)

Mode = Literal["penalty", "constraint", "speed"]
RankKey = tuple[float, ...]  # smaller is better; compared entry by entry

# How far a design got, worst first. A design that its worker lost has shown nothing, so it comes before all stages.
_REACHED: tuple[Stage, ...] = (Stage.WORKER, *(stage for stage in Stage if stage is not Stage.WORKER))


@dataclass(frozen=True, slots=True)
class FitnessRule:
    """How speed and manufacturability make one number.

    With v the speed [m/s] and S_mfg in [0, 5]:

    - "penalty": F = v - weight (1 - S_mfg / 5). The weight is the speed that a perfectly buildable body may lose.
    - "constraint": F = v where S_mfg >= bound. Designs below the bound have no fitness and rank after those, the
      nearest to the bound first.
    - "speed": F = v; every design that can be built counts the same.

    Attributes:
        mode: which of the three.
        weight: [m/s], at least 0; used by "penalty".
        bound: in [0, 5]; used by "constraint".

    Raises:
        ValueError: if a value is out of its bounds.
    """

    mode: Mode = "penalty"
    weight: float = 0.2
    bound: float = 2.5

    def __post_init__(self) -> None:
        """Check the values."""
        if self.mode not in ("penalty", "constraint", "speed"):
            raise ValueError(f"fitness mode is {self.mode!r}; it must be 'penalty', 'constraint' or 'speed'")
        if not (math.isfinite(self.weight) and self.weight >= 0.0):
            raise ValueError(f"fitness weight is {self.weight}; it must be a finite speed of at least 0 m/s")
        if not 0.0 <= self.bound <= MAX_S_MFG:
            raise ValueError(f"fitness bound is {self.bound}; S_mfg lies in [0, {MAX_S_MFG:g}]")

    def fitness(self, speed: float, scores: Scores) -> float | None:
        """Combine speed [m/s] and scores of a design that passed every solver; None where the constraint is broken."""
        if self.mode == "penalty":
            return speed - self.weight * (1.0 - scores.total / MAX_S_MFG)
        if self.mode == "constraint" and scores.total < self.bound:
            return None
        return speed


DEFAULT_RULE = FitnessRule()


def rank_key(fitness: float | None, failure: Failure | None, scores: Scores) -> RankKey:
    """Order anything that was evaluated; smaller is better.

    First those with a fitness, by it. Then those that can be built but break the constraint, by S_mfg. Then those that
    cannot be built: whoever got to a later stage first, among equals the higher partial S_mfg. A design whose worker
    crashed or hung comes last. No failed design is ever given a fitness.

    Raises:
        ValueError: if a failed design has a fitness, or a fitness is not finite.
    """
    if failure is not None:
        if fitness is not None:
            raise ValueError(f"a design failed ({failure}) and has fitness {fitness}; a failure has none")
        return (2.0, -float(_REACHED.index(failure.stage)), -scores.total)
    if fitness is None:
        return (1.0, -scores.total, 0.0)
    if not math.isfinite(fitness):
        raise ValueError(f"fitness is {fitness}; it must be finite")
    return (0.0, -fitness, 0.0)
