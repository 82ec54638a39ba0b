"""The vocabulary that solvers, evolution and analysis share: where a design failed, why, and what it scored."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import StrEnum

from mfg.miss import Miss


class Stage(StrEnum):
    """Failure classes, in the order in which a design meets them (paper Table I, plus the classes it folds in)."""

    SKELETON = "skeleton"
    MOTOR = "motor"
    ELECTRONICS = "electronics"
    WIRE = "wire"
    PRINT = "print"
    WORKER = "worker"


class Reason(StrEnum):
    """Why a solver said no."""

    NO_JOINT = "no_joint"
    DISCONNECTED = "disconnected"
    CYCLE = "cycle"
    TOO_THIN = "too_thin"
    NO_MOTION = "no_motion"
    NO_OVERLAP = "no_overlap"
    WEAK_MOUNT = "weak_mount"
    NO_PART = "no_part"
    UNSETTLED = "unsettled"
    MOTOR_COLLISION = "motor_collision"
    NO_ACCESS = "no_access"
    BONE_SEVERED = "bone_severed"
    NO_ROOM = "no_room"
    NO_ROUTE = "no_route"
    SHARP_BEND = "sharp_bend"
    TOO_LARGE = "too_large"
    NOT_WATERTIGHT = "not_watertight"
    OVERLAP = "overlap"
    CRASHED = "crashed"
    TIMED_OUT = "timed_out"


@dataclass(frozen=True, slots=True)
class Failure:
    """A design that cannot be built: a value, never an exception.

    Attributes:
        stage: where it failed.
        reason: why.
        detail: the closest miss in words, with numbers.
        miss: the same for programs, where a joint or a body is to blame; not shown and not compared.
    """

    stage: Stage
    reason: Reason
    detail: str
    miss: Miss | None = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        """One line for people."""
        return f"{self.stage}: {self.reason} ({self.detail})"


@dataclass(frozen=True, slots=True)
class Scores:
    """The five manufacturability scores, each in [0, 1]; None where the design did not get that far."""

    motor: float | None = None
    electronics: float | None = None
    cable: float | None = None
    electronics_install: float | None = None
    body_install: float | None = None

    @property
    def total(self) -> float:
        """S_mfg in [0, 5]: the sum of the scores of the stages that were passed (paper Eq. 10)."""
        return sum(value for value in self.values() if value is not None)

    def values(self) -> tuple[float | None, ...]:
        """The five scores in the paper's order."""
        return tuple(getattr(self, f.name) for f in fields(self))
