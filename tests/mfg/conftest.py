"""Small bodies built in code, sized for the paper's motor."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import ellipsoid, painted

from decoder.design import Joint, VoxelDesign


@pytest.fixture(scope="session")
def elbow() -> VoxelDesign:
    """Two stout bones at a right angle that fold into each other within their range."""
    upper = ellipsoid((24, 32, 24), (13, 6, 6))
    lower = ellipsoid((40, 32, 36), (6, 6, 14))
    joint = Joint(np.array([0.36, 0.32, 0.25]), np.array([0.0, 1.0, 0.0]), np.array([-1.4, 1.4]), 1, 2)
    return painted([upper, lower], (joint,))


@pytest.fixture(scope="session")
def creature() -> VoxelDesign:
    """A torso that can host the electronics, with two legs and soft tissue all over."""
    torso = ellipsoid((32, 32, 40), (13, 9, 8))
    legs = [ellipsoid((x, 32, 20), (6, 6, 13)) for x in (14, 50)]
    joints = tuple(
        Joint(np.array([x * 0.01, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-1.0, 1.0]), 1, i)
        for i, x in ((2, 16.5), (3, 47.5))
    )
    soft = ellipsoid((32, 32, 40), (14.8, 11, 10))
    for x in (14, 50):
        soft |= ellipsoid((x, 32, 20), (7.5, 7.5, 14.5))
    return painted([torso, *legs], joints, soft)
