"""Exact counterparts of what the solvers estimate on fields: rooms, overlap volumes, clearances, disjointness."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from mfg.blueprint import Blueprint, BoxSeat, WireRun
from mfg.mounts import Mount, connector_keepout, holder_keepout, housing, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.solids import Solid, ball_chain, box, cylinder, tube, union

REAMED = 5e-4  # by which the exact cylinder exceeds the one on the field, whose error is less [m]
ACCESS = 0.035  # free length above the connector and below the base plate, for a motor and a screwdriver [m]


def core(mount: Mount, offset: float, half_length: float) -> Solid:
    """The bone processor's cylinder about the joint axis, in the frame of a motor at `offset` along it [m].

    It is at least long enough to leave access to the screws of both mounts, and a little wider than what the processor
    cut on the field: surfaces that nearly coincide would cross everywhere.
    """
    low = min(-half_length - offset, mount.base_low - ACCESS)
    high = max(half_length - offset, mount.connector_high + ACCESS)
    return cylinder(mount.attach_radius + REAMED, low, high)


def box_solid(seat: BoxSeat) -> Solid:
    """The box itself, in the design frame."""
    half = np.asarray(seat.size) / 2
    return box(-half, half).moved(seat.T_design_box)


def box_room(seat: BoxSeat) -> Solid:
    """The cavity of a box with its clearance and the shaft by which it is inserted, in the design frame."""
    half = np.asarray(seat.size) / 2 + seat.clearance
    return box(-half, [half[0], half[1], max(half[2], seat.shaft)]).moved(seat.T_design_box)


def tunnel(wire: WireRun) -> Solid:
    """The room of one cable."""
    return ball_chain(wire.path, wire.radius)
