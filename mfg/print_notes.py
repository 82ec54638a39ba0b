"""What the printer has to hold up, what it closes in for good and how thin it prints: for the plate and for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mfg.blueprint import Blueprint
from mfg.fields import box_depth
from mfg.finish import FinishSolver
from mfg.mounts import WALL, envelope_depth, mount_of
from mfg.plate import OVERHANG
from mfg.solids import Solid
from mfg.splitting import Piece

_OUT = 1e-3  # how far from a surface one looks for what covers it [m]


def air_surface(blueprint: Blueprint, piece: Piece) -> NDArray[np.float64]:
    """Corners (m, 3, 3) of the triangles of a printed piece that face air and not its own other material [m].

    Bone and skin meet in surfaces of which neither needs support. What covers a triangle is asked of the fields, a
    millimetre away from it; motors and boxes are not there yet when it is printed.
    """
    body, mount = blueprint.bodies[piece.body], mount_of(blueprint.catalogue.motor)
    both = len({part.material for part in piece.parts}) > 1
    found = []
    for part in piece.parts:
        corners = part.solid.vertices[part.solid.triangles]
        if not both or body.skin is None:
            found.append(corners)
            continue
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        beside = corners.mean(axis=1) + _OUT * normal
        in_bone = body.bone.sample(beside) > 0
        covered = in_bone if part.material == "soft" else ~in_bone & (body.skin.sample(beside) > 0)
        for seat in blueprint.seats:
            covered &= envelope_depth(beside, seat.T_design_motor, mount) <= 0
        for box in blueprint.boxes:
            covered &= box_depth(beside, box.T_design_box, np.array(box.size) / 2 + box.clearance) <= 0
        found.append(corners[~covered])
    return np.concatenate(found)


def closed_hollows(solid: Solid) -> list[float]:
    """Volumes of the hollows inside a solid that have no way out, largest first [m3]."""
    triangles = solid.triangles
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    n = len(solid.vertices)
    _, shell = connected_components(coo_matrix((np.ones(len(sides)), sides.T), shape=(n, n)), directed=False)
    a, b, c = solid.vertices[triangles].transpose(1, 0, 2)
    volumes = np.bincount(shell[triangles[:, 0]], (a * np.cross(b, c)).sum(1) / 6, minlength=int(shell.max()) + 1)
    return sorted((-float(v) for v in volumes if v < 0), reverse=True)


def print_notes(blueprint: Blueprint) -> list[str]:
    """Lines about walls, supports and hollows, as they stand on the sheet of print settings."""
    printer, finish = blueprint.catalogue.printer, FinishSolver()
    lines = [
        f"Walls: skins are at least {1e3 * finish.min_skin:.1f} mm thick where they begin, motor cups "
        f"{1e3 * WALL:.1f} mm; a printed line is {1e3 * printer.line_width:.2f} mm wide.",
        f"Supports: rigid filament, under what is less steep than {np.rad2deg(OVERHANG):.0f} degrees, on the build "
        "plate and inside motor cups; bodies lie so that they need little.",
        "Keep supports out of the cable tunnels, which bridge by themselves; clear motor cups and box shafts of them.",
    ]
    hollows = [(part.name, closed_hollows(part.solid)) for part in blueprint.parts]
    closed = [(name, found) for name, found in hollows if found]
    if not closed:
        return [*lines, "Hollows: none is closed; every one drains, and supports in it can be reached."]
    lines.append("Hollows with no way out (block supports there, and do not wash the part in a bath):")
    lines += [f"  {name}: {len(found)}, {1e6 * sum(found):.2f} cm3 in all" for name, found in closed]
    return lines
