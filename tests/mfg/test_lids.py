"""Lids by exact booleans: flush with the bone, loose, pulled out straight, and held by screws that bite."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone, three_motor_robot

from mfg.blueprint import Blueprint, BoxSeat, PrintedPart
from mfg.electronics_search import SearchElectronicsSolver
from mfg.exact import box_solid
from mfg.finish import FinishSolver
from mfg.lids import FIT, GRIP, PILOT, PLATE, Lid, lids_of
from mfg.parts import PAPER
from mfg.solids import Solid, cylinder, from_field
from mfg.stl import torn_edges, welded

KINDS = ("battery", "controller")


def bones_of(blueprint: Blueprint) -> list[Solid]:
    return [from_field(body.bone, FinishSolver.tolerance) for body in blueprint.bodies]


def along(seat: BoxSeat, distance: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = distance * seat.T_design_box[:3, 2]
    return T


def upright(seat: BoxSeat, point: np.ndarray, low: float, high: float, radius: float) -> Solid:
    """A cylinder along the opening of a box, between two heights above a point."""
    T = seat.T_design_box.copy()
    T[:3, 3] = point
    return cylinder(radius, low, high, 32).moved(T)


@pytest.fixture(scope="module")
def robot() -> Blueprint:
    answer = SearchElectronicsSolver().solve(replace(three_motor_robot(), boxes=()))
    assert isinstance(answer, Blueprint), str(answer)
    return answer


@pytest.fixture(scope="module")
def built(robot: Blueprint) -> Blueprint:
    answer = FinishSolver(lids=True).solve(robot)
    assert isinstance(answer, Blueprint), str(answer)
    return answer


@pytest.fixture(scope="module")
def lids(robot: Blueprint) -> list[Lid]:
    found, notes = lids_of(robot, bones_of(robot), [])
    assert notes == []
    return found


def part(blueprint: Blueprint, name: str) -> PrintedPart:
    return next(p for p in blueprint.parts if p.name == name)


def test_without_the_option_nothing_changes(robot: Blueprint, built: Blueprint) -> None:
    plain = FinishSolver().solve(robot)
    assert isinstance(plain, Blueprint)
    names = [p.name for p in built.parts]
    assert [p.name for p in plain.parts] == [name for name in names if "_lid_" not in name]
    assert {name for name in names if "_lid_" in name} == {f"body_0_lid_{kind}" for kind in KINDS}


def test_lids_close_and_share_nothing_with_anything(built: Blueprint) -> None:
    for kind in KINDS:
        lid = part(built, f"body_0_lid_{kind}")
        assert lid.material == "rigid"
        assert not len(torn_edges(welded(lid.solid)[1]))
        assert len(lid.solid.components()) == 1
        assert lid.solid.volume > 1e-6
        for other in built.parts:
            assert other is lid or other.solid.overlap(lid.solid) < 1e-12
        for seat in built.boxes:
            assert box_solid(seat).overlap(lid.solid) < 1e-12


def test_a_lid_fills_its_opening_flush_with_the_bone(robot: Blueprint, lids: list[Lid]) -> None:
    bone = bones_of(robot)[0]
    for lid in lids:
        seat = robot.boxes[lid.seat]
        assert (lid.solid - bone).volume < 1e-12
        # A post through the middle of the opening is filled from above the cavity up to where the bone ended.
        half = seat.size[2] / 2 + seat.clearance
        post = upright(seat, seat.T_design_box[:3, 3], half, seat.shaft, 0.002)
        assert (post ^ bone).volume == pytest.approx((post ^ lid.solid).volume, rel=1e-6)


def test_a_lid_is_pulled_out_straight_and_does_not_fall_in(robot: Blueprint, built: Blueprint, lids: list[Lid]) -> None:
    bone = part(built, "body_0_bone").solid
    for lid in lids:
        seat = robot.boxes[lid.seat]
        for distance in (0.001, 0.005, 0.02, 0.05, 0.1):
            assert bone.overlap(lid.solid.moved(along(seat, distance))) < 1e-12
        assert bone.overlap(lid.solid.moved(along(seat, -0.001))) > 1e-8
        side = np.eye(4)
        side[:3, 3] = 3 * FIT * seat.T_design_box[:3, 0]
        assert bone.overlap(lid.solid.moved(side)) > 1e-9


def test_screws_pass_the_lid_and_bite_in_the_bone(robot: Blueprint, built: Blueprint, lids: list[Lid]) -> None:
    bone = part(built, "body_0_bone").solid
    for lid in lids:
        seat = robot.boxes[lid.seat]
        assert 2 <= len(lid.screws) <= 4
        middle = seat.T_design_box[:3, 3]
        across = (lid.screws - middle) @ seat.T_design_box[:3, :2]
        assert (across @ across.T).min() < 0  # two of them lie across the opening from each other
        for head in lid.screws:
            shank = upright(seat, head, -PLATE / 2, 0.05, PILOT)
            assert shank.overlap(lid.solid) < 1e-12
            assert shank.overlap(bone) < 1e-12
            # The head rests on the lid, the thread has bone all around.
            assert upright(seat, head, -PLATE / 2, 0.0, 0.0031).overlap(lid.solid) > 1e-8
            wall = upright(seat, head, -PLATE / 2 - GRIP + 5e-4, -PLATE / 2 - 5e-4, PILOT + 1e-3)
            hole = upright(seat, head, -PLATE / 2 - GRIP, -PLATE / 2, PILOT * 0.95)
            assert hole.overlap(bone) < 1e-12
            around = (wall - upright(seat, head, -PLATE / 2 - GRIP, 0.0, PILOT * 1.02)).volume
            assert wall.overlap(bone) == pytest.approx(around, rel=0.05)


@pytest.mark.parametrize(("wall", "holds"), [(0.0045, False), (0.012, True)])
def test_where_no_screw_finds_hold_there_is_no_lid_but_a_note(wall: float, holds: bool) -> None:
    size = np.array(PAPER.battery.size)
    T = np.eye(4)
    T[:3, 3] = 0.3
    seat = BoxSeat("battery", 0, PAPER.battery.size, T, 0.001, size[2] / 2 + 0.001 + wall + 0.005)
    bone = box_bone((0.3, 0.3, 0.3), size + 0.002 + 2 * wall)
    blueprint = replace(blueprint_of([bone]), boxes=(seat,))
    found, notes = lids_of(blueprint, bones_of(blueprint), [])
    assert (len(found), len(notes)) == ((1, 0) if holds else (0, 1))
    assert all("no lid" in note for note in notes)
