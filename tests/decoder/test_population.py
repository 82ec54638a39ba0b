"""What a set of bodies is like."""

from __future__ import annotations

import numpy as np

from decoder.design import GRID, Joint, Material, VoxelDesign
from decoder.population import population_of


def chain(count: int) -> VoxelDesign:
    """Boxes of 10 x 4 x 4 voxels along x, each half bone and half skin."""
    material = np.zeros((GRID,) * 3, np.uint8)
    segment = np.zeros((GRID,) * 3, np.int16)
    for k in range(count):
        material[4 + 10 * k : 14 + 10 * k, 20:22, 20:24] = Material.RIGID
        material[4 + 10 * k : 14 + 10 * k, 22:24, 20:24] = Material.SOFT
        segment[4 + 10 * k : 14 + 10 * k, 20:24, 20:24] = k + 1
    joints = tuple(
        Joint(np.array([0.04 + 0.1 * k, 0.22, 0.22]), np.array([0.0, 0.0, 1.0]), np.array([-1.0, 1.0]), k, k + 1)
        for k in range(1, count)
    )
    return VoxelDesign(material, segment, joints=joints)


def test_a_population_is_counted_and_measured() -> None:
    bodies = [chain(3), chain(2), chain(3), VoxelDesign(chain(2).material, chain(2).segment)]
    population = population_of(bodies)
    assert (population.n, population.segments) == (4, {2: 2, 3: 2})
    assert population.shapes == 2  # The one without joints has none.
    assert population.extent == 25.0
    assert population.rigid == 0.5
