"""Motion: the cylindrical shortcuts agree with turning the bodies and intersecting them exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blueprints import turned
from scipy import ndimage

from decoder.design import VoxelDesign
from mfg.blueprint import Blueprint
from mfg.bones import BoneSolver
from mfg.motion import CylindricalPair, MotionSolver, Reaches, _running_maximum, carve
from mfg.mounts import motor_pose
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.skeleton import SkeletonSolver
from mfg.solids import from_field


def boned(design: VoxelDesign) -> Blueprint:
    blueprint = Blueprint(design, PAPER)
    for solver in (SkeletonSolver(), BoneSolver()):
        answer = solver.solve(blueprint)
        assert isinstance(answer, Blueprint), answer
        blueprint = answer
    return blueprint


def test_interference_equals_the_exact_boolean(elbow: VoxelDesign) -> None:
    blueprint = boned(elbow)
    theta, hinge = MotionSolver(), blueprint.hinges[0]
    parent, child = (blueprint.bodies[i].bone for i in (hinge.parent, hinge.body))
    pair = CylindricalPair.sample(
        parent, child, motor_pose(hinge.position, hinge.axis, 0.0), theta.angle_step, theta.radial_step
    )
    assert pair is not None
    curve = pair.interference()
    P, C = from_field(parent), from_field(child)
    for k in (0, 10, -12, 18, 24, -30):
        exact = P.overlap(C.moved(turned(hinge, k * pair.step)))
        assert curve[k] == pytest.approx(exact, abs=max(0.05 * exact, 1.5e-6)), k
    assert curve.max() > 2e-5  # The elbow really folds into itself, so the test can fail.


def test_the_carved_pair_turns_freely(elbow: VoxelDesign) -> None:
    blueprint = boned(elbow)
    before = [b.bone.volume() for b in blueprint.bodies]
    solved = MotionSolver().solve(blueprint)
    assert isinstance(solved, Blueprint)
    hinge = solved.hinges[0]
    P, C = (from_field(solved.bodies[i].bone) for i in (hinge.parent, hinge.body))
    for angle in np.linspace(*hinge.range, 9):
        assert P.overlap(C.moved(turned(hinge, angle))) < 1e-8
    after = [b.bone.volume() for b in solved.bodies]
    # The bone that does not give way only loses sharp edges.
    assert 0.99 * before[hinge.body] < after[hinge.body] <= before[hinge.body]
    assert after[hinge.parent] <= before[hinge.parent]


def test_range_only_ever_narrows_and_keeps_the_rest_pose(elbow: VoxelDesign) -> None:
    blueprint = boned(elbow)
    solved = MotionSolver().solve(blueprint)
    assert isinstance(solved, Blueprint)
    wanted, got = blueprint.hinges[0].range, solved.hinges[0].range
    assert wanted[0] <= got[0] <= 0 <= got[1] <= wanted[1]


def test_a_blocked_joint_is_a_motor_failure(elbow: VoxelDesign) -> None:
    failure = replace(MotionSolver(), max_interference=1e-9, min_range=2.2).solve(boned(elbow))
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.MOTOR, Reason.NO_MOTION)
    assert "joint_1" in failure.detail


@pytest.mark.parametrize(("ahead", "behind"), [(0, 0), (1, 0), (0, 3), (4, 2), (7, 8), (20, 30)])
def test_running_maximum_equals_the_definition(ahead: int, behind: int) -> None:
    values = np.random.default_rng(3).normal(size=(2, 24, 3)).astype(np.float32)
    got = _running_maximum(values, ahead, behind)
    for k in range(24):
        window = [(k + d) % 24 for d in range(-ahead, behind + 1)]
        np.testing.assert_array_equal(got[:, k], values[:, window].max(axis=1))


def test_bones_never_overlap_at_rest(elbow: VoxelDesign) -> None:
    blueprint = boned(elbow)
    a, b = (from_field(body.bone) for body in blueprint.bodies)
    assert a.overlap(b) == 0.0
    assert ndimage.label(blueprint.bodies[0].bone.values > 0)[1] == 1


def test_reach_is_that_of_the_samples_and_is_found_anew_for_a_new_bone(elbow: VoxelDesign) -> None:
    blueprint = boned(elbow)
    hinge, bone, reaches = blueprint.hinges[0], blueprint.bodies[0].bone, Reaches()
    frame = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    thin = bone.with_values(np.where(bone.points()[..., 0] < bone.centroid()[0], bone.values, -1.0).astype(np.float32))
    found = []
    for field in (bone, bone, thin):
        there = (field.points()[field.values > -field.spacing] - hinge.position) @ frame.T
        radius = np.linalg.norm(there[:, :2], axis=1)
        found.append(reaches.of(field, hinge.position, frame))
        wanted = radius.min(), radius.max(), there[:, 2].min(), there[:, 2].max()
        np.testing.assert_allclose(found[-1], wanted, atol=1e-7)
    assert found[0] is found[1]
    assert found[0] != found[2]


def test_carving_is_the_same_in_the_window_of_the_pair_as_in_the_whole_bone(
    elbow: VoxelDesign, monkeypatch: pytest.MonkeyPatch
) -> None:
    blueprint = boned(elbow)
    theta, hinge = MotionSolver(), blueprint.hinges[0]
    bones = blueprint.bodies[hinge.parent].bone, blueprint.bodies[hinge.body].bone
    pair = CylindricalPair.sample(
        *bones, motor_pose(hinge.position, hinge.axis, 0.0), theta.angle_step, theta.radial_step
    )
    assert pair is not None
    swept = pair.swept(-1.0, 1.0, of_child=True)
    near, lost = carve(blueprint.bodies[hinge.parent], pair, swept, hinge, theta.gap)
    monkeypatch.setattr(CylindricalPair, "window", lambda _, field, position: field.window(position, 10.0))
    whole, lost_of_whole = carve(blueprint.bodies[hinge.parent], pair, swept, hinge, theta.gap)
    assert (near.bone.values < bones[0].values).any()
    np.testing.assert_array_equal(near.bone.values, whole.bone.values)
    assert lost == lost_of_whole
