"""Pictures of the assembly guide: the renderer's image with labels and arrows drawn over it, as one inline SVG."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Transform
from mfg.camera import project
from mfg.catalogue import ScrewPattern
from mfg.exact import STRAIGHT, box_solid, motor_solid, straightened
from mfg.lids import SCREW
from mfg.masses import wire_stretches
from mfg.mounts import Mount, mount_of
from mfg.picture import BATTERY, BONES, CONTROLLER, MOTOR, WIRE
from mfg.render import render, visible_shares
from mfg.shape import Colour, Shape
from mfg.solids import Solid, ball_chain, cylinder, union

Array = NDArray[np.float64]

SIZE = (640, 430)  # of the image of a step [pixels]
MARGIN = 150  # beside an image, for labels [pixels]
TEXT = 15  # height of a label [pixels]
SHOWN_ERROR = 4.0e-4  # of the surfaces in pictures [m]
AZIMUTH, ELEVATION = -0.95, 0.40  # of the usual camera, as in all pictures of robots
NEW_BONE: Colour = (1.00, 0.74, 0.36)  # of a body that moves in a step
NEW_SKIN: Colour = (0.96, 0.56, 0.30)
NEW: Colour = (0.95, 0.50, 0.10)  # of a motor or box that goes in
PALE_SKIN: Colour = (0.62, 0.74, 0.86)
SCREW_COLOUR: Colour = (0.20, 0.21, 0.24)
ARROW = "#c2255c"
INK = "#22272b"
COLOURS = 96  # in the palette of an image
CONTRAST = 120  # sum over red, green, blue from which a step between two pixels is smoothed [0 to 765]
GHOST = 0.5  # how much of a hidden cable or screw shows through


@dataclass(frozen=True, slots=True)
class View:
    """A direction to look from: azimuth of the camera about z and elevation above the horizon [rad]."""

    azimuth: float = AZIMUTH
    elevation: float = ELEVATION

    @property
    def back(self) -> Array:
        """Unit vector towards the viewer."""
        e, a = self.elevation, self.azimuth
        return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


VIEWS = tuple(
    View(AZIMUTH + k * math.pi / 6, elevation)
    for elevation in (ELEVATION, 0.85, -0.35)
    for k in (0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6)
)


@dataclass(frozen=True, eq=False, slots=True)
class Mark:
    """A label, and the point that it names [m], (3,)."""

    text: str
    at: Array
    strong: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Scenery:
    """What a picture shows.

    Attributes:
        shapes: in their places, design frame.
        marks: labels.
        arrows: polylines (k, 3) whose last point is the head [m].
        focus: point sets (n, 3) that must be in the picture [m]; everything if there are none.
    """

    shapes: list[Shape] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    arrows: list[Array] = field(default_factory=list)
    focus: list[Array] = field(default_factory=list)


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


def figure(scenery: Scenery, view: View, alt: str, size: tuple[int, int] = SIZE) -> str:
    """The picture as an SVG element: image, arrows, labels at both sides with lines to what they name."""
    points = np.concatenate((scenery.focus or [s.vertices for s in scenery.shapes]) + scenery.arrows)
    image = render(scenery.shapes, size, view.azimuth, view.elevation, bounds=points, shadows=False, draft=True,
                   perspective=False)  # fmt: skip

    def at(where: Array) -> Array:
        return project(np.atleast_2d(where), points, size, view.azimuth, view.elevation, perspective=False)

    width, height = size
    named: list[tuple[str, float, float, bool]] = []
    margin = MARGIN if scenery.marks else 0
    parts = [
        f'<svg class="picture" role="img" aria-label="{escape(alt)}" xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="{-margin} 0 {width + 2 * margin} {height}">',
        f"<title>{escape(alt)}</title>",
        f'<image href="{png_uri(image)}" x="0" y="0" width="{width}" height="{height}"/>',
    ]
    if scenery.focus:  # The picture is a cut-out: say so by a frame.
        parts.append(f'<rect x="0.5" y="0.5" width="{width - 1}" height="{height - 1}" fill="none" stroke="#c9cfd4"/>')
    parts += [_arrow(at(path)) for path in scenery.arrows]
    for mark in scenery.marks:
        x, y = np.clip(at(mark.at)[0], 6, [width - 6, height - 6]).tolist()
        named.append((mark.text, x, y, mark.strong))
    parts += _labels(named, size)
    return "\n".join([*parts, "</svg>"])


def best_view(
    scenery: Scenery, wanted: Sequence[int], facing: Array | None = None, across: Array | None = None
) -> View:
    """The view from which most of some shapes is seen; the usual one where others are hardly better.

    Args:
        scenery: what will be drawn.
        wanted: indices of the shapes that must be seen.
        facing: a direction that should point to the viewer, but not right at them.
        across: a direction that should run across the picture.
    """
    rated = []
    for k, view in enumerate(VIEWS):
        cost = 0.010 * k
        if facing is not None:
            cost += 1.5 * abs(float(view.back @ facing) - 0.55)
        if across is not None:
            cost += 1.2 * max(0.0, abs(float(view.back @ across)) - 0.45)
        rated.append((cost, k))
    tried = sorted(rated)[:6]
    shares = visible_shares(scenery.shapes, wanted, [(VIEWS[k].azimuth, VIEWS[k].elevation) for _, k in tried])
    return VIEWS[min((cost - share, k) for (cost, k), share in zip(tried, shares, strict=True))[1]]


def png_uri(image: NDArray[np.uint8]) -> str:
    """A picture (height, width, 3) as a data URI: PNG with a palette of its own."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(_softened(image)).quantize(
        COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
    ).save(data, "PNG")
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


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


def _softened(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Smooth the steps of outlines: pixels beside a strong contrast take the mean of their neighbourhood."""
    grey = image.astype(np.int16).sum(axis=2)
    edge = np.zeros(grey.shape, bool)
    across, down = np.abs(np.diff(grey, axis=1)) > CONTRAST, np.abs(np.diff(grey, axis=0)) > CONTRAST
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    edge[[0, -1]] = edge[:, [0, -1]] = False
    rows, columns = np.nonzero(edge)
    around = [image[rows + i, columns + j].astype(np.float32) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    soft = image.copy()
    soft[rows, columns] = np.rint(0.25 * around[4] + 0.75 * np.mean(around, axis=0)).astype(np.uint8)
    return soft


def _labels(marks: list[tuple[str, float, float, bool]], size: tuple[int, int]) -> list[str]:
    """Labels in a column at either side, in the order of what they name, so that no two lines cross much."""
    width, height = size
    parts = []
    for left in (True, False):
        column = sorted((m for m in marks if (m[1] < width / 2) == left), key=lambda m: m[2])
        rows = _spread([m[2] for m in column], TEXT * 1.7, TEXT, height - TEXT)
        for (text, x, y, strong), row in zip(column, rows, strict=True):
            end, anchor = (-8.0, "end") if left else (width + 8.0, "start")
            parts.append(
                f'<path d="M{x:.0f} {y:.0f}L{end:.0f} {row:.0f}" stroke="#fff" stroke-width="3.5" fill="none"/>'
            )
            parts.append(
                f'<path d="M{x:.0f} {y:.0f}L{end:.0f} {row:.0f}" stroke="{INK}" stroke-width="1.2" fill="none"/>'
            )
            parts.append(f'<circle cx="{x:.0f}" cy="{y:.0f}" r="3.2" fill="{INK}" stroke="#fff"/>')
            weight = ' font-weight="700"' if strong else ""
            shift = -4 if left else 4
            parts.append(f'<text x="{end + shift:.0f}" y="{row + TEXT * 0.35:.0f}" font-size="{TEXT}" fill="{INK}" '
                         f'text-anchor="{anchor}"{weight}>{escape(text)}</text>')  # fmt: skip
    return parts


def _spread(wanted: list[float], gap: float, low: float, high: float) -> list[float]:
    """Rows as near as may be to those wanted (ascending), `gap` apart, between low and high."""
    rows = list(wanted)
    floor = low
    for k, row in enumerate(rows):
        rows[k] = floor = max(row, floor)
        floor += gap
    ceiling = high
    for k in range(len(rows) - 1, -1, -1):
        rows[k] = ceiling = min(rows[k], ceiling)
        ceiling -= gap
    return rows


def _arrow(path: Array) -> str:
    """A broad arrow along a polyline of pixels, its head at the last point."""
    tip, before = path[-1], path[-2]
    d = (tip - before) / max(float(np.linalg.norm(tip - before)), 1e-9)
    n = np.array([-d[1], d[0]])
    neck = tip - 17 * d
    line = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in (*path[:-1], neck))
    head = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in (tip, neck + 9 * n, neck - 9 * n)) + "Z"
    return (
        f'<path d="{line}" stroke="#fff" stroke-width="8" fill="none" stroke-linejoin="round"/>'
        f'<path d="{head}" fill="{ARROW}" stroke="#fff" stroke-width="2"/>'
        f'<path d="{line}" stroke="{ARROW}" stroke-width="4.5" fill="none" stroke-linejoin="round"/>'
    )


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
