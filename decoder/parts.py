"""How the learned decoder sees one part of a body: a frame, a pose of 18 numbers, and two lattices in a box.

The formulas run on numpy arrays and on torch tensors alike: `xp` is the module that made the arrays.
"""

from __future__ import annotations

import math
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_PARTS = 8
LATTICE = (12, 12, 16)  # nodes across, across and along, from face to face of the part's box
NODES = LATTICE[0] * LATTICE[1] * LATTICE[2]
TRUNCATION = 4.0  # of the signed distances in the lattices [voxels]
BOX_SPREAD, BOX_ROOM = 2.2, 5.5  # half side of the box = 2.2 standard deviations of the bone + 5.5 voxels
SHARPNESS = 1.98  # per voxel: 1 / (1 + exp(1.98 d)) is the smoothed occupancy at signed distance d
SMOOTHING = 1.3  # variance that the same smoothing adds to a shape [voxel^2]
MIDDLE = 32.0  # of the grid [voxels]
REACH = 16.0  # scale of the torso's offset from there [voxels]
HINGES_APART = 9.0  # at least, for a motor at each [voxels]
BONES_APART = 1.5  # bones without a common hinge, at least [voxels]

# The pose of a part, one row of 18 numbers.
ATTACH = slice(0, 3)  # hinge in the carrying part's box, each face at +-1; of the torso: its offset from the middle
DIRECTION = slice(3, 6)  # unit vector from hinge to centre, in the grid; 0 for the torso
DISTANCE = slice(6, 7)  # log of hinge to centre over 8 voxels
SPREAD = slice(7, 10)  # log of the bone's standard deviation along the part's axes over 3 voxels
TENSOR = slice(10, 16)  # hinge axis a in the part's frame as a a^T: xx, yy, zz, xy, xz, yz
RANGE = slice(16, 18)  # least and greatest angle [rad]
POSE = 18
# Tolerances: a deviation of so much costs half a nat. Their ratio to a body's spread is the information a latent holds.
# A part out of place is wrong all over its surface, and so is all that it carries: places are held more tightly.
TOLERANCES = (
    ("attach", ATTACH, 0.01), ("direction", DIRECTION, 0.01), ("distance", DISTANCE, 0.01), ("spread", SPREAD, 0.015),
    ("axis", TENSOR, 0.06), ("range", RANGE, 0.08),
)  # fmt: skip
_AZIMUTH_CUT = -7 * math.pi / 8  # siblings are numbered by azimuth from here


@lru_cache(maxsize=1)
def lattice_points() -> NDArray[np.float32]:
    """Nodes of the lattice in the box [-1, 1]^3, (2304, 3), the last axis fastest."""
    axes = [np.linspace(-1.0, 1.0, count) for count in LATTICE]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(NODES, 3).astype(np.float32)
    points.setflags(write=False)
    return points


def frames_along(direction: Any, xp: ModuleType) -> Any:
    """Frame (..., 3, 3) whose third column is the unit vector `direction` (..., 3): -z turned there the short way.

    Continuous but for a limb that points straight up.
    """
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    k = 1.0 / (1.0 - z).clip(1e-3)
    across = xp.stack([1 - k * x * x, -k * x * y, x], -1)
    other = xp.stack([k * x * y, k * y * y - 1, -y], -1)
    return xp.stack([across, other, direction], -1)


def torso_frame() -> NDArray[np.float32]:
    """Frame of the torso: across is y, across is z, along is x of the grid."""
    return np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.float32)


def box_of(spread: Any) -> Any:
    """Half sides (..., 3) of a part's box from the standard deviations of its bone [voxels]."""
    return BOX_SPREAD * spread + BOX_ROOM


def tensor_of(axis: Any, xp: ModuleType) -> Any:
    """The sign-free a a^T of an axis (..., 3) as (..., 6)."""
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    return xp.stack([x * x, y * y, z * z, x * y, x * z, y * z], -1)


def axis_of(tensor: NDArray[np.floating]) -> tuple[NDArray[np.float64], float]:
    """Unit axis (3,) of a tensor (6,), and how well it is known: (l1 - l2) / (|l1| + |l2| + |l3|) of its eigenvalues.

    The sign is that of the largest component, positive.
    """
    xx, yy, zz, xy, xz, yz = (float(t) for t in tensor)
    values, vectors = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    axis = vectors[:, 2]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    total = float(np.abs(values).sum())
    return axis / np.linalg.norm(axis), float(np.clip((values[2] - values[1]) / max(total, 1e-9), 0.0, 1.0))


def order_key(depth: Any, centre: Any, torso: Any, xp: ModuleType) -> Any:
    """What parts are numbered by: depth in the tree, then azimuth of the centre (..., 3) about the torso's."""
    offset = centre - torso
    azimuth = xp.arctan2(offset[..., 1], offset[..., 0]) - _AZIMUTH_CUT
    return depth * 10.0 + azimuth % (2 * math.pi)
