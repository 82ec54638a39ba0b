"""Room to put an electronics box into a body by hand: its shaft, and what stands in the way (paper Eq. 8)."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mfg.blueprint import Blueprint, Body, BoxSeat
from mfg.fields import OUTSIDE, Field, box_depth, coverage
from mfg.mounts import Mount, envelope_depth, mount_of

Array = NDArray[np.float64]
STEP = 0.005  # resolution at which the chosen shafts are measured [m]
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))


def obstacle_depth(blueprint: Blueprint, host: int, points: Array) -> NDArray[np.float32]:
    """Depth of points (n, 3) in what cannot be carved away: motors, their mounts and the bones of other bodies [m]."""
    mount = mount_of(blueprint.catalogue.motor)
    depth = np.full(len(points), OUTSIDE, np.float32)
    for index, body in enumerate(blueprint.bodies):
        if index == host:
            continue
        bone = body.bone
        end = bone.origin + (np.array(bone.values.shape) - 1) * bone.spacing
        near = np.flatnonzero(((points >= bone.origin) & (points <= end)).all(axis=-1))
        depth[near] = np.maximum(depth[near], bone.sample(points[near]))
    for seat in blueprint.seats:
        T = seat.T_design_motor
        near = np.flatnonzero(((points - T[:3, 3]) ** 2).sum(axis=-1) < (mount_reach(mount) + 0.01) ** 2)
        depth[near] = np.maximum(depth[near], envelope_depth(points[near], T, mount))
    return depth


def shaft_height(outer: Field, seat: BoxSeat) -> float:
    """Height above a box's centre at which its shaft has left the body for good, on a 5 mm grid rounded up [m]."""
    half = np.array(seat.size) / 2 + seat.clearance
    T = seat.T_design_box
    corners = outer.origin + CORNERS * ((np.array(outer.values.shape) - 1) * outer.spacing)
    reach = float(((corners - T[:3, 3]) @ T[:3, 2]).max())
    heights = np.arange(half[2], max(reach, half[2]) + STEP, STEP)
    across = [np.linspace(-h, h, math.ceil(2 * h / STEP) + 1) for h in half[:2]]
    local = np.stack(np.meshgrid(*across, heights, indexing="ij"), axis=-1)
    inside = (outer.sample(local @ T[:3, :3].T + T[:3, 3]) > 0).any(axis=(0, 1))
    last = np.flatnonzero(inside)
    return float(heights[last[-1]] + STEP) if len(last) else float(half[2])


def interference_above(blueprint: Blueprint, seat: BoxSeat) -> float:
    """V_cap of one module: what it meets on its way in [m3] (paper Eq. 8).

    The room is the cavity's cross-section from the top of the cavity to the end of the shaft and one module height
    beyond, where the module stands clear before it goes in. Motors, mounts, other boxes and the bones of other bodies
    in it count; the module's own bone does not, because the shaft is cut through it.
    """
    half = np.array(seat.size) / 2 + seat.clearance
    T = seat.T_design_box
    low, high = half * (-1, -1, 1), np.array([half[0], half[1], max(seat.shaft, half[2]) + 2 * half[2]])
    count = np.ceil((high - low) / STEP).astype(int)
    width = (high - low) / count
    axes = [low[a] + (np.arange(count[a]) + 0.5) * width[a] for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    depth = obstacle_depth(blueprint, seat.body, points)
    for other in blueprint.boxes:
        if other is not seat:
            depth = np.maximum(depth, box_depth(points, other.T_design_box, np.array(other.size) / 2))
    return float(coverage(depth, float(width.mean())).sum(dtype=np.float64) * width.prod())


def outer_surface(body: Body) -> Field:
    """Depth of bone and skin together."""
    return body.skin if body.skin is not None else body.bone


def mount_reach(mount: Mount) -> float:
    """Radius of the ball about the motor's centre that holds its mount [m]."""
    return math.hypot(mount.envelope_radius, max(mount.connector_high, -mount.base_low))


class Room:
    """What stands above the boxes of one host, coarsely, on a grid along a frame: to compare many ways in at once."""

    def __init__(
        self, blueprint: Blueprint, host: int, anchor: Array, frame: Array, spacing: float, centre: Array, half: Array
    ) -> None:
        """Sample the host's own outer surface and every obstacle where a shaft may pass.

        Args:
            blueprint: with seats.
            host: index of the body.
            anchor: origin of the frame [m], (3,).
            frame: its axes in columns, (3, 3).
            spacing: edge of a cell [m].
            centre: of every cavity that may be asked for, in the frame [m], (..., 3).
            half: half extents of these cavities [m], (..., 3).
        """
        outer = outer_surface(blueprint.bodies[host])
        inside = ((np.argwhere(outer.values[::2, ::2, ::2] > 0) * 2 + outer.corner) * outer.spacing - anchor) @ frame
        headroom = 2 * half.reshape(-1, 3).max(axis=0)
        lateral = (np.abs(centre) + half).reshape(-1, 3).max(axis=0) + spacing
        self.spacing = spacing
        self.low = np.floor((inside.min(axis=0) - headroom) / spacing) * spacing
        self.shape = np.ceil((inside.max(axis=0) + headroom - self.low) / spacing).astype(int)
        axes = [self.low[a] + (np.arange(self.shape[a]) + 0.5) * spacing for a in range(3)]
        narrow = [np.abs(along) <= reach for along, reach in zip(axes, lateral, strict=True)]
        # A shaft runs along one axis and stays narrow across the two others.
        x, y, z = narrow[0][:, None, None], narrow[1][None, :, None], narrow[2][None, None, :]
        cells = np.nonzero((x & y) | (x & z) | (y & z))
        local = np.stack([axes[a][cells[a]] for a in range(3)], axis=-1)
        points = anchor + local @ frame.T
        own = np.zeros(self.shape, bool)
        own[cells] = outer.sample(points) > 0
        filled = np.zeros(self.shape)
        filled[cells] = coverage(obstacle_depth(blueprint, host, points), spacing)
        # Summed-volume table: entry (i, j, k) is the volume in the first i, j, k cells.
        table = np.pad(filled, ((1, 0),) * 3).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
        self.table = table * spacing**3
        # Of every column along each axis: the edges between which the host has matter.
        self.extent = [
            (np.where(own.any(axis=a), n - np.flip(own, a).argmax(axis=a), 0),
             np.where(own.any(axis=a), own.argmax(axis=a), n))
            for a, n in enumerate(self.shape)
        ]  # fmt: skip

    def shafts(self, centre: Array, half: Array, axis: int, sign: int) -> tuple[Array, Array, Array]:
        """Corners (n, 3) of the room that each module passes through, and the length of its shaft (n,) [m].

        The room begins above the cavity and ends one module height above the mouth: there the module must stand clear
        before it goes in.
        """
        low, high = centre - half, centre + half
        across = [a for a in range(3) if a != axis]
        start = np.floor((low[:, across] - self.low[across]) / self.spacing).astype(int)
        stop = np.ceil((high[:, across] - self.low[across]) / self.spacing).astype(int)
        last, first = self.extent[axis]
        mouth = np.zeros(len(centre))
        for i, ((p, q), (r, s)) in enumerate(zip(start, stop, strict=True)):
            mouth[i] = last[p:r, q:s].max() if sign > 0 else first[p:r, q:s].min()
        mouth = self.low[axis] + mouth * self.spacing
        shaft = np.maximum(sign * (mouth - centre[:, axis]), half[:, axis])
        end = centre[:, axis] + sign * (shaft + 2 * half[:, axis])
        if sign > 0:
            low[:, axis], high[:, axis] = centre[:, axis] + half[:, axis], end
        else:
            low[:, axis], high[:, axis] = end, centre[:, axis] - half[:, axis]
        return low, high, shaft

    def blocked(self, low: Array, high: Array) -> Array:
        """Volume of obstacles in boxes given by their corners (n, 3) in the frame [m3]."""
        edges = [np.clip((c - self.low) / self.spacing, 0, self.shape) for c in (low, high)]
        total = np.zeros(len(low))
        for choice in itertools.product((0, 1), repeat=3):
            index = np.stack([edges[c][:, a] for a, c in enumerate(choice)])
            total += (-1) ** (3 - sum(choice)) * ndimage.map_coordinates(self.table, index, order=1, mode="nearest")
        return np.maximum(total, 0.0)
