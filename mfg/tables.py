"""The tables that go with a robot: what to buy or print, and what is wired to what."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence

from mfg.addresses import can_address, turn_sign
from mfg.blueprint import Blueprint
from mfg.lids import SCREW
from mfg.moments import printed_moments
from mfg.slicer import SliceReport, clock

SLICED = "filament, sliced"  # kind of the rows that a slicer wrote


def bill_of_materials(blueprint: Blueprint) -> str:
    """CSV: one line per kind of component, then one per filament; masses in grams, empty where not in the model."""
    catalogue, motors = blueprint.catalogue, len(blueprint.seats)
    motor = catalogue.motor
    rows: list[Sequence[object]] = [
        ("motor", motor.name, motors, "pcs", _grams(motor.mass * motors), motor.source),
        ("battery", catalogue.battery.name, 1, "pcs", _grams(catalogue.battery.mass), catalogue.battery.source),
    ]
    rows += [("electronics", d.name, 1, "pcs", _grams(d.mass), d.source) for d in catalogue.computer.devices]
    encoder = catalogue.joint_encoder
    rows.append(("encoder", encoder.name, motors, "pcs", "", f"1 per joint, {encoder.source}; not in the mass model"))
    for pattern, use in ((motor.body_screws, "motor to holder"), (motor.output_screws, "motor to connector")):
        rows.append(("screw", pattern.screw, pattern.count * motors, "pcs", "", f"{pattern.count} per joint, {use}"))
    for lid in blueprint.lids:
        use = f"over the {blueprint.boxes[lid.box].kind}"
        rows.append(("printed lid", lid.part, 1, "pcs", "", f"{use}; its mass is in that of {catalogue.rigid.name}"))
        rows.append(("screw", SCREW, len(lid.screws), "pcs", "", f"lid {use}, cuts its own thread"))
    length = sum(wire.cable_length for wire in blueprint.wires)
    mass = catalogue.wire.mass_per_metre * length
    rows.append(("cable", catalogue.wire.name, f"{length:.2f}", "m", _grams(mass), catalogue.wire.source))
    for material, filament in (("rigid", catalogue.rigid), ("soft", catalogue.soft)):
        mass = sum(
            printed_moments(part.solid.vertices, part.solid.triangles, filament, catalogue.printer.line_width).mass
            for part in blueprint.parts
            if part.material == material
        )
        note = f"{material} parts, without supports"
        rows.append(("filament", filament.name, f"{1e3 * mass:.0f}", "g", _grams(mass), note))
    return _csv(("kind", "item", "quantity", "unit", "mass_g", "note"), rows)


def sliced_bill(bill: str, report: SliceReport, filaments: tuple[str, str]) -> str:
    """The same bill with what a slicer lays down of each filament (rigid, soft) at its end; older such rows go."""
    header, *rows = csv.reader(io.StringIO(bill))
    rows = [row for row in rows if row[0] != SLICED]
    for material, name, grams in zip(("rigid", "soft"), filaments, report.grams, strict=True):
        note = f"{material} filament with supports as {report.program} slices it; {clock(report.seconds)} in all"
        rows.append([SLICED, name, f"{grams:.0f}", "g", "", note])
    return _csv(header, rows)


def wiring_table(blueprint: Blueprint) -> str:
    """CSV: one line per cable, with the motor's CAN address, the sign of its angle and the slack at each joint.

    The length is that of the cable to cut; the slack in it is named again by joint, from the controller on.
    """
    rows = []
    for wire in blueprint.wires:
        seat = blueprint.seats[wire.seat]
        hinge = blueprint.hinges[seat.hinge]
        mates = blueprint.bodies[seat.holder].name, blueprint.bodies[seat.connector].name
        address = (*can_address(wire.seat), turn_sign(blueprint, seat))
        slack = " ".join(f"{blueprint.hinges[c.hinge].name}:{1e3 * c.slack:.0f}" for c in wire.crossings)
        rows.append((wire.name, "controller", hinge.name, f"{1e3 * wire.cable_length:.0f}", *address, *mates, slack))
    header = (
        "wire", "from", "to", "length_mm", "bus", "can_id", "sign", "motor_held_by", "output_screwed_to", "slack_mm",
    )  # fmt: skip
    return _csv(header, rows)


def _grams(mass: float) -> str:
    return f"{1e3 * mass:.1f}"


def _csv(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
