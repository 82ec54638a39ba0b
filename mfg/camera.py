"""The camera of a picture: what it shows, the rays through its pixels, and where a point falls on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

FILLED = 0.92  # share of the picture that the body may fill
LENS = float(np.tan(np.radians(11.0)))  # half the field of view; small, so that a body looks like a drawing of itself


@dataclass(frozen=True, eq=False)
class Camera:
    """Where a picture is taken from.

    Attributes:
        target: the point in the middle [m], (3,).
        axes: right, up, back (towards the viewer), as rows (3, 3).
        distance: from the eye to the target; infinite in parallel projection [m].
        half: of the picture's height in the plane of the target [m].
    """

    target: NDArray[np.float64]
    axes: NDArray[np.float64]
    distance: float
    half: float

    @classmethod
    def fitted(
        cls, points: NDArray[np.float64], azimuth: float, elevation: float, size: tuple[int, int], perspective: bool
    ) -> Camera:
        """The camera that just shows all points from a direction."""
        back = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        axes = np.stack([right, np.cross(back, right), back])
        seen = points @ axes.T
        target = (seen.min(0) + seen.max(0)) / 2
        aspect = size[0] / size[1]
        limit = np.array([aspect, 1.0]) * FILLED
        distance, half = np.inf, 1e-6
        for _ in range(8):  # recentring moves the outline a little, because near points look larger
            local = seen - target
            if not perspective:
                half = max(float((np.abs(local[:, :2]).max(0) / limit).max()), 1e-6)
                break
            distance = max(float((np.abs(local[:, :2]) / (limit * LENS) + local[:, 2:]).max()), 1e-5)
            depth = (distance - local[:, 2:]) / distance
            flat = local[:, :2] / np.maximum(depth, 1e-9)
            target[:2] += (flat.min(0) + flat.max(0)) / 2
            half = distance * LENS
        return cls(target @ axes, axes, distance, half)

    def rays(self, size: tuple[int, int]) -> tuple[F32, F32]:
        """Start and unit direction of the ray through each sample, row by row, (w h, 3) both."""
        width, height = size
        x = ((np.arange(width) + 0.5) / width * 2 - 1) * (self.half * width / height)
        y = (1 - (np.arange(height) + 0.5) / height * 2) * self.half
        right, up, back = self.axes
        plane = (x[None, :, None] * right + y[:, None, None] * up).reshape(-1, 3)
        if not np.isfinite(self.distance):
            start = plane + self.target + back * (self.half * 50)
            return start.astype(np.float32), np.broadcast_to(-back.astype(np.float32), plane.shape)
        direction = plane - back * self.distance
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        eye = (self.target + back * self.distance).astype(np.float32)
        return np.broadcast_to(eye, plane.shape), direction.astype(np.float32)


def project(
    points: NDArray[np.float64], bounds: NDArray[np.float64], size: tuple[int, int], azimuth: float, elevation: float,
    *, perspective: bool = True,
) -> NDArray[np.float64]:  # fmt: skip
    """Where `render` with these bounds draws points (n, 3): columns and rows from the top left [pixels], (n, 2)."""
    camera = Camera.fitted(shown_points(bounds), azimuth, elevation, size, perspective)
    x, y, z = camera.axes @ (np.asarray(points, np.float64) - camera.target).T
    nearer = camera.distance / (camera.distance - z) if np.isfinite(camera.distance) else 1.0
    width, height = size
    across = x * nearer / (camera.half * width / height)
    return np.stack([(1 + across) / 2 * width, (1 - y * nearer / camera.half) / 2 * height], axis=-1)


def shown_points(bounds: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points that a picture with these bounds just shows: the corners of a box (2, 3), or (n, 3) themselves."""
    array = np.asarray(bounds, np.float64)
    return _corners(array) if len(array) == 2 else array


def _corners(box: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
