"""The verdict on one body, with given parts or with parts sized to it: the same in every command and every worker."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from decoder.design import VoxelDesign
from mfg.catalogue import Catalogue
from mfg.library import Library
from mfg.parts import PAPER
from mfg.pipeline import DEFAULT, RULES, Outcome, Rules, run, score
from mfg.selection import Drivers, Margins

if TYPE_CHECKING:
    from evo.sizing import Sized

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True)
class Judge:
    """Can a body be built, and how easily? The answer depends on these fields and the design alone.

    With a library the parts are sized by `evo.sizing.sized` to the gait of the robot that they make; the seed of its
    search is the design's key, so that one body has one answer wherever it is asked.

    Attributes:
        rules: of the pipeline.
        catalogue: the parts; with a library its filaments, printer and joint encoder only.
        library: motors, batteries, controllers and wires to choose from; None for those of the catalogue.
        drivers: which of its motors count, see `mfg.selection.Margins`: "only" for robots that `hardware` shall drive.
    """

    rules: Rules = DEFAULT
    catalogue: Catalogue = PAPER
    library: Library | None = None
    drivers: Drivers = "prefer"

    def score(self, design: VoxelDesign, progress: Progress | None = None) -> Outcome:
        """Verdict and five scores without exact solids.

        Args:
            design: the body.
            progress: told (round, rounds, names of the parts) before each search of a gait, where parts are sized.
        """
        if self.library is None:
            return score(design, self.catalogue, self.rules)
        start = time.perf_counter()
        found = self.sized(design, self.library, progress).verdict
        spent = time.perf_counter() - start - sum(found.seconds.values())
        return replace(found, seconds=found.seconds | {"sizing": spent})

    def build(self, design: VoxelDesign, progress: Progress | None = None) -> Outcome:
        """The whole blueprint: as `score`, then exact printable solids, masses and scores re-checked on them."""
        scored = self.score(design, progress)
        if not scored.ok:
            return scored
        built = run(RULES[self.rules][-1:], scored.blueprint)
        return replace(built, seconds=scored.seconds | built.seconds)

    def sized(self, design: VoxelDesign, library: Library, progress: Progress | None = None) -> Sized:
        """The parts of a library that bear the robot that they make of a design, round by round."""
        from evo.sizing import sized  # the simulator is loaded where parts are sized, and only there.

        rng = np.random.default_rng(int(design.key, 16))
        margins = Margins(drivers=self.drivers)
        return sized(design, rng, library, base=self.catalogue, solve=self._solve, margins=margins, progress=progress)

    def _solve(self, design: VoxelDesign, catalogue: Catalogue) -> Outcome:
        return score(design, catalogue, self.rules)


DEFAULT_JUDGE = Judge()
