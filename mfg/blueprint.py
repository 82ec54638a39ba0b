"""The one record that every solver takes and returns a new version of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from decoder.design import VoxelDesign
from mfg.catalogue import Catalogue, Size
from mfg.outcome import Scores

if TYPE_CHECKING:
    from mfg.fields import Field
    from mfg.solids import Solid

Transform = NDArray[np.float64]  # (4, 4) homogeneous; T_a_b maps coordinates in frame b to frame a


@dataclass(frozen=True, eq=False, slots=True)
class Tree:
    """The kinematic tree over bodies, root first.

    Attributes:
        segments: segment id of each body; body 0 is the root and a parent always comes before its children.
        parent: body index of each body's parent, -1 for the root.
        joint: index into `design.joints` of the joint that holds each body, -1 for the root.
        flipped: True where the design's joint names this body as the *parent*: the axis turns sign, the range does not.
    """

    segments: tuple[int, ...]
    parent: tuple[int, ...]
    joint: tuple[int, ...]
    flipped: tuple[bool, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Hinge:
    """One joint of the tree as it will be built; hinge k moves body k + 1.

    Attributes:
        body: index of the moved (child) body.
        parent: index of the body that carries it.
        position: a point on the axis [m], design frame.
        axis: unit vector, design frame; the child turns about it by the right-hand rule.
        range: feasible angles [rad], (2,); starts as the design's and is narrowed by the motion solver.
    """

    body: int
    parent: int
    position: NDArray[np.float64]
    axis: NDArray[np.float64]
    range: NDArray[np.float64]

    @property
    def name(self) -> str:
        """Joint name in every exported file."""
        return f"joint_{self.body}"


@dataclass(frozen=True, eq=False, slots=True)
class Body:
    """One rigid segment and the soft tissue that belongs to it.

    Attributes:
        name: body name in every exported file.
        segment: id in the design.
        bone: depth field of the rigid part, positive inside [m].
        skin: depth field of rigid and soft together (the outer surface), or None where there is no soft tissue.
    """

    name: str
    segment: int
    bone: Field
    skin: Field | None = None


@dataclass(frozen=True, eq=False, slots=True)
class MotorSeat:
    """Where one hinge's motor sits (paper Eq. 2-3).

    Attributes:
        hinge: index into `blueprint.hinges`.
        holder: body that holds the motor's housing.
        connector: body that is screwed to its output.
        offset: delta along the hinge axis [m].
        T_design_motor: pose of the motor frame (origin at its centre, z along the axis towards the output).
        holder_volume: V_h, overlap of the holder with its body [m3].
        connector_volume: V_c [m3].
        score: S(delta), in [m3].
        turn: angle about the axis from the fixed rule of `motor_pose` to the motor frame's x axis [rad].
        safety: strength over stress of the weaker half of the mount under the peak torque, or None where nobody asked.
    """

    hinge: int
    holder: int
    connector: int
    offset: float
    T_design_motor: Transform
    holder_volume: float
    connector_volume: float
    score: float
    turn: float = 0.0
    safety: float | None = None


@dataclass(frozen=True, eq=False, slots=True)
class BoxSeat:
    """Where an electronics box sits in a body.

    Attributes:
        kind: "battery" or "controller".
        body: index of the host.
        size: extents along the box's own axes [m], without clearance.
        T_design_box: pose of the box frame (origin at its centre); inserted along -z, so +z points at its opening.
        clearance: gap all around in the cavity [m].
        shaft: how far the insertion shaft reaches above the box centre along +z [m].
    """

    kind: Literal["battery", "controller"]
    body: int
    size: Size
    T_design_box: Transform
    clearance: float
    shaft: float


@dataclass(frozen=True, eq=False, slots=True)
class Crossing:
    """Where a cable passes from one bone to the next, free to follow the joint between them.

    Attributes:
        hinge: index into `blueprint.hinges`.
        position: middle of the free stretch [m], (3,).
        span: length of the free stretch in the rest pose [m].
        needed: least free length at the lower and the upper end of the joint's range [m].
        slack: cable to be left over there beyond the tunnel's length [m].
    """

    hinge: int
    position: NDArray[np.float64]
    span: float
    needed: tuple[float, float]
    slack: float


@dataclass(frozen=True, eq=False, slots=True)
class WireRun:
    """One cable tunnel from the controller box to a motor.

    Attributes:
        name: e.g. "wire_2".
        seat: index into `blueprint.seats` of the motor it serves.
        path: centre line in the design frame [m], (k, 3), from the controller to the motor.
        radius: of the tunnel [m].
        crossings: of joints, from the controller on, where slack was worked out.
    """

    name: str
    seat: int
    path: NDArray[np.float64]
    radius: float
    crossings: tuple[Crossing, ...] = ()

    @property
    def length(self) -> float:
        """Length of the centre line [m]."""
        return float(np.linalg.norm(np.diff(self.path, axis=0), axis=1).sum())

    @property
    def slack(self) -> float:
        """Cable left over at the joints [m]."""
        return sum(crossing.slack for crossing in self.crossings)

    @property
    def cable_length(self) -> float:
        """Length of cable to cut: tunnel and slack [m]."""
        return self.length + self.slack


@dataclass(frozen=True, eq=False, slots=True)
class PrintedPart:
    """One printed solid in the design frame, exactly as it goes to the printer (build only).

    Attributes:
        name: of its file and in every table.
        body: index of the body that it moves with.
        material: of which of the two filaments.
        solid: its shape.
        piece: which printed object of the body it belongs to: "" where there is one, "1", "2", ... of a body that was
            cut, "lid_battery" or "lid_controller".
    """

    name: str
    body: int
    material: Literal["rigid", "soft"]
    solid: Solid
    piece: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class LidSeat:
    """A lid over the opening of an electronics box (build only).

    Attributes:
        box: index into `blueprint.boxes`.
        part: name of the printed part.
        screws: where the heads of its screws rest [m], (n, 3); all point along -z of the box.
        notch: middle of the notch at its edge through which leads come out, at the opening [m], (3,).
    """

    box: int
    part: str
    screws: NDArray[np.float64]
    notch: NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class MassProperties:
    """A rigid body's mass distribution.

    Attributes:
        mass: [kg].
        com: centre of mass in the design frame [m], (3,).
        inertia: about the centre of mass, in design axes [kg.m2], (3, 3).
    """

    mass: float
    com: NDArray[np.float64]
    inertia: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Blueprint:
    """A design on its way to a printer. Empty tuples are stages that have not run yet."""

    design: VoxelDesign
    catalogue: Catalogue
    tree: Tree | None = None
    bodies: tuple[Body, ...] = ()
    hinges: tuple[Hinge, ...] = ()
    seats: tuple[MotorSeat, ...] = ()  # seats[k] drives hinges[k]
    boxes: tuple[BoxSeat, ...] = ()
    wires: tuple[WireRun, ...] = ()
    parts: tuple[PrintedPart, ...] = ()
    lids: tuple[LidSeat, ...] = ()
    masses: tuple[MassProperties, ...] = ()  # of each body with everything in it
    scores: Scores = field(default_factory=Scores)
    notes: tuple[str, ...] = ()  # what was repaired or dropped, for the report
    rules: str | None = None  # by which it is made (`mfg.pipeline.Rules`); None where solvers are called one by one

    def box(self, kind: str) -> BoxSeat:
        """The seat of the battery or the controller."""
        return next(seat for seat in self.boxes if seat.kind == kind)

    def pointing(self, seat: MotorSeat) -> int:
        """+1 where a motor's output points along its hinge's axis, -1 where it points against it."""
        return 1 if self.hinges[seat.hinge].axis @ seat.T_design_motor[:3, 2] > 0 else -1

    def noted(self, note: str) -> Blueprint:
        """The same blueprint with one more note."""
        return replace(self, notes=(*self.notes, note))

    def scored(self, **scores: float) -> Blueprint:
        """The same blueprint with some scores set."""
        return replace(self, scores=replace(self.scores, **scores))
