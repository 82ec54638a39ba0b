"""One or two boxes in one bone together: how much room they have, and near misses shifted and turned until they fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def layouts_of(places: tuple[Places, ...], wall: float) -> Layout:
    """All layouts of one box, or of two: of every place of the first with every place of the second."""
    if len(places) == 1:
        one = places[0]
        place = np.arange(len(one))[:, None]
        return Layout(one.half[None], one.centre[:, None], one.turn[:, None], one.margin, place)
    first, second = places
    gap = separation(
        first.half, first.centre[:, None], first.turn[:, None], second.half, second.centre[None], second.turn[None]
    )
    margin = np.minimum(np.minimum(first.margin[:, None], second.margin[None]), gap - wall)
    a, b = np.indices(margin.shape).reshape(2, -1)
    return Layout(
        np.stack([first.half, second.half]),
        np.stack([first.centre[a], second.centre[b]], axis=1),
        np.stack([first.turn[a], second.turn[b]], axis=1),
        margin.reshape(-1),
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
    rooms = _rooms(depth, half, centre, turn, look)
    margin, value = _judged(rooms, half, centre, turn, wall, look)
    best = Layout(
        half, centre.copy(), turn.copy(), margin.copy(), np.arange(centre[..., 0].size).reshape(-1, len(half))
    )
    level = np.zeros(len(layout), int)
    for _ in range(ROUNDS):
        busy = np.flatnonzero((level < len(steps)) & (margin < ENOUGH))
        if not len(busy):
            break
        slope = _slope(depth, [r[busy] for r in rooms], half, centre[busy], turn[busy], value[busy], wall, look)
        length = np.maximum(np.linalg.norm(slope, axis=(1, 2), keepdims=True), 1e-12)
        moved = _moved(half, centre[busy], turn[busy], slope / length * steps[level[busy]][:, None, None])
        tried = _rooms(depth, half, *moved, look)
        least, worth = _judged(tried, half, *moved, wall, look)
        gains = worth > value[busy] + 1e-6
        level[busy[~gains]] += 1
        rows = busy[gains]
        centre[rows], turn[rows], margin[rows], value[rows] = (
            moved[0][gains],
            moved[1][gains],
            least[gains],
            worth[gains],
        )
        for room, new in zip(rooms, tried, strict=True):
            room[rows] = new[gains]
        rows = rows[margin[rows] > best.margin[rows]]
        best.centre[rows], best.turn[rows], best.margin[rows] = centre[rows], turn[rows], margin[rows]
    return best


def _rooms(depth: Field, half: Array, centre: Array, turn: Array, look: Look) -> list[NDArray[np.float32]]:
    """Depth all over the surface of every box in n layouts, (n, m) each [m]."""
    return [_depths(depth, half[b], centre[:, b], turn[:, b], look) for b in range(len(half))]


def _depths(depth: Field, half: Array, centre: Array, turn: Array, look: Look) -> NDArray[np.float32]:
    return depth.sample(centre[:, None] + box_surface(half, look.sample) @ np.swapaxes(turn, 1, 2))


def _judged(
    rooms: list[NDArray[np.float32]], half: Array, centre: Array, turn: Array, wall: float, look: Look
) -> tuple[Array, Array]:
    """Margin of every layout, and its smooth stand-in, which every shallow point pulls down a little [m]."""
    if len(half) == 2:
        gap = separation(half[0], centre[:, 0], turn[:, 0], half[1], centre[:, 1], turn[:, 1])
        rooms = [*rooms, gap[:, None].astype(np.float32)]
    room = np.concatenate(rooms, axis=1) - np.float32(wall)
    margin, soft = room.min(axis=1), np.float32(look.soft)
    value = margin - soft * np.log(np.exp((margin[:, None] - room) / soft).sum(axis=1))
    return margin.astype(np.float64), value.astype(np.float64)


def _slope(
    depth: Field, rooms: list[NDArray[np.float32]], half: Array, centre: Array, turn: Array, value: Array, wall: float,
    look: Look,
) -> Array:  # fmt: skip
    """Gain of the stand-in per length of each of the 6 moves of every box, (n, k, 6)."""
    n, k = centre.shape[:2]
    slope = np.zeros((n, k, 6))
    for b in range(k):
        move = np.zeros((n, 6, k, 6))
        move[:, range(6), b, range(6)] = PROBE
        c, t = _moved(half, np.repeat(centre, 6, axis=0), np.repeat(turn, 6, axis=0), move.reshape(-1, k, 6))
        probed = [
            _depths(depth, half[b], c[:, b], t[:, b], look) if other == b else np.repeat(rooms[other], 6, axis=0)
            for other in range(k)
        ]
        slope[:, b] = (_judged(probed, half, c, t, wall, look)[1].reshape(n, 6) - value[:, None]) / PROBE
    return slope


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
