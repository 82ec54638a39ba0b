"""How far a design missed a requirement, for programs that mend bodies: which body lacks what, where, and how much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from mfg.outcome import Stage

Remedy = Literal["grow_near_joint", "thicken_near_joint", "move_joints_apart", "none"]


@dataclass(frozen=True, slots=True)
class Miss:
    """The closest miss of a stage.

    Attributes:
        stage: that failed.
        joint: index into `blueprint.hinges`, or None where no joint is to blame.
        body: index into `blueprint.bodies` of the body that lacks material or is in the way, or None.
        segment: its id in the design, or None.
        short_volume: missing volume [m3].
        short_length: missing length [m].
        short_factor: missing share of a safety factor; 0.25 means that 1.5 of 2 were reached.
        remedy: the kind of change that would mend it.
        other: index of the other hinge where two joints are in each other's way, or None.
    """

    stage: Stage
    joint: int | None = None
    body: int | None = None
    segment: int | None = None
    short_volume: float = 0.0
    short_length: float = 0.0
    short_factor: float = 0.0
    remedy: Remedy = "none"
    other: int | None = None
