"""Flat cuts through a body: where they may lie, and whether they keep clear of all that is in it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Transform
from mfg.exact import box_room
from mfg.lids import DEPTH
from mfg.mounts import Mount, mount_of

STEEPEST = np.pi / 3  # most that a tunnel may lean from the normal of a cut that it crosses [rad]
MOST_CUTS = 48  # tried along one direction


def planes(points: NDArray[np.float64], pitch: float) -> Iterator[Transform]:
    """Frames of cuts across points (n, 3), z normal to the cut: across the design's axes and the principal ones [m]."""
    centred = points - points.mean(axis=0)
    _, principal = np.linalg.eigh(centred.T @ centred)
    for normal in (*np.eye(3), *principal.T):
        along = points @ normal
        count = min(int(np.ptp(along) / pitch), MOST_CUTS)
        for offset in along.min() + np.ptp(along) * (np.arange(1, count) / max(count, 1)):
            T = np.eye(4)
            x = np.eye(3)[int(np.argmin(np.abs(normal)))]
            x = x - (x @ normal) * normal
            T[:3, 0] = x / np.linalg.norm(x)
            T[:3, 1], T[:3, 2] = np.cross(normal, T[:3, 0]), normal
            T[:3, 3] = points.mean(axis=0) + (offset - points.mean(axis=0) @ normal) * normal
            yield T


def clear_of_hardware(blueprint: Blueprint, body: int, T: Transform, room: float) -> bool:
    """Whether a cut leaves all hardware of a body in one piece, by `room` [m], and crosses its tunnels steeply."""
    mount = mount_of(blueprint.catalogue.motor)
    for seat in blueprint.seats:
        if body not in (seat.holder, seat.connector):
            continue
        low, high = _mount_span(mount, seat.T_design_motor, T)
        if low - room < 0 < high + room:
            return False
    for k, placed in enumerate(blueprint.boxes):
        if placed.body == body:
            along = (_box_points(blueprint, k) - T[:3, 3]) @ T[:3, 2]
            if along.min() - room < 0 < along.max() + room:
                return False
    for wire in blueprint.wires:
        along = (wire.path - T[:3, 3]) @ T[:3, 2]
        step, length = np.diff(along), np.linalg.norm(np.diff(wire.path, axis=0), axis=1)
        here = (np.abs(along[:-1]) < 2 * wire.radius) | (np.abs(along[1:]) < 2 * wire.radius)
        here |= along[:-1] * along[1:] < 0
        if blueprint.bodies[body].bone.sample(wire.path[:-1][here]).max(initial=-1.0) < 0:
            continue  # it passes outside of this body's bone
        if (np.abs(step[here]) < np.cos(STEEPEST) * length[here] - 1e-12).any():
            return False
    return True


def _box_points(blueprint: Blueprint, index: int) -> NDArray[np.float64]:
    """Corners of what a box needs of its body: cavity, shaft, and the lid with its screws where it has one."""
    placed = blueprint.boxes[index]
    points = [box_room(placed).vertices]
    for lid in blueprint.lids:
        if lid.box == index:
            points += [part.solid.vertices for part in blueprint.parts if part.name == lid.part]
            points.append(lid.screws - DEPTH * placed.T_design_box[:3, 2])
    return np.concatenate(points)


def _mount_span(mount: Mount, T_design_motor: Transform, T: Transform) -> tuple[float, float]:
    """Least and greatest height above a plane of a motor with both halves of its mount."""
    lean = float(T[:3, 2] @ T_design_motor[:3, 2])
    middle = float(T[:3, 2] @ (T_design_motor[:3, 3] - T[:3, 3]))
    side = mount.envelope_radius * float(np.sqrt(max(0.0, 1.0 - lean**2)))
    ends = middle + lean * mount.base_low, middle + lean * mount.connector_high
    return min(ends) - side, max(ends) + side
