"""Depth fields: how deep a point lies inside a body, on a regular lattice of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

OUTSIDE = np.float32(-1.0)  # depth far outside [m]
Window = tuple[slice, slice, slice]
MANY = 600  # points from which on array arithmetic is faster than ndimage's loop over points
EXACT = 1 << 24  # whole numbers up to this are exact in 32 bits of floating point
BLOCK = 16384  # points at a time, so that what is worked out in between stays in the cache


@dataclass(frozen=True, eq=False, slots=True)
class Field:
    """Signed depth phi on a lattice, positive inside, about metric near the surface (|grad phi| = 1).

    Attributes:
        values: phi [m], shape (nx, ny, nz), f4.
        corner: lattice index of `values[0, 0, 0]`; sample (i, j, k) lies at (corner + (i, j, k)) * spacing in the
            design frame. All fields of a blueprint share one lattice: their corners are whole numbers apart.
        spacing: distance between samples [m].
    """

    values: NDArray[np.float32]
    corner: tuple[float, float, float]
    spacing: float

    @property
    def origin(self) -> NDArray[np.float64]:
        """Position of sample (0, 0, 0) in the design frame [m]."""
        return np.asarray(self.corner, np.float64) * self.spacing

    def points(self) -> NDArray[np.float64]:
        """Positions of all samples in the design frame [m], (nx, ny, nz, 3)."""
        axes = [self.origin[a] + np.arange(n) * self.spacing for a, n in enumerate(self.values.shape)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def axes(
        self, window: Window | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Coordinates of the samples in a window along x, y and z [m], shaped to broadcast against each other."""
        spans = window or tuple(slice(0, n) for n in self.values.shape)
        x, y, z = (((self.corner[a] + np.arange(s.start, s.stop)) * self.spacing).astype(np.float32)
                   for a, s in enumerate(spans))  # fmt: skip
        return x[:, None, None], y[None, :, None], z[None, None, :]

    def window(self, centre: NDArray[np.float64], reach: float | NDArray[np.float64]) -> Window | None:
        """The samples within `reach` [m] of a point along every (or each) axis, or None where there are none."""
        low = np.floor((centre - reach - self.origin) / self.spacing).astype(int).clip(0, self.values.shape)
        high = np.ceil((centre + reach - self.origin) / self.spacing).astype(int) + 1
        high = high.clip(0, self.values.shape)
        if (high <= low).any():
            return None
        x, y, z = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        return x, y, z

    def sample(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Depth at points (..., 3) of the design frame [m], trilinear; `OUTSIDE` beyond the lattice."""
        if points.size < 3 * MANY or min(self.values.shape) < 2:
            index = (points - self.origin) / self.spacing
            return ndimage.map_coordinates(
                self.values,
                index.transpose(points.ndim - 1, *range(points.ndim - 1)),
                np.float32,
                order=1,
                mode="constant",
                cval=float(OUTSIDE),
            )
        flat = points.reshape(-1, 3)
        blocks = (self._index(flat[k : k + BLOCK]) for k in range(0, len(flat), BLOCK))
        return np.concatenate([interpolated(self.values, *index) for index in blocks]).reshape(points.shape[:-1])

    def sample_at(
        self, x: NDArray[np.floating], y: NDArray[np.floating], z: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """The same at points whose coordinates [m], three arrays that broadcast, are good to 1e-7 m: for grids."""
        per = np.float32(1 / self.spacing)
        index = [np.asarray(v, np.float32) * per - np.float32(c) for v, c in zip((x, y, z), self.corner, strict=True)]
        shape = np.broadcast_shapes(*(v.shape for v in index))
        flat = [np.array(np.broadcast_to(v, shape)).ravel() for v in index]
        starts = range(0, max(len(flat[0]), 1), BLOCK)
        return np.concatenate([interpolated(self.values, *(v[k : k + BLOCK] for v in flat)) for k in starts]).reshape(
            shape
        )

    def _index(self, points: NDArray[np.float64]) -> list[NDArray[np.float32]]:
        """Where points (n, 3) lie, in samples along every axis, (n,) each."""
        place = np.ascontiguousarray(points.T)
        place = (place - self.origin[:, None]) / self.spacing
        return list(place.astype(np.float32))

    def sloped(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Depth at points (..., 3) as `sample` gives it, and its slope there, (..., 3) [m/m]; 0 beyond the lattice."""
        flat = points.reshape(-1, 3)
        blocks = [
            _trilinear_slope(self.values, *self._index(flat[k : k + BLOCK])) for k in range(0, max(len(flat), 1), BLOCK)
        ]
        depth, slope = (np.concatenate(part) for part in zip(*blocks, strict=True))
        slope /= np.float32(self.spacing)
        return depth.reshape(points.shape[:-1]), slope.reshape(points.shape)

    def volume(self) -> float:
        """Volume of phi > 0 with fractional cells at the surface [m3]."""
        return float(coverage(self.values, self.spacing).sum(dtype=np.float64)) * self.spacing**3

    def centroid(self) -> NDArray[np.float64]:
        """Centre of volume in the design frame [m], (3,)."""
        weight = coverage(self.values, self.spacing).astype(np.float64)
        total = weight.sum()
        means = [(weight.sum(axis=tuple(b for b in range(3) if b != a)) * np.arange(n)).sum() / total
                 for a, n in enumerate(weight.shape)]  # fmt: skip
        return self.origin + np.asarray(means) * self.spacing

    def with_values(self, values: NDArray[np.float32]) -> Field:
        """A field on the same samples."""
        return Field(np.ascontiguousarray(values, np.float32), self.corner, self.spacing)

    def on_lattice_of(self, other: Field) -> NDArray[np.float32]:
        """This field's values at the samples of `other` (same spacing), `OUTSIDE` where it has none."""
        out = np.full(other.values.shape, OUTSIDE, np.float32)
        shared = self.shared(other)
        if shared is not None:
            here, there = shared
            out[there] = self.values[here]
        return out

    def shared(self, other: Field) -> tuple[Window, Window] | None:
        """The samples that two fields have in common, as windows of this one and of the other, or None."""
        windows: list[tuple[slice, slice]] = []
        for a, b, n, m in zip(self.corner, other.corner, self.values.shape, other.values.shape, strict=True):
            shift = round(a - b)
            low, high = max(shift, 0), min(shift + n, m)
            if high <= low:
                return None
            windows.append((slice(low - shift, high - shift), slice(low, high)))
        (x, u), (y, v), (z, w) = windows
        return (x, y, z), (u, v, w)


def interpolated(
    values: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Values between samples at index x, y, z (n,), written over; `OUTSIDE` beyond.

    A third as long as `map_coordinates` takes, to 1e-5 of the difference between two samples.
    """
    first, outside = _cells(values, x, y, z)
    row, layer = values.shape[2], values.shape[1] * values.shape[2]
    flat = values.ravel()

    def along(step: int) -> NDArray[np.float32]:
        # A neighbour beyond the last sample counts for nothing: it is outside, or its weight is 0.
        low, high = flat[step:].take(first, mode="clip"), flat[step + 1 :].take(first, mode="clip")
        return _between(low, high, z)

    found = _between(_between(along(0), along(row), y), _between(along(layer), along(layer + row), y), x)
    found[outside] = OUTSIDE
    return found


def _trilinear_slope(
    values: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32], w: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The same with the slope of what is interpolated, (n, 3), per sample; 0 beyond."""
    first, outside = _cells(values, u, v, w)
    row, layer = values.shape[2], values.shape[1] * values.shape[2]
    flat = values.ravel()
    faces = []
    for face in (0, layer):
        edges = []
        for step in (face, face + row):
            low, high = flat[step:].take(first, mode="clip"), flat[step + 1 :].take(first, mode="clip")
            rise = high - low
            edges.append((low + w * rise, rise))
        (near, near_rise), (far, far_rise) = edges
        across = far - near
        faces.append((near + v * across, across, _between(near_rise, far_rise, v)))
    (near, *near_slope), (far, *far_slope) = faces
    slope = np.stack([far - near, *(_between(a, b, u) for a, b in zip(near_slope, far_slope, strict=True))], axis=-1)
    found = _between(near, far, u)
    found[outside], slope[outside] = OUTSIDE, 0
    return found, slope


def _cells(
    values: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """For points at index x, y, z: flat index of the first corner of the cell, and whether there is no cell.

    The place in the cell is written over the index.
    """
    a, b, c = (n - 1 for n in values.shape)
    outside = (x < 0) | (x > a) | (y < 0) | (y > b) | (z < 0) | (z > c)
    i, j, k = np.trunc(x), np.trunc(y), np.trunc(z)
    x -= i
    y -= j
    z -= k
    if values.size > EXACT:
        first = i.astype(np.intp) * (values.shape[1] * values.shape[2])
        return first + j.astype(np.intp) * values.shape[2] + k.astype(np.intp), outside
    i *= np.float32(values.shape[1] * values.shape[2])
    j *= np.float32(values.shape[2])
    i += j
    i += k
    return i.astype(np.intp), outside


def _between(low: NDArray[np.float32], high: NDArray[np.float32], share: NDArray[np.float32]) -> NDArray[np.float32]:
    """Interpolate, low + share (high - low), written over both."""
    high -= low
    high *= share
    low += high
    return low


def coverage(depth: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    """Share of a cell of the given width that lies inside, from the depth at its centre."""
    share = depth * np.float32(1 / width)
    share += np.float32(0.5)
    np.maximum(share, np.float32(0), out=share)
    return np.minimum(share, np.float32(1), out=share)


def cylindrical(
    axes: tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]],
    centre: NDArray[np.float64],
    axis: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distance from an axis and height along it, at every sample of a lattice window given by its `axes` [m]."""
    x, y, z = (a - np.float32(c) for a, c in zip(axes, centre, strict=True))
    u, v, w = (np.float32(c) for c in axis)
    along = x * u + y * v + z * w
    radial = np.sqrt(np.maximum(x * x + y * y + z * z - along * along, 0))
    return radial, along


def about_axis(
    T_design_axis: NDArray[np.float64], radius: NDArray[np.floating], angle: NDArray[np.floating],
    height: NDArray[np.floating],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
    """Coordinates of points about the z axis of a frame, for `Field.sample_at`; the three arrays broadcast [m]."""
    (x, y, z), o = T_design_axis[:3, :3].T, T_design_axis[:3, 3]
    a, b = radius * np.cos(angle), radius * np.sin(angle)
    # Whatever the shapes: only the last sum is as large as the grid.
    one, two, three = ((a * x[k] + b * y[k]).astype(np.float32) + (o[k] + height * z[k]).astype(np.float32)
                       for k in range(3))  # fmt: skip
    return one, two, three


def cylinder_depth(
    radial: NDArray[np.float32], along: NDArray[np.float32], radius: float, low: float, high: float
) -> NDArray[np.float32]:
    """Depth inside a cylinder, between heights low and high along its axis [m]."""
    return np.minimum(
        np.float32(radius) - radial, np.minimum(along - np.float32(low), np.float32(high) - along)
    ).astype(np.float32)


def box_depth(
    points: NDArray[np.float64], T_design_box: NDArray[np.float64], half: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Depth inside a box of the given half extents in its own frame [m] (Chebyshev inside, so exact on faces)."""
    local = (points - T_design_box[:3, 3]) @ T_design_box[:3, :3]
    x, y, z = (half[a] - np.abs(local[..., a]) for a in range(3))
    return np.minimum(np.minimum(x, y), z).astype(np.float32)


def cylinder_distance(points: NDArray[np.float64], T_design_cylinder: NDArray[np.float64], radius: float, low: float,
                      high: float) -> NDArray[np.float64]:  # fmt: skip
    """Euclidean distance from points (..., 3) to a cylinder about z of its frame; negative depth inside [m]."""
    local = points - T_design_cylinder[:3, 3]
    along = local @ T_design_cylinder[:3, 2]
    radial = np.sqrt(np.maximum(np.einsum("...i,...i->...", local, local) - along**2, 0.0)) - radius
    axial = np.maximum(low - along, along - high)
    return np.hypot(np.maximum(radial, 0), np.maximum(axial, 0)) + np.minimum(np.maximum(radial, axial), 0)


def box_distance(
    points: NDArray[np.float64], T_design_box: NDArray[np.float64], half: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Euclidean distance from points (..., 3) to a box of the given half extents; negative depth inside [m]."""
    beyond = np.abs((points - T_design_box[:3, 3]) @ T_design_box[:3, :3]) - half
    x, y, z = (beyond[..., a] for a in range(3))
    outside = np.sqrt(np.maximum(x, 0) ** 2 + np.maximum(y, 0) ** 2 + np.maximum(z, 0) ** 2)
    return outside + np.minimum(np.maximum(np.maximum(x, y), z), 0)
