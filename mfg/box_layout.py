"""One or two boxes in one bone together: how much room they have, and near misses shifted and turned until they fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from mfg.box_fit import Places, box_surface, separation
from mfg.fields import Field

Array = NDArray[np.float64]
Rows = NDArray[np.int64] | NDArray[np.bool_]
PROBE = 5.0e-4  # length of the moves by which slopes are measured [m]
ROUNDS = 24  # moves at most
ENOUGH = 3.0e-4  # margin at which a layout needs no more mending [m]


@dataclass(frozen=True, eq=False, slots=True)
class Layout:
    """n ways to put k boxes into one bone.

    Attributes:
        half: half extents of the cavities [m], (k, 3).
        centre: (n, k, 3) in the design frame [m].
        turn: R_design_box, (n, k, 3, 3).
        margin: least of what the boxes have beyond the wall, to the outside and between each other [m], (n,).
        place: which place each box takes; where two layouts agree in it, they agree in the box, (n, k).
    """

    half: Array
    centre: Array
    turn: Array
    margin: Array
    place: NDArray[np.int64]

    def __len__(self) -> int:
        """How many."""
        return len(self.margin)

    def only(self, rows: Rows) -> Layout:
        """Some of the layouts."""
        return Layout(self.half, self.centre[rows], self.turn[rows], self.margin[rows], self.place[rows])

    def nearest(self, count: int) -> Layout:
        """The layouts with the most room, one for every place of the first box, the best first."""
        order = np.argsort(-self.margin, kind="stable")
        _, first = np.unique(self.place[order, 0], return_index=True)
        return self.only(order[np.sort(first)[:count]])


def layouts_of(places: tuple[Places, ...], wall: float, least: float = -np.inf) -> Layout:
    """The layouts of one box, or of every place of one with every place of another, with a margin of `least` or more.

    Args:
        places: of every box.
        wall: between two boxes [m].
        least: margin [m].
    """
    if len(places) == 1:
        one = places[0]
        place = np.flatnonzero(one.margin >= least)
        return Layout(one.half[None], one.centre[place, None], one.turn[place, None], one.margin[place], place[:, None])
    first, second = places
    margin = np.minimum(first.margin[:, None], second.margin[None])
    # No slab between two boxes is wider than what their middles are apart less half of their least sides.
    away = cdist(first.centre, second.centre) - (first.half.min() + second.half.min() + wall)
    a, b = np.nonzero(np.minimum(margin, away) >= least)
    gap = separation(first.half, first.centre[a], first.turn[a], second.half, second.centre[b], second.turn[b])
    margin = np.minimum(margin[a, b], gap - wall)
    keep = np.flatnonzero(margin >= least)
    a, b = a[keep], b[keep]
    return Layout(
        np.stack([first.half, second.half]),
        np.stack([first.centre[a], second.centre[b]], axis=1),
        np.stack([first.turn[a], second.turn[b]], axis=1),
        margin[keep],
        np.stack([a, b], axis=1),
    )


def joined(first: Layout, second: Layout) -> Layout:
    """The layouts of both, each at places of its own."""
    both = [np.concatenate(pair) for pair in ((first.centre, second.centre), (first.turn, second.turn))]
    margin = np.concatenate([first.margin, second.margin])
    place = np.arange(margin.size * len(first.half)).reshape(-1, len(first.half))
    return Layout(first.half, both[0], both[1], margin, place)


@dataclass(frozen=True, slots=True)
class Look:
    """How closely layouts are looked at while they are mended.

    Attributes:
        steps: lengths of the moves [m], falling; a turn moves the corners of a box by as much.
        sample: greatest distance between the points of a surface that are looked at [m].
        soft: differences in depth that the smooth stand-in for the margin evens out [m].
    """

    steps: tuple[float, ...]
    sample: float
    soft: float


def refined(depth: Field, layout: Layout, wall: float, look: Look) -> Layout:
    """Shift and turn the boxes of every layout that does not fit yet, and give the best seen of each.

    Steepest ascent of a smooth stand-in for the margin; where a step gains nothing, the next smaller one is tried. A
    layout is done when it fits or when the steps are used up.

    Args:
        depth: distance to all that a cavity keeps away from [m].
        layout: to start from.
        wall: least depth of the cavities, and between them [m].
        look: how far to move and how closely to look.
    """
    half, centre, turn = layout.half, layout.centre.copy(), layout.turn.copy()
    steps = np.array(look.steps)
    margin, value, slope = _judged(depth, half, centre, turn, wall, look)
    best = Layout(
        half, centre.copy(), turn.copy(), margin.copy(), np.arange(centre[..., 0].size).reshape(-1, len(half))
    )
    level = np.zeros(len(layout), int)
    for _ in range(ROUNDS):
        busy = np.flatnonzero((level < len(steps)) & (margin < ENOUGH))
        if not len(busy):
            break
        length = np.maximum(np.linalg.norm(slope[busy], axis=(1, 2), keepdims=True), 1e-12)
        moved = _moved(half, centre[busy], turn[busy], slope[busy] / length * steps[level[busy]][:, None, None])
        least, worth, onward = _judged(depth, half, *moved, wall, look)
        gains = worth > value[busy] + 1e-6
        level[busy[~gains]] += 1
        rows = busy[gains]
        centre[rows], turn[rows] = moved[0][gains], moved[1][gains]
        margin[rows], value[rows], slope[rows] = least[gains], worth[gains], onward[gains]
        rows = rows[margin[rows] > best.margin[rows]]
        best.centre[rows], best.turn[rows], best.margin[rows] = centre[rows], turn[rows], margin[rows]
    return best


def _judged(
    depth: Field, half: Array, centre: Array, turn: Array, wall: float, look: Look
) -> tuple[Array, Array, Array]:
    """Margin of every layout, its smooth stand-in, and the slope of that for each of the 6 moves of every box.

    The stand-in is v = -s log(sum exp(-r / s)) over what there is beyond the wall at every point of the surfaces and
    between the boxes, r, at softness s: every shallow point pulls it down a little. So dv = sum w dr with
    w = exp((v - r) / s), and a shift d or a turn t of a box changes the depth at its point p, seen from its middle, by
    g d + (p x g) t where g is the slope of the depth.

    Returns:
        Margin and stand-in [m], (n,) each, and the slope, (n, k, 6).
    """
    n, k = centre.shape[:2]
    arms = [box_surface(half[b], look.sample) @ np.swapaxes(turn[:, b], 1, 2) for b in range(k)]
    depths, slopes = zip(*(depth.sloped(centre[:, b, None] + arms[b]) for b in range(k)), strict=True)
    rooms = list(depths)
    if k == 2:
        gap = separation(half[0], centre[:, 0], turn[:, 0], half[1], centre[:, 1], turn[:, 1])
        rooms.append(gap[:, None].astype(np.float32))
    room = np.concatenate(rooms, axis=1) - np.float32(wall)
    margin, soft = room.min(axis=1), np.float32(look.soft)
    weight = np.exp((margin[:, None] - room) / soft)
    total = weight.sum(axis=1)
    value = margin - soft * np.log(total)
    weight /= total[:, None]
    slope = np.zeros((n, k, 6))
    first = 0
    for b in range(k):
        pull = slopes[b] * weight[:, first : first + arms[b].shape[1], None]
        first += arms[b].shape[1]
        slope[:, b, :3] = pull.sum(axis=1)
        moment = np.swapaxes(arms[b], 1, 2) @ pull  # its antisymmetric part is the sum of p x g
        across = moment[:, (1, 2, 0), (2, 0, 1)] - moment[:, (2, 0, 1), (1, 2, 0)]
        slope[:, b, 3:] = across / np.linalg.norm(half[b])
    if k == 2:
        slope += weight[:, -1, None, None] * _parting(half, centre, turn, gap)
    return margin.astype(np.float64), value.astype(np.float64), slope


def _parting(half: Array, centre: Array, turn: Array, gap: Array) -> Array:
    """Gain of the gap between two boxes per length of each of the 6 moves of either, (n, 2, 6)."""
    move = (np.eye(12) * PROBE).reshape(12, 2, 6)
    c, t = _moved(half, centre[:, None], turn[:, None], move)
    wide = separation(half[0], c[..., 0, :], t[..., 0, :, :], half[1], c[..., 1, :], t[..., 1, :, :])
    return ((wide - gap[:, None]) / PROBE).reshape(-1, 2, 6)


def _moved(half: Array, centre: Array, turn: Array, move: Array) -> tuple[Array, Array]:
    """Layouts whose boxes are shifted by move[..., :3] and turned so that corners go about move[..., 3:] far [m]."""
    vector = move[..., 3:] / np.linalg.norm(half, axis=-1)[:, None]
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    cross = np.zeros((*vector.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -z, y, -x
    cross -= np.swapaxes(cross, -1, -2)
    small = np.maximum(angle, 1e-9)
    rotation = np.eye(3) + np.sinc(small / np.pi) * cross + (1 - np.cos(small)) / small**2 * (cross @ cross)
    return centre + move[..., :3], rotation @ turn
