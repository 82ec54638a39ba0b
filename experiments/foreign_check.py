"""A built robot's files read back by foreign programs, and every clearance in it by exact booleans of what was read.

trimesh reads STL and 3MF, ADMesh every STL, PrusaSlicer the 3MF; the latter two are skipped where they are not.
"""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mfg.blueprint import Blueprint
    from mfg.pipeline import Outcome
    from mfg.solids import Solid

# What all pairs of things of a robot may share together [m3]. Parts step back by more than their files round (see
# mfg.retreat), so nothing is left but slivers at corners that lie within a quarter of a micrometre of an edge; a single
# bone and motor that were left touching share ten times as much.
TOUCH = 1e-12
SAME = 1e-5  # relative difference of two volumes that are the same
PATIENCE = 120.0  # for a foreign program that only looks at a file [s]
_REPAIRS = ("Degenerate facets", "Edges fixed", "Facets removed", "Facets added", "Facets reversed", "Backwards edges")


def check(outcome: Outcome, folder: Path) -> list[str]:
    """Write a built blueprint and return everything that is wrong with its files and its geometry."""
    return checked(outcome, folder)[0]


def checked(outcome: Outcome, folder: Path) -> tuple[list[str], float]:
    """As `check`, and what all pairs of printed parts, hardware and tunnels share in all [m3]."""
    import numpy as np

    from mfg.export import write_blueprint
    from mfg.manifest import changed_files, part_file
    from mfg.plate import fits_printer
    from mfg.solids import Solid
    from mfg.splitting import pieces

    blueprint = outcome.blueprint
    write_blueprint(outcome, folder)
    problems = [f"{path} does not match its hash" for path in changed_files(folder)]
    solids: dict[str, Solid] = {}
    for part in blueprint.parts:
        path = folder / part_file(part)
        mesh = read_mesh(path)
        problems += [f"{part.name}.stl {flaw}" for flaw in (*flaws(mesh), *admesh_flaws(path))]
        solids[part.name] = Solid(np.asarray(mesh.vertices) / 1e3, np.asarray(mesh.faces, np.int64))
        if abs(solids[part.name].volume / part.solid.volume - 1) > SAME:
            problems.append(f"{part.name}.stl has another volume than the part")
    for piece in pieces(blueprint):
        points = np.concatenate([solids[part.name].vertices for part in piece.parts])
        if not fits_printer(points, blueprint.catalogue.printer.volume):
            problems.append(f"{piece.name} does not fit the printer")
    problems += printed_objects(blueprint, folder, solids)
    problems += prusa_flaws(folder / "print.3mf", len(pieces(blueprint)))
    shared = overlaps(blueprint, solids)
    total = sum(shared.values())
    if total > TOUCH:
        problems += [f"{pair} share {1e9 * volume:.5f} mm3" for pair, volume in shared.items() if volume > TOUCH / 100]
    return problems, total


def read_mesh(path: Path) -> Any:
    """A mesh file as a foreign library reads it, equal corners merged."""
    import trimesh

    return trimesh.load(path, force="mesh")


def flaws(mesh: Any) -> list[str]:
    """What keeps a mesh from being one closed solid."""
    found = []
    if not mesh.is_watertight:
        found.append("is not watertight")
    if not mesh.is_winding_consistent:
        found.append("has triangles of both senses")
    if not mesh.volume > 0:
        found.append(f"has volume {mesh.volume:g}")
    if mesh.body_count != 1:
        found.append(f"has {mesh.body_count} pieces")
    return found


def admesh_flaws(path: Path) -> list[str]:
    """What ADMesh would have to mend in an STL; nothing where ADMesh is not here."""
    if shutil.which("admesh") is None:
        return []
    said = _said(["admesh", str(path)])
    loose = re.search(r"^Total disconnected facets\s*:\s*(\d+)", said, re.MULTILINE)
    counts = {name: re.search(rf"^{name}\s*:\s*(\d+)", said, re.MULTILINE) for name in _REPAIRS}
    if loose is None or not all(counts.values()):
        return [f"is not understood by ADMesh: {said.strip()[-200:]!r}"]
    found = [f"has {loose[1]} disconnected facets by ADMesh"] if int(loose[1]) else []
    return found + [f"has {name.lower()}: {m[1]}, by ADMesh" for name, m in counts.items() if m and int(m[1])]


def prusa_flaws(path: Path, objects: int) -> list[str]:
    """What PrusaSlicer says is wrong with a 3MF of so many objects; nothing where it is not here."""
    from mfg.slicer import find_slicer

    program = find_slicer()
    if program is None:
        return []
    said = _said([str(program), "--info", str(path)])
    whole = re.findall(r"^manifold = (\w+)", said, re.MULTILINE)
    if len(whole) != objects:
        return [f"{path.name}: PrusaSlicer reads {len(whole)} objects of {objects}: {said.strip()[-200:]!r}"]
    return [
        f"{path.name}: object {k} is not manifold to PrusaSlicer" for k, word in enumerate(whole, 1) if word != "yes"
    ]


def printed_objects(blueprint: Blueprint, folder: Path, solids: Mapping[str, Solid]) -> list[str]:
    """Flaws of the objects in both 3MF files: one per piece, each part closed and equal to its STL, on the plate."""
    import numpy as np

    from mfg.splitting import pieces

    problems = []
    wanted = {piece.name: [part.name for part in piece.parts] for piece in pieces(blueprint)}
    for name in ("print.3mf", "print_bambu.3mf"):
        objects = read_3mf(folder / name)
        if [len(meshes) for meshes, _ in objects] != [len(parts) for parts in wanted.values()]:
            problems.append(f"{name} holds other objects than {', '.join(wanted)}")
            continue
        for (meshes, pose), (piece, parts) in zip(objects, wanted.items(), strict=True):
            problems += [
                f"{name}: {part} {flaw}" for part, mesh in zip(parts, meshes, strict=True) for flaw in flaws(mesh)
            ]
            for part, mesh in zip(parts, meshes, strict=True):
                if abs(mesh.volume / 1e9 / solids[part].volume - 1) > SAME:
                    problems.append(f"{name}: {part} has another volume than its STL file")
            laid = np.concatenate([np.asarray(mesh.vertices) for mesh in meshes]) @ pose[:3] + pose[3]
            size = np.ptp(laid, axis=0) / 1e3
            if abs(laid[:, 2].min()) > 1e-3:
                problems.append(f"{name}: {piece} stands at z = {laid[:, 2].min():.3f} mm")
            if (size > np.asarray(blueprint.catalogue.printer.volume) + 1e-5).any():
                problems.append(f"{name}: {piece} is larger than the printer")
    return problems


def read_3mf(path: Path) -> list[tuple[list[Any], Any]]:
    """(part meshes [mm], pose (4, 3) for row vectors) of every built object of a 3MF file of either flavour."""
    import zipfile
    from xml.etree import ElementTree

    import numpy as np
    import trimesh

    space = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    with zipfile.ZipFile(path) as archive:
        model = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
        prusa = "Metadata/Slic3r_PE_model.config"
        config = ElementTree.fromstring(archive.read(prusa)) if prusa in archive.namelist() else None
    meshes: dict[str, list[Any]] = {}
    for thing in model.iter(f"{space}object"):
        key = thing.get("id", "")
        vertices = np.array([[float(v.get(c, "nan")) for c in "xyz"] for v in thing.iter(f"{space}vertex")])
        faces = np.array([[int(t.get(c, "")) for c in ("v1", "v2", "v3")] for t in thing.iter(f"{space}triangle")])
        meshes[key] = [mesh for part in thing.iter(f"{space}component") for mesh in meshes[part.get("objectid", "")]]
        if len(faces):
            ranges = [(0, len(faces) - 1)]
            if config is not None:
                volumes = config.findall(f"object[@id='{key}']/volume")
                ranges = [(int(v.get("firstid", "")), int(v.get("lastid", ""))) for v in volumes]
            meshes[key] = [trimesh.Trimesh(vertices, faces[a : b + 1]) for a, b in ranges]
    return [
        (meshes[item.get("objectid", "")], np.array(item.get("transform", "").split(), float).reshape(4, 3))
        for item in model.iter(f"{space}item")
    ]


def overlaps(blueprint: Blueprint, solids: Mapping[str, Solid]) -> dict[str, float]:
    """Volumes that pairs share, of printed parts, motors, boxes and tunnels, by their names; none that are 0 [m3]."""
    from mfg.exact import box_solid, motor_solid, tunnel

    things = dict(solids)
    things |= {f"motor_{seat.hinge + 1}": motor_solid(blueprint, seat) for seat in blueprint.seats}
    things |= {box.kind: box_solid(box) for box in blueprint.boxes}
    things |= {wire.name: tunnel(wire) for wire in blueprint.wires}
    return {
        f"{a} and {b}": volume
        for (a, one), (b, two) in itertools.combinations(things.items(), 2)
        if (volume := one.overlap(two)) > 0
    }


def _said(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=PATIENCE, check=False)
    return done.stdout + done.stderr
