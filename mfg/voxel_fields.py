"""Voxels of a design to smooth depth fields: rounded from the labels, or from the depth that the design carries."""

from __future__ import annotations

import math
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import DEPTH_UNIT, Material, VoxelDesign
from mfg.along_axes import blurred, halfway, refined
from mfg.fields import Field, Window
from mfg.voxel_distances import NOWHERE, distances

Scalar = TypeVar("Scalar", bound=np.generic)

PAD = 3  # voxels around a voxel set in its field
OUTER = 8  # how far outside a design's own depth tells distances apart [voxels]
NEAR, FAR = 2.0, 4.0  # a design's own depth counts down to NEAR, distances between voxels from FAR on [voxels]


def bone_field(design: VoxelDesign, segment: int, smoothing: float, fine: bool = True) -> Field:
    """Depth in the bone of one segment, from the design's own depth where it has one, else from its labels.

    Args:
        design: that has this segment.
        segment: id of the bone.
        smoothing: width of the Gaussian that rounds voxel steps [voxels].
        fine: samples at half the pitch, else at voxel centres only, where a depth is good at the surface only.
    """
    return _of(design, (design.segment == segment) & (design.material == Material.RIGID), 0, smoothing, 0.0, fine)


def whole_field(
    design: VoxelDesign, segment: int, soft: NDArray[np.bool_], smoothing: float, opening: float = 0.0,
    fine: bool = True,
) -> Field:  # fmt: skip
    """Depth in the bone of one segment and the soft voxels given with it, (64, 64, 64), else as `bone_field`.

    Where the depth is the design's own, the rims of its boundary to other voxels are opened [voxels].
    """
    bone = (design.segment == segment) & (design.material == Material.RIGID)
    return _of(design, soft | bone, 1, smoothing, opening, fine)


def smooth_field(occupied: NDArray[np.bool_], pitch: float, smoothing: float, fine: bool = True) -> Field:
    """Smooth signed depth of a voxel set on the half-voxel lattice, keeping its volume.

    The Euclidean depth at voxel centres is smoothed, interpolated to half the pitch (cubic), and shifted so that the
    region phi > 0 has the volume of the voxels.

    Args:
        occupied: (64, 64, 64); at least one voxel, none within `PAD` voxels of the array border is required: the
            crop is padded.
        pitch: edge of a voxel [m].
        smoothing: Gaussian width [voxels].
        fine: else samples at voxel centres only.
    """
    low, window = bounding_window(occupied)
    crop = _around(occupied, window)
    depth = refined(_rounded_depth(crop, smoothing))
    target = int(crop.sum()) * 8  # Samples per voxel on the fine lattice.
    level = float(np.partition(depth.ravel(), -target)[-target]) if target < depth.size else 0.0
    depth = depth if fine else depth[::2, ::2, ::2]
    return _field(depth - np.clip(level, -0.5, 0.5), low, pitch, fine)


def measured_field(
    occupied: NDArray[np.bool_], depth: NDArray[np.int8], pitch: float, smoothing: float, opening: float = 0.0,
    fine: bool = True,
) -> Field:  # fmt: skip
    """Signed depth of a voxel set that is part of a solid of known depth, on the half-voxel lattice.

    Where the set ends with the solid, its surface is the solid's, depth 0, interpolated to half the pitch (cubic).
    Where other voxels of the solid go on beyond it, the set ends half-way to them, with the voxel steps of that
    boundary rounded; the boundary continues into the empty room around, so that it meets the surface squarely.

    Args:
        occupied: (64, 64, 64); at least one voxel, all of them with depth above 0.
        depth: of the whole solid, (64, 64, 64), in 1/`DEPTH_UNIT` voxel.
        pitch: edge of a voxel [m].
        smoothing: width of the Gaussian that takes off steps [voxels].
        opening: radius of the ball that opens the rim where boundary and surface meet [voxels].
        fine: else samples at voxel centres only, and no depth beyond the stored one.
    """
    low, window = bounding_window(occupied)
    crop = _around(occupied, window)
    known = _around(depth, window, "edge").astype(np.float32) / np.float32(DEPTH_UNIT)
    inside = known > 0
    # Steps of 1/16 voxel would show as ripples. 2 G - G G takes them off and leaves cubic surfaces where they are.
    once = blurred(known, smoothing)
    known = 2 * once - blurred(once, smoothing)
    others = inside & ~crop
    if not fine:
        if others.any():
            here = _reached(others)
            beside = blurred(_towards(crop[here], others[here]), smoothing)
            known[here] = opened_min(known[here], beside, opening, 1)
        return _field(known, low, pitch, fine)
    # A stored depth ends somewhere; deep inside, distances between voxels keep the ridge where clearance is measured.
    share = np.clip((known - NEAR) / (FAR - NEAR), 0.0, 1.0)
    if share.any():
        far = distances(np.pad(inside, 1))[1:-1, 1:-1, 1:-1] - 0.5
        known = (known + share * (far - known)).astype(np.float32)
    values = refined(known)
    if others.any():
        nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
        cell = crop[tuple(nearest)]
        # Farther than the solid is deep, and than its own depth is told outside of it, that is far is enough.
        far_off = max(OUTER, math.ceil(float(known.max())) + 2)
        values = opened_min(values, refined(_rounded_depth(cell, smoothing, far_off)), opening)
    return _field(values, low, pitch, fine)


def halved(field: Field) -> Field:
    """A field of samples at voxel centres at half the pitch: what lies between them is interpolated (cubic)."""
    x, y, z = (round(2 * c) for c in field.corner)
    return Field(refined(field.values), (x, y, z), field.spacing / 2)


def at_centres(field: Field) -> Field:
    """The samples of a fine field that lie at voxel centres; `halved` keeps them."""
    x, y, z = (c / 2 for c in field.corner)
    return Field(np.ascontiguousarray(field.values[::2, ::2, ::2]), (x, y, z), field.spacing * 2)


def opened_min(a: NDArray[np.float32], b: NDArray[np.float32], radius: float, stride: int = 2) -> NDArray[np.float32]:
    """Depth in both of two regions, with the edges where their surfaces meet opened by a ball, wedges included.

    The centre of the ball keeps to a >= radius and b >= radius. Where the edge of that region is what is nearest, at
    u = radius - a and v = radius - b, it is |u, v| away in the frame of the two gradients, which need not be square.

    Args:
        a: depth in one region, odd numbers of samples along every side.
        b: depth in the other, same samples.
        radius: of the ball, in the unit of the depths; 0 leaves every edge as it is.
        stride: every how many samples slopes are taken, 1 or 2; a multiple of it and one more along every side.
    """
    least, r = np.minimum(a, b), np.float32(radius)
    if radius <= 0 or min(a.shape) < 3:
        return least
    # Nothing else is both in a body and near enough to an edge; further outside, the sign is all that counts. And
    # whatever the angle, an edge is nearest only where u + v > 0.
    most = np.maximum(a, b)
    mask = (least > -r) & (most < 2 * r)
    most += least
    mask &= most < 2 * r
    if not mask.any():
        return least
    # Slopes are taken around those samples only, and at the places where slopes over the whole would be.
    here = _grown(bounding_window(mask)[1], stride)
    near = np.flatnonzero(mask[here])
    a, b = a[here], b[here]
    cosine = _cosine(a[::stride, ::stride, ::stride], b[::stride, ::stride, ::stride])
    c = (halfway(cosine) if stride == 2 else cosine).take(near)
    u, v = r - a.ravel().take(near), r - b.ravel().take(near)
    square = (u * u + v * v - 2 * c * u * v) / np.maximum(1 - c * c, np.float32(0.05))
    opened = r - np.sqrt(np.maximum(square, 0))
    wedge, rim = (v > c * u) & (u > c * v), least[here]
    at = np.unravel_index(near[wedge], rim.shape)
    rim[at] = np.minimum(rim[at], opened[wedge])
    return least


def _cosine(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Cosine of the angle between the slopes of two depths at every sample; 0 where one has none."""
    (p, q, r), (u, v, w) = np.gradient(a), np.gradient(b)
    length = np.sqrt((p * p + q * q + r * r) * (u * u + v * v + w * w))
    return np.asarray((p * u + q * v + r * w) / np.maximum(length, np.finfo(np.float32).tiny), np.float32)


def _grown(window: Window, stride: int) -> Window:
    """A window with its ends brought to multiples of the stride and two strides more, the reach of a slope's samples.

    It may end beyond the array, never begin before it.
    """
    x, y, z = (
        slice(max(s.start // stride - 2, 0) * stride, (-(-(s.stop - 1) // stride) + 2) * stride + 1) for s in window
    )
    return x, y, z


def between_centres(window: Window) -> Window:
    """The window of a field made here, widened to begin and end at voxels' centres."""
    x, y, z = (slice(s.start - s.start % 2, s.stop + (s.stop + 1) % 2) for s in window)
    return x, y, z


def bounding_window(occupied: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Window]:
    """Lowest corner and slices of the box around the true voxels of a grid; at least one must be true."""
    x = _span(occupied.any(axis=(1, 2)))
    y = _span(occupied[x].any(axis=(0, 2)))
    z = _span(occupied[x, y].any(axis=(0, 1)))
    return np.array([x.start, y.start, z.start]), (x, y, z)


def _span(occupied: NDArray[np.bool_] | np.bool_) -> slice:
    along = np.atleast_1d(occupied)
    return slice(int(along.argmax()), len(along) - int(along[::-1].argmax()))


def _around(grid: NDArray[Scalar], window: Window, mode: Literal["constant", "edge"] = "constant") -> NDArray[Scalar]:
    """A window of a grid with `PAD` more voxels around, made up by np.pad's `mode` where the grid ends."""
    wide = tuple(slice(max(s.start - PAD, 0), s.stop + PAD) for s in window)
    short = [(max(PAD - s.start, 0), max(s.stop + PAD - n, 0)) for s, n in zip(window, grid.shape, strict=True)]
    return np.pad(grid[wide], short, mode=mode) if any(map(any, short)) else grid[wide]


def _of(
    design: VoxelDesign, occupied: NDArray[np.bool_], layer: int, smoothing: float, opening: float, fine: bool
) -> Field:
    if design.depth is None:
        return smooth_field(occupied, design.pitch, smoothing, fine)
    return measured_field(occupied, design.depth[layer], design.pitch, smoothing, opening, fine)


def _reached(voxels: NDArray[np.bool_]) -> Window:
    """The box around voxels and `PAD` more on every side, as far as the array goes."""
    x, y, z = (slice(max(s.start - PAD, 0), s.stop + PAD) for s in bounding_window(voxels)[1])
    return x, y, z


def _towards(own: NDArray[np.bool_], others: NDArray[np.bool_]) -> NDArray[np.float32]:
    """How much nearer every voxel is to one set than to another, as a depth that is 0 half-way [voxels]."""
    there, here = (distances(~voxels) for voxels in (others, own))
    return ((there - here) / np.where(own | others, 1.0, 2.0) - np.where(own, 0.5, np.where(others, -0.5, 0.0))).astype(
        np.float32
    )


def _rounded_depth(occupied: NDArray[np.bool_], smoothing: float, most: int = NOWHERE) -> NDArray[np.float32]:
    """Euclidean depth of a voxel set at voxel centres, no more than `most` [voxels], smoothed near its surface."""
    between = distances(occupied, most) - distances(~occupied, most)
    depth = (between - np.where(occupied, 0.5, -0.5)).astype(np.float32)
    rounded = blurred(depth, smoothing)
    # Only the surface needs rounding; deep inside, smoothing would flatten the ridge where clearance is measured.
    depth += np.clip((3.0 - np.abs(depth)) / 1.5, 0.0, 1.0) * (rounded - depth)
    return depth


def _field(depth: NDArray[np.floating], low: NDArray[np.int64], pitch: float, fine: bool) -> Field:
    """Depth [voxels] on the lattice of a crop that was padded by `PAD`, with its lowest voxel at `low`."""
    x, y, z = (int(v) - PAD for v in low)
    values = np.ascontiguousarray(depth * np.float32(pitch), np.float32)
    if fine:  # Centre of voxel i is lattice index 2 i + 1; refining keeps the first sample.
        return Field(values, (2 * x + 1, 2 * y + 1, 2 * z + 1), pitch / 2)
    return Field(values, (x + 0.5, y + 0.5, z + 0.5), pitch)
