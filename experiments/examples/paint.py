"""Paint the example sketches: `python experiments/examples/paint.py` writes the .vox files beside this one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decoder.sketch import HINGE, PALETTE, SOFT_NEAREST
from decoder.vox import VoxModel, write_vox

SIZE = 62
Triple = tuple[float, float, float]
ALONG_Y: Triple = (0.0, 1.0, 0.0)


def blob(centre: Triple, radii: Triple, power: float = 3.0, yaw: float = 0.0) -> NDArray[np.bool_]:
    """A superellipsoid in voxels, turned by `yaw` [rad] about z; power 2 is an ellipsoid, more is boxier."""
    x, y, z = _offsets(centre)
    ahead, aside = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    return sum(np.abs(d / r) ** power for d, r in zip((ahead, aside, z), radii, strict=True)) < 1.0


def rod(start: Triple, end: Triple, first: float, last: float) -> NDArray[np.bool_]:
    """A round bone between two points, of radius `first` at its start and `last` at its end, with round ends."""
    offset = np.stack(_offsets(start), axis=-1)
    axis = np.subtract(end, start)
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
    bones = [blob((31, 31, 40), (14.0, 14.0, 7.0), 2.6)]
    soft = blob((31, 31, 40.5), (15.0, 15.0, 8.5), 2.6)
    hinges = []
    for yaw in np.radians((0.0, 120.0, 240.0)):
        out = np.array([np.cos(yaw), np.sin(yaw)])
        at = lambda r, z: (31 + r * out[0], 31 + r * out[1], z)
        bones.append(rod(at(12.0, 29.0), at(15.5, 15.0), 6.2, 4.8))
        soft |= rod(at(12.0, 27.0), at(15.5, 15.0), 7.0, 6.2)
        hinges.append((at(11.0, 34.0), (-out[1], out[0], 0.0)))
    return sketch(bones, soft, hinges)


def crawler() -> VoxModel:
    """A belly that drags and two arms of two joints, shoulder and elbow, that pull it."""
    bones = [blob((16, 31, 16), (14.0, 13.0, 8.0))]
    soft = blob((16, 31, 15.5), (14.8, 14.0, 9.3))
    hinges = []
    for y in (23.0, 39.0):
        bones.append(blob((40, y, 20), (9.0, 6.0, 6.0)))
        soft |= blob((40, y, 20), (9.0, 6.8, 7.0))
        hinges.append(((31.5, y, 18.0), ALONG_Y))
    for y in (23.0, 39.0):
        bones.append(rod((50, y, 16), (52, y, 12), 6.0, 4.8))
        soft |= rod((50, y, 15), (52, y, 12), 6.8, 6.2)
        hinges.append(((47.5, y, 21.0), ALONG_Y))
    return sketch(bones, soft, hinges)


def inchworm() -> VoxModel:
    """Four links in a row that bend up and down."""
    bones, soft = [], np.zeros((SIZE,) * 3, bool)
    for x, half in ((9.0, 9.0), (24.5, 6.5), (37.5, 6.5), (53.0, 9.0)):
        bones.append(blob((x, 31, 12), (half, 7.5, 7.0)))
        soft |= blob((x, 31, 11.5), (half, 8.5, 8.0))
    hinges = [((x, 31.0, 12.0), ALONG_Y) for x in (18.0, 31.0, 44.0)]
    return sketch(bones, soft, hinges)


SKETCHES = (quadruped, tripod, crawler, inchworm)


def main() -> None:
    """Write every example."""
    for paint in SKETCHES:
        write_vox(Path(__file__).parent / f"{paint.__name__}.vox", paint())


def _offsets(centre: Triple) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """How far the middle of every voxel lies from a point, along x, y and z."""
    x, y, z = np.meshgrid(*(np.arange(SIZE) + 0.5 - c for c in centre), indexing="ij")
    return x, y, z


if __name__ == "__main__":
    main()
