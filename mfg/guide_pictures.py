"""Pictures of the assembly guide: the renderer's image with labels and arrows drawn over it, as one inline SVG."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

from mfg.camera import project
from mfg.render import render, visible_shares
from mfg.shape import Shape

Array = NDArray[np.float64]

SIZE = (640, 430)  # of the image of a step [pixels]
MARGIN = 150  # beside an image, for labels [pixels]
TEXT = 15  # height of a label [pixels]
AZIMUTH, ELEVATION = -0.95, 0.40  # of the usual camera, as in all pictures of robots
ARROW = "#c2255c"
INK = "#22272b"
COLOURS = 96  # in the palette of an image
CONTRAST = 120  # sum over red, green, blue from which a step between two pixels is smoothed [0 to 765]


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
