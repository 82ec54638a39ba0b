"""Painted voxels in, a design out: the palette convention, and joints where the painter left them to us.

A sketch is a MagicaVoxel model of at most 62 x 62 x 62 voxels, z up. The palette index of a voxel says what it is:

    index       meaning
    1 - 32      bone of segment 1 - 32
    101 - 132   soft tissue of segment 1 - 32
    200         soft tissue of the nearest bone
    250         hinge: a straight run of two or more voxels; its middle is the joint, its direction the hinge axis

A hinge joins the two segments nearest to its middle, both within 4 voxels of it; its voxels become bone of the nearer
one. Two segments that touch without a hinge between them get an inferred one, unless that would close a loop.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder.design import DEFAULT_PITCH, GRID, DesignError, Joint, Material, VoxelDesign
from decoder.vox import Colour, read_vox

SEGMENTS = 32  # most segments of a sketch
SOFT_OFFSET = 100  # soft tissue of segment k is painted with index 100 + k
SOFT_NEAREST = 200
HINGE = 250
LARGEST = GRID - 2  # voxels along a side, so that a margin of one is left
RANGE = 1.0  # how far a painted joint may turn either way before the motion solver narrows it [rad]
MIN_CONTACT = 4  # voxel faces that two segments must share to be joined by an inferred hinge
ELONGATED = 1.3  # a contact patch this much longer than wide tells the hinge axis
HINGE_REACH = 4.0  # voxels from the middle of a painted hinge within which it must find two segments
EVERY_NEIGHBOUR = np.ones((3, 3, 3), bool)

PALETTE: dict[int, Colour] = {
    **{k: (225 - 9 * (k % 4), 220 - 17 * (k % 7), 205 - 23 * (k % 5), 255) for k in range(1, SEGMENTS + 1)},
    **{SOFT_OFFSET + k: (70 + 4 * k, 120 + 3 * k, 190, 255) for k in range(1, SEGMENTS + 1)},
    SOFT_NEAREST: (92, 148, 204, 255),
    HINGE: (190, 30, 45, 255),
}


def load_design(path: Path | str) -> VoxelDesign:
    """Read a design from .npz, or a sketch from .vox.

    Raises:
        DesignError: if the file holds no design that could be built upon, saying what is wrong and where.
        OSError: if it cannot be read at all.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".npz":
        return VoxelDesign.load(path)
    if suffix == ".vox":
        model = read_vox(path)
        try:
            return from_palette(model.index)
        except DesignError as error:
            raise DesignError(f"{path}: {error}") from None
    raise DesignError(f"{path}: cannot read designs of type {suffix or 'none'!r}; use .npz or .vox")


def from_palette(index: NDArray[np.uint8], pitch: float = DEFAULT_PITCH) -> VoxelDesign:
    """Turn palette indices (x, y, z) into a design, centred in the grid.

    Raises:
        DesignError: if an index has no meaning, the sketch is empty or too large, or a hinge cannot be understood.
    """
    unknown = sorted(set(np.unique(index).tolist()) - {0, *PALETTE})
    if unknown:
        raise DesignError(
            f"palette index {unknown[0]} has no meaning; use 1-{SEGMENTS} bone, "
            f"{SOFT_OFFSET + 1}-{SOFT_OFFSET + SEGMENTS} or {SOFT_NEAREST} soft, {HINGE} hinge"
        )
    painted = _centred(index)
    segment = np.where((painted >= 1) & (painted <= SEGMENTS), painted, 0).astype(np.int16)
    if not segment.any():
        raise DesignError(f"the sketch has no bone; paint at least one voxel with an index of 1 to {SEGMENTS}")
    hinges = _painted_hinges(painted, segment, pitch)
    material = np.where(segment > 0, Material.RIGID, Material.EMPTY).astype(np.uint8)
    owned = (painted > SOFT_OFFSET) & (painted <= SOFT_OFFSET + SEGMENTS) & (segment == 0)
    material[owned | ((painted == SOFT_NEAREST) & (segment == 0))] = Material.SOFT
    bones = segment.copy()
    segment[owned] = painted[owned].astype(np.int16) - SOFT_OFFSET
    return VoxelDesign(material, segment, pitch, (*hinges, *_inferred(bones, hinges, pitch)))


def _centred(index: NDArray[np.uint8]) -> NDArray[np.uint8]:
    filled = np.argwhere(index > 0)
    if not len(filled):
        raise DesignError("the sketch is empty")
    low, high = filled.min(axis=0), filled.max(axis=0) + 1
    size = high - low
    if (size > LARGEST).any():
        raise DesignError(
            f"the sketch is {size[0]} x {size[1]} x {size[2]} voxels; at most {LARGEST} fit along each side"
        )
    start = (GRID - size) // 2
    grid = np.zeros((GRID, GRID, GRID), np.uint8)
    there = tuple(slice(int(a), int(a + n)) for a, n in zip(start, size, strict=True))
    here = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    grid[there] = index[here]
    return grid


def _painted_hinges(painted: NDArray[np.uint8], segment: NDArray[np.int16], pitch: float) -> list[Joint]:
    """The hinges that were painted; their voxels become bone, in `segment` itself."""
    runs, count = ndimage.label(painted == HINGE, EVERY_NEIGHBOUR)
    if not count:
        return []
    known = [int(s) for s in np.unique(segment) if s > 0]
    bones = {s: (np.argwhere(segment == s) + 0.5) * pitch for s in known}
    joints = []
    for run in range(1, count + 1):
        voxels = np.argwhere(runs == run)
        centres = (voxels + 0.5) * pitch
        middle = centres.mean(axis=0)
        if len(voxels) < 2:
            raise DesignError(f"the hinge at voxel {voxels[0].tolist()} of the grid is a single voxel; paint a line")
        spread, axes = np.linalg.eigh(np.cov(centres.T))
        if spread[2] <= 4 * spread[1]:
            raise DesignError(f"the hinge around {middle.round(3).tolist()} m is a blob; paint a straight line")
        away = {s: float(np.linalg.norm(bones[s] - middle, axis=1).min()) for s in known}
        near = sorted(known, key=lambda s: (away[s], s))
        if len(near) < 2:
            raise DesignError("a hinge joins two segments, but the sketch has only one")
        if away[near[1]] > HINGE_REACH * pitch:
            raise DesignError(
                f"the hinge around {middle.round(3).tolist()} m is {away[near[1]] / pitch:.0f} voxels from segment "
                f"{near[1]}; it must lie within {HINGE_REACH:g} voxels of the two segments it joins"
            )
        a, b = sorted(near[:2])
        joints.append(Joint(middle, _upright(axes[:, 2]), np.array([-RANGE, RANGE]), a, b))
        for voxel, centre in zip(voxels, centres, strict=True):
            owner = min(near[:2], key=lambda s: (float(np.linalg.norm(bones[s] - centre, axis=1).min()), s))
            segment[tuple(voxel)] = owner
    return joints


def _inferred(bones: NDArray[np.int16], hinges: list[Joint], pitch: float) -> list[Joint]:
    """A hinge for every pair of touching segments that has none, largest contact first, never closing a loop."""
    group = {int(s): int(s) for s in np.unique(bones) if s > 0}

    def find(s: int) -> int:
        while group[s] != s:
            s = group[s]
        return s

    joined = set()
    for joint in hinges:
        joined.add((joint.parent, joint.child))
        group[find(joint.parent)] = find(joint.child)
    patches = _contacts(bones, pitch)
    found = []
    for (a, b), patch in sorted(patches.items(), key=lambda item: (-len(item[1]), item[0])):
        if (a, b) in joined or len(patch) < MIN_CONTACT or find(a) == find(b):
            continue
        group[find(a)] = find(b)
        axis, confidence = _axis(patch, bones, a, b, pitch)
        found.append(Joint(patch.mean(axis=0), axis, np.array([-RANGE, RANGE]), a, b, confidence))
    return found


def _contacts(bones: NDArray[np.int16], pitch: float) -> dict[tuple[int, int], NDArray[np.float64]]:
    """Centres of the voxel faces that each pair of segments shares [m], (n, 3)."""
    faces: dict[tuple[int, int], list[NDArray[np.float64]]] = {}
    for axis in range(3):
        a, b = (bones.take(range(k, GRID - 1 + k), axis) for k in (0, 1))
        where = np.argwhere((a != b) & (a > 0) & (b > 0))
        centre = where + 0.5
        centre[:, axis] += 0.5
        for face, low, high in zip(centre, a[tuple(where.T)], b[tuple(where.T)], strict=True):
            faces.setdefault((int(min(low, high)), int(max(low, high))), []).append(face)
    return {pair: np.array(found) * pitch for pair, found in faces.items()}


def _axis(
    patch: NDArray[np.float64], bones: NDArray[np.int16], a: int, b: int, pitch: float
) -> tuple[NDArray[np.float64], float]:
    """The likeliest hinge axis of a contact patch, and how far to believe it.

    A long patch turns about its length. A round one says nothing; then the axis is square to both bones, and if they
    lie in line, it is level and square to them.
    """
    middle = patch.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov(patch.T))
    if spread[2] > ELONGATED**2 * spread[1]:
        return _upright(axes[:, 2]), 0.7
    along = []
    for segment in (a, b):
        direction = (np.argwhere(bones == segment) + 0.5).mean(axis=0) * pitch - middle
        along.append(direction / max(float(np.linalg.norm(direction)), 1e-9))
    square = np.cross(along[0], along[1])
    if np.linalg.norm(square) > 0.26:  # The bones bend by more than 15 degrees.
        return _upright(square / np.linalg.norm(square)), 0.5
    level = np.cross(along[1], np.array([0.0, 0.0, 1.0]))
    if np.linalg.norm(level) < 1e-3:
        level = np.array([0.0, 1.0, 0.0])
    return _upright(level / np.linalg.norm(level)), 0.2


def _upright(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """One of the two directions of an axis, by a fixed rule: its largest component is positive."""
    axis = axis / np.linalg.norm(axis)
    return axis if axis[int(np.argmax(np.abs(axis)))] > 0 else -axis
