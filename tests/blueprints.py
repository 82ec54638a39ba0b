"""Blueprints built in code from shapes whose depth is known, for tests of what comes after the motors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from bodies import ellipsoid, painted
from numpy.typing import NDArray

from decoder.design import Joint
from mfg.blueprint import Blueprint, Body, Hinge, MotorSeat
from mfg.electronics import ElectronicsSolver
from mfg.fields import Field, box_distance
from mfg.mounts import motor_pose
from mfg.parts import PAPER

SPACING = 0.005
Shape = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def sampled(shape: Shape, low: Sequence[float], high: Sequence[float]) -> Field:
    """The depth of a shape on the lattice between two corners [m], with some room around."""
    first = np.floor(np.array(low) / SPACING).astype(int) - 3
    count = np.ceil(np.array(high) / SPACING).astype(int) + 4 - first
    grid = Field(np.zeros(count, np.float32), tuple(int(v) for v in first), SPACING)  # type: ignore[arg-type]
    return grid.with_values(shape(grid.points()).astype(np.float32))


def box_bone(centre: Sequence[float], size: Sequence[float], turn: NDArray[np.float64] | None = None) -> Field:
    """A box of bone, turned about its centre."""
    T, half = np.eye(4), np.array(size) / 2
    T[:3, 3] = centre
    T[:3, :3] = np.eye(3) if turn is None else turn
    reach = np.abs(T[:3, :3]) @ half
    return sampled(lambda p: -box_distance(p, T, half), T[:3, 3] - reach, T[:3, 3] + reach)


def ball_bone(centre: Sequence[float], radius: float) -> Field:
    """A ball of bone."""
    c = np.array(centre)
    return sampled(lambda p: radius - np.linalg.norm(p - c, axis=-1), c - radius, c + radius)


def tube_bone(radius: float, half_length: float) -> Field:
    """A cylinder of bone about x, centred in the design frame."""

    def depth(p: NDArray[np.float64]) -> NDArray[np.float64]:
        radial = radius - np.hypot(p[..., 1] - 0.3, p[..., 2] - 0.3)
        return np.minimum(radial, half_length - np.abs(p[..., 0] - 0.3))

    return sampled(
        depth, (0.3 - half_length, 0.3 - radius, 0.3 - radius), (0.3 + half_length, 0.3 + radius, 0.3 + radius)
    )


def blueprint_of(
    bones: Sequence[Field], seats: Sequence[tuple[int, int, Sequence[float], Sequence[float]]] = (),
    skins: Sequence[Field | None] | None = None,
) -> Blueprint:  # fmt: skip
    """A blueprint with these bones and motors given as (holder, connector, position, axis)."""
    design = painted(
        [ellipsoid((20, 32, 32), (9, 6, 6)), ellipsoid((44, 32, 32), (9, 6, 6))],
        (Joint(np.array([0.32, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-1.0, 1.0]), 1, 2),),
    )
    skins = skins or [None] * len(bones)
    bodies = tuple(
        Body(f"body_{i}", i + 1, bone, skin) for i, (bone, skin) in enumerate(zip(bones, skins, strict=True))
    )
    hinges, motors = [], []
    for k, (holder, connector, position, axis) in enumerate(seats):
        p, a = np.array(position, float), np.array(axis, float) / np.linalg.norm(axis)
        hinges.append(Hinge(k + 1, 0, p, a, np.array([-1.0, 1.0])))
        motors.append(MotorSeat(k, holder, connector, 0.0, motor_pose(p, a, 0.0), 1e-5, 1e-5, 1e-5))
    return Blueprint(design, PAPER, bodies=bodies, hinges=tuple(hinges), seats=tuple(motors))


def three_motor_robot() -> Blueprint:
    """A torso with both boxes, an arm on either side and a hand on one of them: three motors."""
    bones = [
        box_bone((0.30, 0.30, 0.30), (0.24, 0.15, 0.12)),
        box_bone((0.48, 0.30, 0.30), (0.12, 0.10, 0.10)),
        box_bone((0.12, 0.30, 0.30), (0.12, 0.10, 0.10)),
        box_bone((0.60, 0.30, 0.30), (0.12, 0.10, 0.10)),
    ]
    seats = [(0, 1, (0.43, 0.30, 0.30), (0, 1, 0)), (2, 0, (0.17, 0.30, 0.30), (0, 1, 0)),
             (1, 3, (0.55, 0.30, 0.30), (0, 0, 1))]  # fmt: skip
    answer = ElectronicsSolver().solve(blueprint_of(bones, seats))
    assert isinstance(answer, Blueprint), str(answer)
    return answer


def turned(hinge: Hinge, angle: float) -> NDArray[np.float64]:
    """Rigid motion of the child when its joint stands at `angle` (Rodrigues)."""
    a = hinge.axis
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    T[:3, 3] = hinge.position - T[:3, :3] @ hinge.position
    return T
