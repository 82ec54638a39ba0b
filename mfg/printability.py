"""Solver: would every body come out of the printer in one piece that fits it? The fast stand-in for exact parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mfg.blueprint import Blueprint, Body, BoxSeat
from mfg.fields import Field, Window, box_depth, cylindrical
from mfg.miss import Miss
from mfg.mounts import Mount, cup_depth, disc_depth, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.plate import fits_printer


@dataclass(frozen=True)
class PrintabilitySolver:
    """Check on fields what the finish solver later checks on solids.

    Attributes:
        gap: room between a mount and the bodies that it does not belong to [m].
        max_loss: largest share of a bone that the hardware may cut loose.
        min_volume: least volume of a bone with its mounts [m3].
        split: bodies beyond the printer's volume will be cut into pieces, so none is refused for its size.
    """

    gap: float = 1.5e-3
    max_loss: float = 0.10
    min_volume: float = 3.0e-5
    split: bool = False

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint unchanged, or a print failure."""
        mount = mount_of(blueprint.catalogue.motor)
        printer = blueprint.catalogue.printer
        for index, body in enumerate(blueprint.bodies):
            field = with_hardware(blueprint, index, mount, self.gap)
            failure = self._in_one_piece(blueprint, index, body, field)
            if failure is not None:
                return failure
            if self.split:
                continue
            outline = np.concatenate([outline_points(f) for f in (field, body.skin) if f is not None])
            if not fits_printer(outline, printer.volume):
                return Failure(
                    Stage.PRINT,
                    Reason.TOO_LARGE,
                    f"{body.name} measures {_mm(np.ptp(outline, axis=0))} mm and no way up fits the "
                    f"{_mm(np.array(printer.volume))} mm of {printer.name}; the search rules cut such a body into "
                    "pieces with pegs, and a smaller pitch scales it",
                )
        return blueprint

    def _in_one_piece(self, blueprint: Blueprint, index: int, body: Body, field: Field) -> Failure | None:
        pieces, count = ndimage.label(field.values > 0)
        sizes = np.bincount(pieces.ravel())[1:] if count else np.zeros(1)
        volume = float(sizes.max()) * field.spacing**3
        lost = 1 - sizes.max() / max(sizes.sum(), 1)
        if volume < self.min_volume or lost > self.max_loss:
            return Failure(
                Stage.PRINT,
                Reason.BONE_SEVERED,
                f"the hardware leaves {body.name} in {count} pieces, the largest {1e6 * volume:.0f} cm3 "
                f"({100 * lost:.0f} % would be lost)",
                Miss("volume of a bone in one piece", "m3", volume, self.min_volume, bodies=(index,))
                if volume < self.min_volume
                else Miss("share of a bone that is kept", "1", 1 - float(lost), 1 - self.max_loss, bodies=(index,)),
            )
        main = int(np.argmax(sizes)) + 1
        mount = mount_of(blueprint.catalogue.motor)
        for seat in blueprint.seats:
            if index not in (seat.holder, seat.connector):
                continue
            window = motor_window(field, seat.T_design_motor, mount)
            if window is None:
                continue
            depth = cup_depth if seat.holder == index else disc_depth
            own = depth(*about_motor(field, window, seat.T_design_motor), mount) > 0
            if not (pieces[window][own] == main).any():
                return Failure(
                    Stage.PRINT,
                    Reason.BONE_SEVERED,
                    f"the mount of {blueprint.hinges[seat.hinge].name} hangs on a splinter of {body.name}",
                    Miss(
                        "bone about a mount", "m3", joints=(seat.hinge,), bodies=(index,), remedy="thicken_near_joint"
                    ),
                )
        return None


def with_hardware(blueprint: Blueprint, index: int, mount: Mount, gap: float) -> Field:
    """Depth field of one bone after everything is cut from it and its mounts are added."""
    body = blueprint.bodies[index]
    values = body.bone.values.copy()
    for box in blueprint.boxes:
        if box.body == index:
            cut_shaft(body.bone, values, box)
    for seat in blueprint.seats:
        window = motor_window(body.bone, seat.T_design_motor, mount)
        if window is None:
            continue
        radial, along = about_motor(body.bone, window, seat.T_design_motor)
        cup, disc = cup_depth(radial, along, mount), disc_depth(radial, along, mount)
        if index == seat.holder:
            cut = disc
        elif index == seat.connector:
            cut = cup
        else:
            cut = np.maximum(cup, disc)
        values[window] = np.minimum(values[window], -cut - np.float32(gap))
    for seat in blueprint.seats:
        window = motor_window(body.bone, seat.T_design_motor, mount)
        if window is None or index not in (seat.holder, seat.connector):
            continue
        radial, along = about_motor(body.bone, window, seat.T_design_motor)
        own = cup_depth(radial, along, mount) if index == seat.holder else disc_depth(radial, along, mount)
        values[window] = np.maximum(values[window], own)
    return body.bone.with_values(values)


def motor_window(field: Field, T_design_motor: NDArray[np.float64], mount: Mount) -> Window | None:
    """The samples of a field that a motor's mount can reach, or None."""
    return field.window(T_design_motor[:3, 3], float(np.hypot(mount.envelope_radius, mount.connector_high)) + 0.01)


def about_motor(
    field: Field, window: Window, T_design_motor: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distance from the motor's axis and height along it, at the samples of a window [m]."""
    return cylindrical(field.axes(window), T_design_motor[:3, 3], T_design_motor[:3, 2])


def outline_points(field: Field) -> NDArray[np.float64]:
    """Points on the surface phi = 0 (n, 3) [m]: the samples just inside it, moved along the gradient by their depth."""
    near = (field.values > 0) & (field.values <= field.spacing)
    slopes = [np.asarray(np.gradient(-field.values, axis=a), np.float64)[near] for a in range(3)]
    normal = np.stack(slopes, axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return (np.argwhere(near) + field.corner) * field.spacing + field.values[near][:, None] * normal


def cut_shaft(field: Field, values: NDArray[np.float32], box: BoxSeat) -> None:
    """Cut the cavity of a box and its insertion shaft out of `values`, the samples of a field, in place."""
    half = np.array(box.size) / 2 + box.clearance
    low, high = -half[2], max(box.shaft, half[2])
    T = box.T_design_box.copy()
    T[:3, 3] += T[:3, 2] * (low + high) / 2
    half[2] = (high - low) / 2
    window = field.window(T[:3, 3], float(np.linalg.norm(half)) + field.spacing)
    if window is not None:
        depth = box_depth(np.stack(np.broadcast_arrays(*field.axes(window)), axis=-1), T, half)
        values[window] = np.minimum(values[window], -depth)


def _mm(extents: NDArray[np.float64]) -> str:
    return " x ".join(f"{1e3 * e:.0f}" for e in extents)
