"""Masks and designs for tests, painted in code; imported by name from the tests beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decoder.design import GRID, Joint, Material, VoxelDesign

CENTRES = np.stack(np.meshgrid(*[np.arange(GRID) + 0.5] * 3, indexing="ij"), axis=-1)


def ellipsoid(centre: tuple[float, float, float], radii: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Voxels inside an ellipsoid, all in voxels."""
    return (((CENTRES - centre) / radii) ** 2).sum(-1) < 1.0


def painted(
    bones: list[NDArray[np.bool_]], joints: tuple[Joint, ...], soft: NDArray[np.bool_] | None = None
) -> VoxelDesign:
    """A design from bone masks (earlier ones win) and an optional soft mask."""
    material = np.zeros((GRID,) * 3, np.uint8)
    segment = np.zeros((GRID,) * 3, np.int16)
    for index, bone in enumerate(bones, start=1):
        new = bone & (segment == 0)
        segment[new], material[new] = index, Material.RIGID
    if soft is not None:
        material[soft & (material == 0)] = Material.SOFT
    return VoxelDesign(material, segment, joints=joints)
