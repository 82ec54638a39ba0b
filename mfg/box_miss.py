"""The closest miss of the electronics search: which bone lacks how much, in which direction, and what would mend it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mfg.box_fit import SURFACE, box_surface, separation
from mfg.box_host import KINDS, Host, Kind
from mfg.box_layout import Layout
from mfg.miss import Miss

Array = NDArray[np.float64]
NEAR = 1.0e-3  # points of a cavity this close to the shallowest one count as short too [m]


def miss_of(host: Host, kinds: tuple[Kind, ...], found: Layout, half: Array, wall: float) -> Miss:
    """Describe the miss of the first layout of `found`; where it is empty, that of a box of half extents `half` [m]."""
    what = kinds[0] if len(kinds) == 1 else "both"
    said = f"the {what}" if len(kinds) == 1 else "both boxes together"
    segment, pitch = host.blueprint.bodies[host.index].segment, host.blueprint.design.pitch
    if len(found) and found.margin[0] >= 0:
        text = f"{said} would fit {host.name}, but no way in is free: grow segment {segment} away from motors and bones"
        way = _vector(found.turn[0, 0][:, 0])
        return Miss(f"way in of {what}", "m", 0.0, 0.0, (), (host.index,), 0.0, way, "clear_way", text)
    if len(found):
        short, need = -float(found.margin[0]), wall
        direction, side = _lacking(host, found, wall)
        text = f"{said} {1e3 * short:.1f} mm short in {host.name} along {side}"
    else:
        need, thickness = float(half.min()) + wall, max(float(host.free.values.max()), 0.0)
        short, direction = need - thickness, host.frames[1][:, 0]
        text = f"{said} needs a bone {2e3 * need:.0f} mm thick, {host.name} has {2e3 * thickness:.0f} mm"
    voxels = max(1, math.ceil(2 * short / pitch - 1e-6))
    plural, axis = "" if voxels == 1 else "s", "xyz"[int(np.abs(direction).argmax())]
    mend = f"grow segment {segment} by {voxels} voxel{plural} across its {axis}"
    return Miss(
        f"depth of {what} in its bone", "m", need - short, need, (), (host.index,), short, _vector(direction),
        "grow_body", f"{text}: {mend}",
    )  # fmt: skip


def _vector(direction: Array) -> tuple[float, float, float]:
    x, y, z = direction.tolist()
    return x, y, z


def _lacking(host: Host, found: Layout, wall: float) -> tuple[Array, str]:
    """Where the first layout is short: the direction in which the bone must grow, and the side of the box along it."""
    free, half, centre, turn = host.free, found.half, found.centre[0], found.turn[0]
    step = np.eye(3) * free.spacing / 2
    normals, owners = [np.zeros((0, 3))], []
    for box in range(len(half)):
        points = centre[box] + box_surface(half[box], SURFACE) @ turn[box].T
        depth = free.sample(points)
        short = points[depth <= depth.min() + NEAR]
        slope = np.stack([free.sample(short - s) - free.sample(short + s) for s in step], axis=-1).astype(np.float64)
        normals.append(slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9))
        owners += [box] * len(short)
    if len(half) == 2 and separation(half[0], centre[0], turn[0], half[1], centre[1], turn[1]) < wall:
        # The boxes press on each other: what they need lies beyond them, on the line through both.
        between = centre[1] - centre[0]
        normals.append(np.tile(between / np.linalg.norm(between), (len(owners), 1)))
        owners += [0] * len(owners)
    stack = np.concatenate(normals)
    # Opposite walls lack the same way: take the strongest axis without its sign, then the side that lacks more.
    direction = np.linalg.eigh(stack.T @ stack)[1][:, 2]
    direction = direction * np.sign(direction[np.abs(direction).argmax()])
    lean = float((stack @ direction).sum())
    direction = -direction if lean < -1e-6 else direction
    box = owners[int(np.abs(np.round(stack @ direction, 6)).argmax())]
    along = int(np.abs(turn[box].T @ direction).argmax())
    owner = "its" if len(half) == 1 else f"the {KINDS[box]}'s"
    return direction, f"{owner} {2e3 * half[box, along]:.0f} mm side"
