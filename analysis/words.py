"""What stages, reasons and scores mean, in plain words."""

from __future__ import annotations

from mfg.outcome import Reason, Stage

STAGES: dict[str, str] = {
    Stage.SKELETON: "The body is one tree of rigid segments joined by hinges.",
    Stage.MOTOR: "Every hinge has room for its motor, and both bodies hold on to it.",
    Stage.ELECTRONICS: "Battery and controller box fit inside a rigid body, and can be put there.",
    Stage.WIRE: "A cable tunnel leads from every motor to the controller.",
    Stage.PRINT: "Every part is one closed solid that fits the printer.",
    Stage.WORKER: "The computation itself ended with an answer.",
}

REASONS: dict[str, str] = {
    Reason.NO_JOINT: "The body has no hinge, so nothing of it can move.",
    Reason.DISCONNECTED: "Some of the body hangs together with the rest by no hinge.",
    Reason.CYCLE: "Segments hang together in a loop; a robot of this kind must be a tree.",
    Reason.TOO_THIN: "A rigid segment is so thin that nothing of it is left to print.",
    Reason.NO_MOTION: "A hinge cannot turn far enough before the bodies beside it touch.",
    Reason.NO_OVERLAP: "A body is too far from its hinge, or too slight there, to hold the motor or its output.",
    Reason.WEAK_MOUNT: "A body is too slight around its hinge to stand the motor's peak torque.",
    Reason.NO_PART: "No part of those to choose from meets what the robot's own gait asks of it.",
    Reason.UNSETTLED: "The choice of parts never repeats: each makes a robot that asks for others.",
    Reason.MOTOR_COLLISION: "A motor would sit inside another motor.",
    Reason.NO_ACCESS: "Two motors sit so close in one body that one of them cannot be put in or screwed down.",
    Reason.BONE_SEVERED: "Making room for the motor would cut a rigid body in pieces.",
    Reason.NO_ROOM: "No rigid body is large enough inside for the battery or the controller box.",
    Reason.NO_ROUTE: "No cable tunnel leads from some motor to the controller within the rigid bodies.",
    Reason.SHARP_BEND: "A cable tunnel turns too sharply for a cable to be pushed around.",
    Reason.TOO_LARGE: "A part does not fit the printer in any orientation.",
    Reason.NOT_WATERTIGHT: "A part is not one closed solid, so a slicer would guess what is inside.",
    Reason.OVERLAP: "Two parts claim the same space.",
    Reason.CRASHED: "The computation for this design ended with an error; the design itself may be fine.",
    Reason.TIMED_OUT: "The computation for this design took too long and was stopped.",
}

# Column of the run file, name, meaning; in the paper's order.
SCORES: tuple[tuple[str, str, str], ...] = (
    ("motor", "motor", "How firmly and evenly both bodies hold every motor."),
    (
        "electronics",
        "electronics",
        "How much room the body that hosts the electronics has inside; less if it is hard to print.",
    ),
    ("cable", "cable", "Short cables without sharp bends."),
    ("electronics_install", "electronics installation", "Free space above the boxes, so that a hand can put them in."),
    ("body_install", "body installation", "Rigid bodies do not share space once the motors are in."),
)
SCORE_COLUMNS = dict(
    zip(("s_motor", "s_elec", "s_cable", "s_elec_inst", "s_body_inst"), (s[0] for s in SCORES), strict=True)
)
