"""Collision-free ranges: tried by turning exact solids, every moved body against every standing one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blueprints import turned

from decoder.design import VoxelDesign
from mfg.blueprint import Blueprint
from mfg.bones import BoneSolver
from mfg.motion import MotionSolver
from mfg.motion_search import SearchMotionSolver
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.skeleton import SkeletonSolver
from mfg.skins import SkinSolver
from mfg.solids import from_field

SOLVER = SearchMotionSolver()


def boned(design: VoxelDesign) -> Blueprint:
    blueprint = Blueprint(design, PAPER)
    for solver in (SkeletonSolver(), BoneSolver(), SkinSolver()):
        answer = solver.solve(blueprint)
        assert isinstance(answer, Blueprint), answer
        blueprint = answer
    return blueprint


@pytest.mark.parametrize("name", ["elbow", "creature"])
def test_nothing_that_a_joint_moves_meets_anything_that_stands(name: str, request: pytest.FixtureRequest) -> None:
    solved = SOLVER.solve(boned(request.getfixturevalue(name)))
    assert isinstance(solved, Blueprint)
    solids = [from_field(body.bone) for body in solved.bodies]
    for hinge in solved.hinges:
        for angle in np.linspace(*hinge.range, 7):
            moved = solids[hinge.body].moved(turned(hinge, angle))
            for index, solid in enumerate(solids):
                if index != hinge.body:
                    # Between bodies that no joint joins, `touch` is allowed.
                    allowed = 1e-8 if index == hinge.parent else SOLVER.touch * min(solid.volume, moved.volume)
                    assert moved.overlap(solid) <= allowed


def test_every_joint_gets_the_minimum_and_no_more_than_the_design_asks(elbow: VoxelDesign) -> None:
    blueprint = boned(elbow)
    wanted = blueprint.hinges[0].range
    for minimum in (0.1, 0.26, 0.6, 5.0):
        solved = replace(SOLVER, minimum=minimum, max_loss=1.0, max_carved=1.0).solve(blueprint)
        assert isinstance(solved, Blueprint)
        low, high = solved.hinges[0].range
        assert wanted[0] <= low <= max(wanted[0], -minimum)
        assert min(wanted[1], minimum) <= high <= wanted[1]


def test_carving_for_less_takes_less(elbow: VoxelDesign) -> None:
    blueprint = boned(elbow)
    left = []
    for solver in (SOLVER, replace(SOLVER, minimum=1.0), MotionSolver()):
        solved = solver.solve(blueprint)
        assert isinstance(solved, Blueprint)
        left.append(sum(body.bone.volume() for body in solved.bodies))
    assert left[0] > left[1]
    assert left[0] > left[2]


def test_a_joint_without_room_is_a_failure_that_names_what_meets(elbow: VoxelDesign) -> None:
    failure = replace(SOLVER, minimum=1.4, max_carved=0.01).solve(boned(elbow))
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.MOTOR, Reason.NO_MOTION)
    for word in ("joint_1", "body_0", "body_1", "rad", "would mend it"):
        assert word in failure.detail
