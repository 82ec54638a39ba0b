"""How much longer than its tunnel a cable must be, so that every joint that it crosses can turn to both its ends."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Crossing, MotorSeat
from mfg.miss import Miss
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage

Array = NDArray[np.float64]


def crossings(blueprint: Blueprint, seat: int, path: Array, reserve: float) -> tuple[Crossing, ...] | Failure:
    """The joints that a cable crosses, and its slack at each.

    Between two bones the cable hangs free. Its least length when the joint stands at an angle is that of a string
    drawn tight from where it leaves the one to where it enters the other: straight, or around the mount where it
    passes beside that. The slack makes up for what the rest pose lacks at the worse end of the range, and a reserve.

    Args:
        blueprint: with bodies, hinges, seats and boxes.
        seat: index of the motor that the cable serves; it ends on that motor's holder.
        path: from the controller to the motor, (k, 3) [m].
        reserve: free length over what is needed [m].

    Returns:
        The crossings from the controller on, or a failure where the cable would pass between bodies without a joint.
    """
    spans = _spans(blueprint, seat, path)
    found = []
    for a, b, first, last in spans:
        joint = next((k for k, h in enumerate(blueprint.hinges) if {h.parent, h.body} == {a, b}), None)
        if joint is None:
            names = blueprint.bodies[a].name, blueprint.bodies[b].name
            detail = f"the cable would pass from {names[0]} to {names[1]}, which no joint holds"
            return Failure(Stage.WIRE, Reason.NO_ROUTE, detail, Miss("room for a cable", "m", bodies=(a, b)))
        hinge = blueprint.hinges[joint]
        sign = 1.0 if hinge.parent == a else -1.0
        motor = next(s for s in blueprint.seats if s.hinge == joint)
        radius = blueprint.catalogue.wire.diameter / 2
        needed = tuple(taut_length(blueprint, motor, path[first : last + 1], sign * q, radius) for q in hinge.range)
        span = float(np.linalg.norm(np.diff(path[first : last + 1], axis=0), axis=1).sum())
        slack = max(0.0, max(needed) - span) + reserve
        found.append(Crossing(joint, path[(first + last) // 2], span, (needed[0], needed[1]), slack))
    return tuple(found)


def taut_length(blueprint: Blueprint, motor: MotorSeat, span: Array, turn: float, radius: float) -> float:
    """Length of a string drawn tight between the ends of a span after the far end has turned about the hinge [m].

    L^2 = p^2 + dz^2 with p the way in the plane across the axis. With ends at distances a and b from the axis and the
    angle f between them, counted along the span, p^2 = a^2 + b^2 - 2 a b cos f while that line passes a circle of
    radius c, else p = sqrt(a^2 - c^2) + sqrt(b^2 - c^2) + c (f - acos(c / a) - acos(c / b)).

    Args:
        blueprint: for the mount.
        motor: seat at the hinge.
        span: the free stretch in the rest pose, (k, 3) [m].
        turn: about the motor's axis, of the far end against the near one [rad].
        radius: of the cable [m].
    """
    T, mount = motor.T_design_motor, mount_of(blueprint.catalogue.motor)
    local = (span - T[:3, 3]) @ T[:3, :3]
    away = np.hypot(local[:, 0], local[:, 1])
    angle = np.unwrap(np.arctan2(local[:, 1], local[:, 0]))
    # The hinge's axis and the motor's may point opposite ways.
    axis = blueprint.hinges[motor.hinge].axis
    f = abs(float(angle[-1] - angle[0]) + turn * math.copysign(1.0, float(axis @ T[:3, 2])))
    a, b, rise = float(away[0]), float(away[-1]), float(local[-1, 2] - local[0, 2])
    beside = bool(((local[:, 2] > mount.base_low) & (local[:, 2] < mount.connector_high)).any())
    # Where the span passes the mount it passes it: the string can be drawn no closer.
    c = min(mount.envelope_radius + radius, float(away.min())) if beside else 0.0
    straight = math.acos(min(1.0, c / max(a, 1e-9))) + math.acos(min(1.0, c / max(b, 1e-9)))
    if f <= straight:
        across = math.sqrt(max(a * a + b * b - 2 * a * b * math.cos(min(f, math.pi)), 0.0))
    else:
        across = math.sqrt(max(a * a - c * c, 0.0)) + math.sqrt(max(b * b - c * c, 0.0)) + c * (f - straight)
    return math.hypot(across, rise)


def _spans(blueprint: Blueprint, seat: int, path: Array) -> list[tuple[int, int, int, int]]:
    """(body left, body entered, last point in the one, first point in the other) for every change of body."""
    depth = np.stack([body.bone.sample(path) for body in blueprint.bodies])
    owner = np.where(depth.max(axis=0) > 0, depth.argmax(axis=0), -1)
    owner[0], owner[-1] = blueprint.box("controller").body, blueprint.seats[seat].holder
    inside = np.flatnonzero(owner >= 0)
    return [
        (int(owner[i]), int(owner[j]), int(i), int(j)) for i, j in itertools.pairwise(inside) if owner[i] != owner[j]
    ]
