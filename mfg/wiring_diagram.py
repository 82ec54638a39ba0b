"""The wiring diagram of a robot as SVG: power and bus from the battery to every motor."""

from __future__ import annotations

from html import escape

from mfg.addresses import can_address
from mfg.blueprint import Blueprint
from mfg.guide_text import STUB, cut_length

WIDTH, ROW, TOP = 900, 62, 40  # [pixels]
POWER, BUS, SIGNAL, INK = "#c92a2a", "#1864ab", "#2b8a3e", "#22272b"


def bus_ends(blueprint: Blueprint) -> dict[str, int]:
    """The seat at the far end of every bus: the one with the longest cable takes the second resistor."""
    ends: dict[str, int] = {}
    length = {wire.seat: wire.length for wire in blueprint.wires}
    for k in range(len(blueprint.seats)):
        bus = can_address(k)[0]
        if bus not in ends or length.get(k, 0.0) > length.get(ends[bus], 0.0):
            ends[bus] = k
    return ends


def wiring_diagram(blueprint: Blueprint) -> str:
    """An SVG element: battery, switch and fuse, controller box with its devices, one cable per motor.

    Every cable is named with its length, every motor with its joint, bus and id; the resistors sit at both ends of
    each bus.
    """
    ends = bus_ends(blueprint)
    height = TOP + max(len(blueprint.seats) * ROW, 250) + 60
    parts = [
        f'<svg class="diagram" role="img" aria-label="wiring diagram" xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="0 0 {WIDTH} {height}" font-size="14">',
        "<title>wiring diagram</title>",
        _box(20, TOP, 150, 54, [blueprint.catalogue.battery.name, f"{blueprint.catalogue.battery.voltage:g} V"], POWER),
        _box(20, TOP + 84, 150, 54, ["switch + fuse 30 A", "in the plus lead"], POWER),
        _line([(95, TOP + 54), (95, TOP + 84)], POWER, 4),
        _box(250, TOP + 84, 160, 138, [d.name for d in blueprint.catalogue.computer.devices], SIGNAL),
        _text(330, TOP + 76, "controller box", "middle", INK, bold=True),
        _line([(170, TOP + 125), (250, TOP + 125)], POWER, 2),
    ]  # fmt: skip
    spine_power, spine_bus = 470, 486
    last = TOP + max(len(blueprint.seats) - 1, 0) * ROW + 27
    parts += [
        _line([(170, TOP + 105), (210, TOP + 105), (210, TOP + 40), (spine_power, TOP + 40)], POWER, 4),
        _line([(spine_power, min(TOP + 40, TOP + 20)), (spine_power, max(last - 7, TOP + 40))], POWER, 4),
        _line([(410, TOP + 150), (spine_bus, TOP + 150)], BUS, 2.5),
        _line([(spine_bus, TOP + 34), (spine_bus, max(last + 7, TOP + 150))], BUS, 2.5),
        _text(448, TOP + 143, "CAN", "middle", BUS),
        _text(330, TOP + 244, "120 Ω: jumper of the CAN adapter ON", "middle", BUS, bold=True),
    ]
    for k, seat in enumerate(blueprint.seats):
        y = TOP + k * ROW
        bus, address = can_address(k)
        joint = blueprint.hinges[seat.hinge].name
        run = next((wire for wire in blueprint.wires if wire.seat == k), None)
        parts += [_line([(spine_power, y + 20), (690, y + 20)], POWER, 3),
                  _line([(spine_bus, y + 34), (690, y + 34)], BUS, 2),
                  _box(690, y, 190, 54, [f"motor of {joint}", f"{bus} id {address}"], INK)]  # fmt: skip
        if run is not None:
            parts.append(_text(588, y + 13, f"{run.name}: cut {1e3 * cut_length(run.length):.0f} mm", "middle", INK))
            if run.length > STUB and ends.get(bus) != k:
                parts.append(_text(588, y + 49, f"branch over {1e3 * STUB:.0f} mm", "middle", "#a05a00"))
        if ends.get(bus) == k:
            parts.append(_text(588, y + 49, "120 Ω across H and L", "middle", BUS, bold=True))
    legend = f"thick red: {blueprint.catalogue.battery.voltage:g} V supply; blue: CAN H and CAN L, 1 Mbit/s"
    parts.append(
        _text(20, height - 22, f"{legend}; both run in one sleeve ({blueprint.catalogue.wire.name})", "start", INK)
    )
    return "\n".join([*parts, "</svg>"])


def _box(x: float, y: float, width: float, height: float, lines: list[str], colour: str) -> str:
    out = [f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="5" fill="#fff" stroke="{colour}" '
           'stroke-width="2"/>']  # fmt: skip
    step = min(20.0, height / (len(lines) + 0.4)) if lines else 0.0
    first = y + height / 2 - step * (len(lines) - 1) / 2 + 5
    for k, line in enumerate(lines):
        fit = f' textLength="{width - 14}" lengthAdjust="spacingAndGlyphs"' if 7.2 * len(line) > width - 14 else ""
        out.append(f'<text x="{x + width / 2}" y="{first + k * step:.1f}" text-anchor="middle" fill="{INK}"{fit}>'
                   f"{escape(line)}</text>")  # fmt: skip
    return "".join(out)


def _line(points: list[tuple[float, float]], colour: str, width: float) -> str:
    path = "M" + "L".join(f"{x:g} {y:g}" for x, y in points)
    return f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"/>'


def _text(x: float, y: float, text: str, anchor: str, colour: str, *, bold: bool = False) -> str:
    weight = ' font-weight="700"' if bold else ""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{colour}"{weight}>{escape(text)}</text>'
