"""The search for motors: strong, clear of each other, and failing with reasons that teach."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from bodies import ellipsoid, painted

from decoder.design import Joint, VoxelDesign
from mfg.addresses import turn_sign
from mfg.blueprint import Blueprint
from mfg.bones import BoneSolver
from mfg.finish import FinishSolver
from mfg.motion import MotionSolver
from mfg.motor_search import FUSED, SearchMotorSolver
from mfg.motors import MotorSolver, envelopes_meet
from mfg.mount_sections import Sections
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import J60_6, PAPER
from mfg.skeleton import SkeletonSolver
from mfg.skins import SkinSolver
from mfg.strength import Plastic

MOUNT = mount_of(J60_6)
Y = np.array([0.0, 1.0, 0.0])


def ready(design: VoxelDesign) -> Blueprint:
    blueprint = Blueprint(design, PAPER)
    for solver in (SkeletonSolver(), BoneSolver(), SkinSolver(), MotionSolver()):
        answer = solver.solve(blueprint)
        assert isinstance(answer, Blueprint), answer
        blueprint = answer
    return blueprint


def solved(design: VoxelDesign, solver: SearchMotorSolver | None = None) -> Blueprint:
    answer = (solver or SearchMotorSolver()).solve(ready(design))
    assert isinstance(answer, Blueprint), answer
    return answer


@pytest.fixture(scope="module")
def neck() -> VoxelDesign:
    """A stout bone and one that is stout at the hinge and at its far end, and two voxels thin in between."""
    stout = ellipsoid((22, 32, 32), (13, 8, 8))
    neck = np.zeros_like(stout)
    neck[34:42, 29:35, 29:35] = True
    neck[42:47, 31:33, 31:33] = True
    head = ellipsoid((52, 32, 32), (6, 7, 7))
    return painted([stout, neck | head], (Joint(np.array([0.345, 0.32, 0.32]), Y, np.array([-0.6, 0.6]), 1, 2),))


def test_every_seat_is_strong_by_its_own_account_and_clear_of_the_others(creature: VoxelDesign) -> None:
    found = solved(creature)
    solver = SearchMotorSolver()
    plastic = Plastic.of(found.catalogue.rigid, found.catalogue.printer)
    before = ready(creature)
    for hinge, seat in zip(found.hinges, found.seats, strict=True):
        assert {seat.holder, seat.connector} == {hinge.parent, hinge.body}
        safety = min(
            Sections.sample(
                before.bodies[body].bone, hinge.position, hinge.axis, MOUNT, plastic, solver.scan
            ).safety(seat.offset, half, found.pointing(seat) < 0)
            for half, body in (("holder", seat.holder), ("connector", seat.connector))
        )  # fmt: skip
        assert seat.safety == pytest.approx(safety)
        assert safety >= solver.min_safety
        T = seat.T_design_motor
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose(T[:3, 3], hinge.position + seat.offset * hinge.axis, atol=1e-12)
        assert abs(T[:3, 2] @ hinge.axis) == pytest.approx(1.0)
    for a, b in itertools.combinations(found.seats, 2):
        assert not envelopes_meet(a.T_design_motor, b.T_design_motor, MOUNT, solver.gap)


def test_the_same_design_gives_the_same_seats(creature: VoxelDesign) -> None:
    one, other = solved(creature), solved(creature)
    for a, b in zip(one.seats, other.seats, strict=True):
        assert a.T_design_motor.tobytes() == b.T_design_motor.tobytes()
        assert (a.score, a.safety, a.turn) == (b.score, b.safety, b.turn)


def test_without_a_demand_on_strength_no_joint_scores_worse_than_the_papers_scan(elbow: VoxelDesign) -> None:
    """More offsets, both directions, no bound on strength: the best S can only grow (to within the slices sampled)."""
    paper = MotorSolver().solve(ready(elbow))
    assert isinstance(paper, Blueprint)
    free = solved(elbow, SearchMotorSolver(min_safety=0.0, spread=0.0, candidates=10**6))
    assert free.seats[0].score >= 0.97 * paper.seats[0].score


def test_a_seat_below_tau_is_taken_where_it_is_strong(elbow: VoxelDesign) -> None:
    demanding = MotorSolver(min_overlap=1.0)
    assert isinstance(demanding.solve(ready(elbow)), Failure)
    assert solved(elbow).seats[0].safety is not None


def test_a_thin_neck_is_refused_with_factor_bound_and_remedy(neck: VoxelDesign) -> None:
    failure = SearchMotorSolver().solve(ready(neck))
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.MOTOR, Reason.WEAK_MOUNT)
    assert "safety factor" in failure.detail
    assert "needs 2.00" in failure.detail
    assert "thicken segment 2" in failure.detail
    assert failure.miss is not None
    assert (failure.miss.joints, failure.miss.bodies, failure.miss.remedy) == ((0,), (1,), "thicken_near_joint")
    assert (failure.miss.what, failure.miss.unit, failure.miss.need) == ("safety factor", "1", 2.0)
    assert 0 <= failure.miss.have < 2.0


def test_a_neck_that_is_stout_enough_passes(neck: VoxelDesign) -> None:
    """The same body with the neck that the failure asks for, only more of it."""
    stout = ellipsoid((22, 32, 32), (13, 8, 8))
    thick = np.zeros_like(stout)
    thick[34:47, 29:35, 29:35] = True
    head = ellipsoid((52, 32, 32), (6, 7, 7))
    found = solved(painted([stout, thick | head], neck.joints))
    assert found.seats[0].safety is not None
    assert found.seats[0].safety >= 2.0


def test_bones_out_of_reach_name_the_body_and_the_distance() -> None:
    near, far = ellipsoid((24, 32, 32), (12, 8, 8)), ellipsoid((54, 32, 32), (8, 8, 8))
    joint = Joint(np.array([0.36, 0.32, 0.32]), Y, np.array([-0.6, 0.6]), 1, 2)
    blueprint = ready(painted([near, far], (joint,)))
    failure = SearchMotorSolver().solve(blueprint)
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.NO_OVERLAP
    assert "grow segment 2" in failure.detail
    assert failure.miss is not None
    assert failure.miss.bodies == (1,)
    assert failure.miss.grow > 0
    assert failure.miss.shortfall == pytest.approx(SearchMotorSolver().min_overlap, rel=0.2)


def test_two_joints_in_one_place_collide_and_both_are_named() -> None:
    trunk = ellipsoid((32, 32, 46), (14, 12, 10))
    legs = [ellipsoid((32, y, 26), (9, 5, 9)) for y in (26, 38)]
    joints = tuple(Joint(np.array([0.32, 0.01 * y, 0.355]), np.array([1.0, 0, 0]), np.array([-0.6, 0.6]), 1, i)
                   for i, y in ((2, 30), (3, 34)))  # fmt: skip
    failure = SearchMotorSolver(scan=0.02, min_safety=0.0, min_overlap=1e-12).solve(
        ready(painted([trunk, *legs], joints))
    )
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.MOTOR_COLLISION
    assert "joint_1" in failure.detail
    assert "joint_2" in failure.detail
    assert failure.miss is not None
    assert set(failure.miss.joints) == {0, 1}


def test_walls_grow_only_as_far_as_the_mounts_need(creature: VoxelDesign) -> None:
    strong = solved(creature, SearchMotorSolver(strength=1e9))
    assert strong.catalogue is PAPER
    assert not strong.notes
    found = solved(creature)
    walls = found.catalogue.rigid.walls
    assert PAPER.rigid.walls <= walls <= SearchMotorSolver.most_walls
    if walls > PAPER.rigid.walls:
        assert any(f"{walls} walls" in note for note in found.notes)


def test_a_flipped_motor_turns_the_joint_the_other_way(elbow: VoxelDesign) -> None:
    found = solved(elbow)
    seat = found.seats[0]
    back = seat.T_design_motor.copy()
    back[:3, 1:3] *= -1
    flipped = replace(seat, T_design_motor=back)
    assert found.pointing(seat) == -found.pointing(flipped)
    assert turn_sign(found, seat) == -turn_sign(found, flipped)


@pytest.mark.parametrize("flip", [False, True])
def test_exact_solids_accept_the_seats_in_both_directions(creature: VoxelDesign, flip: bool) -> None:
    found = solved(creature)
    if flip:  # The mirror image of a seat, where the room beside the joint is the same.
        seats = []
        for seat in found.seats:
            T = seat.T_design_motor.copy()
            T[:3, 1:3] *= -1
            seats.append(replace(seat, T_design_motor=T))
        found = replace(found, seats=tuple(seats))
    built = FinishSolver(min_overlap=FUSED).solve(found)
    assert isinstance(built, Blueprint), built
    assert len([part for part in built.parts if part.material == "rigid"]) == len(found.bodies)
