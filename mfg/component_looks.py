"""How a bought part looks: an STL beside its file, for pictures and assembly views only, never for a solver."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

MM_PER_M = 1000.0  # STL is in millimetres by custom
TOLERANCE = 1e-3  # by which looks may leave the stated cylinder or box [m]
LEAST_SHARE = 0.3  # of the stated extent along every axis: less is a wrong unit or a wrong part
MOST_TRIANGLES = 200_000
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


class LooksError(ValueError):
    """A mesh that cannot stand for its part; the message says why."""


@dataclass(frozen=True, eq=False, slots=True)
class Looks:
    """A surface in the part's own frame, origin at the centre of its stated cylinder or box.

    Attributes:
        vertices: [m], (n, 3).
        triangles: vertex indices, (m, 3).
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]


def read_looks(path: Path, room: tuple[float, float, float], *, round_: bool) -> Looks:
    """Read a binary or text STL in mm, whose frame is the part's, and check that it fits the part.

    Args:
        path: of the STL.
        room: stated extents [m].
        round_: the part is a cylinder about z, else a box.

    Raises:
        LooksError: if it is no such STL, or leaves its room by more than `TOLERANCE`, or is much smaller.
    """
    try:
        corners = _corners(path.read_bytes()) / MM_PER_M
    except OSError as error:
        raise LooksError(f"it cannot be read ({error.strerror})") from None
    if not len(corners) or len(corners) > MOST_TRIANGLES or not np.isfinite(corners).all():
        raise LooksError(f"it must be an STL of 1 to {MOST_TRIANGLES} triangles with finite corners")
    points = corners.reshape(-1, 3)
    half = np.asarray(room) / 2
    out = np.abs(points) - half
    if round_:
        out[:, 0] = out[:, 1] = np.hypot(points[:, 0], points[:, 1]) - half[0]
    worst = float(out.max())
    if worst > TOLERANCE:
        shape = f"the cylinder of {_mm(room[:1])} x {_mm(room[2:])} mm" if round_ else f"the box of {_mm(room)} mm"
        raise LooksError(
            f"it leaves {shape} about its origin by {1e3 * worst:.1f} mm, at most {1e3 * TOLERANCE:g} may be"
        )
    share = float((np.ptp(points, axis=0) / room).min())
    if share < LEAST_SHARE:
        raise LooksError(f"it fills {100 * share:.0f} % of the part's extent along an axis, at least "
                         f"{100 * LEAST_SHARE:.0f} % is expected (is it in mm?)")  # fmt: skip
    vertices, index = np.unique(points, axis=0, return_inverse=True)
    return Looks(vertices, index.reshape(-1, 3).astype(np.int64))


def _corners(data: bytes) -> NDArray[np.float64]:
    """Corners (m, 3, 3) of the triangles of an STL [mm]."""
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + count * _RECORD.itemsize:
        return np.frombuffer(data, _RECORD, count, 84)["corners"].astype(np.float64)
    words = data.split() if data.lstrip().startswith(b"solid") else []
    at = [k for k, word in enumerate(words) if word == b"vertex"]
    try:
        numbers = [[float(word) for word in words[k + 1 : k + 4]] for k in at]
        return np.array(numbers, np.float64).reshape(-1, 3, 3)
    except ValueError:
        raise LooksError("it is no STL that can be read, binary or text") from None


def _mm(extents: tuple[float, ...]) -> str:
    return " x ".join(f"{1e3 * e:.1f}" for e in extents)
