"""The closest miss of the electronics search: which bone lacks how much, in which direction, and what would mend it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.box_fit import SURFACE, Places, box_surface, separation
from mfg.box_layout import Layout
from mfg.electronics import Host, Kind

Array = NDArray[np.float64]
NEAR = 1.0e-3  # points of a cavity this close to the shallowest one count as short too [m]


@dataclass(frozen=True, eq=False, slots=True)
class Miss:
    """What keeps the most roomy placement from being one.

    Attributes:
        what: "battery", "controller" or "both".
        body: index of the bone that is nearest to taking it.
        shortfall: by how much the cavity is too shallow on either side [m]; 0 where it fits and no way in is free.
        direction: unit vector in the design frame along which the bone must grow, or the way in become free, (3,).
        detail: one sentence for people.
    """

    what: str
    body: int
    shortfall: float
    direction: Array
    detail: str


def miss_of(host: Host, kinds: tuple[Kind, ...], places: Mapping[Kind, Places], found: Layout, wall: float) -> Miss:
    """Describe the miss of the most roomy layout of `found`, or of the deepest point where there is no layout."""
    what = kinds[0] if len(kinds) == 1 else "both"
    said = what if len(kinds) == 1 else "both boxes"
    body = host.blueprint.bodies[host.index]
    free, pitch = host.free, host.blueprint.design.pitch
    if not len(found):
        # Nothing comes near: measure at the deepest point, along the thinnest way through the bone.
        need = max(float(places[kind].half.min()) for kind in kinds) + wall
        short = need - max(float(free.values.max()), 0.0)
        direction = host.frames[1][:, 0]
        across = float(2e3 * need)
        text = f"{said} {1e3 * short:.0f} mm short in {host.name}, which is nowhere {across:.0f} mm thick"
    elif found.margin[0] >= 0:
        direction = found.turn[0, 0][:, 0]
        return Miss(what, host.index, 0.0, direction, f"{said} would fit {host.name}, but no way in is free")
    else:
        short = -float(found.margin[0])
        direction, side = _lacking(host, found, wall)
        text = f"{said} {1e3 * short:.1f} mm short in {host.name} along {side}"
    axis = int(np.abs(direction).argmax())
    voxels = max(1, math.ceil(2 * short / pitch - 1e-6))
    plural = "" if voxels == 1 else "s"
    mend = f"grow segment {body.segment} by {voxels} voxel{plural} across its {'xyz'[axis]}"
    return Miss(what, host.index, max(short, 0.0), direction, f"{text}: {mend}")


def _lacking(host: Host, found: Layout, wall: float) -> tuple[Array, str]:
    """Where a layout is short: the direction in which the bone must grow, and the side of the box along it."""
    free, half = host.free, found.half
    normals: list[Array] = []
    owners: list[int] = []
    for box in range(len(half)):
        points = found.centre[0, box] + box_surface(half[box], SURFACE) @ found.turn[0, box].T
        depth = free.sample(points) - wall
        short = points[depth <= found.margin[0] + NEAR]
        step = np.eye(3) * free.spacing / 2
        slope = np.stack([free.sample(short - s) - free.sample(short + s) for s in step], axis=-1).astype(np.float64)
        normals += list(slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9))
        owners += [box] * len(short)
    if len(half) == 2:
        gap = separation(half[0], found.centre[0, 0], found.turn[0, 0], half[1], found.centre[0, 1], found.turn[0, 1])
        if not normals or float(gap) - wall <= found.margin[0] + NEAR:
            between = found.centre[0, 1] - found.centre[0, 0]
            normals += [between / np.linalg.norm(between)] * max(1, len(normals))
            owners += [0] * max(1, len(normals) - len(owners))
    stack = np.array(normals)
    # Opposite walls lack the same way: an axis has no sign, so take the strongest axis, then the sign of the mean.
    direction = np.linalg.eigh(stack.T @ stack)[1][:, 2]
    lean = float((stack @ direction).sum())
    direction = direction * (
        1.0 if lean > 1e-9 or (abs(lean) <= 1e-9 and direction[np.abs(direction).argmax()] > 0) else -1.0
    )
    box = owners[int(np.abs(stack @ direction).argmax())]
    along = int(np.abs(found.turn[0, box].T @ direction).argmax())
    clearance = 0.0
    name = "the battery's" if box == 0 and len(half) == 2 else ("the controller's" if len(half) == 2 else "its")
    return direction, f"{name} {2e3 * (half[box, along] - clearance):.0f} mm side"
