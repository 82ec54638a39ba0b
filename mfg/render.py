"""Pictures without a display, by a software ray caster."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfg.camera import Camera, shown_points
from mfg.lighting import GAMMA, Stage
from mfg.ray_soup import NOTHING, Soup
from mfg.shape import Colour, Shape

WHITE: Colour = (1.0, 1.0, 1.0)
RAYS = 7  # ambient rays of one pixel; it shares them with its neighbours


def render(
    shapes: Sequence[Shape],
    size: tuple[int, int] = (640, 480),
    azimuth: float = -0.95,
    elevation: float = 0.40,
    *,
    floor: bool | float = False,
    bounds: NDArray[np.float64] | None = None,
    background: Colour = WHITE,
    shadows: bool = True,
    draft: bool = False,
    perspective: bool = True,
) -> NDArray[np.uint8]:
    """Draw shapes as seen from a direction; the same input gives the same bytes.

    Args:
        shapes: what to draw, in any order and in one frame with z up [m].
        size: width and height [pixels].
        azimuth: of the camera about z, from +x towards +y [rad].
        elevation: of the camera above the horizon [rad].
        floor: True draws a tiled floor at the lowest point, a number at that height [m].
        bounds: what the picture just shows [m]: a box (2, 3), or three or more points (n, 3); the shapes themselves if
            None. Give it to hold a camera still.
        background: colour of what is empty.
        shadows: cast soft shadows and darken hollows.
        draft: one sample per pixel and no ambient rays, for the frames of a video.
        perspective: False for parallel projection.

    Returns:
        The picture, (height, width, 3) u8.

    Raises:
        ValueError: if the size is not positive.
    """
    width, height = size
    if width < 1 or height < 1:
        raise ValueError(f"picture size is {width} x {height}; both must be at least 1 pixel")
    shapes = [shape for shape in shapes if len(shape.triangles) and shape.alpha > 0]
    points = np.concatenate([s.vertices for s in shapes]) if shapes else np.zeros((1, 3))
    shown = points if bounds is None else shown_points(bounds)
    level = None if floor is False else float(points[:, 2].min()) if floor is True else float(floor)
    samples = 1 if draft else 2
    camera = Camera.fitted(shown, azimuth, elevation, (width, height), perspective)
    origin, ray = camera.rays((width * samples, height * samples))
    stage = Stage(shapes, camera, level, shown, background)
    fine = (height * samples, width * samples)
    what, colour = stage.opaque(origin, ray, fine, samples, shadows, 0 if draft else RAYS)
    stage.cover(origin, ray, what, colour)
    grid = colour.reshape(height, samples, width, samples, 3).mean(axis=(1, 3))
    return np.rint(255.0 * np.clip(grid, 0.0, 1.0) ** (1.0 / GAMMA)).astype(np.uint8)


def visible_shares(
    shapes: Sequence[Shape], wanted: Sequence[int], views: Sequence[tuple[float, float]],
    size: tuple[int, int] = (96, 72),
) -> list[float]:  # fmt: skip
    """Share of some opaque shapes that no other hides, seen from each view: of the pixels that they would fill alone.

    Args:
        shapes: all of them, as for `render`.
        wanted: indices of those that are to be seen.
        views: azimuth and elevation of each camera, in parallel projection [rad].
        size: of the pictures that are counted [pixels].
    """
    points = np.concatenate([shapes[k].vertices for k in wanted])
    everything, alone = Soup(shapes, range(len(shapes))), Soup([shapes[k] for k in wanted], list(wanted))
    shares = []
    for azimuth, elevation in views:
        origin, ray = Camera.fitted(points, azimuth, elevation, size, perspective=False).rays(size)
        filled = alone.owners(origin, ray) != NOTHING
        seen = np.isin(everything.owners(origin[filled], ray[filled]), wanted)
        shares.append(float(seen.mean()) if len(seen) else 0.0)
    return shares


def save_png(path: Path | str, image: NDArray[np.uint8]) -> None:
    """Write a picture (height, width, 3) as PNG."""
    from PIL import Image

    Image.fromarray(image).save(path, format="PNG", optimize=True)
