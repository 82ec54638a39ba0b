"""Shortest ways for cables through a route field, from straight approaches at the controller to those at the motors."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, BoxSeat, MotorSeat
from mfg.cheapest_ways import RootedGraph, Tree
from mfg.fields import Field
from mfg.mounts import Mount
from mfg.route_field import Margins, Obstacles, RouteField
from mfg.routing import AZIMUTHS, box_references

Array = NDArray[np.float64]
Index = NDArray[np.int64]
STEPS = np.array([s for s in itertools.product((-1, 0, 1), repeat=3) if 0 < np.abs(s).sum() < 3])  # 18 neighbours
TURNS = (0.0, np.pi / 4, np.pi / 2)  # of the arcs that lead from a straight approach to the samples around [rad]
EASE = 1.6  # radius of these arcs over the cable's least
SLANT = 1.0  # by how much a tunnel may meet a motor's cup off square [rad]
HEADING = 0.4  # price of a way that doubles back at the end of such an arc [m]
DETOURS = (0.25, 1e6)  # how much more than the cheapest way with nothing taken a way may cost, tried in order [m]
BLUR = 5e-4  # by how much the interpolated clearance may come out too small [m]


@dataclass(frozen=True, eq=False, slots=True)
class Mouths:
    """Straight approaches of tunnels to one piece of hardware, and the arcs that lead on from them.

    Attributes:
        start: where each tunnel opens into the cavity [m], (m, 3).
        outer: where its straight approach ends [m], (m, 3).
        mouth, node: of every arc: the mouth that it begins at and the sample that it ends near, (k,).
        bends: points along every arc [m], (k, 2, 3).
        heading: unit direction at its end, (k, 3).
        cost: of it, approach included [m], (k,).
    """

    start: Array
    outer: Array
    mouth: Index
    node: Index
    bends: Array
    heading: Array
    cost: Array


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """A way on the lattice.

    Attributes:
        points: from mouth to mouth, the ends of the straight approaches second and last but one, (n, 3) [m].
        start, end: indices of the mouths at the controller and at the motor.
    """

    points: Array
    start: int
    end: int


@dataclass(frozen=True, eq=False, slots=True)
class Taken:
    """What earlier tunnels leave no room for.

    Attributes:
        cells: of the graph's samples, (n,).
        starts, ends: of the mouths at the controller and at one motor, (m,) each.
    """

    cells: NDArray[np.bool_]
    starts: NDArray[np.bool_]
    ends: NDArray[np.bool_]


class RouteGraph:
    """The samples of a route field as nodes of a graph, and the controller as one more."""

    def __init__(self, blueprint: Blueprint, field: RouteField, margins: Margins, approach: float) -> None:
        """Link neighbouring samples and lay out the mouths.

        Args:
            blueprint: with seats and boxes.
            field: its free room.
            margins: of every tunnel.
            approach: length of the straight stretch at either end of a tunnel [m].
        """
        self.blueprint, self.field, self.margins, self.approach = blueprint, field, margins, approach
        self.obstacles = Obstacles.of(blueprint, margins.shafts)
        self.cells = np.flatnonzero(field.label >= 0)
        self.index = np.full(field.label.size, -1, np.int32)
        self.index[self.cells] = np.arange(len(self.cells), dtype=np.int32)
        at = np.stack(np.unravel_index(self.cells, field.label.shape), axis=-1)
        self.points = (at + np.asarray(field.clearance.corner)) * field.clearance.spacing
        self.label = field.label.ravel()[self.cells]
        self.cost = field.cost.ravel()[self.cells]
        self.starts = self._from_controller()
        self.ends = [self._to_motor(k) for k in range(len(blueprint.seats))]
        column, weight = self.linked()
        graph = RootedGraph.of(column, weight, [self.starts.node, *(ends.node for ends in self.ends)])
        self.first = graph.tree(0, self.starts.cost)
        # What a step adds to the whole way over a motor, it and the cheapest rest: what a search need not follow costs.
        self.rest = np.where(np.isfinite(self.first.length), self.first.length, 1e3).astype(np.float32)
        weight += self.rest.take(column)
        weight -= self.rest[:, None]
        self.graph = graph.costing(np.maximum(weight, np.float32(1e-9), out=weight))

    def linked(self) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Every sample's 18 neighbours and what a step to each costs, (n, 18) each.

        A step to one of another label that is not joined to its own, or to none, leads back and costs infinitely much.
        """
        shape = self.field.label.shape
        # The outermost samples have no label: no step leaves the array.
        stride = np.array([shape[1] * shape[2], shape[2], 1])
        other = self.index.take(self.cells[:, None] + STEPS @ stride)
        none = other < 0
        other[none] = len(self.cells)  # a sample without a label takes what is appended
        weight = np.append(self.cost, np.float32(np.inf)).take(other, mode="clip")
        weight += self.cost[:, None]
        weight *= (np.linalg.norm(STEPS, axis=1) * (self.field.clearance.spacing / 2)).astype(np.float32)
        beyond = np.append(self.label, np.int8(-1)).take(other, mode="clip")
        row, step = np.divmod(np.flatnonzero((beyond != self.label[:, None]) & ~none), len(STEPS))
        shut = ~self.field.joined[self.label[row], beyond[row, step]]
        weight[row[shut], step[shut]] = np.inf
        row, step = np.divmod(np.flatnonzero(none), len(STEPS))
        other[row, step] = row
        return other, weight

    def _from_controller(self) -> Mouths:
        box, seats = self.blueprint.box("controller"), len(self.blueprint.seats)
        start, out = controller_mouths(box, self.margins)
        outer = start + self.approach * out
        along = start[:, None] + np.linspace(0, 1, 4)[:, None] * (outer - start)[:, None]
        clear = self._clear_of_others(along, seats + self.blueprint.boxes.index(box))
        depth = self.blueprint.bodies[box.body].bone.sample(along).min(axis=1)
        clear &= depth >= self.margins.radius + self.margins.wall
        return self._leading_on(start[clear], outer[clear], out[clear], (box.body,))

    def _to_motor(self, k: int) -> Mouths:
        seat, mount = self.blueprint.seats[k], self.obstacles.mount
        start, out = motor_mouths(seat, mount, self.margins.radius)
        # Slanted approaches are longer: they end as far from the cup.
        beside = start - seat.T_design_motor[:3, 3]
        axis = seat.T_design_motor[:3, 2]
        beside -= (beside @ axis)[:, None] * axis
        across = out - (out @ axis)[:, None] * axis
        a, b = (across**2).sum(axis=1), (beside * across).sum(axis=1)
        beyond = mount.holder_radius + self.margins.radius + self.margins.gap + BLUR
        length = (np.sqrt(np.maximum(b**2 + a * (beyond**2 - (beside**2).sum(axis=1)), 0)) - b) / a
        outer = start + np.maximum(length, self.approach)[:, None] * out
        along = start[:, None] + np.linspace(0, 1, 5)[:, None] * (outer - start)[:, None]
        clear = self._clear_of_others(along, k)
        # What the motor's own output moves must not be pierced on the way in.
        clear &= self.blueprint.bodies[seat.connector].bone.sample(along).max(axis=1) < -self.margins.radius
        return self._leading_on(start[clear], outer[clear], out[clear], (seat.holder, len(self.blueprint.bodies) + k))

    def _clear_of_others(self, along: Array, own: int) -> NDArray[np.bool_]:
        distance = self.obstacles.distance(along.reshape(-1, 3)).reshape(-1, *along.shape[:2])
        rest = np.delete(distance, own, axis=0)
        near = self.margins.radius + self.margins.gap
        return np.asarray((rest >= near).all(axis=(0, 2))) if len(rest) else np.ones(len(along), bool)

    def _leading_on(self, start: Array, outer: Array, out: Array, labels: tuple[int, ...]) -> Mouths:
        """Arcs from the end of every approach to samples that carry one of the labels, where all of an arc is free."""
        clearance = self.field.clearance
        here = clearance.sample(outer) >= -BLUR
        start, outer, out = start[here], outer[here], out[here]
        radius = EASE * self.blueprint.catalogue.wire.bend_radius
        side = _ring(out)
        leads, headings, lengths = [], [], []
        for angle in TURNS:
            # The arc that does not turn is as long as half of one that turns at right angles.
            arc = angle * np.array([1 / 3, 2 / 3, 1])
            ahead = np.sin(arc) if angle else np.array([1 / 3, 2 / 3, 1]) * (np.pi / 4)
            around = side if angle else side[:1]
            leads.append(ahead[:, None] * out[None, :, None] + (1 - np.cos(arc))[:, None] * around[:, :, None])
            headings.append(np.cos(angle) * out + np.sin(angle) * around)
            lengths.append(np.full(len(around), radius * max(angle, np.pi / 4)))
        points = outer[:, None] + radius * np.concatenate(leads)  # (turn, mouth, along, 3)
        at = np.round((points[:, :, 2] - clearance.origin) / clearance.spacing).astype(int)
        inside = ((at >= 0) & (at < clearance.values.shape)).all(axis=-1)
        flat = np.ravel_multi_index(
            tuple(np.where(inside, a, 0) for a in np.moveaxis(at, -1, 0)), clearance.values.shape
        )
        node = np.where(inside, self.index[flat], -1).astype(np.int64)
        ok = (node >= 0) & np.isin(self.label[np.maximum(node, 0)], labels)
        turn, mouth = np.nonzero(ok)
        free = (clearance.sample(points[turn, mouth]) >= -BLUR).all(axis=1)
        turn, mouth = turn[free], mouth[free]
        hit = node[turn, mouth]
        stub = np.linalg.norm(outer - start, axis=1)[mouth]
        cost = (stub + np.concatenate(lengths)[turn]) * self.cost[hit]
        return Mouths(start, outer, mouth, hit, points[turn, mouth, :2], np.concatenate(headings)[turn, mouth], cost)

    def taken(self, seat: int, earlier: list[Array], apart: float) -> Taken:
        """What earlier tunnels, as points at most a few millimetres apart, leave no room for at a distance [m]."""
        cells = np.zeros(len(self.cells), bool)
        for path in earlier:
            near = self.index.take(_samples_near(self.field.clearance, path, apart))
            cells[near[near >= 0]] = True
        starts, ends = (
            np.any([np.minimum(_distance((m.start + m.outer) / 2, p), _distance(m.outer, p)) < apart for p in earlier],
                   axis=0) if earlier else np.zeros(len(m.start), bool)
            for m in (self.starts, self.ends[seat])
        )  # fmt: skip
        return Taken(cells, starts, ends)

    def tree(self, seat: int, taken: Taken, banned: set[int]) -> Tree | None:
        """Cheapest ways from a motor to every sample that earlier tunnels leave.

        Args:
            seat: index of the motor.
            taken: by earlier tunnels.
            banned: mouths at the motor that must not be used.

        Returns:
            The tree, as far as ways may matter, or None where every mouth is taken.
        """
        ends = self.ends[seat]
        cost = ends.cost + HEADING * (1 - self._onward(ends, self.first.before)) + self.rest[ends.node]
        cost[_shut(taken.ends, banned)[ends.mouth] | taken.cells[ends.node]] = np.inf
        if not len(cost) or not np.isfinite(cost).any():
            return None
        for detour in DETOURS:
            tree = self.graph.tree(seat + 1, cost, float(cost.min()) + detour, taken.cells)
            tree.length[taken.cells] = np.inf
            if np.isfinite(tree.length[self.starts.node]).any():
                break
        return replace(tree, length=tree.length - self.rest)

    def way(self, seat: int, tree: Tree, taken: Taken, banned: set[int]) -> Way | None:
        """Cheapest way of a motor's tree to the controller, without its banned mouths, or None."""
        starts, ends = self.starts, self.ends[seat]
        total = tree.length[starts.node] + starts.cost + HEADING * (1 - self._onward(starts, tree.before))
        total[_shut(taken.starts, banned)[starts.mouth]] = np.inf
        if not len(total) or not np.isfinite(total).any():
            return None
        best = int(np.argmin(total))
        chain = [int(starts.node[best])]
        while tree.before[chain[-1]] < len(self.cells):
            chain.append(int(tree.before[chain[-1]]))
        arcs = np.flatnonzero(ends.node == chain[-1])
        leaf = int(arcs[np.argmin(tree.cost[arcs])])
        first, last = int(starts.mouth[best]), int(ends.mouth[leaf])
        points = [
            starts.start[[first]], starts.outer[[first]], starts.bends[best], self.points[chain],
            ends.bends[leaf][::-1], ends.outer[[last]], ends.start[[last]],
        ]  # fmt: skip
        return Way(np.concatenate(points), first, last)

    def _onward(self, mouths: Mouths, before: NDArray[np.int32]) -> Array:
        """Cosine between the heading of every arc and the way onward from its end, (k,)."""
        node = mouths.node
        for _ in range(3):
            back = before[node]
            node = np.where((back >= 0) & (back < len(self.cells)), back, node)
        way = self.points[node] - self.points[mouths.node]
        along = (way * mouths.heading).sum(axis=1)
        return np.asarray(along / np.maximum(np.linalg.norm(way, axis=1), 1e-9))


def controller_mouths(box: BoxSeat, margins: Margins) -> tuple[Array, Array]:
    """Where tunnels may open into the controller's cavity, and the outward normals of its faces there, (n, 3) each."""
    points = box_references(box, margins.radius, margins.gap)
    R, centre = box.T_design_box[:3, :3], box.T_design_box[:3, 3]
    local = (points - centre) @ R
    beyond = np.abs(local) - np.array(box.size) / 2
    normal = np.zeros_like(local)
    rows, axis = np.arange(len(local)), beyond.argmax(axis=1)
    normal[rows, axis] = np.sign(local[rows, axis])
    return points, normal @ R.T


def motor_mouths(seat: MotorSeat, mount: Mount, radius: float) -> tuple[Array, Array]:
    """Where tunnels may open into a motor's cavity, through the side of its cup, and the ways out, (n, 3) each.

    They end beside the housing near its lower end, square to it or slanted.
    """
    T = seat.T_design_motor
    angle = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    side = np.cos(angle)[:, None] * T[:3, 0] + np.sin(angle)[:, None] * T[:3, 1]
    foot = T[:3, 3] + (mount.housing_low + 2 * radius) * T[:3, 2]
    # A tunnel that touches the housing opens into the gap around it, facets and all; farther off a film could stay.
    points = foot + (mount.housing_radius + radius) * side
    round_about = np.cross(T[:3, 2], side)
    slanted = [
        np.cos(SLANT) * side + np.sin(SLANT) * (c * round_about + s * T[:3, 2])
        for c, s in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    return np.tile(points, (5, 1)), np.concatenate([side, *slanted])


def _ring(axis: Array) -> Array:
    """Six unit vectors square to each axis (m, 3), evenly around it, (6, m, 3)."""
    helper = np.eye(3)[np.abs(axis).argmin(axis=1)]
    x = np.cross(axis, helper)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    turn = np.arange(6) * (np.pi / 3)
    return np.asarray(np.cos(turn)[:, None, None] * x + np.sin(turn)[:, None, None] * np.cross(axis, x))


def _shut(taken: NDArray[np.bool_], banned: set[int]) -> NDArray[np.bool_]:
    """Which mouths are banned or taken."""
    shut = taken.copy()
    shut[sorted(banned)] = True
    return shut


def _samples_near(grid: Field, path: Array, apart: float) -> Index:
    """Flat indices of the samples of a lattice nearer than `apart` to any vertex of a path (k, 3) [m], some twice."""
    place = (path - grid.origin) / grid.spacing
    middle = np.rint(place).astype(np.int64)
    reach = int(apart / grid.spacing + 0.5)
    offset = np.arange(-reach, reach + 1)
    squares = []
    for axis, size in enumerate(grid.values.shape):
        at = middle[:, axis, None] + offset
        squares.append(np.where((at >= 0) & (at < size), (at - place[:, axis, None]) ** 2, np.inf))
    x, y, z = squares
    near = x[:, :, None, None] + y[:, None, :, None] + z[:, None, None] < (apart / grid.spacing) ** 2
    vertex, *steps = np.nonzero(near)
    i, j, k = (middle[vertex, axis] + offset[step] for axis, step in enumerate(steps))
    return np.asarray((i * grid.values.shape[1] + j) * grid.values.shape[2] + k, np.int64)


def _distance(points: Array, path: Array) -> Array:
    """Distance from points (n, 3) to the vertices of a path (k, 3), (n,) [m]."""
    if not len(points):
        return np.zeros(0)
    squared = (points**2).sum(axis=1)[:, None] + (path**2).sum(axis=1) - 2 * points @ path.T
    return np.sqrt(np.maximum(squared.min(axis=1), 0.0))
