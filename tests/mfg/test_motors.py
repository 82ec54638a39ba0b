"""Motors: S(delta) equals a brute-force scan of exact booleans, and the best offset is really the best."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from decoder.design import VoxelDesign
from mfg.blueprint import Blueprint
from mfg.bones import BoneSolver
from mfg.motion import MotionSolver
from mfg.motors import MotorSolver, envelopes_meet
from mfg.mounts import connector, envelope, holder, motor_pose, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import J60_6, PAPER
from mfg.scores import mount_balance
from mfg.skeleton import SkeletonSolver
from mfg.solids import Solid, from_field

MOUNT = mount_of(J60_6)


def ready(design: VoxelDesign) -> Blueprint:
    blueprint = Blueprint(design, PAPER)
    for solver in (SkeletonSolver(), BoneSolver(), MotionSolver()):
        answer = solver.solve(blueprint)
        assert isinstance(answer, Blueprint), answer
        blueprint = answer
    return blueprint


def test_the_scan_equals_exact_booleans_at_every_offset(elbow: VoxelDesign) -> None:
    blueprint = ready(elbow)
    solver, hinge = MotorSolver(), blueprint.hinges[0]
    offsets = solver.offsets()
    largest = 0.0
    for body in (hinge.parent, hinge.body):
        bone = from_field(blueprint.bodies[body].bone)
        halves: tuple[tuple[Literal["holder", "connector"], Solid], ...]
        halves = (("holder", holder(MOUNT)), ("connector", connector(MOUNT)))
        for part, solid in halves:
            fast = solver.rings(blueprint.bodies[body].bone, hinge, MOUNT).overlaps(offsets, part)
            for k in range(0, len(offsets), 5):
                exact = bone.overlap(solid.moved(motor_pose(hinge.position, hinge.axis, float(offsets[k]))))
                assert fast[k] == pytest.approx(exact, rel=0.04, abs=4e-7), (body, part, offsets[k])
                largest = max(largest, exact)
    assert largest > 5e-6  # There is something to measure.


def test_the_seat_is_the_brute_force_optimum(elbow: VoxelDesign) -> None:
    blueprint = ready(elbow)
    solver, hinge = MotorSolver(), blueprint.hinges[0]
    solved = solver.solve(blueprint)
    assert isinstance(solved, Blueprint)
    seat = solved.seats[0]
    best = 0.0
    bones = [from_field(b.bone) for b in blueprint.bodies]
    for h, c in ((0, 1), (1, 0)):
        for offset in solver.offsets():
            T = motor_pose(hinge.position, hinge.axis, float(offset))
            V_h, V_c = bones[h].overlap(holder(MOUNT).moved(T)), bones[c].overlap(connector(MOUNT).moved(T))
            best = max(best, solver.objective(V_h, V_c))
    exact = solver.objective(
        bones[seat.holder].overlap(holder(MOUNT).moved(seat.T_design_motor)),
        bones[seat.connector].overlap(connector(MOUNT).moved(seat.T_design_motor)),
    )
    assert exact >= 0.97 * best
    assert seat.score == pytest.approx(mount_balance(seat.holder_volume, seat.connector_volume, solver.alpha))


def test_below_tau_nothing_scores() -> None:
    solver = MotorSolver()
    tau = solver.min_overlap
    assert solver.objective(tau * 0.999, 1.0) == 0.0
    assert solver.objective(1.0, tau * 0.999) == 0.0
    assert solver.objective(tau, tau) == pytest.approx(tau + 2 * solver.alpha * tau)


def test_a_weak_mount_is_refused_with_both_volumes(elbow: VoxelDesign) -> None:
    failure = replace(MotorSolver(), min_overlap=1e-3).solve(ready(elbow))
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.MOTOR, Reason.NO_OVERLAP)
    assert "1000.0 cm3" in failure.detail


@pytest.mark.parametrize("seed", range(12))
def test_meeting_envelopes_agree_with_exact_booleans(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(2, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    A = motor_pose(np.zeros(3), axes[0], 0.0)
    B = motor_pose(rng.uniform(-0.11, 0.11, 3), axes[1], 0.0)
    gap = 2e-3
    exact = envelope(MOUNT, 0.0).moved(A).overlap(envelope(MOUNT, 0.0).moved(B))
    if exact > 1e-9:
        assert envelopes_meet(A, B, MOUNT, gap)
    if not envelopes_meet(A, B, MOUNT, gap):
        assert exact == 0.0


def test_motor_pose_is_a_rotation_with_z_along_the_axis() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        T = motor_pose(np.array([0.1, 0.2, 0.3]), axis, 0.05)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose(T[:3, 2], axis, atol=1e-12)
        np.testing.assert_allclose(T[:3, 3], np.array([0.1, 0.2, 0.3]) + 0.05 * axis)
