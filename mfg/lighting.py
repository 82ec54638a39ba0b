"""Light, shadow and outline of what the rays of one picture meet: opaque shapes, floor, then translucent ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mfg.camera import Camera
from mfg.ray_soup import NOTHING, Soup, unit
from mfg.shape import F32, Colour, Shape

GAMMA = 2.2  # between colours as given (for a screen) and the light that is added up
KEY, FILL, AMBIENT, SHINE = 0.62, 0.14, 0.44, 0.08  # strength of the lights; a lit face comes out about as its colour
LAYERS = 6  # translucent surfaces drawn one behind the other
INK = 0.40  # share of its light that an outline of an opaque shape keeps
TILE = 0.10  # edge of a floor tile [m]
FLOOR = -2  # what a ray met where it met the floor


class Stage:
    """Shapes, lights and floor of one picture."""

    def __init__(
        self, shapes: Sequence[Shape], camera: Camera, level: float | None, shown: NDArray[np.float64],
        background: Colour,
    ) -> None:  # fmt: skip
        """Sort the shapes by how they are seen, and hang the lights.

        Args:
            shapes: what to draw.
            camera: whose axes the lights follow.
            level: height of the floor, or None [m].
            shown: points that the picture just shows, (n, 3) [m].
            background: colour of what is empty.
        """
        solid = [k for k, s in enumerate(shapes) if s.alpha >= 1]
        clear = [k for k, s in enumerate(shapes) if s.alpha < 1]
        self.solid = Soup([shapes[k] for k in solid], solid)
        self.clear = Soup([shapes[k] for k in clear], clear)
        ghosts = [k for k in solid if shapes[k].ghost > 0]
        self.ghosts = Soup([shapes[k] for k in ghosts], ghosts)
        self.ghost = np.array([s.ghost for s in shapes], np.float32)
        self.albedo = np.array([s.colour for s in shapes], np.float32).reshape(-1, 3) ** np.float32(GAMMA)
        self.alpha = np.array([s.alpha for s in shapes], np.float32)
        self.background = np.array(background, np.float32) ** np.float32(GAMMA)
        self.level = level
        self.centre = (shown.min(0) + shown.max(0)) / 2
        self.extent = float(np.linalg.norm(np.ptp(shown, axis=0))) or 1.0
        right, up, back = camera.axes
        self.key = unit((-0.55 * right + 0.80 * up + 0.62 * back).astype(np.float32)[None])[0]
        self.fill = unit((0.85 * right + 0.10 * up + 0.55 * back).astype(np.float32)[None])[0]

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
        towards = unit(self.key + blur[:, :1] * side + blur[:, 1:2] * up)
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
        half = unit(self.key - ray)
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
