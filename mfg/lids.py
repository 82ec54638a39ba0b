"""Lids over the openings of the electronics boxes: a plug flush with the bone, held by M3 screws through tabs.

In the frame of the box, z towards the opening, u across:

      top of the bone  ___________________________
                      |  tab  |            |  tab  |      the lid ends where the bone ended
        shelf         |___!___|            |___!___|      tabs rest on shelves in the wall around the shaft
                          !   |    plug    |   !
        pilot holes       !   |____________|   !          the plug ends above the box and keeps it down
                              |    box     |

Lid and bone meet with `FIT` of play all around. The screws cut their thread into the pilot holes. The plug has a notch
at its edge: the leads of the battery come out of one lid and go in through the other, and both lift off with the leads
in place; for the same reason a cable that crosses the plug runs in a slot that is open towards the box.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint
from mfg.exact import box_room
from mfg.mounts import envelope, mount_of
from mfg.solids import Solid, box, cylinder, union

FIT = 2.0e-4  # play between lid and bone on every side [m]
TAB = 9.0e-3  # width of a tab [m]
REACH = 9.0e-3  # how far a tab reaches beyond the shaft [m]
PLATE = 4.0e-3  # least thickness of a tab over its screw, of which the head takes half [m]
HOLE, PILOT, HEAD = 1.7e-3, 1.25e-3, 3.1e-3  # radii for an M3: clearance hole, pilot hole, head and driver [m]
SCREW = "M3x10"  # 2 mm of it in the tab, 8 mm in the bone
GRIP = 9.0e-3  # depth of a pilot hole: the screw must not meet its end [m]
DEPTH = PLATE / 2 + GRIP  # from where a head rests to the end of its hole [m]
LEADS = (1.0e-2, 6.0e-3)  # along the edge and into the plug: two leads of 12 AWG side by side [m]
AROUND = 1.6e-3  # least wall around a pilot hole, two and a half printed lines [m]
JOINED = 3.0e-3  # least height over which a tab and the plug are one [m]
DRIVER = 0.06  # length of a screwdriver above the mouth [m]
OVER = 1.0e-3  # by which cutters reach beyond what they cut [m]
CRUMB = 1.0e-9  # volume of a piece that does not count [m3]
MOST = 4  # screws


@dataclass(frozen=True, eq=False, slots=True)
class Lid:
    """One lid in the design frame.

    Attributes:
        seat: index into `blueprint.boxes`.
        solid: as printed.
        room: what the host's bone and skin must leave free for it, its pilot holes too.
        screws: points on the axes of the screws where their heads rest [m], (n, 3); all point along -z of the box.
        notch: middle of the notch for the leads, at the opening [m], (3,).
    """

    seat: int
    solid: Solid
    room: tuple[Solid, ...]
    screws: NDArray[np.float64]
    notch: NDArray[np.float64]


def lids_of(blueprint: Blueprint, bones: Sequence[Solid], tunnels: Sequence[Solid]) -> tuple[list[Lid], list[str]]:
    """A lid for every box that can have one, and a note for every box that cannot."""
    lids: list[Lid] = []
    notes = []
    for index, seat in enumerate(blueprint.boxes):
        keep_out = [lid.solid for lid in lids] + [part for lid in lids for part in lid.room]
        lid = _lid(blueprint, index, bones, tunnels, keep_out)
        if lid is None:
            notes.append(f"the {seat.kind} in {blueprint.bodies[seat.body].name} has no lid: no two screws find hold")
        else:
            lids.append(lid)
    return lids, notes


def _lid(
    blueprint: Blueprint, index: int, bones: Sequence[Solid], tunnels: Sequence[Solid], keep_out: Sequence[Solid]
) -> Lid | None:
    seat = blueprint.boxes[index]
    T = seat.T_design_box
    inward = np.eye(4)
    inward[:3, :3], inward[:3, 3] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    half = np.array(seat.size) / 2 + seat.clearance
    if seat.shaft <= half[2]:
        return None
    # Everything happens in the frame of the box, where all tools are upright, and as far away as a lid reaches.
    beside = half + REACH + 2 * OVER
    around = box([*-beside[:2], half[2] - GRIP - 3 * OVER], [*beside[:2], seat.shaft + 2 * DRIVER])
    cables = [solid.moved(inward) ^ around for solid in tunnels]
    taken = [solid.moved(inward) ^ around for solid in [*_taken(blueprint, index, bones), *keep_out]]
    local = bones[seat.body].moved(inward) ^ around
    whole = local.minus([*taken, *cables])
    found: list[tuple[Solid, float, NDArray[np.float64]]] = []
    for place in _places(half):
        tab = _tab(whole, [*taken, *cables], local, place, half, seat.shaft)
        if tab is not None:
            found.append((tab[0], tab[1], place))
    chosen = _opposite([place for _, _, place in found])
    if not chosen:
        return None
    tabs = [found[k] for k in chosen]
    top = seat.shaft
    plug = box([-half[0] + FIT, -half[1] + FIT, half[2]], [half[0] - FIT, half[1] - FIT, top])
    wide = union([plug, *(_tab_box(place, half, shelf, top, 0.0) for _, shelf, place in tabs)])
    holes, room, heads = [], [], []
    for _, shelf, place in tabs:
        x, y = place[:2]
        rest = shelf + PLATE / 2
        holes += [_at(cylinder(HOLE, shelf - OVER, top, 24), x, y), _at(cylinder(HEAD, rest, top, 24), x, y)]
        room += [_tab_box(place, half, shelf, top, FIT), _at(cylinder(PILOT, shelf - GRIP, shelf + OVER, 16), x, y)]
        heads.append((x, y, rest))
    cavity = box(-half, half)
    edge = _notch([place for _, _, place in tabs], half)
    reach = np.array([LEADS[1], LEADS[0] / 2, 0.0])[[int(edge[2]), 1 - int(edge[2]), 2]]
    notch = box([*(edge[:2] - reach[:2]), half[2] - OVER], [*(edge[:2] + reach[:2]), top + OVER])
    slots = [slot for cable in cables for slot in _slots(cable, wide, top - half[2])]
    pieces = ((wide ^ local).minus([cavity, *holes, *taken, notch, *slots])).components()
    if not pieces or sum(piece.volume for piece in pieces[1:]) > 0.05 * pieces[0].volume:
        return None
    screws, mouth = (points @ T[:3, :3].T + T[:3, 3] for points in (np.array(heads), np.array([*edge[:2], top])))
    return Lid(index, pieces[0].moved(T), tuple(solid.moved(T) for solid in room), screws, mouth)


def _notch(tabs: Sequence[NDArray[np.float64]], half: NDArray[np.float64]) -> NDArray[np.float64]:
    """The place on the edge of the plug that is farthest from all tabs: (x, y, axis, sign)."""
    best: tuple[float, NDArray[np.float64]] = (-1.0, np.zeros(4))
    for axis, sign, share in itertools.product(range(2), (1.0, -1.0), (0.0, -0.5, 0.5)):
        place = np.zeros(4)
        place[axis], place[1 - axis] = sign * half[axis], share * half[1 - axis]
        place[2:] = axis, sign
        away = min(float(np.linalg.norm(tab[:2] - place[:2])) for tab in tabs)
        if away > best[0] + 1e-6:
            best = (away, place)
    return best[1]


def _slots(cable: Solid, wide: Solid, height: float) -> list[Solid]:
    """What a cable takes of a plug of this height, open downwards, so that the lid lifts off the cable."""
    met = cable ^ wide
    down = np.eye(4)
    down[2, 3] = -height
    return [] if met.is_empty else [union([piece, piece.moved(down)]).hull() for piece in met.components()]


def _taken(blueprint: Blueprint, index: int, bones: Sequence[Solid]) -> list[Solid]:
    """Hardware and bodies that neither a lid nor its screws may touch: motors and mounts, other boxes, other bones."""
    seat, whole = blueprint.boxes[index], envelope(mount_of(blueprint.catalogue.motor))
    taken = [whole.moved(motor.T_design_motor) for motor in blueprint.seats]
    taken += [box_room(other) for k, other in enumerate(blueprint.boxes) if k != index]
    return taken + [bone for body, bone in enumerate(bones) if body != seat.body]


def _places(half: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Axes of the screws that are tried, two or three on every side: (x, y, axis, sign)."""
    places = []
    for axis, sign in itertools.product(range(2), (1.0, -1.0)):
        along = half[1 - axis] - TAB / 2
        for share in (-1.0, 0.0, 1.0):
            place = np.zeros(4)
            place[axis], place[1 - axis] = sign * (half[axis] + REACH / 2), share * along
            place[2:] = axis, sign
            places.append(place)
    return places


def _tab_box(place: NDArray[np.float64], half: NDArray[np.float64], low: float, high: float, grow: float) -> Solid:
    """A tab about a screw, joined to the plug, grown sideways by `grow`."""
    axis, sign = int(place[2]), place[3]
    corner, end = np.zeros(3), np.zeros(3)
    corner[1 - axis], end[1 - axis] = place[1 - axis] - TAB / 2 - grow, place[1 - axis] + TAB / 2 + grow
    ends = sorted((sign * (half[axis] - 2 * FIT - OVER), sign * (half[axis] + REACH + grow)))
    corner[axis], end[axis] = ends
    corner[2], end[2] = low, high
    return box(corner, end)


def _tab(
    whole: Solid, taken: Sequence[Solid], bone: Solid, place: NDArray[np.float64], half: NDArray[np.float64], top: float
) -> tuple[Solid, float] | None:
    """The highest shelf on which a screw holds, with the tab above it, or None."""
    x, y = float(place[0]), float(place[1])
    column = _at(cylinder(HEAD, half[2] - GRIP - 2 * OVER, top, 16), x, y) ^ bone
    if column.is_empty:
        return None
    # The lid is bone: over its screw it is as thick as the bone is high at the lowest point of the rim of the head.
    shelf = _lowest_top(column) - PLATE
    if shelf + PLATE < half[2] + JOINED:
        return None
    need = _at(cylinder(PILOT + AROUND, shelf - GRIP, shelf, 16), x, y)
    tab = _tab_box(place, half, shelf, top, FIT)
    # It is pulled out straight, and a driver must reach the screw.
    way = [_tab_box(place, half, shelf, 2 * top - shelf, FIT), _at(cylinder(HEAD, top, top + DRIVER, 16), x, y)]
    blocked = any(way[0].overlap(solid) > CRUMB or way[1].overlap(solid) > CRUMB for solid in taken)
    if blocked or need.overlap(whole) < need.volume - CRUMB:
        return None
    return tab, shelf


def _lowest_top(column: Solid) -> float:
    """Height of the lowest point of the upper surface of a column about a vertical axis [m]."""
    corners = column.vertices[column.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = normal[:, 2] > 1e-3 * np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
    return float(corners[up][:, :, 2].min()) if up.any() else -math.inf


def _opposite(places: Sequence[NDArray[np.float64]]) -> list[int]:
    """Two screws across the opening from each other, and more where there is hold: at most `MOST`, spread out."""
    best: tuple[float, list[int]] = (0.0, [])
    for a, b in itertools.combinations(range(len(places)), 2):
        spread = float(np.linalg.norm(places[a][:2] - places[b][:2]))
        if float(places[a][:2] @ places[b][:2]) < 0 and spread > best[0] + 1e-6:
            best = (spread, [a, b])
    chosen = best[1]
    while chosen and len(chosen) < MOST:
        away = [min(float(np.linalg.norm(p[:2] - places[k][:2])) for k in chosen) for p in places]
        farthest = int(np.argmax(np.round(away, 6)))
        if away[farthest] < 2 * TAB:
            break
        chosen = [*chosen, farthest]
    return sorted(chosen)


def _at(solid: Solid, x: float, y: float) -> Solid:
    shift = np.eye(4)
    shift[:2, 3] = x, y
    return solid.moved(shift)
