"""Solver: exact printable parts, and everything that was decided on fields decided again on solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from mfg.blueprint import Blueprint, LidSeat, MotorSeat, PrintedPart
from mfg.exact import (
    attachment,
    body_overlap,
    box_room,
    conflict,
    core,
    filled_mounts,
    interference_above,
    largest_ball,
    opened_tunnel,
)
from mfg.fields import Field
from mfg.lids import Lid, lids_of
from mfg.masses import body_masses
from mfg.miss import Miss
from mfg.moments import volume_moments
from mfg.motors import MotorSolver
from mfg.mounts import MIN_OVERLAP, Mount, connector, connector_keepout, envelope, holder, holder_keepout, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.plate import fits_printer
from mfg.retreat import RETREAT, retreated
from mfg.scores import (
    body_install_score,
    electronics_install_score,
    electronics_score,
    motor_score,
    mount_balance,
    oriented_extents,
    size_penalty,
)
from mfg.solids import Solid, ball_chain, from_field, surface, union
from mfg.splitting import SplitSolver, pieces
from mfg.stl import MM_PER_M, torn_edges, welded

TIDIER = (1e-6, 1e-5, 5e-5)  # by which edges are tidied where a part does not close otherwise; it steps back as far [m]
PINCH = 2e-4  # radius of the hole made where two sheets of a part only touch, below the width of a line [m]
EDGE_BLUR = 1.5  # width of the blur that straightens the rim of a skin [samples]
_REPAIRS = 4  # attempts


@dataclass(frozen=True)
class FinishSolver:
    """Make the solids that go to the printer.

    The order of cuts keeps every feature whole: bone - (room for motors, boxes, other bodies' mounts) + own mounts
    - tunnels. So no shaft eats a mount, no mount fills a cavity, and every tunnel is open at both ends. At last every
    part steps back from its surface by a quarter of a micrometre, so that rounded in a file it meets no other.

    Attributes:
        gap: room between a body and a mount that it does not carry [m].
        cut_half_length: half length of the motor's way in along the joint axis, as in the bone processor [m].
        min_piece: smallest piece worth printing; smaller ones are crumbs and are dropped [m3].
        max_loss: largest share of a bone that the hardware may cut loose.
        min_skin: least thickness of a skin [m].
        tolerance: surface error allowed when thinning triangles, half the width of a printed line [m].
        max_touch: overlap of two components, or of a mount and a loose piece of bone, that rounding may leave [m3].
        min_overlap: tau of Eq. 2, applied to the exact volumes; less where seats are judged by strength [m3].
        alpha: of Eq. 3, as in the motor solver.
        lids: whether the openings of the electronics boxes get lids with screws, as parts of their own.
        split: cut bodies that are beyond the printer's volume into pieces that fit, with pegs; else they are failures.
    """

    gap: float = 1.5e-3
    cut_half_length: float = 0.080
    min_piece: float = 5.0e-7
    max_loss: float = 0.10
    min_skin: float = 1.2e-3
    tolerance: float = 3.0e-4
    max_touch: float = 1.0e-9
    min_overlap: float = MIN_OVERLAP
    alpha: float = MotorSolver.alpha
    lids: bool = False
    split: bool = False

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `parts`, `masses` and exact scores, or why it cannot be printed."""
        mount = mount_of(blueprint.catalogue.motor)
        bones = [from_field(body.bone, self.tolerance) for body in blueprint.bodies]
        tunnels = [opened_tunnel(blueprint, wire) for wire in blueprint.wires]
        parts: list[PrintedPart] = []
        blueprint, lids = self._lids(blueprint, bones, tunnels) if self.lids else (blueprint, [])
        for index in range(len(blueprint.bodies)):
            own = [lid for lid in lids if blueprint.boxes[lid.seat].body == index]
            made = self._body(blueprint, index, bones[index], tunnels, mount, own)
            if isinstance(made, Failure) and own:
                blueprint = blueprint.noted(f"{blueprint.bodies[index].name} is too weak for lids with screws")
                lids = [lid for lid in lids if lid not in own]
                made = self._body(blueprint, index, bones[index], tunnels, mount, [])
            if isinstance(made, Failure):
                return made
            found, notes = made
            parts += found
            for note in notes:
                blueprint = blueprint.noted(note)
        blueprint = replace(blueprint, lids=tuple(_lid_seat(blueprint, lid) for lid in lids))
        separate = self._apart(parts)
        if isinstance(separate, Failure):
            return separate
        if self.split:
            divided = SplitSolver(min_piece=self.min_piece).solve(replace(blueprint, parts=tuple(separate)))
            if isinstance(divided, Failure):
                return divided
            blueprint, separate = divided, list(divided.parts)
        whole = [self._whole(part) for part in separate]
        for part in whole:
            if isinstance(part, Failure):
                return part
        blueprint = replace(blueprint, parts=tuple(part for part in whole if isinstance(part, PrintedPart)))
        failure = self._too_large(blueprint) or conflict(blueprint, self.max_touch)
        if failure is not None:
            return failure
        return self._rescored(replace(blueprint, masses=body_masses(blueprint)), bones, mount)

    def _lids(
        self, blueprint: Blueprint, bones: Sequence[Solid], tunnels: Sequence[Solid]
    ) -> tuple[Blueprint, list[Lid]]:
        """The lids that can be made and printed, and notes of those that cannot."""
        lids, notes = lids_of(blueprint, bones, tunnels)
        kept = [lid for lid in lids if isinstance(self._whole(_lid_part(blueprint, lid)), PrintedPart)]
        for note in notes:
            blueprint = blueprint.noted(note)
        return blueprint, kept

    def _rescored(self, blueprint: Blueprint, bones: Sequence[Solid], mount: Mount) -> Blueprint | Failure:
        """Replace what the fields estimated by what the solids say; the paths of cables are the same in both."""
        catalogue, seats = blueprint.catalogue, []
        for seat in blueprint.seats:
            V_h, V_c = attachment(blueprint, seat, bones)
            if min(V_h, V_c) < self.min_overlap:
                return Failure(
                    Stage.MOTOR,
                    Reason.NO_OVERLAP,
                    f"{blueprint.hinges[seat.hinge].name}: the solids share {1e6 * V_h:.1f} cm3 with the holder and "
                    f"{1e6 * V_c:.1f} cm3 with the connector, each needs {1e6 * self.min_overlap:.1f} cm3",
                    Miss("shared volume", "m3", min(V_h, V_c), self.min_overlap, (seat.hinge,),
                         remedy="grow_near_joint"),
                )  # fmt: skip
            score = mount_balance(V_h, V_c, self.alpha)
            seats.append(replace(seat, holder_volume=V_h, connector_volume=V_c, score=score))
        scores = {
            "motor": motor_score([seat.score for seat in seats], mount, self.alpha),
            "body_install": body_install_score(body_overlap(blueprint, bones)),
        }
        if blueprint.boxes:
            hosts = sorted({seat.body for seat in blueprint.boxes})
            scores["electronics"] = min(self._room_score(blueprint, index, bones[index], mount) for index in hosts)
            V_cap = sum(interference_above(blueprint, seat, bones) for seat in blueprint.boxes)
            scores["electronics_install"] = electronics_install_score(V_cap, catalogue)
        return replace(blueprint, seats=tuple(seats)).scored(**scores)

    def _room_score(self, blueprint: Blueprint, index: int, bone: Solid, mount: Mount) -> float:
        outline = [bone.vertices]
        for seat in blueprint.seats:
            if index in (seat.holder, seat.connector):
                outline.append(filled_mounts(mount)[index == seat.connector].moved(seat.T_design_motor).vertices)
        p_obb = size_penalty(oriented_extents(np.concatenate(outline)), blueprint.catalogue.printer.volume)
        return electronics_score(largest_ball(blueprint, index, bone), p_obb, blueprint.catalogue)

    def _body(
        self, blueprint: Blueprint, index: int, bone: Solid, tunnels: Sequence[Solid], mount: Mount, lids: Sequence[Lid]
    ) -> tuple[list[PrintedPart], list[str]] | Failure:
        body = blueprint.bodies[index]
        room = union(self._room(blueprint, index, mount) + [solid for lid in lids for solid in lid.room])
        mounts = union(own_mounts(blueprint, index, mount))
        pieces = (bone - room + mounts).minus(tunnels).components()
        total = sum(piece.volume for piece in pieces)
        lost = total - pieces[0].volume if pieces else 0.0
        notes = []
        if not pieces or lost > max(self.max_loss * total, self.min_piece):
            return Failure(
                Stage.PRINT,
                Reason.BONE_SEVERED,
                f"the hardware leaves {body.name} in {len(pieces)} pieces; {1e6 * lost:.1f} of {1e6 * total:.0f} cm3 "
                f"would be lost, at most {100 * self.max_loss:.0f} % may be",
                Miss("volume that is lost", "m3", lost, max(self.max_loss * total, self.min_piece), bodies=(index,)),
            )
        if any(piece.overlap(mounts) > self.max_touch for piece in pieces[1:]):
            detail = f"a mount of {body.name} is not attached to the rest of it"
            return Failure(Stage.PRINT, Reason.BONE_SEVERED, detail, Miss("bone about a mount", "m3", bodies=(index,)))
        if lost > 0:
            notes.append(f"{body.name}: dropped {len(pieces) - 1} loose piece(s) of bone, {1e6 * lost:.2f} cm3 in all")
        parts = [PrintedPart(f"{body.name}_bone", index, "rigid", pieces[0])]
        parts += [_lid_part(blueprint, lid) for lid in lids]
        if body.skin is None:
            return parts, notes
        soft = soft_region(body.skin, body.bone, self.min_skin)
        # A film thinner than the tolerance would be thinned to nothing, which is no solid.
        if not (soft.values > 0).any() or volume_moments(*surface(soft)).mass < self.min_piece:
            return parts, notes
        # One cutter at a time: where bone and room cross, uniting them first costs more than cutting twice, and the
        # kernel's union of room and mounts, which have faces in common, lacks slivers of the mounts.
        skin = (from_field(soft, self.tolerance) - bone - room - mounts).minus(tunnels)
        kept = [piece for piece in skin.components() if piece.volume >= self.min_piece]
        parts += [PrintedPart(f"{body.name}_skin_{k}", index, "soft", piece) for k, piece in enumerate(kept, start=1)]
        return parts, notes

    def _room(self, blueprint: Blueprint, index: int, mount: Mount) -> list[Solid]:
        """What must be free of this body: the motors' ways in, boxes, and what moves against it."""
        room = []
        for seat in blueprint.seats:
            offset = blueprint.pointing(seat) * seat.offset  # along the motor's own z
            if index == seat.holder:
                cuts = [connector_keepout(mount), core(mount, offset, self.cut_half_length, way_in=True)]
            elif index == seat.connector:
                cuts = [holder_keepout(mount), core(mount, offset, self.cut_half_length)]
            else:
                cuts = [envelope(mount, self.gap)]
            room += [cut.moved(seat.T_design_motor) for cut in cuts]
        return room + [box_room(box) for box in blueprint.boxes if box.body == index]

    def _apart(self, parts: list[PrintedPart]) -> list[PrintedPart] | Failure:
        """Trim what two bodies still share, however little: the soft part gives way, else the later one."""
        parts = list(parts)
        for i in range(len(parts)):
            for j in range(i + 1, len(parts)):
                a, b = parts[i], parts[j]
                if a.body == b.body or a.solid.overlap(b.solid) <= 0:
                    continue
                loser, keeper = (i, j) if a.material == "soft" and b.material == "rigid" else (j, i)
                trimmed = parts[loser].solid.minus([parts[keeper].solid]).components()
                kept = trimmed[0].volume if trimmed else 0.0
                if kept < (1 - self.max_loss) * parts[loser].solid.volume:
                    return Failure(Stage.PRINT, Reason.OVERLAP, f"{a.name} and {b.name} cannot be told apart")
                parts[loser] = replace(parts[loser], solid=trimmed[0])
        return parts

    def _whole(self, part: PrintedPart) -> PrintedPart | Failure:
        """The part as one solid that, its corners rounded to what a file can hold, is closed and meets no other."""
        for tidy in (0.0, *TIDIER):
            solid = self._opened(retreated(part.solid.simplified(tidy) if tidy else part.solid, RETREAT + tidy))
            if solid is not None:
                return replace(part, solid=solid)
        return Failure(Stage.PRINT, Reason.NOT_WATERTIGHT, f"{part.name} does not close on the lattice of an STL file")

    def _opened(self, whole: Solid) -> Solid | None:
        """The solid where it closes on the lattice of a file, opened where two of its sheets only touch; or None."""
        solid = whole
        for _ in range(_REPAIRS):
            vertices, triangles = welded(solid)
            torn = torn_edges(triangles)
            if not len(torn) and len(triangles):
                return solid
            # Two sheets that meet in an edge or a corner: no printer makes that, so open it.
            ends = vertices[torn] / MM_PER_M
            pieces = solid.minus([ball_chain(pair, PINCH, 8) for pair in ends]).components()
            if not pieces or pieces[0].volume < whole.volume - self.min_piece:
                break
            solid = pieces[0]
        return None

    def _too_large(self, blueprint: Blueprint) -> Failure | None:
        printer = blueprint.catalogue.printer
        for piece in pieces(blueprint):
            if not fits_printer(piece.points, printer.volume):
                extents = " x ".join(f"{1e3 * e:.0f}" for e in np.ptp(piece.points, axis=0))
                return Failure(
                    Stage.PRINT, Reason.TOO_LARGE, f"{piece.name} measures {extents} mm; no way up fits {printer.name}"
                )
        return None


def _lid_part(blueprint: Blueprint, lid: Lid) -> PrintedPart:
    seat = blueprint.boxes[lid.seat]
    piece = f"lid_{seat.kind}"
    return PrintedPart(f"{blueprint.bodies[seat.body].name}_{piece}", seat.body, "rigid", lid.solid, piece)


def _lid_seat(blueprint: Blueprint, lid: Lid) -> LidSeat:
    return LidSeat(lid.seat, _lid_part(blueprint, lid).name, lid.screws, lid.notch)


def own_mounts(blueprint: Blueprint, index: int, mount: Mount) -> list[Solid]:
    """The holders and connectors that a body carries, in the design frame."""
    return [_mount(seat, index, mount) for seat in blueprint.seats if index in (seat.holder, seat.connector)]


def _mount(seat: MotorSeat, index: int, mount: Mount) -> Solid:
    return (holder(mount) if seat.holder == index else connector(mount)).moved(seat.T_design_motor)


def soft_region(skin: Field, bone: Field, thinnest: float) -> Field:
    """Where the outer surface stands at least `thinnest` above the bone, bone included: no slivers on bare bone [m]."""
    above = skin.values - bone.on_lattice_of(skin) - np.float32(thinnest)
    # Two surfaces that part slowly meet in a ragged line; blurred, the line is one that a printer can follow.
    reach = 2 * skin.spacing
    edge = ndimage.gaussian_filter(np.clip(above, -reach, reach), EDGE_BLUR, mode="nearest")
    return skin.with_values(np.minimum(skin.values, edge))
