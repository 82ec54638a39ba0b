"""Paint the example sketches: `python experiments/examples/paint.py` writes the .vox files beside this one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decoder.sketch import HINGE, PALETTE, SOFT_NEAREST
from decoder.vox import VoxModel, write_vox

SIZE = 62
GRID = np.stack(np.meshgrid(*[np.arange(SIZE) + 0.5] * 3, indexing="ij"), axis=-1)  # the middle of every voxel
Triple = tuple[float, float, float]
ALONG_Y: Triple = (0.0, 1.0, 0.0)


def blob(centre: Triple, radii: Triple, power: float = 3.0) -> NDArray[np.bool_]:
    """A superellipsoid in voxels; power 2 is an ellipsoid, more is boxier."""
    return (np.abs((GRID - centre) / radii) ** power).sum(axis=-1) < 1.0


def rod(start: Triple, end: Triple, first: float, last: float) -> NDArray[np.bool_]:
    """A round bone between two points, of radius `first` at its start and `last` at its end, with round ends."""
    offset, axis = GRID - start, np.subtract(end, start)
    along = np.clip(offset @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(offset - along[..., None] * axis, axis=-1) < first + along * (last - first)


def sketch(bones: list[NDArray[np.bool_]], soft: NDArray[np.bool_], hinges: list[tuple[Triple, Triple]]) -> VoxModel:
    """Bones in order (the first wins where they meet), flesh around them, a line of voxels along every hinge axis."""
    index = np.zeros((SIZE,) * 3, np.uint8)
    index[soft] = SOFT_NEAREST
    free = np.ones(index.shape, bool)
    for number, bone in enumerate(bones, start=1):
        index[bone & free] = number
        free &= ~bone
    for centre, axis in hinges:
        for step in range(-2, 3):
            index[tuple(np.floor(np.add(centre, step * np.asarray(axis))).astype(int))] = HINGE
    return VoxModel(index, PALETTE)


def quadruped() -> VoxModel:
    """A torso on four legs, each swinging fore and aft."""
    torso = blob((31, 31, 40), (14, 11.5, 7.0))
    soft = blob((31, 31, 40.5), (14.8, 12.5, 8.5))
    bones, hinges = [torso], []
    for x in (21.0, 41.0):
        for y in (24.0, 38.0):
            bones.append(blob((x, y, 25), (5.5, 6.0, 10.5)))
            soft |= blob((x, y, 23.5), (6.5, 6.8, 10.5))
            hinges.append(((x, y, 34.0), ALONG_Y))
    return sketch(bones, soft, hinges)


def tripod() -> VoxModel:
    """A round torso on three splayed legs, each swinging out and in."""
    bones, hinges = [blob((31, 31, 40), (14.0, 14.0, 7.0), 2.6)], []
    soft = blob((31, 31, 40.5), (15.0, 15.0, 8.5), 2.6)
    for yaw in np.radians((0.0, 120.0, 240.0)):
        hip, knee, foot = (_polar(r, yaw, z) for r, z in ((11.0, 34.0), (12.0, 29.0), (15.5, 15.0)))
        bones.append(rod(knee, foot, 6.2, 4.8))
        soft |= rod(knee, foot, 7.0, 6.2)
        hinges.append((hip, (-np.sin(yaw), np.cos(yaw), 0.0)))
    return sketch(bones, soft, hinges)


def crawler() -> VoxModel:
    """A belly that drags and two arms of two joints, shoulder and elbow, that pull it."""
    bones = [blob((19, 31, 14), (10.5, 13.0, 7.5), 2.6)]
    soft = blob((19, 31, 13.8), (11.5, 14.0, 8.9), 2.6)
    shoulders, elbows = [], []
    for y in (22.0, 40.0):
        bones.append(rod((36, y, 19.5), (42.5, y, 22.5), 6.2, 6.0))
        soft |= rod((36, y, 19.5), (42.5, y, 22.5), 7.0, 6.8)
        shoulders.append(((30.0, y, 16.0), ALONG_Y))
    for y in (22.0, 40.0):
        bones.append(rod((49, y, 19), (50, y, 8), 6.0, 4.4))
        soft |= rod((49.5, y, 17.5), (50, y, 8), 6.8, 5.6)
        elbows.append(((46.0, y, 25.0), ALONG_Y))
    return sketch(bones, soft, shoulders + elbows)


def inchworm() -> VoxModel:
    """Four links in a row that bend up and down."""
    bones, soft = [], np.zeros((SIZE,) * 3, bool)
    for x, half in ((10.0, 8.5), (24.5, 6.5), (37.5, 6.5), (52.0, 8.5)):
        bones.append(blob((x, 31, 12), (half, 6.5, 7.0), 2.6))
        soft |= blob((x, 31, 12), (half + 1, 7.6, 8.2), 2.6)
    return sketch(bones, soft, [((x, 31.0, 12.0), ALONG_Y) for x in (18.0, 31.0, 44.0)])


SKETCHES = (quadruped, tripod, crawler, inchworm)


def main() -> None:
    """Write every example."""
    for paint in SKETCHES:
        write_vox(Path(__file__).parent / f"{paint.__name__}.vox", paint())


def _polar(radius: float, yaw: float, z: float) -> Triple:
    """The point `radius` from the middle of the grid in direction `yaw`, at height z."""
    return (SIZE / 2 + radius * float(np.cos(yaw)), SIZE / 2 + radius * float(np.sin(yaw)), z)


if __name__ == "__main__":
    main()
