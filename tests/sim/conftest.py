"""Robots described in code, without voxels: a quadruped of boxes, and a pendulum that hangs from a heavy root."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mfg.description import DescribedJoint, Description, Link
from mfg.parts import J60_6

LEGS = ((0.13, 0.15), (0.13, -0.15), (-0.13, 0.15), (-0.13, -0.15))


def corners(size: tuple[float, float, float], centre: tuple[float, float, float]) -> NDArray[np.float64]:
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return signs * size + centre


def box(name: str, parent: int, at: tuple[float, float, float], mass: float, size: tuple[float, float, float],
        centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Link:  # fmt: skip
    squares = np.square(size)
    # A little skew, so that a transposed or dropped product of inertia shows.
    skew = 0.1 * squares.min() * np.array([[0, 1, 2], [1, 0, 3], [2, 3, 0]])
    inertia = mass / 12 * (np.diag(squares.sum() - squares) + skew)
    return Link(name, parent, np.array(at), mass, np.array(centre), inertia, corners(size, centre))


@pytest.fixture(scope="session")
def quadruped() -> Description:
    """A torso of 0.3 m on four legs that swing fore and aft."""
    T_link_imu = np.eye(4)
    T_link_imu[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T_link_imu[:3, 3] = 0.05, 0.02, 0.01
    links = [box("torso", -1, (0.3, 0.3, 0.2), 2.5, (0.3, 0.2, 0.1))]
    joints = []
    for index, (x, y) in enumerate(LEGS, start=1):
        links.append(box(f"leg_{index}", 0, (x, y, 0.0), 0.4, (0.06, 0.06, 0.18), (0.0, 0.0, -0.07)))
        axis, limits = np.array([0.0, 1.0, 0.0]), np.array([-0.9, 1.1])
        joints.append(DescribedJoint(f"joint_{index}", index, axis, limits, J60_6, index, 1))
    return Description("quadruped", tuple(links), tuple(joints), 0, T_link_imu, "blueprint", 0.16)


@pytest.fixture(scope="session")
def pendulum() -> Description:
    """A bob on a light rod under a root so heavy that it stays where it is while both fall or float."""
    root = replace(box("root", -1, (0.0, 0.0, 0.0), 1e9, (0.1, 0.1, 0.1)), inertia=1e9 * np.eye(3))
    rod = box("rod", 0, (0.0, 0.0, 0.0), 0.5, (0.02, 0.02, 0.3), (0.0, 0.0, -0.15))
    joint = DescribedJoint("swing", 1, np.array([0.0, 1.0, 0.0]), np.array([-3.0, 3.0]), J60_6, 1, 1)
    return Description("pendulum", (root, rod), (joint,), 0, np.eye(4), "design", 1.0)


@pytest.fixture(scope="module")
def short_evaluation() -> Iterator[None]:
    """Ten seconds of dozens of robots after every chunk or race would be all that tests of training do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sim.verdict.EVALUATION_SECONDS", 0.2)
        yield
