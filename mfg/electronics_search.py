"""Solver: battery and controller anywhere in a bone, in any of 64 orientations, with a free way in (search form)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, BoxSeat
from mfg.box_fit import Places, box_points, places
from mfg.box_host import KINDS, Host, Kind, scored
from mfg.box_layout import Layout, Look, joined, layouts_of, refined
from mfg.box_miss import miss_of
from mfg.box_paths import WAYS, Surroundings, apart, ways_out
from mfg.catalogue import Size
from mfg.electronics import CORNERS, side_by_side
from mfg.insertion import interference_above, outer_surface, shaft_height
from mfg.miss import Miss
from mfg.mounts import mount_of
from mfg.orientations import along, orientations
from mfg.outcome import Failure, Reason, Stage

Array = NDArray[np.float64]
PRINTED = 0.4  # share of a bone that walls and infill fill, for its weight (assumed)
LOOKED_AT = 400  # layouts of one bone whose ways in are compared
FINALISTS = 6  # mended layouts of one bone that are mended again, at a closer look
COARSE = Look((0.004, 0.002, 0.001, 0.0005), sample=0.018, soft=1.0e-3)  # at first, for the nearest misses
FINE = Look((0.002, 0.001, 0.0005), sample=0.006, soft=3.0e-4)  # then, for the best of them
HOPELESS = 0.002  # miss after the first look that a closer one does not mend [m]
ANCHORED = 3  # arrangements at the centre of mass that are mended too, in each of two frames
FAR = 0.025  # greatest miss that is described exactly where nothing comes near [m]
TRIED = 40  # ways in of one bone that are looked at closely
ROUNDING = 1.0e-6  # a margin may be negative by so much [m]
CLOSE = 0.006  # greatest distance between points of a cavity in a close look [m]
TOUCH = 1.0e-4  # by which a point of a cavity may be too shallow in a close look [m]


@dataclass(frozen=True)
class SearchElectronicsSolver:
    """Place battery and controller anywhere in the whole volume of a bone, with a free way in for each.

    In every bone the centres of a box are all samples of its depth field that are deep enough, its orientations the
    64 of `mfg.orientations`; what misses by less than `slack` is then shifted and turned until it fits or does not.
    Both boxes go into one bone where that is possible (the largest bone first), else one each into two bones. A box is
    inserted along one of the six directions of its sides; its shaft is cut through the host's own bone and skin, and
    on its way it meets no motor or mount, no bone of another body at rest, and not the other box: each can be taken
    out while the other stays in. Of all accepted placements the one with the least cost is taken:

        sum over boxes: shaft + `balance` * distance to the centre of mass - `deep` * min(spare depth, `spare`)
        + `soft` * share of the way that brushes past soft tissue of other bodies

    Attributes:
        clearance: gap between a box and its cavity [m].
        wall: least depth of a cavity in the bone, away from every motor mount too, and between two cavities [m].
        slack: greatest miss on the lattice that is worth mending [m].
        mended: layouts of one bone that are mended, the nearest misses first.
        blocked: most of what stands in the way of a box [m3]; 0 means a free way.
        balance: cost per distance from the robot's centre of mass.
        deep: gain per spare depth beyond the wall.
        spare: depth beyond the wall that is worth something [m].
        soft: cost of a way wholly through soft tissue of other bodies [m].
    """

    clearance: float = 0.001
    wall: float = 0.003
    slack: float = 0.006
    mended: int = 12
    blocked: float = 0.0
    balance: float = 0.1
    deep: float = 1.0
    spare: float = 0.004
    soft: float = 0.05

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `boxes` and the two electronics scores, or a failure with the closest miss."""
        search = _Search(self, blueprint)
        found = search.placed()
        if found is not None:
            return scored(blueprint, *found)
        miss = search.miss()
        detail = f"no bones take the boxes with walls of {1e3 * self.wall:.0f} mm; closest: {miss.detail}"
        return Failure(Stage.ELECTRONICS, Reason.NO_ROOM, detail, miss)


class _Search:
    """The search in all bones of one blueprint, largest first."""

    def __init__(self, rules: SearchElectronicsSolver, blueprint: Blueprint) -> None:
        mount = mount_of(blueprint.catalogue.motor)
        hosts = [Host(blueprint, index, mount) for index in range(len(blueprint.bodies))]
        hosts.sort(key=lambda host: (-host.samples, host.index))
        middle = centre_of_mass(blueprint, hosts)
        self.bones = [_Bone(rules, host, middle) for host in hosts]

    def placed(self) -> tuple[tuple[BoxSeat, ...], list[Host]] | None:
        """Seats for both boxes and their hosts, or None."""
        for bone in self.bones:
            boxes = bone.seats(KINDS)
            if boxes:
                return boxes, [bone.host]
        for small in range(1, len(self.bones)):
            for large in range(small):
                for b, c in ((large, small), (small, large)):
                    first = self.bones[b].seats(("battery",))
                    second = self.bones[c].seats(("controller",)) if first else ()
                    if first and second:
                        return first + second, [self.bones[b].host, self.bones[c].host]
        return None

    def miss(self) -> Miss:
        """The smallest change that would make room: for a pair, or for the box that finds none beside the other."""
        options = [miss for miss in (bone.miss(KINDS) for bone in self.bones) if miss is not None]
        needs = {kind: [(bool(bone.seats((kind,))), bone.miss((kind,))) for bone in self.bones] for kind in KINDS}
        for b, c in itertools.permutations(range(len(self.bones)), 2):
            (has_b, miss_b), (has_c, miss_c) = needs["battery"][b], needs["controller"][c]
            if (has_b or miss_b) and (has_c or miss_c):
                # Where two bones would have to change, the worse one tells how far away that is.
                options.append(max((m for m in (miss_b, miss_c) if m is not None), key=lambda miss: miss.shortfall))
        if options:
            return min(options, key=lambda miss: miss.shortfall)
        # Nothing comes near: what is worst off, in the bone with the most room.
        lost = [kind for kind in KINDS if not any(has or miss for has, miss in needs[kind])]
        roomiest = max(self.bones, key=lambda bone: float(bone.host.free.values.max()))
        return roomiest.far_miss((lost[0],) if lost else KINDS)


@dataclass(frozen=True, eq=False)
class _Bone:
    """One bone as it is searched."""

    rules: SearchElectronicsSolver
    host: Host
    middle: Array  # the robot's centre of mass [m]

    @cached_property
    def places(self) -> dict[Kind, Places]:
        """Where each box fits on its own, or nearly."""
        rules, catalogue = self.rules, self.host.blueprint.catalogue
        sizes: dict[Kind, Size] = {"battery": catalogue.battery.size, "controller": catalogue.computer.size}
        halves = {kind: np.array(size) / 2 + rules.clearance for kind, size in sizes.items()}
        if self.host.free.values.max() < rules.wall - rules.slack + min(half.min() for half in halves.values()):
            nothing = np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0)
            return {kind: Places(half, *nothing) for kind, half in halves.items()}
        turns = orientations(self.host.frames[1])
        return {kind: places(self.host.free, half, turns, rules.wall, rules.slack) for kind, half in halves.items()}

    @cached_property
    def around(self) -> Surroundings:
        """What a box may meet on its way in."""
        rise = 2 * max(float(p.half.max()) for p in self.places.values())
        return Surroundings.of(self.host.blueprint, self.host.index, rise + self.rules.wall)

    def layouts(self, kinds: tuple[Kind, ...], least: float) -> Layout:
        """The layouts on the lattice and in the 64 orientations with a margin of `least` or more [m]."""
        return layouts_of(tuple(self.places[kind] for kind in kinds), self.rules.wall, least)

    def anchored(self, kinds: tuple[Kind, ...]) -> Layout:
        """The arrangements of the paper's rules, at the bone's centre of mass, that come near: the best few."""
        rules, half = self.rules, np.stack([self.places[kind].half for kind in kinds])
        sizes = tuple(tuple(float(v) for v in 2 * (h - rules.clearance)) for h in half)
        known = side_by_side(sizes, rules.clearance, rules.wall)
        near = []
        for frame in self.host.frames:
            centre = self.host.anchor + known.centre @ frame.T
            turn = along(frame)[known.order]
            corners = centre[..., None, :] + (CORNERS * half[:, None]) @ np.swapaxes(turn, -1, -2)
            margin = self.host.free.sample(corners).min(axis=(1, 2)) - np.float32(rules.wall)
            best = np.argsort(-margin, kind="stable")[:ANCHORED]
            best = best[margin[best] >= -rules.slack]
            near.append(Layout(half, centre[best], turn[best], margin[best].astype(np.float64), known.order[best]))
        return joined(*near)

    def mended(self, kinds: tuple[Kind, ...]) -> Layout:
        """The most roomy layouts, shifted and turned to have more room, the best first."""
        if kinds not in self._mended:
            rules = self.rules
            found = self.layouts(kinds, -rules.slack).nearest(rules.mended)
            found = joined(found, self.anchored(kinds))
            found = refined(self.host.free, found, rules.wall, COARSE).nearest(FINALISTS)
            if len(found) and found.margin[0] >= -HOPELESS:
                found = refined(self.host.free, found, rules.wall, FINE).nearest(FINALISTS)
            self._mended[kinds] = found
        return self._mended[kinds]

    def seats(self, kinds: tuple[Kind, ...]) -> tuple[BoxSeat, ...]:
        """The accepted placement of least cost, empty where there is none."""
        if kinds not in self._seats:
            found = self.layouts(kinds, -ROUNDING)
            self._seats[kinds] = self._chosen(found, kinds) or self._chosen(self.mended(kinds), kinds)
        return self._seats[kinds]

    @cached_property
    def _mended(self) -> dict[tuple[Kind, ...], Layout]:
        return {}

    @cached_property
    def _seats(self) -> dict[tuple[Kind, ...], tuple[BoxSeat, ...]]:
        return {}

    def _chosen(self, found: Layout, kinds: tuple[Kind, ...]) -> tuple[BoxSeat, ...]:
        """The layout and the ways in of least cost that bear a close look."""
        found = found.only(found.margin >= -ROUNDING)
        if not len(found):
            return ()
        rules, n, k = self.rules, len(found), len(kinds)
        top, cost = np.zeros((n, k, 6)), np.zeros((n, k, 6))
        for box in range(k):
            # Where two layouts agree in the place, they agree in the box: look along its ways once.
            place = found.place[:, box]
            row_of = np.full(int(place.max()) + 1, -1)
            row_of[place[::-1]] = np.arange(n)[::-1]
            first = row_of[row_of >= 0]
            same = np.cumsum(row_of >= 0)[place] - 1
            half, centre = found.half[box], found.centre[first, box]
            ways = ways_out(self.around, half, centre, found.turn[first, box])
            shaft = ways.top - np.array([half[axis] for axis, _ in WAYS])
            away = np.linalg.norm(centre - self.middle, axis=1)[:, None]
            price = np.where(ways.free, shaft + rules.soft * ways.brushed, np.inf) + rules.balance * away
            top[:, box], cost[:, box] = ways.top[same], price[same]
        base = -rules.deep * np.minimum(found.margin, rules.spare)
        best = cost.min(axis=2).sum(axis=1) + base
        rows = np.argsort(best, kind="stable")[:LOOKED_AT]
        rows = rows[np.isfinite(best[rows])]
        if k == 1:
            total = cost[rows, 0] + base[rows, None]
        else:
            total = cost[rows, 0][:, :, None] + cost[rows, 1][:, None] + base[rows, None, None]
            tops = top[rows, 0], top[rows, 1]
            total[~apart(found.half, found.centre[rows], found.turn[rows], tops, rules.wall)] = np.inf
        flat = total.reshape(-1)
        for pick in np.argsort(flat, kind="stable")[:TRIED].tolist():
            if not np.isfinite(flat[pick]):
                break
            row, *ways_in = np.unravel_index(pick, total.shape)
            seats = tuple(
                self._seat(kind, found.half[box], found.centre[rows[row], box], found.turn[rows[row], box],
                           WAYS[int(ways_in[box])])
                for box, kind in enumerate(kinds)
            )  # fmt: skip
            if self._holds(seats):
                return seats
        return ()

    def _seat(self, kind: Kind, half: Array, centre: Array, turn: Array, way: tuple[int, int]) -> BoxSeat:
        """A box seat whose z axis points along the given way of the box."""
        axis, sign = way
        across = (axis + 1) % 3, (axis + 2) % 3
        T = np.eye(4)
        T[:3, 0], T[:3, 2], T[:3, 3] = turn[:, across[0]], sign * turn[:, axis], centre
        T[:3, 1] = np.cross(T[:3, 2], T[:3, 0])
        x, y, z = (float(2 * (half[a] - self.rules.clearance)) for a in (*across, axis))
        seat = BoxSeat(kind, self.host.index, (x, y, z), T, self.rules.clearance, 0.0)
        return replace(seat, shaft=shaft_height(outer_surface(self.host.blueprint.bodies[self.host.index]), seat))

    def _holds(self, seats: tuple[BoxSeat, ...]) -> bool:
        """Whether a placement bears a close look: cavities deep enough all through, ways in free."""
        placed = replace(self.host.blueprint, boxes=seats)
        for seat in seats:
            half = np.array(seat.size) / 2 + seat.clearance
            points = box_points(half, CLOSE) @ seat.T_design_box[:3, :3].T + seat.T_design_box[:3, 3]
            if self.host.free.sample(points).min() < self.rules.wall - TOUCH:
                return False
            if interference_above(placed, seat) > self.rules.blocked:
                return False
        return True

    def miss(self, kinds: tuple[Kind, ...]) -> Miss | None:
        """How far the most roomy layout is from a placement; None where there is one or nothing comes near."""
        if self.seats(kinds) or not len(self.mended(kinds)):
            return None
        return miss_of(self.host, kinds, self.mended(kinds), self.places[kinds[0]].half, self.rules.wall)

    def far_miss(self, kinds: tuple[Kind, ...]) -> Miss:
        """Like `miss`, of what comes nowhere near."""
        rules, half = replace(self.rules, slack=FAR), self.places[kinds[0]].half
        found = _Bone(rules, self.host, self.middle).mended(kinds)
        return miss_of(self.host, kinds, found, half, rules.wall)


def centre_of_mass(blueprint: Blueprint, hosts: list[Host]) -> Array:
    """About where bones and motors balance [m], (3,): without skins, wires and boxes, bones printed to `PRINTED`."""
    density = PRINTED * blueprint.catalogue.rigid.density
    weights, points = [], []
    for host in hosts:
        bone = blueprint.bodies[host.index].bone
        weights.append(density * host.samples * bone.spacing**3)
        points.append(host.middle)
    for seat in blueprint.seats:
        weights.append(blueprint.catalogue.motor.mass)
        points.append(seat.T_design_motor[:3, 3])
    return np.asarray(np.average(points, axis=0, weights=weights), np.float64)
