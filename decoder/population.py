"""What a set of bodies is like, in a few numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from decoder.design import Material, VoxelDesign
from decoder.kinematics import tree_shape


@dataclass(frozen=True)
class Population:
    """What a set of bodies is like.

    Attributes:
        n: how many.
        segments: how many have so many segments, ascending.
        shapes: distinct tree shapes.
        extent: mean of the longest side of the box around a body [voxels].
        rigid: mean share of a body that is bone.
    """

    n: int
    segments: Mapping[int, int]
    shapes: int
    extent: float
    rigid: float


def population_of(designs: Sequence[VoxelDesign]) -> Population:
    """Describe a set of at least one body."""
    extents = [float(np.ptp(design.bounds, axis=0).max()) / design.pitch for design in designs]
    filled = [np.count_nonzero(design.material) for design in designs]
    bone = [np.count_nonzero(design.material == Material.RIGID) for design in designs]
    return Population(
        n=len(designs),
        segments=dict(sorted(Counter(len(design.segments) for design in designs).items())),
        shapes=len({tree_shape(design) for design in designs} - {None}),
        extent=float(np.mean(extents)),
        rigid=float(np.mean(np.divide(bone, filled))),
    )
