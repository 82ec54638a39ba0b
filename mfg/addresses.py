"""Where each motor is on the bus and which way it turns: one answer for tables, manifest and policy bundle."""

from __future__ import annotations

from mfg.blueprint import Blueprint, MotorSeat

MAX_BUS = 15  # motors on one CAN bus: the J60's id has 4 bits, and 0 addresses no motor


def can_address(seat: int) -> tuple[str, int]:
    """(bus, id) of the motor in `blueprint.seats[seat]`: ids count from 1, and each bus takes 15 motors."""
    return f"can{seat // MAX_BUS}", seat % MAX_BUS + 1


def turn_sign(blueprint: Blueprint, seat: MotorSeat) -> int:
    """+1 where a positive turn of the motor is one of the joint.

    That is so where the output turns the child and points along the axis; either change alone turns it round: the child
    carries the housing, or the motor points the other way.
    """
    return blueprint.pointing(seat) * (1 if seat.connector == blueprint.hinges[seat.hinge].body else -1)
