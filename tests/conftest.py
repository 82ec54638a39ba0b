"""What every test may use: reproducible property tests, and the smallest body that has a joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from decoder.design import GRID, Joint, Material, VoxelDesign

# The same examples every time, and no deadline: a test must not fail because the machine is busy.
settings.register_profile(
    "bodyplan", derandomize=True, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("bodyplan")


def make_hinge(**changes: object) -> VoxelDesign:
    """Two boxes of bone, 1 in -x and 2 in +x, with a hinge about y between them."""
    material = np.zeros((GRID,) * 3, np.uint8)
    segment = np.zeros((GRID,) * 3, np.int16)
    for number, (low, high) in enumerate(((8, 31), (33, 56)), start=1):
        box = np.s_[low:high, 22:42, 26:38]
        material[box], segment[box] = Material.RIGID, number
    middle = np.array([32.0, 32.0, 32.0]) * 0.01
    joint = Joint(position=middle, axis=np.array([0.0, 1.0, 0.0]), range=np.array([-0.6, 0.6]), parent=1, child=2)
    fields: dict[str, object] = {"material": material, "segment": segment, "pitch": 0.01, "joints": (joint,)}
    return VoxelDesign(**(fields | changes))  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def hinge() -> VoxelDesign:
    return make_hinge()


@pytest.fixture
def hinge_file(hinge: VoxelDesign, tmp_path: Path) -> Path:
    path = tmp_path / "hinge.npz"
    hinge.save(path)
    return path
