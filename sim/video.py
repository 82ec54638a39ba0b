"""Pictures of a moving robot without a display: a strip of moments, or a video."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from mfg.lighting import TILE
from mfg.render import render, save_png
from mfg.shape import Shape
from sim.model import Model
from sim.rollout import CONTROL_PERIOD, Rollouts
from sim.surfaces import body_length, poses, surfaces
from sim.terrain import ground_at, is_level

Image = NDArray[np.uint8]

SIZE = (320, 240)  # of a frame [pixels]; the encoder wants multiples of 16
RATE = 15  # frames per second of a video
FLOOR = 0.0  # height of the ground [m]
FOLLOW = 0.5  # the camera follows the centre of mass averaged over this long [s]
# Links without a colour of their own take these in turn: the root is grey, neighbours differ.
PALETTE = ((0.62, 0.65, 0.69), (0.24, 0.49, 0.69), (0.90, 0.62, 0.24), (0.42, 0.66, 0.42), (0.72, 0.42, 0.52),
           (0.36, 0.64, 0.66), (0.83, 0.74, 0.42), (0.52, 0.47, 0.72))  # fmt: skip
TRAIL = (0.85, 0.25, 0.20)  # where the camera has followed the centre of mass
TRAIL_WIDTH = 0.008  # [m]
GROUND = ((0.95, 0.95, 0.94), (0.84, 0.84, 0.83))  # tiles of ground that is not level
GROUND_LINES = (0.005, 0.25, 0.5, 0.75, 0.995)  # where in a tile its height is asked; a step may lie between two tiles
LEDGE = 0.02  # height of a ledge that is outlined [m]
GROUND_REACH = 2.4  # and so far about the robot, in half body lengths
MUJOCO_GREY = (0.5, 0.5, 0.5, 1.0)  # a geom without a colour


def film(
    model: Model, rollouts: Rollouts, index: int = 0, size: tuple[int, int] = SIZE, rate: int = RATE
) -> Iterator[Image]:
    """Draw one rollout frame by frame, (height, width, 3) each, the camera going along with the robot."""
    count = rollouts.qpos.shape[1]
    every = np.arange(0, count, 1.0 / (rate * CONTROL_PERIOD)).round().astype(int)
    yield from _draw(model, rollouts, index, every[every < count], size, draft=True)


def strip(model: Model, rollouts: Rollouts, index: int = 0, count: int = 6, size: tuple[int, int] = SIZE) -> Image:
    """Set `count` moments of one rollout side by side, from the start to the end."""
    moments = np.linspace(0, rollouts.qpos.shape[1] - 1, count).round().astype(int)
    return np.concatenate(list(_draw(model, rollouts, index, moments, size, draft=False)), axis=1)


def save_strip(path: Path | str, model: Model, rollouts: Rollouts, index: int = 0, count: int = 6) -> None:
    """Write the strip of one rollout as PNG.

    Raises:
        OSError: if it cannot be written.
    """
    save_png(path, strip(model, rollouts, index, count))


def save_video(
    path: Path | str, model: Model, rollouts: Rollouts, index: int = 0, size: tuple[int, int] = SIZE, rate: int = RATE
) -> None:
    """Write one rollout as H.264 in MP4, in real time.

    Raises:
        ValueError: if the size is not a multiple of 16.
        OSError: if it cannot be written.
    """
    if size[0] % 16 or size[1] % 16:
        raise ValueError(f"video size is {size[0]} x {size[1]}; both must be multiples of 16")
    Path(path).open("wb").close()  # the encoder's own complaint would not name the file
    writer = imageio_ffmpeg.write_frames(
        str(path), size, fps=rate, codec="libx264", pix_fmt_out="yuv420p", quality=7, ffmpeg_log_level="error"
    )
    writer.send(None)
    try:
        for frame in film(model, rollouts, index, size, rate):
            writer.send(np.ascontiguousarray(frame))
    finally:
        writer.close()


def _draw(
    model: Model, rollouts: Rollouts, index: int, moments: NDArray[np.intp], size: tuple[int, int], *, draft: bool
) -> Iterator[Image]:
    shapes = _shapes(model)
    reach = 0.5 * body_length(model)
    level = is_level(model)
    com = rollouts.com[index]
    centre = _smoothed(com[:, :2], round(FOLLOW / CONTROL_PERIOD))
    height = float((com[:, 2] - ground_at(model, com[:, 0], com[:, 1])).max())
    trail = np.column_stack([centre, ground_at(model, *centre.T)])
    for moment, pose in zip(moments, poses(model, rollouts.qpos[index, moments]), strict=True):
        x, y, z = trail[moment]
        bounds = np.array([[x - reach, y - reach, z], [x + reach, y + reach, z + height + 0.5 * reach]])
        moved = [shape.moved(pose[geom]) for geom, shape in shapes]
        moved += _trail(trail[: moment + 1])
        if not level:
            moved += _ground(model, (x, y), GROUND_REACH * reach)
        yield render(moved, size, floor=level and FLOOR, bounds=bounds, draft=draft)


def _shapes(model: Model) -> list[tuple[int, Shape]]:
    """(geom, shape) of what is to be seen: meshes made for the eye if there are any, else the hulls."""
    meshes = surfaces(model)
    seen = [mesh for mesh in meshes if not mesh.touches] or meshes
    shapes = []
    for mesh in seen:
        # Skins are drawn opaque: the robot as it stands there, and several times faster than looking through them.
        *colour, _ = PALETTE[(mesh.body - 1) % len(PALETTE)] + (1.0,) if _is_plain(mesh.colour) else mesh.colour
        r, g, b = colour
        shapes.append((mesh.geom, Shape(mesh.vertices, mesh.triangles, (r, g, b))))
    return shapes


def _ground(model: Model, centre: tuple[float, float], reach: float) -> list[Shape]:
    """A tiled piece of the ground about a place; the tiles lie still in the world."""
    first = np.floor((np.array(centre) - reach) / TILE).astype(int)
    tiles = np.arange(int(np.ceil(2 * reach / TILE)) + 1)
    column, row = (np.repeat(k + tiles, len(GROUND_LINES)) for k in first)
    x, y = np.meshgrid(*(TILE * (k + np.tile(GROUND_LINES, len(tiles))) for k in (column, row)))
    vertices = np.stack([x, y, ground_at(model, x, y)], axis=-1).reshape(-1, 3)
    corner = np.arange(len(vertices)).reshape(x.shape)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    quads = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=-2)
    odd = (row[:-1, None] + column[None, :-1]) % 2
    # Tiles of another height are shapes of their own, because shapes have outlines: ledges show from above, too.
    every = np.arange(len(row) - 1) // len(GROUND_LINES) * len(GROUND_LINES)
    level = np.round(vertices[corner[np.ix_(every, every)], 2] / LEDGE)
    return [
        Shape(vertices, quads[(odd == k) & (level == at)].reshape(-1, 3), colour)
        for at in np.unique(level) for k, colour in enumerate(GROUND)
    ]  # fmt: skip


def _trail(path: NDArray[np.float64]) -> list[Shape]:
    """A ribbon on the ground along a path (k, 3)."""
    path = path[:: max(1, round(0.1 / CONTROL_PERIOD))]
    if len(path) < 2:
        return []
    along = np.gradient(path, axis=0)
    across = np.stack([-along[:, 1], along[:, 0], np.zeros(len(path))], axis=1)
    across *= 0.5 * TRAIL_WIDTH / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    raised = path + np.array([0.0, 0.0, 0.001])
    flat = np.concatenate([raised + across, raised - across])
    n = len(path)
    left = np.arange(n - 1)
    triangles = np.concatenate([
        np.stack([left, left + n, left + 1], axis=1), np.stack([left + 1, left + n, left + n + 1], axis=1)
    ])  # fmt: skip
    return [Shape(flat, triangles, TRAIL)]


def _is_plain(colour: tuple[float, float, float, float]) -> bool:
    return bool(np.allclose(colour, MUJOCO_GREY))


def _smoothed(path: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Moving average of a path (k, 2) over up to `width` steps to each side."""
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(path, axis=0)])
    at = np.arange(len(path))
    low, high = np.maximum(at - width, 0), np.minimum(at + width + 1, len(path))
    return (total[high] - total[low]) / (high - low)[:, None]
