"""Every part of a robot as a shape in its place, for the pictures of the assembly guide."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Transform
from mfg.catalogue import ScrewPattern
from mfg.exact import STRAIGHT, box_solid, motor_solid, straightened
from mfg.lids import SCREW
from mfg.masses import wire_stretches
from mfg.mounts import Mount, mount_of
from mfg.picture import BATTERY, BONES, CONTROLLER, MOTOR, WIRE
from mfg.shape import Colour, Shape
from mfg.solids import Solid, ball_chain, cylinder, union

Array = NDArray[np.float64]

SHOWN_ERROR = 4.0e-4  # of the surfaces in pictures [m]
NEW_BONE: Colour = (1.00, 0.74, 0.36)  # of a body that moves in a step
NEW_SKIN: Colour = (0.96, 0.56, 0.30)
NEW: Colour = (0.95, 0.50, 0.10)  # of a motor or box that goes in
PALE_SKIN: Colour = (0.62, 0.74, 0.86)
SCREW_COLOUR: Colour = (0.20, 0.21, 0.24)
GHOST = 0.5  # how much of a hidden cable or screw shows through


@dataclass(frozen=True, eq=False)
class Stock:
    """Every part of a robot as a shape in its place, made once."""

    blueprint: Blueprint

    @cached_property
    def mount(self) -> Mount:
        """Of all motors."""
        return mount_of(self.blueprint.catalogue.motor)

    @cached_property
    def parts(self) -> dict[str, Shape]:
        """What is printed, by name."""
        return {
            part.name: _shape(
                part.solid.simplified(SHOWN_ERROR),
                BONES[part.body % len(BONES)] if part.material == "rigid" else PALE_SKIN,
            )
            for part in self.blueprint.parts
        }

    @cached_property
    def printed(self) -> list[list[tuple[str, Shape]]]:
        """(material, shape) of bones and skins, by body."""
        out: list[list[tuple[str, Shape]]] = [[] for _ in self.blueprint.bodies]
        lids = {lid.part for lid in self.blueprint.lids}
        for part in self.blueprint.parts:
            if part.name not in lids:
                out[part.body].append((part.material, self.parts[part.name]))
        return out

    def lids(self, boxes: Collection[int]) -> list[Shape]:
        """The lids over some boxes, screwed down."""
        return [self.parts[lid.part] for lid in self.blueprint.lids if lid.box in boxes]

    @cached_property
    def motors(self) -> list[Shape]:
        """By seat; the output face is marked by a lighter disc."""
        return [_shape(motor_solid(self.blueprint, seat), MOTOR) for seat in self.blueprint.seats]

    @cached_property
    def boxes(self) -> list[Shape]:
        """By index."""
        return [_shape(box_solid(b), BATTERY if b.kind == "battery" else CONTROLLER) for b in self.blueprint.boxes]

    @cached_property
    def cables(self) -> list[list[tuple[int, Shape]]]:
        """(body, shape) of every stretch, by wire; they show through what hides them."""
        radius = self.blueprint.catalogue.wire.diameter / 2
        return [
            [(body, replace(_shape(ball_chain(straightened(path, 10 * STRAIGHT), radius, 6), WIRE), ghost=GHOST))
             for body, path in wire_stretches(wire, self.blueprint)]
            for wire in self.blueprint.wires
        ]  # fmt: skip

    def screws(self, seat: int, *, output: bool) -> Shape:
        """A joint's screws, driven home."""
        mount, motor = self.mount, self.blueprint.catalogue.motor
        if output:
            solid = _screws(motor.output_screws, mount.connector_low + 6e-3, 1.0)
        else:
            solid = _screws(motor.body_screws, mount.base_low, -1.0)
        return replace(_shape(solid.moved(self.blueprint.seats[seat].T_design_motor), SCREW_COLOUR), ghost=GHOST)

    def lid_screws(self, lid: int) -> Shape:
        """A lid's screws, driven home."""
        seat = self.blueprint.lids[lid]
        T = self.blueprint.boxes[seat.box].T_design_box.copy()
        size, length = screw_size(SCREW)
        one = cylinder(0.875 * size, 0.0, size, 16) + cylinder(size / 2, -length, 0.0, 12)
        placed = []
        for place in seat.screws:
            T[:3, 3] = place
            placed.append(one.moved(T))
        return _shape(union(placed), SCREW_COLOUR)

    def body(self, index: int, *, new: bool = False) -> list[Shape]:
        """The printed parts of a body, highlighted if `new`."""
        shapes = []
        for material, shape in self.printed[index]:
            colour = (NEW_BONE if material == "rigid" else NEW_SKIN) if new else shape.colour
            shapes.append(coloured(shape, colour))
        return shapes

    def centre(self, index: int) -> Array:
        """Middle of a body's bounding box [m]."""
        points = np.concatenate([shape.vertices for _, shape in self.printed[index]])
        return (points.min(0) + points.max(0)) / 2


def pushed(shape: Shape, shift: Array, T: Transform | None = None) -> Shape:
    """The shape turned by T, then shifted."""
    whole = np.eye(4) if T is None else np.array(T)
    whole[:3, 3] += shift
    return shape.moved(whole)


def coloured(shape: Shape, colour: Colour) -> Shape:
    """The shape in another colour, without working out its normals again."""
    out = replace(shape, colour=colour)
    out.__dict__["normals"] = shape.normals
    return out


def _screws(pattern: ScrewPattern, seat: float, up: float) -> Solid:
    """Cap screws whose heads rest at height `seat` and point along `up` z."""
    size, length = screw_size(pattern.screw)
    head, shank = sorted((seat, seat + up * size)), sorted((seat, seat - up * length))
    one = cylinder(0.875 * size, head[0], head[1], 16) + cylinder(size / 2, shank[0], shank[1], 12)
    placed = []
    for k in range(pattern.count):
        angle = 2 * math.pi * k / pattern.count
        T = np.eye(4)
        T[:2, 3] = pattern.circle_radius * math.cos(angle), pattern.circle_radius * math.sin(angle)
        placed.append(one.moved(T))
    return union(placed)


def screw_size(name: str) -> tuple[float, float]:
    """(diameter, length) of a screw by its name, such as M4x10 [m]; M4x10 where the name says nothing."""
    try:
        size, length = name.lower().removeprefix("m").split("x")
        return 1e-3 * float(size), 1e-3 * float(length)
    except ValueError:
        return 4e-3, 10e-3


def _shape(solid: Solid, colour: Colour) -> Shape:
    return Shape(solid.vertices, solid.triangles, colour)
