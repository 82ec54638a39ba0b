"""The blueprint folder: files for the printer, the simulator, the shopper and the person with a screwdriver."""

from __future__ import annotations

import hashlib
import io
import itertools
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from mfg.blueprint import Blueprint, PrintedPart
from mfg.catalogue import Catalogue, Filament
from mfg.description import Description, describe
from mfg.exact import box_solid, motor_solid, tunnel
from mfg.guide import NAME as GUIDE
from mfg.guide import guide_html
from mfg.manifest import NAME, ManifestError, manifest, manifest_bytes, part_file, read_manifest
from mfg.masses import wire_stretches
from mfg.pipeline import Outcome
from mfg.plate import Lay, arrange
from mfg.print_notes import air_surface, print_notes
from mfg.robot_files import Visual, mesh_files, mjcf, urdf
from mfg.slicer import SliceReport
from mfg.solids import Solid
from mfg.splitting import pieces
from mfg.step import step_bytes
from mfg.stl import MM_PER_M, stl_bytes, welded
from mfg.tables import bill_of_materials, sliced_bill, wiring_table
from mfg.threemf import PLATE_STRIDE, PrintObject, Volume, bambu_3mf, prusa_3mf

EXTRUDERS = {"rigid": 1, "soft": 2}
MOTOR_COLOUR, BATTERY_COLOUR, CONTROLLER_COLOUR, WIRE_COLOUR = "#3B8C5A", "#2F5FB3", "#B33A3A", "#E0B83C"
SKIN_ALPHA = 0.55
VISUAL_ERROR = 5e-4  # of the meshes that are only looked at [m]


def write_blueprint(outcome: Outcome, folder: Path | str, *, guide: bool = False, step: bool = False) -> Path:
    """Write the whole folder of a built blueprint; same design, same bytes.

    All files go into a hidden folder beside the target, which takes the target's name only when it is complete; an
    interrupted or failed export leaves nothing under that name.

    Args:
        outcome: what `mfg.pipeline.build` made.
        folder: target; an older blueprint there is replaced.
        guide: also write the assembly guide, which costs seconds: for people, not for searches.
        step: with a STEP file of every rigid part, about 0.8 kB a triangle.

    Returns:
        The folder, as an absolute path.

    Raises:
        ValueError: if the design cannot be built or was only scored.
        FileExistsError: if the target exists and is not a blueprint folder.
        OSError: if it cannot be written.
    """
    if outcome.failure is not None:
        raise ValueError(f"design {outcome.design.key} cannot be built: {outcome.failure}")
    folder = Path(folder).resolve()
    _check_target(folder)
    _sweep(folder)
    files = blueprint_files(outcome.blueprint, guide=guide, step=step)
    partial = folder.with_name(f".{folder.name}.{os.getpid()}.partial")
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        for path, content in files.items():
            target = partial / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        if folder.exists():
            old = folder.with_name(f".{folder.name}.{os.getpid()}.old")
            if Path.cwd().is_relative_to(folder):
                # Someone stands in it: the folder itself must stay where it is.
                old.mkdir()
                _move_content(folder, old)
                _move_content(partial, folder)
            else:
                folder.rename(old)
                partial.rename(folder)
            shutil.rmtree(old)
        else:
            partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return folder


def add_slice(folder: Path | str, report: SliceReport) -> None:
    """Write what a slicer says into the bill of materials and the manifest of a blueprint folder.

    Raises:
        ManifestError: if the manifest is damaged.
        OSError: if a file cannot be read or written.
    """
    folder = Path(folder)
    document = read_manifest(folder)
    try:
        filaments = document["catalogue"]["rigid"]["name"], document["catalogue"]["soft"]["name"]
    except (KeyError, TypeError) as error:
        raise ManifestError(f"{folder}: the filaments are missing or malformed ({error!r:.120})") from None
    bill = sliced_bill((folder / "bom.csv").read_text("utf-8"), report, filaments).encode()
    document["slice"] = report.to_json()
    document["files"]["bom.csv"] = hashlib.sha256(bill).hexdigest()
    # The manifest last: a folder interrupted in between tells that its bill has changed.
    for name, content in (("bom.csv", bill), (NAME, manifest_bytes(document))):
        partial = folder / f".{name}.{os.getpid()}.partial"
        partial.write_bytes(content)
        partial.replace(folder / name)


def blueprint_files(blueprint: Blueprint, *, guide: bool = False, step: bool = False) -> dict[str, bytes]:
    """Contents of every file by its path, the manifest last; the assembly guide and STEP files only if asked for."""
    if not blueprint.parts or not blueprint.masses:
        raise ValueError(f"design {blueprint.design.key} has no printed parts yet; build it before it is exported")
    catalogue = blueprint.catalogue
    description = describe(blueprint)
    printed = pieces(blueprint)
    surfaces = [air_surface(blueprint, piece) for piece in printed]
    lays = arrange([piece.points for piece in printed], catalogue.printer.volume, surfaces)
    objects = print_objects(blueprint, lays)
    visuals = robot_visuals(blueprint, description)
    design = io.BytesIO()
    blueprint.design.save(design)
    files = {"design.npz": design.getvalue()}
    for part in blueprint.parts:
        mesh = welded(part.solid)
        files[part_file(part)] = stl_bytes(*mesh, part.name)
        if step and part.material == "rigid":
            files[f"step/{part.name}.step"] = step_bytes(*mesh, part.name)
    files["print.3mf"] = prusa_3mf(objects, blueprint.design.key, catalogue)
    files["print_bambu.3mf"] = bambu_3mf(objects, blueprint.design.key, catalogue)
    settings = print_settings(blueprint, lays)
    files["print_settings.txt"] = settings.encode()
    files["assembly.glb"] = assembly_glb(visuals, description)
    files["robot.urdf"] = urdf(description, visuals).encode()
    files["robot.xml"] = mjcf(description, visuals).encode()
    files |= mesh_files(description, visuals)
    files["bom.csv"] = bill_of_materials(blueprint).encode()
    files["wiring.csv"] = wiring_table(blueprint).encode()
    if guide:
        files[GUIDE] = guide_html(blueprint, lays, settings)
    files[NAME] = manifest_bytes(manifest(blueprint, description, lays, files))
    return files


def print_objects(blueprint: Blueprint, lays: list[Lay]) -> list[PrintObject]:
    """One object per body, piece of one or lid: rigid and soft parts together, so that the slicer interlocks them."""
    catalogue = blueprint.catalogue
    stride = catalogue.printer.volume[0] * PLATE_STRIDE
    objects = []
    for piece, lay in zip(pieces(blueprint), lays, strict=True):
        volumes = tuple(
            Volume(part.name, *welded(part.solid), EXTRUDERS[part.material], _filament(catalogue, part))
            for part in piece.parts
        )
        pose = lay.T_plate_design.copy()
        pose[0, 3] += lay.plate * stride
        pose[:3, 3] *= MM_PER_M
        objects.append(PrintObject(piece.name, volumes, pose, lay.plate))
    return objects


def robot_visuals(blueprint: Blueprint, description: Description) -> list[Visual]:
    """What a simulator or a viewer shows: printed parts, motors, boxes and cables, each in its link's frame."""
    origins, visuals = description.origins(), []

    def show(name: str, link: int, solid: Solid, colour: str, alpha: float = 1.0) -> None:
        visuals.append(Visual(name, link, solid.vertices - origins[link], solid.triangles, colour, alpha))

    for part in blueprint.parts:
        colour, alpha = _filament(blueprint.catalogue, part).colour, 1.0 if part.material == "rigid" else SKIN_ALPHA
        show(part.name, part.body, part.solid.simplified(VISUAL_ERROR), colour, alpha)
    for seat in blueprint.seats:
        name = f"{blueprint.hinges[seat.hinge].name}_motor"
        show(name, seat.holder, motor_solid(blueprint, seat), MOTOR_COLOUR)
    for box in blueprint.boxes:
        show(box.kind, box.body, box_solid(box), BATTERY_COLOUR if box.kind == "battery" else CONTROLLER_COLOUR)
    for wire in blueprint.wires:
        # A cable bends with the joints that it crosses, so each body carries its own stretch.
        for number, (body, path) in enumerate(wire_stretches(wire, blueprint), start=1):
            show(f"{wire.name}_{number}", body, tunnel(replace(wire, path=path)), WIRE_COLOUR)
    return visuals


def assembly_glb(visuals: list[Visual], description: Description) -> bytes:
    """The assembled robot at rest as binary glTF [m], y up as that format demands, coloured."""
    import trimesh

    scene, origins = trimesh.Scene(), description.origins()
    y_up = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])
    for visual in visuals:
        colour = [int(visual.colour[k : k + 2], 16) for k in (1, 3, 5)]
        material = trimesh.visual.material.PBRMaterial(
            name=visual.name, baseColorFactor=[*colour, round(255 * visual.alpha)], metallicFactor=0.0,
            roughnessFactor=0.8, alphaMode="OPAQUE" if visual.alpha >= 1 else "BLEND", doubleSided=False,
        )  # fmt: skip
        mesh = trimesh.Trimesh(visual.vertices + origins[visual.link], visual.triangles, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=visual.name, geom_name=visual.name, transform=y_up)
    return bytes(scene.export(file_type="glb"))


def print_settings(blueprint: Blueprint, lays: list[Lay]) -> str:
    """A sheet for people whose slicer does not read the settings in the 3MF files."""
    catalogue = blueprint.catalogue
    printer = catalogue.printer
    lines = [
        f"Design {blueprint.design.key}",
        f"Printer: {printer.name}; nozzle {1e3 * printer.nozzle:.1f} mm, line {1e3 * printer.line_width:.2f} mm, "
        f"layer {1e3 * printer.layer_height:.2f} mm",
        f"Load print.3mf (PrusaSlicer) or print_bambu.3mf (Bambu Studio, OrcaSlicer): {len(lays)} objects on "
        f"{max(lay.plate for lay in lays) + 1} plate(s).",
        "",
    ]
    for material, extruder in EXTRUDERS.items():
        f = catalogue.rigid if material == "rigid" else catalogue.soft
        names = "*_skin_*" if material == "soft" else "*_bone*" + (", *_lid_*" if blueprint.lids else "")
        lines.append(
            f"Extruder {extruder}: {f.name} for parts {names}; "
            f"{f.walls} perimeter(s), {f.infill:.0%} {f.infill_pattern} infill"
        )
    lines += [
        "Rigid and soft parts of a body are one object; interlocking depth at their boundary "
        f"{1e3 * printer.interlock_depth:.2f} mm (Bambu Studio: Others > Advanced).",
        *print_notes(blueprint),
        "",
    ]
    for piece, lay in zip(pieces(blueprint), lays, strict=True):
        size = " x ".join(f"{1e3 * s:.0f}" for s in lay.size)
        lines.append(f"{piece.name}: plate {lay.plate + 1}, {size} mm as laid")
    return "\n".join(lines) + "\n"


def _filament(catalogue: Catalogue, part: PrintedPart) -> Filament:
    return catalogue.rigid if part.material == "rigid" else catalogue.soft


def _move_content(source: Path, target: Path) -> None:
    """Move everything in a folder, its manifest last: a folder that has one is complete."""
    for path in sorted(source.iterdir(), key=lambda path: path.name == NAME):
        path.rename(target / path.name)


def _sweep(folder: Path) -> None:
    """Remove what exports to this folder left beside it when they were killed."""
    made = re.compile(rf"\.{re.escape(folder.name)}\.(\d+)\.(partial|old)")
    for path in folder.parent.iterdir() if folder.parent.is_dir() else ():
        match = made.fullmatch(path.name)
        if match and not _is_at_work(int(match[1])):
            shutil.rmtree(path)


def _is_at_work(process: int) -> bool:
    """Whether another process than this one has this id."""
    if process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _check_target(folder: Path) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FileExistsError(f"{folder} is a file; name a folder for the blueprint")
    if not (folder / NAME).is_file() and any(itertools.islice(folder.iterdir(), 1)):
        raise FileExistsError(f"{folder} is not empty and holds no {NAME}; name another folder for the blueprint")
