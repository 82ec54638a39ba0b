"""What the assembly guide says about one robot: tools, torques, steps, tables. Plain text in, escaped HTML out."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from html import escape

from mfg.addresses import can_address, turn_sign
from mfg.assembly import Step
from mfg.blueprint import Blueprint
from mfg.catalogue import ScrewPattern
from mfg.guide_stock import screw_size
from mfg.lids import SCREW
from mfg.splitting import pieces
from mfg.tables import bill_of_materials, wiring_table
from mfg.ways import TOOLS

# Cap screws on plastic, all (assumed): pressure under the head that PLA bears for years without creeping away [Pa],
# head of an ISO 4762 screw as a multiple of its size, nut factor of a dry screw, friction of plastic on aluminium.
BEARING, HEAD_RATIO, NUT_FACTOR, GRIP = 40e6, 1.75, 0.2, 0.2
LID_TORQUE = 0.3  # what strips no thread of an M3 screw in printed plastic (assumed) [N.m]
STUB = 0.3  # longest branch that a CAN bus at 1 Mbit/s bears, a rule of thumb (assumed) [m]
SET_ID, SAVE_CONFIG, GET_CONFIG = 8, 16, 24  # commands of the J60: vendor's can_protocol.h; id = command << 5 | motor


def tightening_torque(pattern: ScrewPattern) -> float:
    """T = K d p A: what presses the plastic under the head with `BEARING` and no more [N.m]."""
    size, _ = screw_size(pattern.screw)
    return NUT_FACTOR * size * clamp(pattern)


def clamp(pattern: ScrewPattern) -> float:
    """Force of one screw at that torque [N]: the bearing pressure times the ring under its head."""
    size, _ = screw_size(pattern.screw)
    return BEARING * math.pi / 4 * ((HEAD_RATIO * size) ** 2 - pattern.hole_diameter**2)


def holding_torque(pattern: ScrewPattern) -> float:
    """What the clamped face carries by friction alone before it slips, about the motor's axis [N.m]."""
    return pattern.count * clamp(pattern) * GRIP * pattern.circle_radius


def tools(blueprint: Blueprint) -> list[str]:
    """Tools and small supplies, one line each."""
    motor = blueprint.catalogue.motor
    keys = sorted({round(0.75e3 * screw_size(p.screw)[0], 1) for p in (motor.body_screws, motor.output_screws)})
    key = " and ".join(f"{k:g} mm" for k in keys)
    lids = ["hex key 2.5 mm for the screws of the lids"] if blueprint.lids else []
    return [
        f"hex keys {key}: a ball-end driver of 120 mm, and one cut to an arm of 15 mm for tight places",
        *lids,
        "torque screwdriver, 0.3 to 1.5 N.m",
        "thread lock of medium strength (blue) for steel screws in the motor's metal threads",
        f"draw wire or nylon fish tape of 1.5 m for the cables (tunnels of {2e3 * _tunnel(blueprint):.0f} mm bore)",
        "round file and deburring knife: clear tunnels, cups and shafts of support before you begin",
        "soldering iron, heat-shrink, plugs for power and CAN to fit the motors; a 120 Ω resistor, 0.25 W",
        "multimeter; LiPo balance charger for 6 cells; paint marker for the zero marks",
    ]


def step_text(blueprint: Blueprint, step: Step) -> list[str]:
    """What to do in a step, as sentences."""
    bodies, motor = blueprint.bodies, blueprint.catalogue.motor
    body = bodies[step.body].name
    if step.kind == "place":
        extra = [name for name in step.adds if "skin" in name]
        with_skin = f" with its soft skin ({', '.join(extra)})" if extra else ""
        text = [f"Take {body}{with_skin} to the bench and clear its holes of support."]
        made = [piece.name for piece in pieces(blueprint) if piece.body == step.body
                and {part.name for part in piece.parts} <= set(step.adds)]  # fmt: skip
        if len(made) > 1:
            text.append(f"It is printed in pieces: glue {', '.join(made)} together, each peg in its hole, until their "
                        "faces meet, and let the glue set.")  # fmt: skip
        return text
    if step.kind == "box":
        return _box_text(blueprint, step)
    if step.kind == "lid":
        return _lid_text(blueprint, step)
    seat = blueprint.seats[step.index]
    joint = blueprint.hinges[seat.hinge].name
    bus, address = can_address(step.index)
    if step.kind == "cable":
        run = next(wire for wire in blueprint.wires if wire.seat == step.index)
        return [f"Draw {run.name} ({1e3 * run.length:.0f} mm of tunnel; cut it {1e3 * cut_length(run.length):.0f} mm) "
                f"through the tunnel of {body} into the empty cup and plug it into the motor of {joint}, "
                f"labelled {bus} id {address}."]  # fmt: skip
    if step.kind == "motor":
        how = "in from the side over the cup, then straight down" if len(step.legs) > 1 else "straight down"
        text = [f"Lower the motor of {joint} into the cup of {body}, {how}, its output face outwards, and draw the "
                "slack of the cable back as it goes, until it rests on the base plate."]  # fmt: skip
        return text + (["Bend the soft skin aside while the motor passes."] if step.soft else [])
    if step.kind == "body_screws":
        return [_screw_text(motor.body_screws, f"from outside through the base plate of {body} into the motor", step)]
    if step.kind == "output_screws":
        what = f"through the disc of {bodies[seat.connector].name} into the motor's output"
        return [_screw_text(motor.output_screws, what, step)]
    moved = ", ".join(bodies[b].name for b in step.moved)
    comes = "disc slides across the output face" if seat.connector in step.moved else "motor slides under the disc"
    text = []
    if step.feeds:
        names = ", ".join(blueprint.wires[w].name for w in step.feeds)
        text.append(f"Lead the loose end of {names} into its tunnel on the other side, and pull it after as you go.")
    text.append(f"Bring {moved} onto {body} along the arrow: its {comes} of {joint} until the axes and the holes meet.")
    if step.angle:
        text.append(f"Do so with the joint turned by {math.degrees(step.angle):+.0f}° (as pictured), and turn it back "
                    "afterwards: the motor turns freely without power.")  # fmt: skip
    if step.soft:
        text.append("Soft skin is in the way here: press it aside, it springs back.")
    return text


def cut_length(run: float) -> float:
    """Length to cut a cable to: its tunnel, 60 mm at each end for plugs and slack, up to the next 10 mm [m]."""
    return math.ceil((run + 0.120) * 100 - 1e-9) / 100


def advice(step: Step) -> str:
    """What to do about a step's trouble; empty where there is none."""
    if not step.trouble:
        return ""
    if step.kind in ("body_screws", "output_screws"):
        holes = ("Move this joint in the design, so that a hand and a key have room behind it, and build again."
                 if "motor" in step.trouble else
                 "Drill access holes of 8 mm through what covers the screws, in line with them, before you go on; or "
                 "move this joint in the design and build again.")  # fmt: skip
        return f"No tool reaches these screws: {step.trouble}. {holes}"
    if step.kind == "box" and "arrive only later" in step.trouble:
        return f"Mind the order: {step.trouble}."
    what = "the printed part" if step.kind == "join" else "the wall"
    return (f"No free straight way was found: {step.trouble}. Try tilting it in; if it does not pass, cut {what} "
            "back at that spot with a knife or file, or change the body there and build again.")  # fmt: skip


def setup_rows(blueprint: Blueprint) -> list[list[str]]:
    """One row per motor: joint, bus, id, frames that give it its id and store it, frame that reads it back."""
    rows = []
    for k, seat in enumerate(blueprint.seats):
        bus, address = can_address(k)
        rows.append([
            blueprint.hinges[seat.hinge].name, bus, str(address),
            f"cansend {bus} {SET_ID << 5 | 1:03X}#{address:02X}", f"cansend {bus} {SAVE_CONFIG << 5 | address:03X}#",
            f"cansend {bus} {GET_CONFIG << 5 | address:03X}#",
        ])  # fmt: skip
    return rows


def calibration_rows(blueprint: Blueprint) -> list[list[str]]:
    """One row per joint: name, id, sign, range, what turns about which axis."""
    rows = []
    for k, seat in enumerate(blueprint.seats):
        hinge = blueprint.hinges[seat.hinge]
        low, high = (float(v) for v in hinge.range)
        rows.append([
            hinge.name, str(can_address(k)[1]), f"{turn_sign(blueprint, seat):+d}",
            f"{math.degrees(low):+.0f}° to {math.degrees(high):+.0f}° ({low:+.2f} to {high:+.2f} rad)",
            f"{blueprint.bodies[hinge.body].name} against {blueprint.bodies[hinge.parent].name}",
            "(" + ", ".join(f"{v:+.2f}" for v in hinge.axis) + ")",
        ])  # fmt: skip
    return rows


def shopping_rows(blueprint: Blueprint) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the bill of materials."""
    return _csv(bill_of_materials(blueprint))


def wiring_rows(blueprint: Blueprint) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the wiring table."""
    return _csv(wiring_table(blueprint))


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """An HTML table of plain text."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"


def listed(lines: Iterable[str], kind: str = "ul") -> str:
    """An HTML list of plain text."""
    return f"<{kind}>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + f"</{kind}>"


def checklist(lines: Iterable[tuple[str, str]]) -> str:
    """A numbered HTML list to tick off: what to do, and the command for it or nothing."""
    items = [
        f'<li class="tick">{escape(text)}{f"<pre>{escape(command)}</pre>" if command else ""}</li>'
        for text, command in lines
    ]
    return "<ol>\n" + "\n".join(items) + "\n</ol>"


def _box_text(blueprint: Blueprint, step: Step) -> list[str]:
    box = blueprint.boxes[step.index]
    body, catalogue = blueprint.bodies[step.body].name, blueprint.catalogue
    depth = f"{1e3 * max(0.0, box.shaft - box.size[2] / 2):.0f} mm below the mouth of its shaft"
    size = " x ".join(f"{1e3 * s:.0f}" for s in box.size)
    bend = ["Bend the soft skin aside at the mouth of the shaft."] if step.soft else []
    if box.kind == "battery":
        return [f"Slide the battery ({catalogue.battery.name}, {size} mm) into {body} along the arrow, leads outwards; "
                f"it sits {depth}. Keep its switch OFF and its plug apart until the first run.",
                *([] if any(lid.box == step.index for lid in blueprint.lids) else
                  ["Secure it with a strap or foam: it has 1 mm of play and no lid in this design."]),
                *bend]  # fmt: skip
    devices = ", ".join(device.name for device in catalogue.computer.devices)
    names = ", ".join(wire.name for wire in blueprint.wires)
    return [f"Stack {devices} into the controller box ({size} mm), the IMU at its centre with its axes along the box.",
            f"Plug in {names}, one at a time, each with its label; check that none is pinched.",
            f"Slide the controller box into {body} along the arrow; it sits {depth}.", *bend]  # fmt: skip


def _lid_text(blueprint: Blueprint, step: Step) -> list[str]:
    lid = blueprint.lids[step.index]
    kind, body = blueprint.boxes[lid.box].kind, blueprint.bodies[step.body].name
    text = [f"Lay the leads of the {kind} into the notch at the edge of {lid.part}, so that they come out.",
            f"Push the lid onto the opening in {body} along the arrow until its tabs rest on their shelves, and drive "
            f"{len(lid.screws)} screws {SCREW}: turn each back until it drops into its thread, then to "
            f"{LID_TORQUE:.1f} N.m, without thread lock."]  # fmt: skip
    if kind == "battery":
        text.append("To change or charge the battery, only these screws come out: it slides out along the arrow.")
    return text + (["Bend the soft skin aside at the mouth of the shaft."] if step.soft else [])


def _screw_text(pattern: ScrewPattern, where: str, step: Step) -> str:
    tool = {TOOLS[0]: "a straight driver reaches them", TOOLS[1]: "60 mm of room: use a stubby driver",
            TOOLS[2]: "35 mm of room: use a hex key", TOOLS[3]: "20 mm of room: use a shortened hex key"}  # fmt: skip
    reach = f"; {tool[step.room]}" if step.room in tool else ""
    return (f"Drive {pattern.count} screws {pattern.screw} {where}, crosswise, first by hand, then to "
            f"{tightening_torque(pattern):.2f} N.m with thread lock{reach}.")  # fmt: skip


def _tunnel(blueprint: Blueprint) -> float:
    return min((wire.radius for wire in blueprint.wires), default=blueprint.catalogue.wire.diameter / 2)


def _csv(text: str) -> tuple[list[str], list[list[str]]]:
    rows = list(csv.reader(io.StringIO(text)))
    return rows[0], rows[1:]
