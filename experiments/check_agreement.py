"""Check that the fast verdict and scores of random designs are those of the full path.

    python -m experiments.check_agreement -n 300 --seed 0

`bodyplan build` runs the solvers of `bodyplan score` and then decides again on exact solids. So a design that the fast
path passes is built and compared; one that it refuses for its print is finished all the same, to see whether the exact
path would have taken it; one refused earlier has no exact path of its own and counts as agreeing, and is counted apart.
Status 1 if verdicts agree on less than 99 % or a score differs by more than 0.05.
"""

from __future__ import annotations

import argparse
import collections
import multiprocessing
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiments.output import DONE, INFEASIBLE, add_decoder_option, add_solver_option, progress

if TYPE_CHECKING:
    from experiments.output import Solvers

LEAST_AGREEMENT, MOST_DIFFERENCE = 0.99, 0.05  # of the benchmark


@dataclass(frozen=True, slots=True)
class Comparison:
    """One design: what the two paths said, and the largest difference between their scores."""

    index: int
    fast: str
    full: str
    difference: float

    @property
    def kind(self) -> str:
        """passed, print, or earlier: which exact decision the fast one was held against."""
        return "passed" if self.fast == "passed" else "print" if self.fast.startswith("print") else "earlier"

    @property
    def agrees(self) -> bool:
        """Whether the verdicts are the same, stage by stage."""
        return self.fast.split(":")[0] == self.full.split(":")[0]


def main(argv: list[str] | None = None) -> int:
    """Run the check; status 1 if the benchmark is missed."""
    parser = argparse.ArgumentParser(prog="python -m experiments.check_agreement", description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=300, help="random designs (300)")
    parser.add_argument("--seed", type=int, default=0, help="of the random designs (0)")
    add_decoder_option(parser)
    add_solver_option(parser)
    parser.add_argument("--workers", type=int, default=2, help="processes (2)")
    args = parser.parse_args(argv)
    tasks = [(args.decoder, args.solver, args.seed, index) for index in range(args.n)]
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        found = list(progress(pool.imap(compare, tasks), args.n, "comparing"))
    counts = collections.Counter(c.kind for c in found)
    agreeing = sum(c.agrees for c in found)
    largest = max((c.difference for c in found), default=0.0)
    for c in found:
        if not c.agrees or c.difference > MOST_DIFFERENCE:
            print(f"design {c.index}: fast {c.fast} | full {c.full} | scores differ by {c.difference:.3f}")
    print(f"verdicts agree on {agreeing} of {args.n} designs ({100 * agreeing / args.n:.1f} %)")
    print(f"  {counts['passed']} passed fast, {counts['print']} refused for their print, {counts['earlier']} earlier")
    print(f"largest difference of a score: {largest:.4f}")
    good = agreeing >= LEAST_AGREEMENT * args.n and largest <= MOST_DIFFERENCE
    return DONE if good else INFEASIBLE


def compare(task: tuple[str, Solvers, int, int]) -> Comparison:
    """Take the design of (decoder, seed, index) through both paths of some rules."""
    import numpy as np

    from decoder.latent import sample_latents
    from experiments.study import decoder_of
    from mfg.outcome import Failure, Stage
    from mfg.pipeline import RULES, score

    name, rules, seed, index = task
    design = decoder_of(name).decode(sample_latents(1, np.random.default_rng([seed, index])))[0]
    outcome = score(design, rules=rules)
    fast = "passed" if outcome.failure is None else str(outcome.failure)
    if outcome.failure is not None and outcome.failure.stage != Stage.PRINT:
        return Comparison(index, fast, fast, 0.0)
    full = RULES[rules][-1].solve(outcome.blueprint)
    if isinstance(full, Failure):
        return Comparison(index, fast, str(full), 0.0)
    pairs = zip(outcome.scores.values(), full.scores.values(), strict=True)
    difference = max(abs(a - b) for a, b in pairs if a is not None and b is not None)
    return Comparison(index, fast, "passed", difference)


if __name__ == "__main__":
    sys.exit(main())
