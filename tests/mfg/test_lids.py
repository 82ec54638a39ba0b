"""Lids by exact booleans: flush with the bone, loose, pulled out straight, and held by screws that bite."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone, three_motor_robot

from mfg.assembly import assembly_steps, part_names
from mfg.blueprint import Blueprint, BoxSeat, PrintedPart
from mfg.electronics_search import SearchElectronicsSolver
from mfg.exact import box_solid
from mfg.export import print_objects
from mfg.finish import FinishSolver
from mfg.guide_stock import screw_size
from mfg.guide_text import step_text
from mfg.lids import FIT, GRIP, PILOT, PLATE, SCREW, Lid, lids_of
from mfg.masses import body_masses, component_moments
from mfg.moments import printed_moments
from mfg.parts import PAPER
from mfg.plate import arrange
from mfg.solids import Solid, ball_chain, cylinder, from_field
from mfg.splitting import pieces
from mfg.stl import torn_edges, welded
from mfg.tables import bill_of_materials
from mfg.ways import Scene, blocked_volume, box_way, lid_way

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


# What the rest of the robot knows of its lids.


def test_a_lid_is_a_printed_object_of_its_own(built: Blueprint) -> None:
    found = {piece.name: [part.name for part in piece.parts] for piece in pieces(built)}
    assert all(found[f"body_0_lid_{kind}"] == [f"body_0_lid_{kind}"] for kind in KINDS)
    assert "body_0_bone" in found["body_0"]
    lays = arrange([piece.points for piece in pieces(built)], built.catalogue.printer.volume)
    assert [thing.name for thing in print_objects(built, lays)] == list(found)


def test_the_body_weighs_what_it_is_printed_and_filled_with_lids_included(built: Blueprint) -> None:
    printed = sum(printed_moments(p.solid.vertices, p.solid.triangles,
                                  PAPER.rigid if p.material == "rigid" else PAPER.soft, PAPER.printer.line_width).mass
                  for p in built.parts)  # fmt: skip
    inside = sum(moments.mass for _, moments in component_moments(built))
    assert sum(mass.mass for mass in built.masses) == pytest.approx(printed + inside)
    lids = {lid.part for lid in built.lids}
    bare = body_masses(replace(built, parts=tuple(p for p in built.parts if p.name not in lids)))
    host = built.boxes[built.lids[0].box].body
    assert built.masses[host].mass > bare[host].mass + 0.002
    assert [m.mass for k, m in enumerate(bare) if k != host] == [
        m.mass for k, m in enumerate(built.masses) if k != host
    ]


def test_the_bill_counts_lids_and_their_screws_once(built: Blueprint) -> None:
    rows = list(csv.DictReader(io.StringIO(bill_of_materials(built))))
    assert [row["item"] for row in rows if row["kind"] == "printed lid"] == [lid.part for lid in built.lids]
    screws = [row for row in rows if row["item"] == SCREW]
    assert [int(row["quantity"]) for row in screws] == [len(lid.screws) for lid in built.lids]
    rigid = next(row for row in rows if row["item"] == PAPER.rigid.name)
    weighed = sum(printed_moments(p.solid.vertices, p.solid.triangles, PAPER.rigid, PAPER.printer.line_width).mass
                  for p in built.parts if p.material == "rigid")  # fmt: skip
    assert float(rigid["mass_g"]) == pytest.approx(1e3 * weighed, abs=0.1)
    assert all(row["mass_g"] == "" for row in rows if row["kind"] == "printed lid")


def test_a_screw_does_not_meet_the_end_of_its_hole_and_holds_by_twice_its_size() -> None:
    size, length = screw_size(SCREW)
    in_bone = length - PLATE / 2
    assert 2 * size <= in_bone <= GRIP - 5e-4


def test_leads_pass_the_notch_with_the_lid_in_place(built: Blueprint) -> None:
    for lid in built.lids:
        seat = built.boxes[lid.box]
        up, centre = seat.T_design_box[:3, 2], seat.T_design_box[:3, 3]
        inward = centre + ((lid.notch - centre) @ up) * up - lid.notch
        lead = lid.notch + 2.6e-3 * inward / np.linalg.norm(inward)  # 4.5 mm thick, against the wall
        way = upright(seat, lead, seat.size[2] / 2 + 1e-4 - seat.shaft, 0.05, 2.25e-3)
        for solid in (part(built, lid.part).solid, part(built, "body_0_bone").solid):
            assert way.overlap(solid) < 1e-12


def test_a_cable_across_the_plug_does_not_keep_the_lid_down(robot: Blueprint) -> None:
    seat = robot.boxes[0]
    # From the edge of the box out through the side of its shaft, above the box.
    across, up = seat.T_design_box[:3, 0], seat.T_design_box[:3, 2]
    edge = seat.T_design_box[:3, 3] + (seat.size[2] / 2 + 0.004) * up + (seat.size[0] / 2 - 0.006) * across
    cable = ball_chain(np.stack([edge, edge + 0.15 * across]), 3.5e-3, 8)
    plain, _ = lids_of(robot, bones_of(robot), [])
    assert plain[0].solid.overlap(cable) > 1e-8  # it is in the way
    found, _ = lids_of(robot, bones_of(robot), [cable])
    lid = next((lid for lid in found if lid.seat == 0), None)
    assert lid is not None
    for distance in (0.0, 0.002, 0.006, 0.012, 0.05):
        assert lid.solid.moved(along(seat, distance)).overlap(cable) < 1e-12, distance


def test_the_guide_closes_every_box_right_after_it_went_in(built: Blueprint) -> None:
    steps = assembly_steps(built)
    assert sorted(name for step in steps for name in step.adds) == sorted(part_names(built))
    for k, lid in enumerate(built.lids):
        at = next(i for i, step in enumerate(steps) if (step.kind, step.index) == ("lid", k))
        assert (steps[at - 1].kind, steps[at - 1].index) == ("box", lid.box)
        assert steps[at].trouble == ""
        text = " ".join(step_text(built, steps[at]))
        assert f"{len(lid.screws)} screws {SCREW}" in text
        assert "notch" in text
    assert "no lid" not in " ".join(line for step in steps for line in step_text(built, step))


def test_the_battery_comes_out_when_its_lid_is_off_and_only_then(built: Blueprint) -> None:
    scene, everything = Scene.of(built), frozenset(range(len(built.bodies)))
    index = next(k for k, seat in enumerate(built.boxes) if seat.kind == "battery")
    assert box_way(scene, index, everything, []).free
    lid = next(k for k, lid in enumerate(built.lids) if lid.box == index)
    assert lid_way(scene, lid, everything).free
    out = built.boxes[index].T_design_box[:3, 2]
    assert blocked_volume([scene.boxes[index]], [scene.lids[lid]], out) > 1e-6
