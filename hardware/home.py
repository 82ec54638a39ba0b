"""Where each motor's zero is: judging the pose before a run, and setting the zero while someone holds the robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hardware.bundle import Bundle
from hardware.bus import ATTEMPTS, SWEEP_TIMEOUT, MotorBus, MotorFault, MotorSilent
from hardware.j60 import Code, Command

ZERO = 0.05  # how far from zero a joint may be right after its zero was set [rad]

Array = NDArray[np.float64]


class PoseError(MotorFault):
    """The robot does not stand as its bundle says that it can."""


def measure_pose(bus: MotorBus, bundle: Bundle) -> Array:
    """Ask motors that are not enabled where their joints are [rad], (n,).

    Raises:
        MotorSilent: A motor does not answer.
        BusUnavailable: The bus is gone.
    """
    found: dict[int, float] = {}
    ids = [joint.can_id for joint in bundle.joints]
    for _ in range(ATTEMPTS):
        missing = [motor for motor in ids if motor not in found]
        replies = bus.sweep(dict.fromkeys(missing, Command()), SWEEP_TIMEOUT) if missing else {}
        found |= {motor: reply.position for motor, reply in replies.items()}
    silent = [motor for motor in ids if motor not in found]
    if silent:
        raise MotorSilent(f"Motors {silent} do not say where they are; check 24 V supply and CAN wiring.")
    return bundle.column("sign") * np.array([found[motor] for motor in ids])


def check_pose(position: Array, bundle: Bundle, margin: float) -> None:
    """Refuse a pose that the robot cannot have: then a motor's zero is wrong, and so would be every target.

    Raises:
        PoseError: A joint is further than `margin` [rad] outside its range.
    """
    outside = [
        f"{joint.name} at {angle:.2f} (range {joint.range[0]:.2f} to {joint.range[1]:.2f})"
        for joint, angle in zip(bundle.joints, position, strict=True)
        if not joint.range[0] - margin <= angle <= joint.range[1] + margin
    ]
    if outside:
        raise PoseError(
            f"Joints measure more than {margin:g} rad outside their range: {', '.join(outside)} rad; "
            "if the robot does not stand so, hold it in its painted pose and set the zeros with --set-home."
        )


def set_home(bus: MotorBus, bundle: Bundle) -> tuple[Array, Array]:
    """Switch every motor off and make the pose in which the robot is held the zero of its joints.

    Returns:
        The pose as it measured before and after [rad], (n,) each.

    Raises:
        PoseError: A joint does not measure zero afterwards.
        MotorFault: A motor refuses.
        MotorSilent: A motor does not answer.
        BusUnavailable: The bus is gone.
    """
    for joint in bundle.joints:
        bus.order(joint.can_id, Code.DISABLE)
    before = measure_pose(bus, bundle)
    for joint in bundle.joints:
        bus.order(joint.can_id, Code.SET_HOME)
        bus.order(joint.can_id, Code.SAVE_CONFIG)
    after = measure_pose(bus, bundle)
    off = [f"{joint.name} at {angle:.2f}" for joint, angle in zip(bundle.joints, after, strict=True)
           if not abs(angle) <= ZERO]  # fmt: skip
    if off:
        raise PoseError(
            f"After setting the zero, not all joints measure 0 rad: {', '.join(off)}; hold still and retry."
        )
    return before, after
