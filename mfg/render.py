"""A software ray caster for pictures without a display: the only importer of embreex."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mfg.camera import Camera, shown_points

Colour = tuple[float, float, float]
F32 = NDArray[np.float32]

WHITE: Colour = (1.0, 1.0, 1.0)
GAMMA = 2.2  # between colours as given (for a screen) and the light that is added up
CREASE = float(np.cos(np.radians(38.0)))  # faces that bend less than this are shaded as one smooth surface
KEY, FILL, AMBIENT, SHINE = 0.62, 0.14, 0.44, 0.08  # strength of the lights; a lit face comes out about as its colour
LAYERS = 6  # translucent surfaces drawn one behind the other
RAYS = 7  # ambient rays of one pixel; it shares them with its neighbours
INK, FAINT_INK = 0.40, 0.80  # share of its light that an outline keeps: of an opaque and of a translucent shape
TILE = 0.10  # edge of a floor tile [m]
NOTHING, FLOOR = -1, -2  # what a ray met where it met no shape


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh of one colour.

    Attributes:
        vertices: (n, 3) [m].
        triangles: (m, 3) vertex indices, counter-clockwise seen from outside.
        colour: red, green, blue in [0, 1], as on a screen.
        alpha: 1 is opaque, 0 invisible.
        ghost: how much of an opaque shape shows through opaque ones before it, 0 nothing.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    colour: Colour
    alpha: float = 1.0
    ghost: float = 0.0

    @cached_property
    def normals(self) -> F32:
        """Unit normal at each corner of each triangle, smooth except over creases, (m, 3, 3)."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        weighted = np.cross(b - a, c - a)
        facet = weighted / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-30)
        # Each corner adds up the faces around its vertex, by area, that do not lie beyond a crease.
        vertex = self.triangles.ravel()
        around = np.argsort(vertex, kind="stable")
        degree = np.bincount(vertex, minlength=len(self.vertices))
        first = np.cumsum(degree) - degree
        count = degree[vertex]
        corner = np.repeat(np.arange(len(vertex)), count)
        step = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count)
        face = around[first[vertex[corner]] + step] // 3
        smooth = np.einsum("ij,ij->i", facet[corner // 3], facet[face]) > CREASE
        corner, face = corner[smooth], face[smooth]
        total = np.stack([np.bincount(corner, weighted[face, k], len(vertex)) for k in range(3)], axis=1)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        normal = np.where(length > 0, total / np.maximum(length, 1e-30), np.repeat(facet, 3, axis=0))
        return normal.reshape(-1, 3, 3).astype(np.float32)

    def moved(self, transform: NDArray[np.float64]) -> Shape:
        """The shape under a (4, 4) rigid transform; its normals are turned with it, not computed again."""
        rotation = np.asarray(transform, np.float64)[:3, :3]
        shape = replace(self, vertices=self.vertices @ rotation.T + transform[:3, 3])
        shape.__dict__["normals"] = self.normals @ rotation.T.astype(np.float32)
        return shape


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
    stage = _Stage(shapes, camera, level, shown, background)
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
    everything, alone = _Soup(shapes, range(len(shapes))), _Soup([shapes[k] for k in wanted], list(wanted))
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


class _Soup:
    """All triangles of some shapes, ready to be hit."""

    def __init__(self, shapes: Sequence[Shape], ids: Sequence[int]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        counts = [len(s.triangles) for s in shapes]
        start = np.cumsum([0, *(len(s.vertices) for s in shapes)])
        self.owner = np.repeat(np.asarray(ids, np.int32), counts)
        self.shapes = shapes
        self.scene: Any = EmbreeScene()
        if shapes:
            vertices = np.concatenate([s.vertices for s in shapes]).astype(np.float32)
            triangles = np.concatenate([s.triangles + k for s, k in zip(shapes, start, strict=False)]).astype(np.int32)
            TriangleMesh(self.scene, vertices, triangles)

    @cached_property
    def normals(self) -> F32:
        """Of all triangles' corners, (m, 3, 3)."""
        return np.concatenate([s.normals for s in self.shapes])

    def owners(self, origin: F32, ray: F32) -> NDArray[np.int32]:
        """Which shape each ray meets first, by its id, or NOTHING."""
        if not self.shapes:
            return np.full(len(ray), NOTHING, np.int32)
        triangle = self.scene.run(np.ascontiguousarray(origin), np.ascontiguousarray(ray))
        return np.where(triangle >= 0, self.owner[triangle], np.int32(NOTHING)).astype(np.int32)

    def hit(self, origin: F32, ray: F32) -> tuple[NDArray[np.int32], F32, F32]:
        """What each ray meets first: index of the triangle or -1, how far along the ray, normal there (k, 3)."""
        if not self.shapes or not len(ray):
            far = np.full(len(ray), np.inf, np.float32)
            return np.full(len(ray), -1, np.int32), far, np.zeros((len(ray), 3), np.float32)
        answer = self.scene.run(np.ascontiguousarray(origin), np.ascontiguousarray(ray), output=1)
        triangle = answer["primID"]
        met = triangle >= 0
        far = np.where(met, answer["tfar"], np.float32(np.inf))
        u, v = answer["u"][met, None], answer["v"][met, None]
        corner = self.normals[triangle[met]]
        normal = np.zeros((len(ray), 3), np.float32)
        normal[met] = _unit(corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v)
        return triangle, far, normal

    def blocked(self, origin: F32, ray: F32, reach: float) -> NDArray[np.bool_]:
        """True where a ray meets anything within `reach` [m]."""
        if not self.shapes or not len(ray):
            return np.zeros(len(ray), bool)
        limit = np.full(len(ray), reach, np.float32)
        return np.asarray(self.scene.run(np.ascontiguousarray(origin), ray, dists=limit, query="OCCLUDED")) >= 0


class _Stage:
    """Shapes, lights and floor of one picture."""

    def __init__(
        self, shapes: Sequence[Shape], camera: Camera, level: float | None, shown: NDArray[np.float64],
        background: Colour,
    ) -> None:  # fmt: skip
        solid = [k for k, s in enumerate(shapes) if s.alpha >= 1]
        clear = [k for k, s in enumerate(shapes) if s.alpha < 1]
        self.solid = _Soup([shapes[k] for k in solid], solid)
        self.clear = _Soup([shapes[k] for k in clear], clear)
        ghosts = [k for k in solid if shapes[k].ghost > 0]
        self.ghosts = _Soup([shapes[k] for k in ghosts], ghosts)
        self.ghost = np.array([s.ghost for s in shapes], np.float32)
        self.albedo = np.array([s.colour for s in shapes], np.float32).reshape(-1, 3) ** np.float32(GAMMA)
        self.alpha = np.array([s.alpha for s in shapes], np.float32)
        self.background = np.array(background, np.float32) ** np.float32(GAMMA)
        self.level = level
        self.centre = (shown.min(0) + shown.max(0)) / 2
        self.extent = float(np.linalg.norm(np.ptp(shown, axis=0))) or 1.0
        right, up, back = camera.axes
        self.key = _unit((-0.55 * right + 0.80 * up + 0.62 * back).astype(np.float32)[None])[0]
        self.fill = _unit((0.85 * right + 0.10 * up + 0.55 * back).astype(np.float32)[None])[0]

    def opaque(
        self, origin: F32, ray: F32, shape: tuple[int, int], samples: int, shadows: bool, rays: int
    ) -> tuple[F32, F32]:
        """Depth of what each sample meets [m], (k,), and its light, (k, 3): opaque shapes, floor and background."""
        triangle, far, normal = self.solid.hit(origin, ray)
        owner = self.solid.owner[triangle] if len(self.solid.owner) else NOTHING
        what = np.where(triangle >= 0, owner, NOTHING).astype(np.int32)
        if self.level is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                down = (np.float32(self.level) - origin[:, 2]) / ray[:, 2]
            on_floor = (ray[:, 2] < 0) & (origin[:, 2] > self.level) & (down < far)
            what[on_floor], far[on_floor], normal[on_floor] = FLOOR, down[on_floor], (0.0, 0.0, 1.0)
        sun, sky = self._visibility(origin, ray, far, normal, what, shape, samples, shadows, rays)
        light = np.tile(self.background, (len(ray), 1))
        met = np.flatnonzero(what >= 0)
        light[met] = self._shaded(normal[met], ray[met], self.albedo[what[met]], sun[met], sky[met])
        ground = np.flatnonzero(what == FLOOR)
        light[ground] = self._floor(origin[ground] + ray[ground] * far[ground, None], sun[ground], sky[ground])
        light[_outline(what, shape)] *= INK
        self._haunt(origin, ray, what, light)
        return far, light

    def _haunt(self, origin: F32, ray: F32, what: NDArray[np.int32], light: F32) -> None:
        """Let hidden shapes show through what hides them [in place]; the floor hides them for good."""
        triangle, _, _ = self.ghosts.hit(origin, ray)
        hidden = np.flatnonzero((triangle >= 0) & (what >= 0))
        who = self.ghosts.owner[triangle[hidden]]
        behind = self.ghost[what[hidden]] == 0  # One of them does not show through another.
        hidden, who = hidden[behind], who[behind]
        share = self.ghost[who, None]
        light[hidden] = light[hidden] * (1 - share) + self.albedo[who] * share

    def cover(self, origin: F32, ray: F32, far: F32, light: F32) -> None:
        """Lay the translucent shapes in front of `far` over `light` [in place], nearest first."""
        if not self.clear.shapes:
            return
        through = np.ones(len(ray), np.float32)
        added = np.zeros_like(light)
        live = np.arange(len(ray))
        start = np.array(origin)
        passed = np.zeros(len(ray), np.float32)
        skip = np.float32(2e-4 * self.extent)
        for _ in range(LAYERS):
            triangle, step, normal = self.clear.hit(start[live], ray[live])
            there = (triangle >= 0) & (passed[live] + step < far[live])
            live, triangle, step, normal = live[there], triangle[there], step[there], normal[there]
            if not len(live):
                break
            who = self.clear.owner[triangle]
            facing = np.abs(np.einsum("ij,ij->i", normal, ray[live]))
            # A clear shell looks denser where the view grazes it, which draws its outline.
            dense = self.alpha[who] + (1 - self.alpha[who]) * 0.55 * (1 - facing) ** 3
            shade = self._shaded(normal, ray[live], self.albedo[who], np.float32(1.0), np.float32(1.0))
            added[live] += shade * (dense * through[live])[:, None]
            through[live] *= 1 - dense
            passed[live] += step + skip
            start[live] += ray[live] * (step + skip)[:, None]
        light *= through[:, None]
        light += added

    def _visibility(
        self, origin: F32, ray: F32, far: F32, normal: F32, what: NDArray[np.int32], shape: tuple[int, int],
        samples: int, shadows: bool, rays: int,
    ) -> tuple[F32, F32]:  # fmt: skip
        """Share of the key light and of the sky that reaches each sample, in [0, 1].

        They are asked once per pixel, with few rays, and smoothed over the neighbours that show the same shape.
        """
        sun, sky = np.ones(len(ray), np.float32), np.ones(len(ray), np.float32)
        if not shadows:
            return sun, sky
        index = np.arange(len(ray)).reshape(shape)[::samples, ::samples]
        rows, columns = index.shape
        asked = np.flatnonzero(what[index.ravel()] != NOTHING)
        pixel = index.ravel()[asked]
        point = origin[pixel] + ray[pixel] * far[pixel, None]
        facing = _facing(normal[pixel], ray[pixel])
        point = point + facing * np.float32(1.5e-3 * self.extent)
        tile = (asked // columns % 4) * 4 + asked % columns % 4
        side, up = _basis(facing)
        pattern = _pattern(max(rays, 1))
        blur = pattern[tile, 0] * np.float32(0.07)
        towards = _unit(self.key + blur[:, :1] * side + blur[:, 1:2] * up)
        lit = np.where(self.solid.blocked(point, towards, 4 * self.extent), np.float32(0), np.float32(1))
        lit *= np.where(self.clear.blocked(point, towards, 4 * self.extent), np.float32(0.72), np.float32(1))
        open_sky = np.ones(len(pixel), np.float32)
        for k in range(rays):
            out = pattern[tile, k]
            towards = side * out[:, :1] + up * out[:, 1:2] + facing * out[:, 2:]
            open_sky -= self.solid.blocked(point, towards, 0.35 * self.extent).astype(np.float32) / rays
        pair = np.zeros((rows * columns, 2), np.float32)
        pair[asked, 0], pair[asked, 1] = lit, open_sky
        smooth = _smoothed(pair.reshape(rows, columns, 2), what.reshape(shape), samples)
        return smooth[..., 0].ravel(), smooth[..., 1].ravel()

    def _shaded(self, normal: F32, ray: F32, albedo: F32, sun: F32 | np.float32, sky: F32 | np.float32) -> F32:
        normal = _facing(normal, ray)
        key = np.maximum(normal @ self.key, 0) * sun
        fill = np.maximum(normal @ self.fill, 0)
        view = np.maximum(-np.einsum("ij,ij->i", normal, ray), 0)
        ambient = (0.80 + 0.20 * normal[:, 2]) * sky
        half = _unit(self.key - ray)
        shine = np.maximum(np.einsum("ij,ij->i", normal, half), 0) ** 40 * sun
        warm, cold = np.array([1.03, 1.0, 0.95], np.float32), np.array([0.96, 1.0, 1.06], np.float32)
        light = (KEY * key + FILL * fill)[:, None] * warm + (AMBIENT * ambient)[:, None] * cold
        rim = 0.72 + 0.28 * np.sqrt(view)  # a pale body stays readable on white
        return (albedo * light * rim[:, None] + (SHINE * shine)[:, None]).astype(np.float32)

    def _floor(self, point: F32, sun: F32, sky: F32) -> F32:
        even = (np.floor(point[:, 0] / TILE) + np.floor(point[:, 1] / TILE)) % 2 == 0
        tone = np.where(even, np.float32(0.90), np.float32(0.80)) * (1 - 0.42 * (1 - sun) - 0.50 * (1 - sky))
        away = np.linalg.norm(point[:, :2] - self.centre[:2].astype(np.float32), axis=1) / np.float32(self.extent)
        fade = np.clip((away - 0.55) / 0.95, 0, 1)[:, None]
        fade = fade * fade * (3 - 2 * fade)
        return tone[:, None] * self.background * (1 - fade) + self.background * fade


def _unit(vectors: F32) -> F32:
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return vectors / np.maximum(length, np.float32(1e-12))[:, None]


def _facing(normal: F32, ray: F32) -> F32:
    return np.where(np.einsum("ij,ij->i", normal, ray)[:, None] > 0, -normal, normal)


def _basis(normal: F32) -> tuple[F32, F32]:
    """Two unit vectors across each normal (Duff et al. 2017)."""
    x, y, z = normal.T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1), np.stack([b, sign + y * y * a, -y], axis=1)


def _pattern(rays: int) -> F32:
    """Cosine-weighted directions about z, (16, rays, 3): one set for each pixel of a 4 x 4 tile."""
    k = np.arange(16 * rays).reshape(rays, 16).T + 0.5  # the sets interleave, so that a tile covers the sky evenly
    radius, angle = np.sqrt(k / (16 * rays)), k * (np.pi * (3 - np.sqrt(5)))
    turned = angle + (np.arange(16) * 7 % 16)[:, None] * (2 * np.pi / 16)
    directions = [radius * np.cos(turned), radius * np.sin(turned), np.sqrt(1 - radius**2)]
    return np.stack(directions, axis=-1).astype(np.float32)


def _smoothed(pair: F32, what: NDArray[np.int32], samples: int) -> F32:
    """Means of `pair` (h, w, 2) over the neighbours with the same `what` (h s, w s), for every sample."""
    out = np.ones((*what.shape, 2), np.float32)
    base = what[::samples, ::samples]
    for name in np.unique(what):
        if name == NOTHING:
            continue
        rows, columns = np.flatnonzero((what == name).any(1)), np.flatnonzero((what == name).any(0))
        box = tuple(slice(max(v[0] // samples - 4, 0), v[-1] // samples + 5) for v in (rows, columns))
        fine = tuple(slice(s.start * samples, s.stop * samples) for s in box)
        mine = (base[box] == name).astype(np.float32)
        weight = ndimage.uniform_filter(mine, 5, mode="constant")
        for k in range(2):
            mean = ndimage.uniform_filter(pair[..., k][box] * mine, 5, mode="constant")
            mean = np.where(weight > 1e-3, mean / np.maximum(weight, np.float32(1e-3)), np.float32(1))
            large = mean.repeat(samples, 0).repeat(samples, 1)
            here = what[fine] == name
            out[fine][..., k][here] = large[: here.shape[0], : here.shape[1]][here]
    return out


def _outline(what: NDArray[np.int32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """True at the samples of a shape whose neighbour shows something else, (k,)."""
    grid = what.reshape(shape)
    edge = np.zeros(shape, bool)
    across, down = grid[:, 1:] != grid[:, :-1], grid[1:] != grid[:-1]
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    return (edge & (grid >= 0)).ravel()
