"""The solvers in order, and the two ways to run them: `score` (fields only, fast) and `build` (exact solids)."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from decoder.design import VoxelDesign
from mfg.blueprint import Blueprint
from mfg.bones import BoneSolver
from mfg.catalogue import Catalogue
from mfg.electronics import ElectronicsSolver
from mfg.electronics_search import SearchElectronicsSolver
from mfg.finish import FinishSolver
from mfg.motion import MotionSolver
from mfg.motion_search import SearchMotionSolver
from mfg.motor_search import FUSED, SearchMotorSolver
from mfg.motors import MotorSolver
from mfg.outcome import Failure, Scores
from mfg.parts import PAPER
from mfg.printability import PrintabilitySolver
from mfg.skeleton import SkeletonSolver
from mfg.skins import SkinSolver
from mfg.wire_search import SearchWireSolver
from mfg.wires import WireSolver


class Solver(Protocol):
    """One manufacturing constraint, O = N(I, theta): the fields of the solver are theta (paper Eq. 1)."""

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with this constraint resolved, or why it cannot be."""
        ...


BODIES: tuple[Solver, ...] = (SkeletonSolver(), BoneSolver(), SkinSolver())  # before any hardware
VIRTUAL: tuple[Solver, ...] = (SkeletonSolver(), BoneSolver(fine=False), SkinSolver(fine=False))
SCORING: tuple[Solver, ...] = (
    *BODIES,
    MotionSolver(),
    MotorSolver(),
    ElectronicsSolver(),
    WireSolver(),
    PrintabilitySolver(),
)
BUILDING: tuple[Solver, ...] = (*SCORING, FinishSolver())

SEARCHING: tuple[Solver, ...] = (
    *BODIES,
    SearchMotionSolver(touch=0.06),  # as much as the paper's rule lets bones share: no joint turns less than by that
    SearchMotorSolver(),
    SearchElectronicsSolver(),
    SearchWireSolver(),
    PrintabilitySolver(split=True),
    FinishSolver(min_overlap=FUSED, lids=True, split=True),
)

Rules = Literal["paper", "search"]
RULES: Mapping[Rules, tuple[Solver, ...]] = {"paper": BUILDING, "search": SEARCHING}  # the last makes exact solids
DEFAULT: Rules = "search"  # wherever a design is solved and nobody says by which rules


def scoring(rules: Rules) -> tuple[Solver, ...]:
    """The solvers that give the verdict: all but the one that makes exact solids."""
    return RULES[rules][:-1]


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """What a pipeline made of one design.

    Attributes:
        blueprint: as far as the solvers got.
        failure: why they stopped, or None.
        seconds: wall time of every solver that ran, by its name.
    """

    blueprint: Blueprint
    failure: Failure | None
    seconds: dict[str, float]

    @property
    def design(self) -> VoxelDesign:
        """The design it started from."""
        return self.blueprint.design

    @property
    def ok(self) -> bool:
        """Whether every solver succeeded."""
        return self.failure is None

    @property
    def scores(self) -> Scores:
        """The scores of the stages that were passed."""
        return self.blueprint.scores

    def to_json(self, out: str | None = None) -> dict[str, Any]:
        """The object that `bodyplan score` and `bodyplan build` print."""
        failure, scores, parts = self.failure, self.scores, self.blueprint.catalogue
        return {
            "design": self.design.key,
            "ok": self.ok,
            "failure": None
            if failure is None
            else {"stage": str(failure.stage), "reason": str(failure.reason), "detail": failure.detail},
            "scores": {
                "motor": scores.motor,
                "electronics": scores.electronics,
                "cable": scores.cable,
                "electronics_install": scores.electronics_install,
                "body_install": scores.body_install,
                "total": scores.total,
            },
            "catalogue": {
                "name": parts.name,
                "motor": parts.motor.name,
                "battery": parts.battery.name,
                "controller": parts.computer.name,
                "wire": parts.wire.name,
            },
            "notes": list(self.blueprint.notes),
            "seconds": {name: round(seconds, 4) for name, seconds in self.seconds.items()},
            "out": out,
        }


def run(solvers: tuple[Solver, ...], blueprint: Blueprint) -> Outcome:
    """Pass a blueprint through solvers in order until one fails."""
    seconds: dict[str, float] = {}
    for solver in solvers:
        start = time.perf_counter()
        answer = solver.solve(blueprint)
        name = type(solver).__name__.removesuffix("Solver").removeprefix("Search").lower()
        seconds[name] = time.perf_counter() - start
        if isinstance(answer, Failure):
            return Outcome(blueprint, answer, seconds)
        blueprint = answer
    return Outcome(blueprint, None, seconds)


def virtual(design: VoxelDesign, catalogue: Catalogue = PAPER) -> Outcome:
    """Bones and skins only, as fine as weighing and touching need: the virtual robot, before any hardware."""
    return run(VIRTUAL, Blueprint(design, catalogue))


def score(design: VoxelDesign, catalogue: Catalogue = PAPER, rules: Rules = DEFAULT) -> Outcome:
    """Verdict and five scores without exact solids or files: the fast path, used as fitness."""
    return run(scoring(rules), Blueprint(design, catalogue, rules=rules))


def build(design: VoxelDesign, catalogue: Catalogue = PAPER, rules: Rules = DEFAULT) -> Outcome:
    """The whole blueprint: as `score`, then exact printable solids, masses and scores re-checked on them."""
    return run(RULES[rules], Blueprint(design, catalogue, rules=rules))
