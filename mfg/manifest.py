"""blueprint.json: the versioned manifest of a blueprint folder, and the robot read back from it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mfg.addresses import MAX_BUS, can_address, turn_sign
from mfg.blueprint import Blueprint, LidSeat, PrintedPart, WireRun
from mfg.catalogue import Motor, ScrewPattern
from mfg.description import PAPER_SKIN, DescribedJoint, Description, Link, SkinMaterial
from mfg.lids import SCREW
from mfg.moments import printed_moments
from mfg.outcome import Scores
from mfg.plate import Lay
from mfg.splitting import Piece, pieces
from mfg.stl import welded

FORMAT = "bodyplan-blueprint"
VERSION = 1
NAME = "blueprint.json"


class ManifestError(ValueError):
    """A file that is no blueprint manifest; the message names it, what is wrong and what is expected."""


def manifest(
    blueprint: Blueprint, description: Description, lays: list[Lay], files: Mapping[str, bytes]
) -> dict[str, Any]:
    """Everything about a finished blueprint that fits in one JSON document.

    Args:
        blueprint: with parts and masses.
        description: of the same blueprint.
        lays: how each body, or each piece of a body that was cut, lies on the printer.
        files: contents by path within the folder, for their hashes.
    """
    laid = list(zip(pieces(blueprint), lays, strict=True))
    divided = {} if len(laid) == len(blueprint.bodies) else {"pieces": [_piece(blueprint, *pair) for pair in laid]}
    of_body = {piece.body: lay for piece, lay in reversed(laid)}
    return {
        "format": FORMAT,
        "version": VERSION,
        "design": blueprint.design.key,
        "units": {"length": "m", "angle": "rad", "mass": "kg", "files in parts/ and *.3mf": "mm"},
        "frame": "design frame: corner of the voxel grid at the origin, z up, robot at rest; poses T_a_b map b to a",
        "pitch": blueprint.design.pitch,
        "scores": scores_json(blueprint.scores),
        **({} if blueprint.rules is None else {"rules": blueprint.rules}),
        "notes": list(blueprint.notes),
        "catalogue": component_json(blueprint.catalogue),
        # A body that was cut has the place of its first piece here; `pieces` has them all.
        "bodies": [_body(blueprint, index, of_body[index]) for index in range(len(blueprint.bodies))],
        **divided,
        "joints": [_joint(blueprint, index) for index in range(len(blueprint.hinges))],
        "boxes": [
            {"kind": box.kind, "body": blueprint.bodies[box.body].name, "size": list(box.size),
             "T_design_box": box.T_design_box.tolist(), "clearance": box.clearance, "shaft": box.shaft}
            for box in blueprint.boxes
        ],
        **({"lids": [_lid(blueprint, lid) for lid in blueprint.lids]} if blueprint.lids else {}),
        "wires": [_wire(blueprint, wire) for wire in blueprint.wires],
        "parts": [_part(blueprint, part) for part in blueprint.parts],
        "robot": robot_json(description),
        "files": {path: hashlib.sha256(files[path]).hexdigest() for path in sorted(files)},
    }  # fmt: skip


def manifest_bytes(document: Mapping[str, Any]) -> bytes:
    """The document as UTF-8 JSON; NaN and infinity are refused."""
    return (json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()


def scores_json(scores: Scores) -> dict[str, float | None]:
    """The five scores and their sum."""
    return {**asdict(scores), "total": scores.total}


def component_json(component: Any) -> dict[str, Any]:
    """The fields of a component or a catalogue; what is at its default and what is only for pictures is left out."""
    return {f.name: _component_value(value) for f in fields(component)
            if f.compare and (value := getattr(component, f.name)) != f.default}  # fmt: skip


def robot_json(description: Description) -> dict[str, Any]:
    """A description in full precision, as `read_description` reads it."""
    return {
        "name": description.name,
        "source": description.source,
        "mass": description.mass,
        "standing_height": description.standing_height,
        "imu_link": description.imu_link,
        "T_link_imu": description.T_link_imu.tolist(),
        "skin": asdict(description.skin),
        "links": [
            {"name": link.name, "parent": link.parent, "T": link.T.tolist(), "mass": link.mass,
             "com": link.com.tolist(), "inertia": link.inertia.tolist(), "hull": link.hull.tolist(),
             "skin_thickness": link.skin_thickness}
            for link in description.links
        ],
        "joints": [
            {"name": joint.name, "link": joint.link, "axis": joint.axis.tolist(), "range": joint.range.tolist(),
             "motor": component_json(joint.motor), "can_id": joint.can_id, "sign": joint.sign}
            for joint in description.joints
        ],
    }  # fmt: skip


def read_manifest(path: Path | str) -> dict[str, Any]:
    """Read the manifest of a blueprint folder, given the folder or the file itself.

    Raises:
        ManifestError: if it is damaged, foreign or of another version.
        OSError: if it cannot be read.
    """
    path = Path(path)
    path = path / NAME if path.is_dir() else path
    try:
        document = json.loads(path.read_bytes(), parse_constant=_refuse)
    except ValueError as error:
        raise ManifestError(f"{path}: not readable as JSON ({str(error).splitlines()[0][:120]})") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ManifestError(f"{path}: not a blueprint manifest; its format should be {FORMAT!r}")
    if document.get("version") != VERSION:
        raise ManifestError(f"{path}: version is {document.get('version')!r}, this program reads version {VERSION}")
    return document


def read_description(path: Path | str) -> Description:
    """Read the robot out of a blueprint folder, exactly as it was described.

    Raises:
        ManifestError: if the manifest is damaged or lacks something.
        OSError: if it cannot be read.
    """
    document = read_manifest(path)
    robot: Any = document.get("robot")
    try:
        # Older files say the motors' addresses and signs here only.
        built = {joint["name"]: joint for joint in document["joints"]}
        links = tuple(
            Link(str(link["name"]), int(link["parent"]), _array(link["T"], 3), _finite(link["mass"]),
                 _array(link["com"], 3), _array(link["inertia"], 3, 3), _array(link["hull"], -1, 3),
                 _finite(link.get("skin_thickness", 0.0)))
            for link in robot["links"]
        )  # fmt: skip
        joints = tuple(
            DescribedJoint(str(joint["name"]), int(joint["link"]), _array(joint["axis"], 3), _array(joint["range"], 2),
                           _motor(joint["motor"]), *_drive({**built.get(joint["name"], {}), **joint}))
            for joint in robot["joints"]
        )  # fmt: skip
        if not links or any(not -1 <= link.parent < index for index, link in enumerate(links)):
            raise ValueError("links must name earlier links as their parents")
        if any(not 0 < joint.link < len(links) for joint in joints) or not 0 <= int(robot["imu_link"]) < len(links):
            raise ValueError("a joint or the IMU names a link that does not exist")
        return Description(
            str(robot["name"]), links, joints, int(robot["imu_link"]), _array(robot["T_link_imu"], 4, 4),
            robot["source"], _finite(robot["standing_height"]),
            # Older files know no skin; theirs is the paper's.
            SkinMaterial(**{k: _finite(v) for k, v in robot["skin"].items()}) if "skin" in robot else PAPER_SKIN,
        )  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise ManifestError(f"{path}: the robot in it is incomplete or malformed ({error!r:.120})") from None


def changed_files(folder: Path | str) -> list[str]:
    """Paths whose content no longer has the hash in the manifest, missing ones included.

    Raises:
        ManifestError: if the manifest is damaged.
        OSError: if a file cannot be read.
    """
    folder = Path(folder)
    stored = read_manifest(folder)["files"]
    return [
        path for path, digest in stored.items()
        if not (folder / path).is_file() or hashlib.sha256((folder / path).read_bytes()).hexdigest() != digest
    ]  # fmt: skip


def part_file(part: PrintedPart) -> str:
    """Where a part's STL is kept in the folder."""
    return f"parts/{part.name}.stl"


def _body(blueprint: Blueprint, index: int, lay: Lay) -> dict[str, Any]:
    body, mass = blueprint.bodies[index], blueprint.masses[index]
    return {
        "name": body.name, "segment": body.segment, "parent": None if index == 0 else
        blueprint.bodies[blueprint.hinges[index - 1].parent].name,
        "mass": mass.mass, "com": mass.com.tolist(), "inertia": mass.inertia.tolist(),
        "plate": lay.plate, "T_plate_design": lay.T_plate_design.tolist(), "print_size": lay.size.tolist(),
    }  # fmt: skip


def _piece(blueprint: Blueprint, piece: Piece, lay: Lay) -> dict[str, Any]:
    return {
        "name": piece.name, "body": blueprint.bodies[piece.body].name, "parts": [part.name for part in piece.parts],
        "plate": lay.plate, "T_plate_design": lay.T_plate_design.tolist(), "print_size": lay.size.tolist(),
    }  # fmt: skip


def _lid(blueprint: Blueprint, lid: LidSeat) -> dict[str, Any]:
    seat = blueprint.boxes[lid.box]
    return {
        "box": seat.kind, "body": blueprint.bodies[seat.body].name, "part": lid.part, "screw": SCREW,
        "screws": lid.screws.tolist(), "notch": lid.notch.tolist(),
    }  # fmt: skip


def _joint(blueprint: Blueprint, index: int) -> dict[str, Any]:
    hinge, seat = blueprint.hinges[index], blueprint.seats[index]
    bus, address = can_address(index)
    names = [body.name for body in blueprint.bodies]
    return {
        "name": hinge.name, "parent": names[hinge.parent], "child": names[hinge.body],
        "position": hinge.position.tolist(), "axis": hinge.axis.tolist(), "range": hinge.range.tolist(),
        "motor": blueprint.catalogue.motor.name, "bus": bus, "can_id": address, "sign": turn_sign(blueprint, seat),
        "holder": names[seat.holder], "connector": names[seat.connector], "offset": seat.offset,
        "T_design_motor": seat.T_design_motor.tolist(), "holder_volume": seat.holder_volume,
        "connector_volume": seat.connector_volume,
    }  # fmt: skip


def _wire(blueprint: Blueprint, wire: WireRun) -> dict[str, Any]:
    """A cable: its tunnel, how much more cable it is cut to, and where that is left over."""
    return {
        "name": wire.name, "joint": blueprint.hinges[blueprint.seats[wire.seat].hinge].name,
        "length": wire.length, "slack": wire.slack, "cable_length": wire.cable_length, "radius": wire.radius,
        "path": np.round(wire.path, 6).tolist(),
        "crossings": [
            {"joint": blueprint.hinges[c.hinge].name, "position": np.round(c.position, 6).tolist(), "span": c.span,
             "needed": list(c.needed), "slack": c.slack}
            for c in wire.crossings
        ],
    }  # fmt: skip


def _part(blueprint: Blueprint, part: PrintedPart) -> dict[str, Any]:
    catalogue = blueprint.catalogue
    filament = catalogue.rigid if part.material == "rigid" else catalogue.soft
    vertices, triangles = welded(part.solid)
    moments = printed_moments(part.solid.vertices, part.solid.triangles, filament, catalogue.printer.line_width)
    return {
        "name": part.name, "body": blueprint.bodies[part.body].name, "material": part.material,
        "filament": filament.name, "file": part_file(part), "mass": moments.mass, "volume": part.solid.volume,
        "triangles": len(triangles), "bounds_mm": [vertices.min(0).tolist(), vertices.max(0).tolist()],
    }  # fmt: skip


def _component_value(value: Any) -> Any:
    if is_dataclass(value):
        return component_json(value)
    return [_component_value(item) for item in value] if isinstance(value, tuple) else value


def _motor(stated: dict[str, Any]) -> Motor:
    special: dict[str, Any] = {name: ScrewPattern(**stated[name]) for name in ("body_screws", "output_screws")}
    if "voltage_range" in stated:
        special["voltage_range"] = tuple(_array(stated["voltage_range"], 2).tolist())
    return Motor(**{**stated, **special})


def _drive(joint: dict[str, Any]) -> tuple[int, int]:
    """(CAN id, sign) of a joint's motor."""
    can_id, sign = joint["can_id"], joint["sign"]
    if type(can_id) is not int or type(sign) is not int or sign not in (-1, 1) or not 1 <= can_id <= MAX_BUS:
        raise ValueError(f"{joint['name']} has CAN id {can_id!r} and sign {sign!r}, not 1..{MAX_BUS} and -1 or 1")
    return can_id, sign


def _array(value: Any, *shape: int) -> np.ndarray:
    array = np.array(value, np.float64)
    if array.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
        raise ValueError(f"an array has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError("an array holds a number that is not finite")
    return array


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} is not a finite number")
    return number


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is not a number of JSON")
