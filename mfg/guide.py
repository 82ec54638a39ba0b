"""guide.html: how a person prints, wires, assembles and first runs one robot; a single file that prints on A4."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from mfg.assembly import Step, assembly_steps
from mfg.blueprint import Blueprint
from mfg.guide_pictures import png_uri
from mfg.guide_prose import (
    BRING_UP,
    BUS,
    CLEANING,
    ENCODERS,
    FIRST_RUN,
    HARD,
    HOMING,
    IDS,
    LEGEND,
    NEW_ID,
    PLATES,
    REFUSALS,
    SAFETY,
    SIGNS,
    TORQUES,
    ZERO,
)
from mfg.guide_scenes import (
    box_picture,
    join_picture,
    joint_picture,
    lid_picture,
    motor_picture,
    overview,
    plate_picture,
)
from mfg.guide_stock import Stock
from mfg.guide_style import STYLE
from mfg.guide_text import (
    LID_TORQUE,
    advice,
    calibration_rows,
    checklist,
    holding_torque,
    listed,
    setup_rows,
    shopping_rows,
    step_text,
    table,
    tightening_torque,
    tools,
    wiring_rows,
)
from mfg.lids import SCREW
from mfg.picture import blueprint_shapes
from mfg.plate import Lay
from mfg.render import render
from mfg.splitting import pieces
from mfg.wiring_diagram import wiring_diagram

NAME = "guide.html"
COVER = (620, 420)  # [pixels]


def guide_html(blueprint: Blueprint, lays: Sequence[Lay], settings: str) -> bytes:
    """The guide of a built robot, UTF-8; same blueprint, same bytes.

    Args:
        blueprint: with parts and masses.
        lays: how each of its `pieces` lies on the printer.
        settings: the sheet of print settings, as in print_settings.txt.

    Raises:
        ValueError: if the blueprint has no printed parts.
    """
    steps = assembly_steps(blueprint)
    stock = Stock(blueprint)
    key = escape(blueprint.design.key)
    sections = [
        _cover(blueprint, steps),
        _needs(blueprint),
        _print(stock, lays, settings),
        _assembly(stock, steps),
        _wiring(blueprint),
        _first_run(stock),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Assembly guide, robot {key}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(sections)
        + "\n</body>\n</html>\n"
    ).encode()


def panels(steps: Sequence[Step]) -> Iterator[list[Step]]:
    """Steps that share a picture: a motor with its cable and screws, a join with its screws, a box, a lid.

    A body that is taken to the bench belongs to the next picture.
    """
    panel: list[Step] = []
    for k, step in enumerate(steps):
        panel.append(step)
        following = steps[k + 1].kind if k + 1 < len(steps) else ""
        if step.kind in ("box", "lid") or (
            step.kind in ("body_screws", "output_screws") and following != "output_screws"
        ):
            yield panel
            panel = []
    if panel:
        yield panel


def _cover(blueprint: Blueprint, steps: Sequence[Step]) -> str:
    image = render(blueprint_shapes(blueprint), COVER, floor=True, draft=True)
    points = np.concatenate([part.solid.vertices for part in blueprint.parts])
    size = " × ".join(f"{100 * v:.0f}" for v in np.ptp(points, axis=0))
    bodies, motors = len(blueprint.bodies), len(blueprint.seats)
    mass = sum(m.mass for m in blueprint.masses)
    facts = [
        (f"{size} cm", "length, width, height at rest"), (f"{mass:.2f} kg", "with motors and battery"),
        (str(motors), f"motors, {blueprint.catalogue.motor.name}"), (str(bodies), "printed bodies"),
    ]  # fmt: skip
    tiles = "".join(f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for value, name in facts)
    key = escape(blueprint.design.key)
    hard = [str(number) for number, panel in enumerate(panels(steps), start=1) if any(step.trouble for step in panel)]
    warning = f'<p class="warn">{escape(HARD.format(steps=", ".join(hard)))}</p>\n' if hard else ""
    notes = "".join(f'<p class="quiet">Note of the design: {escape(note)}</p>' for note in blueprint.notes)
    return (
        f'<section class="cover">\n<p class="lead">Assembly guide</p>\n<h1>Robot {key}</h1>\n'
        f'<p class="lead">A walking robot of {bodies} printed bodies and {motors} motors; this guide takes you from '
        f"the printer to its first steps. {key} is its key: the same key, the same robot.</p>\n"
        f'<img alt="the assembled robot" width="{COVER[0]}" height="{COVER[1]}" src="{png_uri(image)}">\n'
        f'<div class="facts">{tiles}</div>\n{warning}{notes}'
        f'<div class="safety"><h3>Read this first</h3>'
        f"{listed(line.format(peak=blueprint.catalogue.motor.peak_torque) for line in SAFETY)}</div>\n</section>"
    )


def _needs(blueprint: Blueprint) -> str:
    motor, count = blueprint.catalogue.motor, len(blueprint.seats)
    rows = []
    for pattern, where in (
        (motor.body_screws, "motor to its cup"),
        (motor.output_screws, "disc to the motor's output"),
    ):
        rows.append([pattern.screw, str(pattern.count * count), where, f"{tightening_torque(pattern):.2f} N.m",
                     f"{holding_torque(pattern):.0f} N.m"])  # fmt: skip
    if blueprint.lids:
        number = sum(len(lid.screws) for lid in blueprint.lids)
        rows.append([SCREW, str(number), "lid to its bone, cuts its own thread", f"{LID_TORQUE:.2f} N.m", "-"])
    return (
        "<section>\n<h2>What you need</h2>\n<h3>To buy and to print</h3>\n"
        + table(*shopping_rows(blueprint))
        + "<h3>Tools and supplies</h3>\n"
        + listed(tools(blueprint))
        + "<h3>Screws</h3>\n"
        + table(["screw", "number", "where", "tighten to", "holds by friction"], rows)
        + f'<p class="quiet">{escape(TORQUES.format(peak=motor.peak_torque))}</p>\n'
        f'<p class="quiet">{escape(ENCODERS)}</p>\n</section>'
    )


def _print(stock: Stock, lays: Sequence[Lay], settings: str) -> str:
    blueprint = stock.blueprint
    cards = []
    for piece, lay in zip(pieces(blueprint), lays, strict=True):
        size = " × ".join(f"{1e3 * s:.0f}" for s in lay.size)
        made = "; ".join(
            f"{p.name}: {(blueprint.catalogue.rigid if p.material == 'rigid' else blueprint.catalogue.soft).name}"
            for p in piece.parts
        )
        caption = f"<b>{escape(piece.name)}</b>, plate {lay.plate + 1}<br>{size} mm as it lies<br>{escape(made)}"
        cards.append(f"<figure>{plate_picture(stock, piece, lay)}<figcaption>{caption}</figcaption></figure>")
    return (
        f"<section>\n<h2>Print the parts</h2>\n<p>{escape(PLATES)}</p>\n"
        f'<div class="parts">{"".join(cards)}</div>\n<h3 class="after">Print settings</h3>\n'
        f"<pre>{escape(settings)}</pre>\n<p>{escape(CLEANING)}</p>\n</section>"
    )


def _assembly(stock: Stock, steps: Sequence[Step]) -> str:
    blueprint = stock.blueprint
    groups = [{b} for b in range(len(blueprint.bodies))]
    filled: list[int] = []
    inside: list[int] = []
    out = [
        f"<section>\n<h2>Put it together</h2>\n<p>{escape(LEGEND)}</p>",
        f'<div class="cover">{overview(stock)}</div>',
    ]
    for number, panel in enumerate(panels(steps), start=1):
        last = panel[-1]
        if any(step.kind == "motor" for step in panel):
            holder = last.body
            picture = motor_picture(stock, panel, [k for k in filled if blueprint.seats[k].holder == holder])
            filled.append(last.index)
            joint = blueprint.hinges[blueprint.seats[last.index].hinge].name
            title = f"Motor of {joint} into {blueprint.bodies[holder].name}"
        elif any(step.kind == "join" for step in panel):
            join = next(step for step in panel if step.kind == "join")
            group = next(g for g in groups if join.body in g)
            moved = next(g for g in groups if join.moved[0] in g)
            picture = join_picture(stock, panel, sorted(group))
            groups = [g for g in groups if g is not group and g is not moved] + [group | moved]
            names = ", ".join(blueprint.bodies[b].name for b in join.moved)
            joint = blueprint.hinges[blueprint.seats[join.index].hinge].name
            title = f"{names} onto {blueprint.bodies[join.body].name} ({joint})"
        elif last.kind == "lid":
            group = next(g for g in groups if last.body in g)
            picture = lid_picture(stock, last, sorted(group), inside)
            kind = blueprint.boxes[blueprint.lids[last.index].box].kind
            title = f"Lid over the {kind} in {blueprint.bodies[last.body].name}"
        else:
            group = next(g for g in groups if last.body in g)
            picture = box_picture(stock, last, sorted(group), inside)
            inside.append(last.index)
            title = f"{blueprint.boxes[last.index].kind} into {blueprint.bodies[last.body].name}"
        lines = listed((line for step in panel for line in step_text(blueprint, step)), "ol")
        warnings = "".join(f'<p class="warn">{escape(text)}</p>' for step in panel if (text := advice(step)))
        out.append(f'<div class="step">\n<h3><b>{number}</b>{escape(title)}</h3>\n{picture}\n{lines}{warnings}</div>')
    return "\n".join([*out, "</section>"])


def _wiring(blueprint: Blueprint) -> str:
    diagram, rows = wiring_diagram(blueprint), table(*wiring_rows(blueprint))
    return f"<section>\n<h2>Wiring</h2>\n{diagram}\n{rows}\n<p>{escape(BUS)}</p>\n</section>"


def _first_run(stock: Stock) -> str:
    blueprint = stock.blueprint
    pictures = []
    for k, hinge in enumerate(blueprint.hinges):
        caption = f"<b>{escape(hinge.name)}</b>: positive angles turn the orange side this way"
        pictures.append(f"<figure>{joint_picture(stock, k)}<figcaption>{caption}</figcaption></figure>")
    ids = table(["joint", "bus", "id", "give it its id (factory id 1)", "store", "read back"], setup_rows(blueprint))
    zeros = table(["joint", "id", "sign", "range", "turns", "axis (x, y, z)"], calibration_rows(blueprint))
    return (
        f"<section>\n<h2>Set it up: motor ids</h2>\n<p>{escape(IDS)}</p>\n<pre>{escape(BRING_UP)}</pre>\n{ids}\n"
        f'<p>{escape(NEW_ID)}</p>\n</section>\n<section>\n<h2 class="flow">Zero, signs and ranges</h2>\n'
        f"<p>{escape(ZERO)}</p>\n"
        f'<div class="parts">{"".join(pictures)}</div>\n{zeros}\n<p>{escape(SIGNS)}</p>\n{checklist(HOMING)}\n'
        f'</section>\n<section>\n<h2 class="flow">First run</h2>\n{checklist(FIRST_RUN)}\n<p>{escape(REFUSALS)}</p>\n'
        "</section>"
    )
