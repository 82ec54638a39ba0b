"""Bones as superelliptic capsules with blobs, drawn on the voxel grid through their signed distances."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from decoder.design import GRID, Material, quantised

MARGIN = 2  # empty voxels that the rasteriser leaves along every face of the grid
COAT = 0.7  # least soft tissue over a bone [voxels]
FAR = np.float32(1e3)  # distance where nothing was measured [voxels]
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class Bone:
    """A core line swept by a superellipse, capped by half superellipsoids. All lengths in voxels.

    With u, v the offsets across and w the overshoot past the ends of the core line, the surface is
    (|u|/a)^p + (|v|/b)^p + (|w|/c)^p = 1.

    Attributes:
        start: near end of the core line, (3,).
        end: far end of the core line, (3,); equal to `start` for a plain superellipsoid.
        frame: columns are the unit vectors of u, v and w, (3, 3).
        half: a, b, c, (3,).
        exponent: p; 2 is round, 4 is boxy.
        taper: a and b at the far end over those at the near end.
        blobs: centre and radius of balls that are blended into the surface, (m, 4).
        thickness: of the soft tissue over this bone.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    frame: NDArray[np.float64]
    half: NDArray[np.float64]
    exponent: float
    taper: float
    blobs: NDArray[np.float64]
    thickness: float

    def bounds(self) -> NDArray[np.float64]:
        """Box around the bone without soft tissue, (2, 3)."""
        reach = np.abs(self.frame) @ (self.half * (max(1.0, self.taper), max(1.0, self.taper), 1.0))
        low = np.minimum(self.start, self.end) - reach
        high = np.maximum(self.start, self.end) + reach
        if len(self.blobs):
            low = np.minimum(low, (self.blobs[:, :3] - self.blobs[:, 3:]).min(0))
            high = np.maximum(high, (self.blobs[:, :3] + self.blobs[:, 3:]).max(0))
        return np.stack([low, high])

    def moved(self, shift: NDArray[np.float64], scale: float) -> Bone:
        """The same bone after x -> scale * x + shift."""
        blobs = self.blobs * scale
        blobs[:, :3] += shift
        return Bone(self.start * scale + shift, self.end * scale + shift, self.frame, self.half * scale,
                    self.exponent, self.taper, blobs, self.thickness)  # fmt: skip

    def distance(self, x: Floats, y: Floats, z: Floats, blend: float) -> Floats:
        """Signed distance to the surface, about metric near it and negative inside, on an open mesh of points."""
        length = float(np.linalg.norm(self.end - self.start))
        sx, sy, sz = (np.float32(s) for s in self.start)
        u, v, w = (
            np.float32(f[0]) * (x - sx) + np.float32(f[1]) * (y - sy) + np.float32(f[2]) * (z - sz)
            for f in self.frame.T
        )
        a, b, c = (np.float32(h) for h in self.half)
        core = np.clip(w, 0.0, np.float32(length))
        if length > 0 and self.taper != 1.0:
            width = 1.0 + core * np.float32((self.taper - 1.0) / length)
            u /= width
            v /= width
        np.abs(u, out=u)
        np.abs(v, out=v)
        w -= core
        np.abs(w, out=w)
        u /= a
        v /= b
        w /= c
        # One Newton step of the implicit function: d = f / |grad f| with f the p-norm minus 1.
        p = np.float32(self.exponent)
        norm = np.maximum((u**p + v**p + w**p) ** (1 / p), np.float32(1e-3))
        slope = np.sqrt((u**(2 * p - 2)) / a**2 + (v**(2 * p - 2)) / b**2 + (w**(2 * p - 2)) / c**2)  # fmt: skip
        slope /= norm ** (p - 1)
        result = (norm - 1) / np.maximum(slope, np.float32(1 / max(a, b, c)))
        for bx, by, bz, radius in self.blobs.astype(np.float32):
            if radius <= 0.5:
                continue
            ball = np.sqrt((x - bx) ** 2 + (y - by) ** 2 + (z - bz) ** 2) - radius
            result = smooth_min(result, ball, blend)
        return result


def smooth_min(a: Floats, b: Floats, width: float) -> Floats:
    """Polynomial smooth minimum: the two surfaces melt into one over a band of `width`."""
    h = np.maximum(np.float32(width) - np.abs(a - b), np.float32(0)) * np.float32(1 / width)
    return np.minimum(a, b) - h * h * np.float32(width / 4)


@lru_cache(maxsize=8)
def spline_basis(count: int) -> NDArray[np.float64]:
    """Quadratic B-splines over the voxel centres of one side of the grid, (64, count), with unit sum of squares.

    Weighting `count` independent N(0, 1) numbers by a row therefore gives N(0, 1) again, at every voxel.
    """
    t = (np.arange(GRID) + 0.5) / GRID * (count - 2) + 0.5  # Knots at whole numbers; the domain starts half-way.
    r = np.abs(t[:, None] - np.arange(count)[None, :])
    basis = np.where(r < 0.5, 0.75 - r**2, np.where(r < 1.5, 0.5 * (1.5 - r) ** 2, 0.0))
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    basis.setflags(write=False)
    return basis


def noise(coefficients: NDArray[np.float64], window: tuple[slice, ...]) -> Floats:
    """Smooth random field on a window of the grid from spline coefficients (kx, ky, kz): variance 1 if theirs is."""
    field = coefficients
    for axis in (2, 1, 0):
        rows = spline_basis(coefficients.shape[axis])[window[axis]]
        field = np.moveaxis(np.tensordot(field, rows, axes=(axis, 1)), -1, axis)
    return field.astype(np.float32)


def fit(bones: list[Bone], room: float) -> tuple[NDArray[np.float64], float]:
    """Shift and scale (at most 1) that centre the bones, with soft tissue and `room` around them, in the grid."""
    boxes = np.stack([bone.bounds() + np.array([[-1.0], [1.0]]) * (bone.thickness + room) for bone in bones])
    low, high = boxes[:, 0].min(0), boxes[:, 1].max(0)
    scale = min(1.0, float((GRID - 2 * MARGIN) / (high - low).max()))
    return GRID / 2 - scale * (low + high) / 2, scale


def rasterise(
    bones: list[Bone], linked: set[tuple[int, int]], bone_noise: NDArray[np.float64], skin_noise: NDArray[np.float64],
    *, blend: float, gap: float, limit: float, signed: bool = False,
) -> tuple[NDArray[np.uint8], NDArray[np.int16], NDArray[np.int8] | None]:  # fmt: skip
    """Draw bones that `fit` has placed: material and segment grids, (64, 64, 64) each, and if `signed` their depth.

    A voxel belongs to the nearest bone; it is rigid where distance < bone noise, and soft where
    distance < max(thickness + skin noise, bone noise + COAT), so that no noise leaves a bone bare.

    Args:
        bones: bone i becomes segment i + 1. All lengths in voxels.
        linked: pairs (i, j) that share a joint, i < j.
        bone_noise: spline coefficients of the rigid surface's displacement [voxels].
        skin_noise: the same for the outer surface.
        blend: width over which linked bones melt together.
        gap: width of the cleft that keeps soft tissue of bones without a common joint apart.
        limit: largest displacement by noise.
        signed: whether to give the depths that material was told from, as in `VoxelDesign.depth`.
    """
    boxes = np.stack([bone.bounds() + np.array([[-1.0], [1.0]]) * (bone.thickness + limit + gap) for bone in bones])
    cells = np.stack([np.floor(boxes[:, 0]), np.ceil(boxes[:, 1])], axis=1).astype(int).clip(MARGIN, GRID - MARGIN)
    low, high = cells[:, 0].min(0), np.maximum(cells[:, 1].max(0), cells[:, 0].min(0) + 1)
    window = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    distances = np.full((len(bones), *(high - low)), FAR, np.float32)
    for index, bone in enumerate(bones):
        if (cells[index, 1] <= cells[index, 0]).any():
            continue
        x, y, z = (np.arange(a, b, dtype=np.float32) + np.float32(0.5) for a, b in cells[index].T)
        region = tuple(slice(int(a), int(b)) for a, b in (cells[index] - low).T)
        distances[index][region] = bone.distance(x[:, None, None], y[None, :, None], z[None, None, :], blend)
    owner = distances.argmin(axis=0)
    nearest = distances.min(axis=0)
    melted, slit = nearest.copy(), np.full(nearest.shape, FAR, np.float32)  # slit: distance to the clefts
    for i in range(len(bones)):
        for j in range(i + 1, len(bones)):
            start = np.maximum(cells[i, 0], cells[j, 0]) - low
            stop = np.minimum(cells[i, 1], cells[j, 1]) - low
            if (stop <= start).any():
                continue
            region = tuple(slice(int(a), int(b)) for a, b in zip(start, stop, strict=True))
            a, b = distances[i][region], distances[j][region]
            if (i, j) in linked:
                melted[region] = np.minimum(melted[region], smooth_min(a, b, blend))
            else:
                beyond = np.where(np.minimum(a, b) <= nearest[region], (np.abs(a - b) - np.float32(gap)) / 2, FAR)
                slit[region] = np.minimum(slit[region], beyond)
    inner = np.clip(noise(bone_noise, window), -limit, limit)
    outer = np.array([bone.thickness for bone in bones], np.float32)[owner]
    outer += np.clip(noise(skin_noise, window), -limit, limit)
    outer = np.maximum(outer, inner + np.float32(COAT))
    rigid = melted < inner
    soft = (melted < outer) & ~rigid & ~(slit < 0)
    material = np.zeros((GRID, GRID, GRID), np.uint8)
    segment = np.zeros((GRID, GRID, GRID), np.int16)
    material[window] = np.where(rigid, Material.RIGID, np.where(soft, Material.SOFT, Material.EMPTY))
    segment[window] = np.where(rigid | soft, owner + 1, 0)
    if not signed:
        return material, segment, None
    deep, whole = np.full((2, GRID, GRID, GRID), -float(FAR))
    deep[window] = inner - melted
    whole[window] = np.maximum(inner - melted, np.minimum(outer - melted, slit))
    # A difference of 0 says neither; the labels do.
    return material, segment, quantised(_towards(deep, material == Material.RIGID), _towards(whole, material > 0))


def _towards(depth: NDArray[np.float64], inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.where(inside, np.maximum(depth, np.finfo(np.float64).tiny), np.minimum(depth, 0.0))
