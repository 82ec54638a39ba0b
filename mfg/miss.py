"""How far a body missed a requirement, for programs that mend bodies: what is short, where, and how much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Remedy = Literal["grow_near_joint", "thicken_near_joint", "move_joints_apart", "grow_body", "clear_way", "none"]
Unit = Literal["m", "m3", "rad", "1"]


@dataclass(frozen=True, slots=True)
class Miss:
    """The closest miss of one requirement; joints and bodies are those of the blueprint that the failure left.

    Before there are bodies they have their segments' places in its tree.

    Attributes:
        what: the quantity that falls short, e.g. "shared volume".
        unit: of what there is and what there must be; "1" for a ratio.
        have: what there is; None where the solver cannot say.
        need: what there must be at least, or at most where it is below what there is; None where it cannot be said.
        joints: indices into `blueprint.hinges` of the joints that are to blame.
        bodies: indices into `blueprint.bodies` of the bodies that lack material or are in the way.
        grow: by how much bone must grow to mend it, or joints part, where that is known [m].
        direction: unit vector in the design frame along which bone must grow or a way become free, or None.
        remedy: the kind of change that would mend it.
        detail: one sentence for people, where the failure says more than that.
    """

    what: str
    unit: Unit
    have: float | None = None
    need: float | None = None
    joints: tuple[int, ...] = ()
    bodies: tuple[int, ...] = ()
    grow: float = 0.0
    direction: tuple[float, float, float] | None = None
    remedy: Remedy = "none"
    detail: str = ""

    @property
    def shortfall(self) -> float:
        """How much is lacking, or too much [unit]; 0 where that cannot be said."""
        return 0.0 if self.have is None or self.need is None else abs(self.need - self.have)
