"""What each picture of the assembly guide shows: parts in their places, the moved one drawn back along its way in."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfg.assembly import Step
from mfg.guide_pictures import Mark, Scenery, View, best_view, figure
from mfg.guide_stock import NEW, NEW_BONE, Stock, coloured, pushed
from mfg.lids import SCREW
from mfg.masses import wire_stretches
from mfg.picture import axis_rod
from mfg.plate import Lay
from mfg.shape import Shape
from mfg.solids import box
from mfg.splitting import Piece
from mfg.ways import turned

Array = NDArray[np.float64]

NEAR = 0.11  # of a body that stays, so much around the motor must be in the picture [m]
DRAWN_BACK = 0.11  # a body or box is drawn back by so much at most [m]
SCREW_BACK = 0.035  # screws are drawn out of their holes by so much [m]
LID_BACK = 0.025  # and a lid off what it closes [m]
SMALL = (330, 260)  # of the pictures of parts and joints [pixels]
PLATE_COLOUR = (0.93, 0.94, 0.95)


def overview(stock: Stock) -> str:
    """The whole robot taken apart, every body, motor and box named."""
    blueprint = stock.blueprint
    middle = stock.centre(0)
    shifts = [0.55 * (stock.centre(b) - middle) for b in range(len(blueprint.bodies))]
    scene = Scenery()
    for b, body in enumerate(blueprint.bodies):
        scene.shapes.extend(pushed(shape, shifts[b]) for shape in stock.body(b))
        scene.marks.append(Mark(body.name, stock.centre(b) + shifts[b], strong=True))
    for k, seat in enumerate(blueprint.seats):
        z = seat.T_design_motor[:3, 2]
        shift = shifts[seat.holder] + 0.09 * z
        scene.shapes.append(pushed(stock.motors[k], shift))
        at = seat.T_design_motor[:3, 3]
        scene.marks.append(Mark(f"motor of {blueprint.hinges[seat.hinge].name}", at + shift))
        scene.arrows.append(np.stack([at + shift, at + shifts[seat.holder]]))
    for k, seat_b in enumerate(blueprint.boxes):
        z, at = seat_b.T_design_box[:3, 2], seat_b.T_design_box[:3, 3]
        back = min(seat_b.shaft + seat_b.size[2], 0.25)
        shift = shifts[seat_b.body] + back * z
        scene.shapes.append(pushed(stock.boxes[k], shift))
        scene.marks.append(Mark(seat_b.kind, at + shift))
        scene.arrows.append(np.stack([at + shift, at + shift - 0.7 * back * z]))
        for lid in stock.lids([k]):
            scene.shapes.append(pushed(lid, shift + (seat_b.size[2] / 2 + LID_BACK) * z))
            scene.marks.append(Mark(f"{seat_b.kind} lid", _middle(scene.shapes[-1])))
    return figure(scene, View(), "all parts of the robot, drawn apart", (700, 560))


def plate_picture(stock: Stock, piece: Piece, lay: Lay) -> str:
    """A printed object as it lies on its plate."""
    shapes = [pushed(stock.parts[part.name], np.zeros(3), lay.T_plate_design) for part in piece.parts]
    points = np.concatenate([shape.vertices for shape in shapes])
    low, high = points.min(0) - 0.012, points.max(0) + 0.012
    slab = _slab(low, high, float(points[:, 2].min()))
    return figure(Scenery([slab, *shapes]), View(-0.95, 0.45), f"{piece.name} on its plate", SMALL)


def motor_picture(stock: Stock, steps: Sequence[Step], filled: Sequence[int]) -> str:
    """A motor above its cup and its screws below; motors put into the same body before are in place."""
    motor = next(step for step in steps if step.kind == "motor")
    blueprint, k = stock.blueprint, motor.index
    seat = blueprint.seats[k]
    at, z = seat.T_design_motor[:3, 3], seat.T_design_motor[:3, 2]
    scene = Scenery(stock.body(seat.holder))
    scene.shapes.extend(stock.motors[j] for j in filled)
    back = -motor.legs[-1].direction * (motor.legs[-1].travel + 0.03)
    path = [at + back, at]
    if len(motor.legs) > 1:
        back = -motor.legs[-1].direction * motor.legs[-1].travel
        side = back - motor.legs[0].direction * min(motor.legs[0].travel, 0.14)
        path, back = [at + side, at + back, at], side
    moved = len(scene.shapes)
    scene.shapes.append(coloured(pushed(stock.motors[k], back), NEW))
    scene.arrows.append(np.array(path))
    scene.shapes.append(pushed(stock.screws(k, output=False), -SCREW_BACK * z))
    base = stock.mount.base_low
    scene.arrows.append(np.stack([at + (base - SCREW_BACK - 0.02) * z, at + (base - 0.003) * z]))
    for wire, stretches in zip(blueprint.wires, stock.cables, strict=True):
        if wire.seat == k:
            scene.shapes.extend(shape for body, shape in stretches if body == seat.holder)
            here = [path for body, path in _stretches(stock, wire.seat) if body == seat.holder]
            if here:
                scene.marks.append(Mark(wire.name, here[-1][len(here[-1]) // 2]))
    pattern = blueprint.catalogue.motor.body_screws
    scene.marks.extend([
        Mark(blueprint.bodies[seat.holder].name, stock.centre(seat.holder)),
        Mark(f"motor of {blueprint.hinges[seat.hinge].name}", at + back, strong=True),
        Mark(f"{pattern.count} × {pattern.screw}", at + (base - SCREW_BACK) * z),
    ])  # fmt: skip
    view = best_view(scene, [moved], facing=z)
    return figure(
        scene, view, f"motor of {blueprint.hinges[seat.hinge].name} into {blueprint.bodies[seat.holder].name}"
    )


def join_picture(stock: Stock, steps: Sequence[Step], stay: Sequence[int]) -> str:
    """A body drawn back from the motor's output, the screws of the output beside it."""
    join = next(step for step in steps if step.kind == "join")
    blueprint, k = stock.blueprint, join.index
    seat = blueprint.seats[k]
    hinge = blueprint.hinges[seat.hinge]
    leg = join.legs[-1]
    shift = -leg.direction * min(leg.travel, DRAWN_BACK)
    T = turned(hinge.position, hinge.axis, join.angle)
    scene = Scenery()
    for b in stay:
        scene.shapes.extend(stock.body(b))
    first = len(scene.shapes)
    for b in join.moved:
        scene.shapes.extend(pushed(shape, shift, T) for shape in stock.body(b, new=True))
    wanted = list(range(first, len(scene.shapes)))
    for j, other in enumerate(blueprint.seats):
        if other.holder in join.moved:
            scene.shapes.append(pushed(stock.motors[j], shift, T))
        elif other.holder in stay:
            scene.shapes.append(stock.motors[j])
    at, z = seat.T_design_motor[:3, 3], seat.T_design_motor[:3, 2]
    moves = seat.connector in join.moved
    disc = at + (stock.mount.connector_high) * z
    held = shift if moves else np.zeros(3)
    scene.shapes.append(pushed(stock.screws(k, output=True), held + SCREW_BACK * z))
    face = at + (stock.mount.connector_low + 0.004) * z
    scene.arrows.append(np.stack([face + shift, face]))
    scene.arrows.append(np.stack([disc + held + (SCREW_BACK + 0.02) * z, disc + held]))
    pattern = blueprint.catalogue.motor.output_screws
    scene.marks.append(Mark(f"{pattern.count} × {pattern.screw}", disc + held + SCREW_BACK * z))
    for b in join.moved:
        scene.marks.append(Mark(blueprint.bodies[b].name, (T @ [*stock.centre(b), 1.0])[:3] + shift, strong=True))
    keeps = seat.holder if seat.holder in stay else seat.connector
    there = np.concatenate([shape.vertices for _, shape in stock.printed[keeps]])
    around = there[np.linalg.norm(there - at, axis=1) < NEAR]
    comes = seat.connector if seat.holder in stay else seat.holder
    scene.focus.extend([around, *(pushed(shape, shift, T).vertices for shape in stock.body(comes))])
    scene.marks.append(Mark(blueprint.bodies[keeps].name, around[np.argmax(around @ (around.mean(0) - at))]))
    scene.marks.append(Mark(f"motor of {hinge.name}", at + (np.zeros(3) if moves else shift)))
    view = best_view(scene, wanted, facing=z, across=leg.direction)
    return figure(scene, view, f"{blueprint.bodies[hinge.body].name} onto {blueprint.bodies[hinge.parent].name}")


def box_picture(stock: Stock, step: Step, bodies: Sequence[int], inside: Sequence[int]) -> str:
    """A box before its shaft; boxes put in before are in place, under their lids."""
    blueprint = stock.blueprint
    seat = blueprint.boxes[step.index]
    at, z = seat.T_design_box[:3, 3], seat.T_design_box[:3, 2]
    shift = z * (max(seat.shaft, seat.size[2] / 2) + seat.size[2] / 2 + 0.03)
    scene = Scenery()
    for b in bodies:
        scene.shapes.extend(stock.body(b))
    scene.shapes.extend(m for m, s in zip(stock.motors, blueprint.seats, strict=True) if s.holder in bodies)
    scene.shapes.extend([*(stock.boxes[k] for k in inside), *stock.lids(inside)])
    moved = len(scene.shapes)
    scene.shapes.append(coloured(pushed(stock.boxes[step.index], shift), NEW))
    if seat.kind == "controller":
        for wire, stretches in zip(blueprint.wires, stock.cables, strict=True):
            scene.shapes.extend(shape for _, shape in stretches)
            scene.marks.append(Mark(wire.name, wire.path[len(wire.path) // 2]))
    scene.arrows.append(np.stack([at + shift, at + max(seat.shaft - 0.02, 0.0) * z]))
    scene.marks.extend([Mark(seat.kind, at + shift, strong=True),
                        Mark(blueprint.bodies[seat.body].name, stock.centre(seat.body))])  # fmt: skip
    view = best_view(scene, [moved], facing=z)
    return figure(scene, view, f"{seat.kind} into {blueprint.bodies[seat.body].name}")


def lid_picture(stock: Stock, step: Step, bodies: Sequence[int], inside: Sequence[int]) -> str:
    """A lid above its opening with the box in it, and its screws above their holes."""
    blueprint, lid = stock.blueprint, stock.blueprint.lids[step.index]
    seat, other = blueprint.boxes[lid.box], [k for k in inside if k != lid.box]
    z = seat.T_design_box[:3, 2]
    scene = Scenery([shape for b in bodies for shape in stock.body(b)])
    scene.shapes.extend(m for m, s in zip(stock.motors, blueprint.seats, strict=True) if s.holder in bodies)
    scene.shapes.extend([*(stock.boxes[k] for k in inside), *stock.lids(other)])
    shift = (step.legs[0].travel + LID_BACK) * z
    moved = len(scene.shapes)
    scene.shapes.append(coloured(pushed(stock.parts[lid.part], shift), NEW))
    scene.shapes.append(pushed(stock.lid_screws(step.index), shift + SCREW_BACK * z))
    scene.arrows.extend(np.stack([place + shift + SCREW_BACK * z, place + shift]) for place in lid.screws)
    scene.arrows.append(np.stack([lid.screws.mean(0) + shift, lid.screws.mean(0)]))
    around = np.concatenate([shape.vertices for _, shape in stock.printed[seat.body]])
    there = around[np.linalg.norm(around - lid.screws.mean(0), axis=1) < NEAR]
    scene.focus.extend([there, *(shape.vertices for shape in scene.shapes[moved:])])
    scene.marks.extend([
        Mark(f"{seat.kind} lid", _middle(scene.shapes[moved]), strong=True),
        Mark("notch for the leads", lid.notch + shift),
        Mark(f"{len(lid.screws)} × {SCREW}", lid.screws[0] + shift + SCREW_BACK * z),
        Mark(seat.kind, seat.T_design_box[:3, 3] + seat.size[2] / 2 * z),
    ])  # fmt: skip
    return figure(scene, best_view(scene, [moved], facing=z), f"lid over the {seat.kind}")


def joint_picture(stock: Stock, hinge_index: int) -> str:
    """A joint's positive turn: the child as painted, and turned by a third of a right angle or to its limit."""
    blueprint = stock.blueprint
    hinge = blueprint.hinges[hinge_index]
    side = {hinge.body}
    for other in blueprint.hinges:
        if other.parent in side:
            side.add(other.body)
    angle = float(min(max(hinge.range[1], 0.0), math.radians(40)))
    T = turned(hinge.position, hinge.axis, angle)
    scene = Scenery()
    wanted: list[int] = []
    for b in range(len(blueprint.bodies)):
        moved = b in side
        if moved:
            wanted.extend(range(len(scene.shapes), len(scene.shapes) + len(stock.printed[b])))
        scene.shapes.extend(pushed(s, np.zeros(3), T) if moved else s for s in stock.body(b, new=moved))
        lids = stock.lids([k for k, seat in enumerate(blueprint.boxes) if seat.body == b])
        scene.shapes.extend(coloured(pushed(s, np.zeros(3), T), NEW_BONE) if moved else s for s in lids)
    scene.shapes.append(axis_rod(hinge.position, hinge.axis, (-0.13, 0.13)))
    middle = np.mean([stock.centre(b) for b in side], axis=0)
    steps = np.linspace(0.0, angle, 7) if angle > 0.05 else np.linspace(-0.3, 0.0, 7)
    reach = _reach(stock, hinge.body, hinge.position, hinge.axis, middle)
    arc = np.array([(turned(hinge.position, hinge.axis, float(a)) @ [*reach, 1.0])[:3] for a in steps])
    scene.arrows.append(arc)
    view = best_view(scene, wanted, facing=hinge.axis)
    return figure(scene, view, f"{hinge.name} turned by {math.degrees(angle):+.0f} degrees", SMALL)


def _reach(stock: Stock, body: int, position: Array, axis: Array, middle: Array) -> Array:
    """A point near the far end of a body, on the ray from its axis through its middle."""
    out = middle - position
    out = out - (out @ axis) * axis
    length = float(np.linalg.norm(out))
    if length < 1e-3:
        helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
        out, length = np.cross(axis, helper), float(np.linalg.norm(np.cross(axis, helper)))
    out = out / length
    points = np.concatenate([shape.vertices for _, shape in stock.printed[body]]) - position
    return position + out * 0.9 * max(float((points @ out).max()), 0.05)


def _stretches(stock: Stock, seat: int) -> list[tuple[int, Array]]:
    wire = next(w for w in stock.blueprint.wires if w.seat == seat)
    return wire_stretches(wire, stock.blueprint)


def _middle(shape: Shape) -> Array:
    """Middle of a shape's bounding box."""
    return np.asarray((shape.vertices.min(0) + shape.vertices.max(0)) / 2)


def _slab(low: Array, high: Array, top: float) -> Shape:
    """A thin plate under a printed body."""
    solid = box([low[0], low[1], top - 0.002], [high[0], high[1], top - 1e-5])
    return Shape(solid.vertices, solid.triangles, PLATE_COLOUR)
