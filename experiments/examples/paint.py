"""Paint the example sketches: `python experiments/examples/paint.py` writes the .vox files beside this one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decoder.sketch import HINGE, PALETTE, SOFT_NEAREST
from decoder.vox import VoxModel, write_vox

SIZE = 62
Triple = tuple[float, float, float]


def blob(centre: Triple, radii: Triple, power: float = 3.0) -> NDArray[np.bool_]:
    """A superellipsoid in voxels; power 2 is an ellipsoid, more is boxier."""
    grid = np.stack(np.meshgrid(*[np.arange(SIZE) + 0.5] * 3, indexing="ij"), axis=-1)
    return (np.abs((grid - centre) / radii) ** power).sum(axis=-1) < 1.0


def sketch(bones: list[NDArray[np.bool_]], soft: NDArray[np.bool_], hinges: list[tuple[Triple, int]]) -> VoxModel:
    """Bones in order (the first wins where they meet), flesh around them, hinge lines of five voxels along an axis."""
    index = np.zeros((SIZE,) * 3, np.uint8)
    index[soft] = SOFT_NEAREST
    free = np.ones(index.shape, bool)
    for number, bone in enumerate(bones, start=1):
        index[bone & free] = number
        free &= ~bone
    for centre, axis in hinges:
        for step in range(-2, 3):
            voxel = np.floor(centre).astype(int)
            voxel[axis] += step
            index[tuple(voxel)] = HINGE
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
            hinges.append(((x, y, 34.0), 1))
    return sketch(bones, soft, hinges)


def main() -> None:
    """Write every example."""
    here = Path(__file__).parent
    write_vox(here / "quadruped.vox", quadruped())


if __name__ == "__main__":
    main()
