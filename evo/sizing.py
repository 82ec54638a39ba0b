"""`catalogue = "auto"`: parts sized to the gait that they make, round by round until the choice repeats.

A round: the pipeline scores the design with a catalogue, a gait is searched on the robot that comes out, its torques
and speeds say what is needed, and `mfg.selection` chooses the next catalogue. Motors that do not fit the body are left
out as the rounds meet them. The start is the lightest motor that fits, so that the climb ends at the first one that
bears its own robot; `Margins.drivers` says whether motors that this program cannot drive count. A body can be built
with chosen parts if some choice bears the robot that it makes: where the choice repeats (FIXED), or, where it goes
round or no part meets what one robot of it needs, if another robot of it bears itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from decoder.design import VoxelDesign
from evo.needs import needs_of
from mfg.blueprint import Blueprint
from mfg.catalogue import Catalogue
from mfg.description import describe
from mfg.library import Library
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.pipeline import Outcome, score
from mfg.repair import progress as reached
from mfg.selection import Margins, Needs, Selection, Unmet, controllers_for, select, suits, unmet
from sim.gaits import SCREENING, GaitBudget, search_gait
from sim.model import compile_model
from sim.rollout import Diverged

ROUNDS = 6

PART_STAGES = {
    "motor": Stage.MOTOR, "battery": Stage.ELECTRONICS, "controller": Stage.ELECTRONICS, "wire": Stage.WIRE,
}  # fmt: skip
PAST_MOTORS = (Stage.ELECTRONICS, Stage.WIRE, Stage.PRINT)  # where another controller may help

Score = Callable[[VoxelDesign, Catalogue], Outcome]


class End(StrEnum):
    """How sizing ended."""

    FIXED = "fixed"  # the choice repeated
    CYCLE = "cycle"  # an earlier choice came back, or is all that bears its own robot
    NO_FIT = "no_fit"  # no parts meet the need and fit the body
    ROUNDS = "rounds"  # still changing after the last round


@dataclass(frozen=True, slots=True)
class Round:
    """One round of sizing.

    Attributes:
        catalogue: that the robot had.
        mass: of that robot [kg].
        speed: of its gait [m/s].
        needs: of its gait.
        chosen: the parts for these needs, or which of them no part meets.
        lacking: what of the needs the robot's own parts did not meet, or None.
    """

    catalogue: Catalogue
    mass: float
    speed: float
    needs: Needs
    chosen: Selection | Unmet
    lacking: Unmet | None


@dataclass(frozen=True, eq=False, slots=True)
class Sized:
    """What sizing came to.

    Attributes:
        catalogue: whose parts bear the robot that they make; None where there is none.
        outcome: of the pipeline with that catalogue, or of the try that got furthest.
        end: how it ended.
        failure: why the body cannot be built with chosen parts; None where there is a catalogue.
        reason: one line for people.
        rounds: what was needed and chosen.
        refused: (motor, why the body does not take it), as met.
    """

    catalogue: Catalogue | None
    outcome: Outcome
    end: End
    failure: Failure | None
    reason: str
    rounds: tuple[Round, ...]
    refused: tuple[tuple[str, Failure], ...]

    @property
    def verdict(self) -> Outcome:
        """The outcome as commands judge it: with this failure, or with a note of what was chosen."""
        if self.failure is not None:
            return replace(self.outcome, failure=self.failure)
        catalogue = self.outcome.blueprint.catalogue
        note = f"parts chosen in {len(self.rounds)} round(s): {', '.join(_names(catalogue))}"
        if self.end is not End.FIXED:
            note += f"; they bear their own robot, but the choice did not repeat ({self.end})"
        if catalogue.motor.driver == "none":
            note += f"; this program has no driver for {catalogue.motor.name}, so it cannot deploy a policy on it"
        return replace(self.outcome, blueprint=self.outcome.blueprint.noted(note))


def sized(
    design: VoxelDesign, rng: np.random.Generator, parts: Library, *, base: Catalogue = PAPER,
    solve: Score = score, budget: GaitBudget = SCREENING, margins: Margins | None = None, duration: float = 900.0,
    rounds: int = ROUNDS, progress: Callable[[int, int, str], None] | None = None,
) -> Sized:  # fmt: skip
    """Size the parts of a design to a fixed point, or say why there is none; the same `rng` gives the same answer.

    Args:
        design: the body.
        rng: for the gait search, which starts alike in every round: equal parts then have equal needs.
        parts: to choose from.
        base: gives filaments, printer and joint encoder.
        solve: the pipeline, `mfg.pipeline.score` or one with other solvers.
        budget: of the gait search.
        margins: of the choice, and which motors count.
        duration: of the work that the battery must last [s].
        rounds: at most.
        progress: told (round, rounds, names of the parts) before each gait search.
    """
    margins = margins or Margins()
    seed = int(rng.integers(2**63))
    body = _Body(design, base, parts, solve, margins)
    started = body.first()
    if started is None:
        return body.unfit()
    outcome, done = started, list[Round]()
    for number in range(1, rounds + 1):
        catalogue = outcome.blueprint.catalogue
        if progress is not None:
            progress(number, rounds, " + ".join(_names(catalogue)))
        try:
            this = _measured(outcome.blueprint, seed, budget, duration, parts, base, margins)
        except Diverged as error:
            # Physics that explodes says nothing about the body, so it is a lost measurement.
            reason = f"no gait to size from: {error}"
            failure = Failure(Stage.WORKER, Reason.CRASHED, reason)
            return body.ended(None, outcome, End.NO_FIT, reason, done, failure)
        done.append(this)
        following = body.next(this)
        if isinstance(following, Unmet):
            kept, reason = _best(done), _no_fit(following, body, _best(done))
            failure = Failure(PART_STAGES[following.what], Reason.NO_PART, reason)
            return body.ended(kept, outcome, End.NO_FIT if kept is None else End.CYCLE, reason, done, failure)
        names = _names(following.blueprint.catalogue)
        if names == _names(catalogue):
            return body.ended(catalogue, outcome, End.FIXED, f"{catalogue.motor.name} bears its own robot", done)
        earlier = [r for r in done if _names(r.catalogue) == names]
        if earlier:
            cycle = done[done.index(earlier[0]) :]
            kept = _best(cycle)
            path = " > ".join(" + ".join(_names(r.catalogue)) for r in cycle)
            verdict = "none of them bears its own robot" if kept is None else f"kept {_kept(kept)}"
            return body.unsettled(kept, outcome, End.CYCLE, f"the choice goes round: {path}; {verdict}", done)
        outcome = following
    kept = _best(done)
    verdict = "none bore its own robot" if kept is None else f"kept {_kept(kept)}"
    return body.unsettled(kept, outcome, End.ROUNDS, f"still changing after {rounds} rounds; {verdict}", done)


def _measured(
    blueprint: Blueprint, seed: int, budget: GaitBudget, duration: float, parts: Library, base: Catalogue,
    margins: Margins,
) -> Round:  # fmt: skip
    description = describe(blueprint)
    model = compile_model(description)
    found = search_gait(model, np.random.default_rng(seed), budget)
    needs = needs_of(model, found.gait, duration)
    chosen = select(needs, parts, base, margins)
    return Round(blueprint.catalogue, description.mass, found.speed, needs, chosen,
                 unmet(blueprint.catalogue, needs, margins))  # fmt: skip


class _Body:
    """One design and the parts that it has not refused yet."""

    def __init__(self, design: VoxelDesign, base: Catalogue, parts: Library, solve: Score, margins: Margins) -> None:
        self.design, self.base, self.parts, self.solve, self.margins = design, base, parts, solve, margins
        self.refused: dict[str, Failure] = {}
        self.tried: dict[tuple[str, ...], Outcome] = {}
        self.closest: Outcome | None = None  # of the tries that failed

    def first(self) -> Outcome | None:
        """The design with the first motor that fits it, in the order of preference, and the lightest other parts."""
        rank = {"only": lambda m: (m.mass, m.name), "any": lambda m: (m.mass, m.name),
                "prefer": lambda m: (m.driver == "none", m.mass, m.name)}[self.margins.drivers]  # fmt: skip
        motors = [m for m in self.parts.motors if m.driver != "none" or self.margins.drivers != "only"]
        for motor in sorted(motors, key=rank):
            batteries = [battery for battery in self.parts.batteries if suits(battery, motor)]
            if not batteries or not self.parts.wires or not self.parts.controllers:
                continue
            lightest = min(batteries, key=lambda b: (b.mass, b.name))
            wire = min(self.parts.wires, key=lambda w: (w.mass_per_metre, w.name))
            catalogue = replace(self.base, name="auto", motor=motor, battery=lightest, wire=wire)
            outcome = self.fitted(catalogue, len(self.design.joints))
            if outcome.ok:
                return outcome
            if outcome.blueprint.tree is None:
                return None  # Not even a skeleton: no part mends that.
        return None

    def next(self, this: Round) -> Outcome | Unmet:
        """The design with the parts chosen for a round's needs; motors that do not fit with them are passed over."""
        chosen, left = this.chosen, self.parts
        while isinstance(chosen, Selection):
            outcome = self.fitted(chosen.catalogue, len(this.needs.joints))
            if outcome.ok:
                return outcome
            misfit = chosen.catalogue.motor.name
            left = left.only(motor for motor in left.motors if motor.name != misfit)
            chosen = select(this.needs, left, self.base, self.margins)
        return chosen

    def fitted(self, catalogue: Catalogue, joints: int) -> Outcome:
        """Score with the lightest controller that fits; where none does, the motor is refused."""
        outcome: Outcome | None = None
        for computer in controllers_for(joints, self.parts.controllers) or [catalogue.computer]:
            parts = replace(catalogue, computer=computer)
            names = _names(parts)
            if names not in self.tried:
                self.tried[names] = self.solve(self.design, parts)
            outcome = self.tried[names]
            if outcome.failure is None:
                return outcome
            if self.closest is None or reached(outcome) > reached(self.closest):
                self.closest = outcome
            if outcome.failure.stage not in PAST_MOTORS:
                break
        assert outcome is not None and outcome.failure is not None  # noqa: PT018 - one fact about the loop above
        self.refused.setdefault(catalogue.motor.name, outcome.failure)
        return outcome

    def ended(
        self, kept: Catalogue | None, last: Outcome, end: End, reason: str, done: list[Round],
        failure: Failure | None = None,
    ) -> Sized:  # fmt: skip
        """The answer: with the catalogue that was kept, or with the last robot."""
        outcome, why = (last, failure) if kept is None else (self.tried[_names(kept)], None)
        return Sized(kept, outcome, end, why, reason, tuple(done), tuple(self.refused.items()))

    def unsettled(self, kept: Catalogue | None, last: Outcome, end: End, reason: str, done: list[Round]) -> Sized:
        """The answer where the choice does not repeat."""
        return self.ended(kept, last, end, reason, done, Failure(Stage.MOTOR, Reason.UNSETTLED, reason))

    def unfit(self) -> Sized:
        """The answer where the body takes no motor: the failure of the try that got furthest."""
        if self.closest is None or self.closest.failure is None:
            outcome = self.solve(self.design, self.base)
            failure = Failure(Stage.MOTOR, Reason.NO_PART, "there is no motor with a battery, a controller and a wire")
        else:
            outcome, failure = self.closest, self.closest.failure
        named = outcome.blueprint.tree is not None and failure is outcome.failure
        if named:  # Else no motor is to blame.
            tries = f"no motor of {len(self.refused)} fits; closest, {outcome.blueprint.catalogue.motor.name}"
            failure = replace(failure, detail=f"{tries}: {failure.detail}")
        refused = tuple(self.refused.items())
        return Sized(None, outcome, End.NO_FIT, failure, f"no motor fits the body: {failure}", (), refused)


def _names(catalogue: Catalogue) -> tuple[str, ...]:
    return catalogue.motor.name, catalogue.battery.name, catalogue.computer.name, catalogue.wire.name


def _kept(catalogue: Catalogue) -> str:
    return f"{' + '.join(_names(catalogue))}, which bears its own robot"


def _best(rounds: list[Round]) -> Catalogue | None:
    """The catalogue of the lightest robot that bears itself."""
    able = [r for r in rounds if r.lacking is None]
    return min(able, key=lambda r: r.mass).catalogue if able else None


def _no_fit(lack: Unmet, body: _Body, kept: Catalogue | None) -> str:
    refused = ", ".join(f"{name} ({failure.stage}: {failure.reason})" for name, failure in body.refused.items())
    text = f"{lack}" + (f"; the body does not take {refused}" if refused else "")
    return text if kept is None else f"{text}; kept {_kept(kept)}"
