"""Signed distances of single parts become one body on the voxel grid: bones that melt together, skins with clefts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import DEPTH_LIMIT, GRID, Material, quantised
from decoder.parts import BONES_APART
from decoder.rasterise import COAT, FAR, MARGIN, Floats, smooth_min

BLEND = 2.0  # width over which linked bones melt together [voxels]
GAP = 2.5  # width of the cleft between the skins of parts without a common joint [voxels]
Scalar = TypeVar("Scalar", bound=np.generic)
_SLIVER = 0.3  # pieces of a bone smaller than this share of its largest are dropped


@dataclass(frozen=True, eq=False)
class Window:
    """Signed distances to one part's bone and skin [voxels], negative inside, at the voxels from `low` on.

    Attributes:
        low: first voxel, (3,).
        bone: (a, b, c).
        skin: (a, b, c).
    """

    low: NDArray[np.intp]
    bone: Floats
    skin: Floats


def window_of(low: NDArray[np.floating], high: NDArray[np.floating]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First voxel and number of voxels (at least 1) of the box `low` to `high` [voxels] within the grid's margin."""
    first = np.clip(np.floor(low), MARGIN, GRID - MARGIN - 1).astype(np.intp)
    last = np.clip(np.ceil(high), MARGIN + 1, GRID - MARGIN).astype(np.intp)
    return first, np.maximum(last - first, 1)


def centres(first: NDArray[np.intp], count: NDArray[np.intp]) -> NDArray[np.float32]:
    """Centres of the voxels of a window [voxels], (a, b, c, 3)."""
    axes = [np.arange(f, f + c, dtype=np.float32) + np.float32(0.5) for f, c in zip(first, count, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def compose(
    windows: Sequence[Window], linked: set[tuple[int, int]]
) -> tuple[NDArray[np.uint8], NDArray[np.int16], NDArray[np.int8]]:
    """Material, segment and depth of a body, as in `VoxelDesign`; part i becomes segment i + 1.

    A voxel is rigid inside the union of the bones, melted together at joints, and belongs to the nearest bone; it is
    soft inside a skin. Between parts that share no joint there is a cleft, in their skins and in their bones. Every
    bone is coated by 0.7 voxels, and of every bone the largest piece is kept.

    Args:
        windows: one per part.
        linked: pairs (i, j) that share a joint, i < j.
    """
    # Everything happens in the box around all windows; beyond it the grid is empty.
    origin = np.min([w.low for w in windows], axis=0)
    size = np.max([w.low + w.bone.shape for w in windows], axis=0) - origin
    bone, skin, crack, slit = (np.full(size, FAR, np.float32) for _ in range(4))
    owner, holder = np.zeros(size, np.int16), np.zeros(size, np.int16)
    places = [_slices(w.low - origin, w.low - origin + w.bone.shape) for w in windows]
    bones = [w.bone for w in windows]
    skins = [np.minimum(w.skin, w.bone - np.float32(COAT)) for w in windows]
    for index, (window, place) in enumerate(zip(windows, places, strict=True)):
        nearer = window.bone < bone[place]
        bone[place] = np.where(nearer, window.bone, bone[place])
        owner[place] = np.where(nearer, index + 1, owner[place])
        closer = skins[index] < skin[place]
        skin[place] = np.where(closer, skins[index], skin[place])
        holder[place] = np.where(closer, index + 1, holder[place])
    melted = bone.copy()
    for i in range(len(windows)):
        for j in range(i + 1, len(windows)):
            start = np.maximum(windows[i].low, windows[j].low)
            stop = np.minimum(windows[i].low + windows[i].bone.shape, windows[j].low + windows[j].bone.shape)
            if (stop <= start).any():
                continue
            region = _slices(start - origin, stop - origin)
            mine, other = (_slices(start - windows[k].low, stop - windows[k].low) for k in (i, j))
            if (i, j) in linked:
                melted[region] = np.minimum(melted[region], smooth_min(bones[i][mine], bones[j][other], BLEND))
            else:
                for cleft, of, nearest, gap in ((crack, bones, bone, BONES_APART), (slit, skins, skin, GAP)):
                    a, b = of[i][mine], of[j][other]
                    beyond = np.where(np.minimum(a, b) <= nearest[region], (np.abs(a - b) - np.float32(gap)) / 2, FAR)
                    cleft[region] = np.minimum(cleft[region], beyond)
    melted = np.maximum(melted, -crack)
    rigid = melted < 0
    dropped = _slivers(rigid, owner, places)
    rigid &= ~dropped
    soft = (np.minimum(skin, melted - np.float32(COAT)) < 0) & ~rigid & ~(slit < 0) & ~dropped
    material = np.where(rigid, Material.RIGID, np.where(soft, Material.SOFT, Material.EMPTY)).astype(np.uint8)
    segment = np.where(rigid, owner, np.where(soft, holder, 0)).astype(np.int16)
    known = np.unique(segment[rigid])
    segment[soft & ~np.isin(segment, known)] = 0
    deep = np.minimum(-melted, FAR)
    whole = np.maximum(deep, np.minimum(-np.minimum(skin, melted - np.float32(COAT)), slit))
    depth = quantised(_towards(deep, rigid), _towards(whole, rigid | soft))
    box = _slices(origin, origin + size)
    return _within(box, material, 0), _within(box, segment, 0), _within(box, depth, -DEPTH_LIMIT)


def _slices(low: NDArray[np.intp], high: NDArray[np.intp]) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))


def _within(box: tuple[slice, ...], values: NDArray[Scalar], beyond: int) -> NDArray[Scalar]:
    """Values of a box in the grid, the last three axes, and another beyond it."""
    grid = np.full((*values.shape[:-3], GRID, GRID, GRID), beyond, values.dtype)
    place: tuple[Any, ...] = (..., *box)
    grid[place] = values
    return grid


def _slivers(
    rigid: NDArray[np.bool_], owner: NDArray[np.int16], places: Sequence[tuple[slice, ...]]
) -> NDArray[np.bool_]:
    """Small loose pieces of bones."""
    dropped = np.zeros(rigid.shape, bool)
    for index, place in enumerate(places):
        pieces, count = ndimage.label(rigid[place] & (owner[place] == index + 1), np.ones((3, 3, 3)))
        if count > 1:
            sizes = np.bincount(pieces.ravel())
            sizes[0] = 0
            small = sizes < max(_SLIVER * sizes.max(), 1)
            small[0] = False
            dropped[place] |= small[pieces]
    return dropped


def _towards(depth: Floats, inside: NDArray[np.bool_]) -> NDArray[np.floating]:
    """The depth where its sign agrees with the labels, and the least one that does elsewhere."""
    tiny = np.float32(1e-6)
    return np.where(inside, np.maximum(depth, tiny), np.minimum(depth, -tiny))
