"""Small bodies built in code, sized for the paper's motor."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import ellipsoid, painted

from decoder.design import Joint, VoxelDesign
from mfg.pipeline import Outcome, build


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
    torso = ellipsoid((32, 32, 40), (13.5, 9, 9))
    legs = [ellipsoid((x, 32, 24), (6, 7, 13)) for x in (20, 44)]
    joints = tuple(
        Joint(np.array([x * 0.01, 0.32, 0.345]), np.array([0.0, 1.0, 0.0]), np.array([-1.0, 1.0]), 1, i)
        for i, x in ((2, 20), (3, 44))
    )
    soft = ellipsoid((32, 32, 40), (14.5, 11, 11))
    for x in (20, 44):
        soft |= ellipsoid((x, 32, 24), (7.5, 8.5, 14.5))
    return painted([torso, *legs], joints, soft)


@pytest.fixture(scope="session")
def built(creature: VoxelDesign) -> Outcome:
    """The creature, all the way to printable parts."""
    outcome = build(creature)
    assert outcome.ok, outcome.failure
    return outcome


@pytest.fixture(scope="session")
def plain(creature: VoxelDesign) -> Outcome:
    """The same by the paper's rules: no lids, nothing split."""
    outcome = build(creature, rules="paper")
    assert outcome.ok, outcome.failure
    return outcome
