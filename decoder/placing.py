"""Parts as the network says them, put where they belong: bones that share a hinge meet, and motors have room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.compose import Window, centres, window_of
from decoder.parts import (
    ATTACH,
    DIRECTION,
    DISTANCE,
    LATTICE,
    MIDDLE,
    RANGE,
    REACH,
    SPREAD,
    TENSOR,
    axis_of,
    box_of,
    frames_along,
    torso_frame,
)
from decoder.rasterise import FAR

_LEAST_REACH = 0.1  # of a hinge either way [rad]
GAP = 0.9  # between bones that meet at a hinge, at most [voxels]; they melt together over so much
_PUSHES = 4  # at most, until they do
MOTORS_APART = 10.5  # hinges, for two motors with their mounts [voxels]
_ROUNDS = 3  # of making room


@dataclass(frozen=True, eq=False)
class Part:
    """One part as the network says it; lengths in voxels, positions in the grid.

    Attributes:
        carrier: index of the part that carries this one.
        centre: (3,).
        frame: columns across, across and along, (3, 3).
        box: half sides, (3,).
        hinge: a point on the hinge towards the carrier, (3,).
        axis: unit vector of the hinge, (3,).
        confidence: in that axis, 0 to 1.
        range: least and greatest angle [rad], (2,).
        distance: of bone and skin at the nodes of its lattice, (2, 12, 12, 16).
    """

    carrier: int
    centre: NDArray[np.float64]
    frame: NDArray[np.float64]
    box: NDArray[np.float64]
    hinge: NDArray[np.float64]
    axis: NDArray[np.float64]
    confidence: float
    range: NDArray[np.float64]
    distance: NDArray[np.float32]


def torso(pose: NDArray[np.float64], distance: NDArray[np.float32]) -> Part:
    """Put the part that nothing carries where its pose says."""
    centre = MIDDLE + REACH * np.clip(pose[ATTACH], -1.6, 1.6)
    return Part(0, centre, torso_frame().astype(np.float64), _box(pose), centre, np.array([0.0, 1.0, 0.0]), 1.0,
                np.array([-1.0, 1.0]), distance)  # fmt: skip


def hung(pose: NDArray[np.float64], distance: NDArray[np.float32], others: Sequence[Part], carrier: int) -> Part:
    """Put one part where its pose says, on the part number `carrier` of those that are placed, the torso first.

    Then it is made room for: away from hinges where two motors would meet, towards the bone that it hangs on. Bodies
    that were learned from seldom need it, and then little; a latent in between may.
    """
    before = others[carrier]
    hinge = before.centre + before.frame @ (before.box * np.clip(pose[ATTACH], -1.2, 1.2))
    length = float(np.linalg.norm(pose[DIRECTION]))
    direction = pose[DIRECTION] / length if length > 1e-3 else np.array([0.0, 0.0, -1.0])
    frame = frames_along(direction, np)
    axis, confidence = axis_of(pose[TENSOR])
    centre = hinge + 8.0 * float(np.exp(np.clip(pose[DISTANCE][0], -2.0, 1.2))) * direction
    axis = frame @ axis
    reach = np.array([np.clip(pose[RANGE][0], -np.pi, -_LEAST_REACH), np.clip(pose[RANGE][1], _LEAST_REACH, np.pi)])
    axis /= np.linalg.norm(axis)
    part = Part(carrier, centre, frame, _box(pose), hinge, axis, confidence, reach, distance)
    hinges = [other.hinge for other in others[1:]]
    for _ in range(_ROUNDS):
        part = seated(spaced(part, hinges), before)
    return part


def _box(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    return box_of(3.0 * np.exp(np.clip(pose[SPREAD], -1.5, 1.5)))


def spaced(part: Part, hinges: Sequence[NDArray[np.float64]]) -> Part:
    """Push a part, hinge and all, away from each of some hinges in turn that is nearer than two motors need."""
    for hinge in hinges:
        away = part.hinge - hinge
        distance = float(np.linalg.norm(away))
        if 1e-6 < distance < MOTORS_APART:
            part = _moved(part, (MOTORS_APART / distance - 1.0) * away)
    return part


def _moved(part: Part, by: NDArray[np.float64]) -> Part:
    return replace(part, centre=part.centre + by, hinge=part.hinge + by)


def seated(part: Part, before: Part) -> Part:
    """Push a part, hinge and all, towards the one that carries it until their bones are at most `GAP` apart.

    The gap is measured on the way from centre to centre over the hinge, where it is narrowest.
    """
    for _ in range(_PUSHES):
        way = np.concatenate([_points_between(before.centre, part.hinge), _points_between(part.hinge, part.centre)])
        gap = 2.0 * float(np.maximum(_bone_at(before, way), _bone_at(part, way)).min())
        inwards = before.centre - part.hinge
        far = float(np.linalg.norm(inwards))
        if gap <= GAP or far < 1.0:
            break
        part = _moved(part, min(gap - GAP, far) / far * inwards)
    return part


def _points_between(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (24, 3) in equal steps from one to the other."""
    return start + np.linspace(0.0, 1.0, 24)[:, None] * (end - start)


def _bone_at(part: Part, points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Distances (m,) to a part's bone at points (m, 3) [voxels]; beyond the box, that of the nearest point in it."""
    at = _node((points - part.centre) @ part.frame / part.box)
    return ndimage.map_coordinates(part.distance[0], at.T, order=1, mode="nearest", prefilter=False)


def _node(local: NDArray[Any]) -> NDArray[Any]:
    """Places in the box [-1, 1]^3, (..., 3), in nodes of the lattice."""
    return (local + 1) * (0.5 * (np.array(LATTICE, local.dtype) - 1))


def window(part: Part) -> Window:
    """Distances of a part at the voxels its box covers, by trilinear interpolation; far away beyond the box."""
    reach = np.abs(part.frame) @ part.box
    first, count = window_of(part.centre - reach, part.centre + reach)
    local = (centres(first, count) - part.centre.astype(np.float32)) @ (part.frame / part.box).astype(np.float32)
    at = np.moveaxis(_node(local), -1, 0)
    bone, skin = (
        ndimage.map_coordinates(layer, at, order=1, mode="constant", cval=FAR, prefilter=False)
        for layer in part.distance
    )
    return Window(first, bone, skin)


def geometric_axis(part: Part, before: Part) -> NDArray[np.float64]:
    """Hinge axis across both parts, or level across the one when they are in line."""
    along = before.frame[:, 2]
    for other in (along, np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])):
        axis = np.cross(other, part.frame[:, 2])
        length = float(np.linalg.norm(axis))
        if length > 0.3:
            return axis / length
    return np.array([1.0, 0.0, 0.0])
