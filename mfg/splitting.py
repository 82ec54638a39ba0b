"""Cutting a body that no way up fits the printer: flat cuts clear of the hardware, with pegs to find the place again.

A cut goes through bone and skin of a body alike, so each piece is printed as a body is: rigid and soft as one object.
The bone carries the joint: round pegs on one face, holes with clearance in the other, and glue between the faces. The
pegs are cut from what was the other piece, so together the pieces are the body, less the clearance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from mfg.blueprint import Blueprint, PrintedPart, Transform
from mfg.cut_planes import clear_of_hardware, planes
from mfg.fields import Field
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.plate import fits_printer
from mfg.printability import with_hardware
from mfg.solids import Solid, box, cylinder
from mfg.stl import torn_edges, welded

MOST_SEATS = 6000  # places on one cut that are looked at: 0.3 m by 0.3 m at the usual pitch
MOST_LOOKS = 80  # of them that are held against the exact bone
_SPARE = 3  # cuts whose parts touch themselves, before the first of them is taken
_FAR = 3.0  # half edge of the box that stands for half of space [m]


@dataclass(frozen=True, eq=False, slots=True)
class Piece:
    """What is printed as one object: a body, a piece of one that was cut, or a lid.

    Attributes:
        name: of the body, with that of the piece if it is not the whole.
        body: index.
        parts: rigid and soft.
    """

    name: str
    body: int
    parts: tuple[PrintedPart, ...]

    @property
    def points(self) -> NDArray[np.float64]:
        """All corners, (n, 3) [m], design frame."""
        return np.concatenate([part.solid.vertices for part in self.parts])


@dataclass(frozen=True, eq=False, slots=True)
class _Cut:
    """A plane, and what the bone is like there.

    Attributes:
        T_design_cut: frame whose z is the plane's normal.
        seats: where pegs may stand, deepest in the bone first, (k, 3) design frame.
        area: of the bone's section [m2].
    """

    T_design_cut: Transform
    seats: NDArray[np.float64]
    area: float


@dataclass(frozen=True)
class SplitSolver:
    """Cut the bodies of a finished blueprint until every piece fits the printer.

    Attributes:
        peg_radius: [m].
        peg_length: that stands out of the face [m].
        clearance: between peg and hole, all around [m].
        ground: between a peg's end and the bottom of its hole [m].
        wall: bone around a hole, least [m].
        room: between a cut and motors, mounts and boxes, least [m].
        pitch: between cuts that are tried, and half of that between seats of pegs [m].
        min_piece: smallest piece of skin worth printing; smaller ones are dropped [m3].
        most: pieces of one body.
        tries: cuts that are made for real before a piece is given up.
    """

    peg_radius: float = 4.0e-3
    peg_length: float = 10.0e-3
    clearance: float = 2.5e-4
    ground: float = 5.0e-4
    wall: float = 2.4e-3
    room: float = 3.0e-3
    pitch: float = 8.0e-3
    min_piece: float = 5.0e-7
    most: int = 16
    tries: int = 24

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with bodies in pieces that fit, or why one cannot be cut; the others stay."""
        volume, parts = blueprint.catalogue.printer.volume, list[PrintedPart]()
        for piece in pieces(blueprint):
            if fits_printer(piece.points, volume):
                parts += piece.parts
                continue
            cut = self._body(blueprint, piece)
            if isinstance(cut, Failure):
                return cut
            made, lost = cut
            parts += made
            count = sum(part.material == "rigid" for part in made)
            blueprint = blueprint.noted(
                f"{piece.name}: cut into {count} pieces to fit {blueprint.catalogue.printer.name}; glue the pegs in"
                + (f"; {1e6 * lost:.2f} cm3 of loose skin dropped" if lost > 0 else "")
            )
        return replace(blueprint, parts=tuple(parts))

    def _body(self, blueprint: Blueprint, piece: Piece) -> tuple[list[PrintedPart], float] | Failure:
        """Pieces of one body, numbered as they came to fit, and the volume of the skin that was dropped [m3]."""
        bone = next(part.solid for part in piece.parts if part.material == "rigid")
        skins = [part.solid for part in piece.parts if part.material == "soft"]
        field = with_hardware(blueprint, piece.body, mount_of(blueprint.catalogue.motor), self.room)
        volume = blueprint.catalogue.printer.volume
        whole, done = [((bone, skins), _least_pieces((bone, skins), volume))], list[tuple[Solid, list[Solid]]]()
        while whole:
            if len(done) + sum(least for _, least in whole) > self.most:
                return self._refused(blueprint, piece, f"more than {self.most} pieces would be needed")
            solids, least = whole.pop(0)
            if least == 1:
                done.append(solids)
                continue
            halves = self._halved(blueprint, piece.body, field, solids)
            if isinstance(halves, str):
                return self._refused(blueprint, piece, halves)
            whole += [(half, _least_pieces(half, volume)) for half in halves]
        name, lost = blueprint.bodies[piece.body].name, sum(skin.volume for skin in skins)
        made = []
        for number, (rigid, soft) in enumerate(done, start=1):
            made.append(PrintedPart(f"{name}_bone_{number}", piece.body, "rigid", rigid, str(number)))
            for k, solid in enumerate(soft, start=1):
                made.append(PrintedPart(f"{name}_skin_{k}_{number}", piece.body, "soft", solid, str(number)))
                lost -= solid.volume
        return made, max(0.0, lost if lost > 1e-12 else 0.0)

    def _refused(self, blueprint: Blueprint, piece: Piece, why: str) -> Failure:
        extents = " x ".join(f"{1e3 * e:.0f}" for e in np.ptp(piece.points, axis=0))
        printer = blueprint.catalogue.printer.name
        return Failure(
            Stage.PRINT, Reason.TOO_LARGE, f"{piece.name} measures {extents} mm; no way up fits {printer}, and {why}"
        )

    def _halved(
        self, blueprint: Blueprint, body: int, field: Field, solids: tuple[Solid, list[Solid]]
    ) -> list[tuple[Solid, list[Solid]]] | str:
        """Both sides of the best cut that can be made, or why none can."""
        points = _points(solids)
        tried = crossing = bare = 0
        cuts: list[_Cut] = []
        for T in planes(points, self.pitch):
            tried += 1
            if not clear_of_hardware(blueprint, body, T, self.room):
                crossing += 1
                continue
            cut = self._section(blueprint, field, solids[0], T)
            if cut is None:
                bare += 1
                continue
            cuts.append(cut)
        cuts.sort(key=lambda cut: -round(cut.area, 9))
        # The largest face that leaves two pieces which fit along the cut's own axes; else the most even cut.
        # What does not fit then is cut again.
        room = np.sort(blueprint.catalogue.printer.volume)
        failed = 0
        hull = ConvexHull(points)
        extents = [_extents(hull, cut.T_design_cut) for cut in cuts]
        fitting = [cut for cut, size in zip(cuts, extents, strict=True) if (np.sort(size, axis=1) <= room).all()]
        longest = [float(np.round(size.max(), 3)) for size in extents]
        rest = [cuts[k] for k in np.argsort(longest, kind="stable")][: self.tries]
        spare: list[list[tuple[Solid, list[Solid]]]] = []
        for cut in (*fitting, *rest):
            halves = self._made(solids, cut)
            if halves is None:
                failed += 1
                continue
            if all(_closed(solid) for half in halves for solid in (half[0], *half[1])):
                return halves
            spare.append(halves)
            if len(spare) == _SPARE:
                break
        if spare:  # What touches itself can still be mended when all parts are made.
            return spare[0]
        return (
            f"of {tried} flat cuts {crossing} run too near a motor or a box or along a tunnel, {bare} have no room for "
            f"two pegs with {1e3 * self.wall:.1f} mm of bone around them, {failed} leave loose pieces; bone "
            "that is thicker away from the motors would help"
        )

    def _section(self, blueprint: Blueprint, field: Field, bone: Solid, T: Transform) -> _Cut | None:
        """The cut with seats for pegs on it, or None where there are not two."""
        local = (bone.vertices - T[:3, 3]) @ T[:3, :3]
        if local[:, 2].min() > -self.peg_length or local[:, 2].max() < self.peg_length:
            return None
        wide = np.ptp(local[:, :2], axis=0)
        step = max(self.pitch / 2, float(np.sqrt(wide.prod() / MOST_SEATS)))  # coarser across what is huge
        x, y = (np.arange(local[:, k].min(), local[:, k].max(), step) for k in (0, 1))
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        across = T[:3, 3] + grid @ T[:3, :2].T
        inside = field.sample(across)
        need = self.peg_radius + self.clearance + self.wall
        deep = inside.astype(np.float64)
        reach = self.peg_length + self.ground + self.wall
        for height in np.linspace(-self.wall, reach, 5):
            deep = np.minimum(deep, field.sample(across + height * T[:3, 2]))
        for wire in blueprint.wires:
            near = wire.path[np.abs((wire.path - T[:3, 3]) @ T[:3, 2]) < reach + wire.radius]
            if len(near):
                flat = ((near - T[:3, 3]) @ T[:3, :2])[None]
                away = np.linalg.norm(grid[:, None] - flat, axis=2).min(1)
                deep = np.minimum(deep, away - wire.radius)
        good = np.flatnonzero(deep >= need)
        if len(good) < 2:
            return None
        good = good[np.argsort(-np.round(deep[good], 6), kind="stable")]
        return _Cut(T, across[good], float((inside > 0).sum()) * step**2)

    def _made(self, solids: tuple[Solid, list[Solid]], cut: _Cut) -> list[tuple[Solid, list[Solid]]] | None:
        """Both sides with pegs and holes as exact solids, or None if a side would be in pieces or a peg break out."""
        bone, skins = solids[0].forgotten(), [skin.forgotten() for skin in solids[1]]
        above = box((-_FAR, -_FAR, 0.0), (_FAR, _FAR, _FAR)).moved(cut.T_design_cut)
        lower, upper = (bone - above).components(), (bone ^ above).components()
        if len(lower) != 1 or len(upper) != 1:
            return None
        seats = self._seats(bone, cut)
        if len(seats) < 2:
            return None
        pegs, holes = [], []
        for seat in seats:
            T = cut.T_design_cut.copy()
            T[:3, 3] = seat
            # A peg begins below the face, so that the two are one solid and not two that touch.
            pegs.append(cylinder(self.peg_radius, -self.wall / 2, self.peg_length).moved(T))
            holes.append(cylinder(self.peg_radius + self.clearance, -1e-3, self.peg_length + self.ground).moved(T))
        with_pegs = lower[0]
        for peg in pegs:
            with_pegs = with_pegs + peg
        with_holes = upper[0].minus(holes)
        if len(with_pegs.components()) != 1 or len(with_holes.components()) != 1:
            return None
        below, over = [], []
        for skin in skins:
            below += [s for s in (skin - above - with_pegs).components() if s.volume >= self.min_piece]
            over += [s for s in ((skin ^ above) - with_holes).components() if s.volume >= self.min_piece]
        return [(with_pegs, below), (with_holes, over)]

    def _seats(self, bone: Solid, cut: _Cut) -> list[NDArray[np.float64]]:
        """Two places for pegs, far apart, with bone all around: the field proposes, the solid decides."""
        radius, depth = self.peg_radius + self.clearance + self.wall, self.peg_length + self.ground + self.wall
        sound: list[NDArray[np.float64]] = []
        left = cut.seats
        for _ in range(MOST_LOOKS):
            if not len(left) or len(sound) == 2:
                break
            # The first is the deepest; the second the farthest from it.
            place = left[0] if not sound else left[int(np.argmax(np.linalg.norm(left - sound[0], axis=1)))]
            if sound and np.linalg.norm(place - sound[0]) < 2 * radius:
                break
            T = cut.T_design_cut.copy()
            T[:3, 3] = place
            around = cylinder(radius, -self.wall, depth).moved(T)
            if around.volume - bone.overlap(around) < 1e-12:
                sound.append(place)
            left = left[np.linalg.norm(left - place, axis=1) > 1e-9]
        return sound


def pieces(blueprint: Blueprint) -> list[Piece]:
    """What is printed as one object each, in the order of bodies; a body comes before its lids."""
    found: dict[tuple[int, str], list[PrintedPart]] = {}
    for part in sorted(blueprint.parts, key=lambda part: part.body):
        found.setdefault((part.body, part.piece), []).append(part)
    return [
        Piece("_".join(filter(None, (blueprint.bodies[body].name, piece))), body, tuple(parts))
        for (body, piece), parts in found.items()
    ]


def _least_pieces(solids: tuple[Solid, Sequence[Solid]], volume: tuple[float, float, float]) -> int:
    """Pieces that a bone with its skins needs at least: 1 if it fits the printer, else as its volume says."""
    if fits_printer(_points(solids), volume):
        return 1
    return max(2, math.ceil((solids[0].volume + sum(skin.volume for skin in solids[1])) / math.prod(volume)))


def _closed(solid: Solid) -> bool:
    """Whether a solid stays closed on the lattice of the files."""
    return len(torn_edges(welded(solid)[1])) == 0


def _points(solids: tuple[Solid, Sequence[Solid]]) -> NDArray[np.float64]:
    return np.concatenate([solids[0].vertices, *(skin.vertices for skin in solids[1])])


def _sides(hull: ConvexHull, T: Transform) -> list[NDArray[np.float64]]:
    """Corners of the two halves of a convex hull: nothing that is in it reaches farther."""
    height = (hull.points - T[:3, 3]) @ T[:3, 2]
    edges = np.concatenate([hull.simplices[:, [0, 1]], hull.simplices[:, [1, 2]], hull.simplices[:, [2, 0]]])
    a, b = edges[height[edges[:, 0]] * height[edges[:, 1]] < 0].T
    share = (height[a] / (height[a] - height[b]))[:, None]
    section = hull.points[a] + share * (hull.points[b] - hull.points[a])
    above = height[hull.vertices] > 0
    return [np.concatenate([hull.points[hull.vertices[side]], section]) for side in (~above, above)]


def _extents(hull: ConvexHull, T: Transform) -> NDArray[np.float64]:
    """Of both sides of a cut, along its axes [m], (2, 3)."""
    return np.stack([np.ptp((side - T[:3, 3]) @ T[:3, :3], axis=0) for side in _sides(hull, T)])
