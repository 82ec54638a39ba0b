"""Ways for boxes into a bone by hand, many at once and coarsely: how long their shafts are and what stands in them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint
from mfg.box_fit import separation
from mfg.fields import Field
from mfg.insertion import mount_reach, outer_surface
from mfg.mounts import envelope_depth, mount_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
WAYS = tuple((axis, sign) for axis in range(3) for sign in (1, -1))  # out along +x, -x, +y, ... of the box
ALONG = 0.010  # distance of samples along a way [m]
ACROSS = 0.030  # greatest distance of samples across a way [m]
AIR, OTHER, OWN, BLOCKED = 0, 1, 2, 3  # nothing, soft tissue of others, the host itself, what does not give way


@dataclass(frozen=True, eq=False, slots=True)
class Surroundings:
    """What is around one host, on the samples of the design's lattice.

    Attributes:
        cells: AIR, OTHER, OWN or BLOCKED, (nx, ny, nz) u1, a layer of AIR on the outside.
        corner: lattice index of `cells[0, 0, 0]`, (3,).
        spacing: of the lattice [m].
        box: lowest and highest corner of the box around the host [m], (2, 3).
    """

    cells: NDArray[np.uint8]
    corner: NDArray[np.int64]
    spacing: float
    box: Array

    @staticmethod
    def of(blueprint: Blueprint, host: int, headroom: float) -> Surroundings:
        """Surroundings as far as `headroom` [m] from the host; motors count with their mounts, bodies at rest."""
        outer, mount = outer_surface(blueprint.bodies[host]), mount_of(blueprint.catalogue.motor)
        grow = math.ceil(headroom / outer.spacing) + 1
        wide = Field(
            np.zeros(np.array(outer.values.shape) + 2 * grow, np.float32),
            (outer.corner[0] - grow, outer.corner[1] - grow, outer.corner[2] - grow),
            outer.spacing,
        )
        cells = np.zeros(wide.values.shape, np.uint8)
        for index, body in enumerate(blueprint.bodies):
            layers = [(outer, OWN)] if index == host else [(body.bone, BLOCKED), (body.skin, OTHER)]
            for layer, mark in layers:
                shared = None if layer is None else wide.shared(layer)
                if layer is not None and shared is not None:
                    here, there = shared
                    cells[here] = np.maximum(cells[here], (layer.values[there] > 0) * np.uint8(mark))
        for seat in blueprint.seats:
            window = wide.window(seat.T_design_motor[:3, 3], mount_reach(mount) + outer.spacing)
            if window is not None:
                points = np.stack(np.broadcast_arrays(*wide.axes(window)), axis=-1)
                inside = envelope_depth(points, seat.T_design_motor, mount, outer.spacing / 2) > 0
                cells[window][inside] = BLOCKED
        for axis in range(3):
            for end in (0, -1):
                np.moveaxis(cells, axis, 0)[end] = AIR
        near = np.argwhere(outer.values > 0)
        box = (np.stack([near.min(0), near.max(0)]) + outer.corner) * outer.spacing
        return Surroundings(cells, np.rint(wide.corner).astype(np.int64), outer.spacing, box)

    def at(self, points: Array) -> NDArray[np.uint8]:
        """The cell nearest to each point (..., 3) [m]; AIR beyond all cells."""
        index = np.rint(points / self.spacing).astype(np.int64) - self.corner
        np.clip(index, 0, np.array(self.cells.shape) - 1, out=index)
        strides = np.array([self.cells.shape[1] * self.cells.shape[2], self.cells.shape[2], 1])
        return self.cells.ravel()[index @ strides]


@dataclass(frozen=True, eq=False, slots=True)
class WaysOut:
    """The six ways out of n cavities of one size, in the order of WAYS.

    Attributes:
        top: height of the mouth of the shaft above the middle of the cavity [m], (n, 6).
        free: whether nothing that does not give way was met before the box stands clear of the mouth, (n, 6).
        brushed: share of the way that leads through soft tissue of other bodies, (n, 6).
    """

    top: Array
    free: Mask
    brushed: Array


def ways_out(around: Surroundings, half: Array, centre: Array, turn: Array) -> WaysOut:
    """Look along all ways out of cavities at centre (n, 3), turn (n, 3, 3)."""
    n = len(centre)
    top, free, brushed = np.zeros((n, 6)), np.zeros((n, 6), bool), np.zeros((n, 6))
    corners = np.array(list(itertools.product(*around.box.T)))
    for way, (axis, sign) in enumerate(WAYS):
        out = sign * turn[:, :, axis]
        reach = ((corners - centre[:, None]) @ out[:, :, None])[..., 0].max(axis=1)
        heights = np.arange(half[axis], max(float(reach.max()), half[axis]) + 2 * half[axis] + ALONG, ALONG)
        grids = [
            np.linspace(-half[a], half[a], math.ceil(2 * half[a] / ACROSS) + 1) if a != axis else sign * heights
            for a in range(3)
        ]
        local = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1)
        local = np.moveaxis(local, axis, 0).reshape(-1, 3)  # heights first
        cells = around.at(centre[:, None] + local @ np.swapaxes(turn, 1, 2)).reshape(n, len(heights), -1)
        own = (cells == OWN).any(axis=2)
        last = np.where(own.any(axis=1), len(heights) - np.argmax(own[:, ::-1], axis=1), 0)
        top[:, way] = half[axis] + last * ALONG
        passed = heights[None] <= top[:, way, None] + 2 * half[axis]
        free[:, way] = ~((cells == BLOCKED).any(axis=2) & passed).any(axis=1)
        brushed[:, way] = ((cells == OTHER).mean(axis=2) * passed).sum(axis=1) / passed.sum(axis=1)
    return WaysOut(top, free, brushed)


def shaft_boxes(half: Array, centre: Array, turn: Array, top: Array) -> tuple[Array, Array]:
    """Half extents and centres of the boxes from the bottom of a cavity to `top` (n, 6), six ways each: (n, 6, 3)."""
    sizes, middles = np.repeat(half[None, None], len(centre), 0).repeat(6, 1), np.repeat(centre[:, None], 6, 1)
    for way, (axis, sign) in enumerate(WAYS):
        sizes[:, way, axis] = (top[:, way] + half[axis]) / 2
        middles[:, way] += sign * ((top[:, way] - half[axis]) / 2)[:, None] * turn[:, :, axis]
    return sizes, middles


def apart(half: Array, centre: Array, turn: Array, tops: tuple[Array, Array], wall: float) -> Mask:
    """Whether two boxes can go in and out independently, for all ways of both: (n, 6, 6).

    Neither shaft, with the height of its box above the mouth, meets the other cavity, and between the two shafts there
    is a wall.

    Args:
        half: half extents of the two cavities [m], (2, 3).
        centre: of the cavities in n layouts [m], (n, 2, 3).
        turn: R_design_box of the same, (n, 2, 3, 3).
        tops: heights of the mouths of both, (n, 6) each [m].
        wall: between shafts [m].
    """
    rise = [np.array([2 * h[axis] for axis, _ in WAYS]) for h in half]
    short = [shaft_boxes(half[b], centre[:, b], turn[:, b], tops[b]) for b in range(2)]
    tall = [shaft_boxes(half[b], centre[:, b], turn[:, b], tops[b] + rise[b]) for b in range(2)]
    t = [turn[:, b, None] for b in range(2)]
    clear = [separation(*tall[b], t[b], half[1 - b], centre[:, 1 - b, None], t[1 - b]) > 0 for b in range(2)]
    between = separation(
        short[0][0][:, :, None], short[0][1][:, :, None], t[0][:, :, None],
        short[1][0][:, None], short[1][1][:, None], t[1][:, None],
    ) >= wall  # fmt: skip
    return between & clear[0][:, :, None] & clear[1][:, None]
