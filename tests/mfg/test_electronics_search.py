"""Boxes anywhere in a bone: against the paper's rules, brute force over all places, and exact booleans on solids."""

from __future__ import annotations

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone, sampled
from scipy.spatial.transform import Rotation

from mfg.blueprint import Blueprint, BoxSeat
from mfg.box_fit import SURFACE, box_surface, least_depth, places, separation
from mfg.box_host import free_depth
from mfg.box_layout import Look, layouts_of, refined
from mfg.electronics import ElectronicsSolver
from mfg.electronics_search import SearchElectronicsSolver
from mfg.exact import box_room, box_solid, interference_above, surface_points
from mfg.fields import Field, box_distance
from mfg.mounts import envelope, mount_of
from mfg.orientations import orientations
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.solids import Solid, box, from_field

SOLVER = SearchElectronicsSolver()
MOUNT = mount_of(PAPER.motor)
BATTERY = np.array(PAPER.battery.size) / 2 + SOLVER.clearance


def cavity(seat: BoxSeat, grow: float = 0.0) -> Solid:
    half = np.array(seat.size) / 2 + seat.clearance + grow
    return box(-half, half).moved(seat.T_design_box)


def solved(blueprint: Blueprint) -> Blueprint:
    answer = SOLVER.solve(blueprint)
    assert isinstance(answer, Blueprint), str(answer)
    return answer


def check_exactly(placed: Blueprint) -> None:
    """Every promise of the solver, by booleans on solids."""
    bones = [from_field(body.bone, 0) for body in placed.bodies]
    for seat, other in (placed.boxes, placed.boxes[::-1]):
        assert (cavity(seat) - bones[seat.body]).volume < 1e-12
        surface, half = surface_points(bones[seat.body], 0.003), np.array(seat.size) / 2 + seat.clearance
        assert box_distance(surface, seat.T_design_box, half).min() > SOLVER.wall - 5e-4
        assert interference_above(placed, seat, bones) < 1e-10
        assert box_room(seat).overlap(cavity(other)) == 0.0
        for motor in placed.seats:
            assert box_room(seat).overlap(envelope(MOUNT, 0.0).moved(motor.T_design_motor)) < 1e-10
        R = seat.T_design_box[:3, :3]
        assert pytest.approx(np.eye(3), abs=1e-9) == R.T @ R
        assert np.linalg.det(R) == pytest.approx(1.0)
        size = PAPER.battery.size if seat.kind == "battery" else PAPER.computer.size
        assert sorted(seat.size) == pytest.approx(sorted(size))


def bent_bone() -> Field:
    """An L of two bars: its centre of mass lies where it has no room."""
    arms = [((0.30, 0.30, 0.30), (0.20, 0.072, 0.060)), ((0.236, 0.38, 0.30), (0.072, 0.20, 0.060))]
    poses = []
    for centre, size in arms:
        T = np.eye(4)
        T[:3, 3] = centre
        poses.append((T, np.array(size) / 2))
    return sampled(
        lambda p: np.maximum(*[-box_distance(p, T, half) for T, half in poses]), (0.2, 0.26, 0.27), (0.4, 0.48, 0.33)
    )


@pytest.fixture(scope="module")
def torso() -> Blueprint:
    bones = [box_bone((0.30, 0.30, 0.30), (0.24, 0.13, 0.11)), box_bone((0.47, 0.30, 0.38), (0.10, 0.10, 0.16))]
    return blueprint_of(bones, [(0, 1, (0.44, 0.30, 0.32), (0, 1, 0))])


def test_what_the_papers_rules_accept_is_accepted_and_keeps_every_promise(torso: Blueprint) -> None:
    assert isinstance(ElectronicsSolver().solve(torso), Blueprint)
    placed = solved(torso)
    assert [seat.kind for seat in placed.boxes] == ["battery", "controller"]
    assert {seat.body for seat in placed.boxes} == {0}
    check_exactly(placed)


def test_a_bone_that_just_takes_both_side_by_side_is_accepted() -> None:
    # Sharp edges, where trilinear samples lose most, and room for one arrangement only.
    sides = np.array([0.105 + 0.008, 0.034 + 0.030 + 0.004 + 0.003 + 0.006, 0.060 + 0.008]) + 0.003
    check_exactly(solved(blueprint_of([box_bone((0.3, 0.3, 0.3), sides)])))


def test_a_bent_bone_takes_boxes_in_its_arms_but_not_at_its_centre_of_mass() -> None:
    blueprint = blueprint_of([bent_bone()])
    assert isinstance(ElectronicsSolver().solve(blueprint), Failure)
    check_exactly(solved(blueprint))


def test_a_motor_in_the_middle_leaves_room_beside_it() -> None:
    bones = [box_bone((0.3, 0.3, 0.3), (0.30, 0.15, 0.15)), box_bone((0.6, 0.3, 0.3), (0.05, 0.05, 0.05))]
    blueprint = blueprint_of(bones, [(0, 1, (0.3, 0.3, 0.3), (0, 0, 1))])
    assert isinstance(ElectronicsSolver().solve(blueprint), Failure)
    placed = solved(blueprint)
    check_exactly(placed)
    assert placed.scores.electronics_install == 1.0


def test_boxes_spread_over_two_bones_where_none_takes_both() -> None:
    turn = Rotation.from_euler("xyz", [0.3, 0.5, 0.2]).as_matrix()
    bones = [
        box_bone((0.20, 0.2, 0.2), (0.120, 0.050, 0.062), turn),
        box_bone((0.40, 0.2, 0.2), (0.080, 0.070, 0.048)),
    ]
    placed = solved(blueprint_of(bones))
    assert [(seat.kind, seat.body) for seat in placed.boxes] == [("battery", 0), ("controller", 1)]
    check_exactly(placed)


def test_openings_keep_clear_of_a_covering_limb() -> None:
    slab = box_bone((0.3, 0.3, 0.2), (0.2, 0.16, 0.056))
    for side in (1, -1):
        cover = box_bone((0.3, 0.3, 0.2 + side * 0.05), (0.25, 0.25, 0.03))
        placed = solved(blueprint_of([slab, cover]))
        assert all(seat.T_design_box[2, 2] * side < 0.5 for seat in placed.boxes)
        check_exactly(placed)


def test_a_caged_bone_has_no_free_way_in() -> None:
    slab = box_bone((0.3, 0.3, 0.3), (0.2, 0.16, 0.056))
    walls = []
    for axis in range(3):
        for sign in (-1, 1):
            centre, size = np.full(3, 0.3), np.full(3, 0.16)
            centre[axis] += sign * (0.13, 0.11, 0.06)[axis]
            size[axis] = 0.05
            # Too thin for a box of their own.
            walls.append(box_bone(centre, np.where(np.arange(3) == axis, 0.03, size)))
    answer = SOLVER.solve(blueprint_of([slab, *walls]))
    assert isinstance(answer, Failure)
    assert "no way in is free" in answer.detail


def test_the_closest_miss_names_bone_shortfall_and_remedy_and_the_remedy_works() -> None:
    # The battery needs 34 + 2 mm and twice the wall: 42 mm; the bone has 38.
    thin = blueprint_of([box_bone((0.3, 0.3, 0.3), (0.2, 0.2, 0.038))])
    answer = SOLVER.solve(thin)
    assert isinstance(answer, Failure)
    assert (answer.stage, answer.reason) == (Stage.ELECTRONICS, Reason.NO_ROOM)
    assert "2.0 mm short in body_0" in answer.detail
    assert "by 1 voxel across its z" in answer.detail
    miss = answer.miss
    assert miss is not None
    assert (miss.bodies, miss.shortfall) == ((0,), pytest.approx(0.002, abs=2e-4))
    assert np.abs(miss.direction) == pytest.approx([0, 0, 1], abs=0.05)
    grown = blueprint_of([box_bone((0.3, 0.3, 0.305), (0.2, 0.2, 0.048))])
    check_exactly(solved(grown))


def test_where_nothing_comes_near_the_missing_thickness_is_named() -> None:
    answer = SOLVER.solve(blueprint_of([box_bone((0.3, 0.3, 0.3), (0.06, 0.06, 0.02))]))
    assert isinstance(answer, Failure)
    assert "battery" in answer.detail
    miss = answer.miss
    assert miss is not None
    assert miss.shortfall > 0.01


def test_the_same_blueprint_gives_the_same_seats(torso: Blueprint) -> None:
    for a, b in zip(solved(torso).boxes, solved(torso).boxes, strict=True):
        assert (a.T_design_box == b.T_design_box).all()
        assert (a.size, a.shaft) == (b.size, b.shaft)


def test_the_best_place_of_all_centres_and_orientations_is_among_the_places(torso: Blueprint) -> None:
    free, turns = free_depth(torso, 0), orientations(np.eye(3))[::4]
    found = places(free, BATTERY, turns, SOLVER.wall, SOLVER.slack)
    assert found.margin == pytest.approx(least_depth(free, BATTERY, found.centre, found.turn, SURFACE) - SOLVER.wall)
    middles = np.argwhere(free.values >= BATTERY.min() + SOLVER.wall)
    if len(middles) > 900:
        middles = middles[((middles + np.array(free.corner)) % 2 == 0).all(axis=1)]
    centres = (middles + np.array(free.corner)) * free.spacing
    best = max(
        float(least_depth(free, BATTERY, centres, np.broadcast_to(turn, (len(centres), 3, 3)), SURFACE).max())
        for turn in turns
    )
    assert found.margin.max() == pytest.approx(best - SOLVER.wall, abs=1e-6)


def test_separation_is_never_more_than_the_distance_and_tells_disjoint_boxes_apart() -> None:
    rng = np.random.default_rng(1)
    touching = 0
    for _ in range(60):
        halves = rng.uniform(0.01, 0.05, (2, 3))
        turns = Rotation.random(2, rng=rng).as_matrix()
        centres = np.array([np.zeros(3), rng.uniform(-0.08, 0.08, 3)])
        gap = float(separation(halves[0], centres[0], turns[0], halves[1], centres[1], turns[1]))
        points = [c + box_surface(h, 0.004) @ t.T for h, c, t in zip(halves, centres, turns, strict=True)]
        nearest = np.linalg.norm(points[0][:, None] - points[1][None], axis=-1).min()
        assert gap <= nearest + 1e-9
        poses = []
        for c, t in zip(centres, turns, strict=True):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = t, c
            poses.append(T)
        shared = box(-halves[0], halves[0]).moved(poses[0]).overlap(box(-halves[1], halves[1]).moved(poses[1]))
        if gap > 0:
            assert shared == 0.0
        touching += shared > 0
    assert 10 < touching < 50


def test_mending_finds_the_place_in_a_bone_that_is_just_large_enough() -> None:
    turn = Rotation.from_euler("xyz", [0.12, 0.08, 0.10]).as_matrix()
    # Trilinear samples lose up to a quarter of the lattice at the edges of a bone.
    free = box_bone((0.3, 0.3, 0.3), 2 * (BATTERY + SOLVER.wall + 0.0025), turn)
    start = places(free, BATTERY, orientations(np.eye(3)), SOLVER.wall, 0.012)
    near = layouts_of((start,), SOLVER.wall).nearest(8)
    assert near.margin.max() < 0
    mended = refined(free, near, SOLVER.wall, Look((0.004, 0.002, 0.001, 0.0005), 0.01, 5e-4))
    assert mended.margin.max() >= 0
    assert (mended.margin >= near.margin - 5e-4).all()


def test_a_box_beside_a_seat_is_drawn_apart(torso: Blueprint) -> None:
    placed = solved(torso)
    assert box_solid(placed.boxes[0]).overlap(box_solid(placed.boxes[1])) == 0.0
    assert cavity(placed.boxes[0], SOLVER.wall - 1e-5).overlap(cavity(placed.boxes[1])) == 0.0
