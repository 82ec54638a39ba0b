"""Boxes in bones: containment, freedom from motors, openings and the room above, against dense and exact references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone
from scipy.spatial.transform import Rotation

from mfg.blueprint import Blueprint, BoxSeat
from mfg.box_host import free_depth
from mfg.electronics import ElectronicsSolver
from mfg.mounts import envelope, envelope_depth, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.solids import Solid, box, from_field

SOLVER = ElectronicsSolver()
MOUNT = mount_of(PAPER.motor)
TILT = Rotation.from_euler("xyz", [0.4, 0.3, 0.5]).as_matrix()


def cavity(seat: BoxSeat, grow: float = 0.0) -> Solid:
    half = np.array(seat.size) / 2 + seat.clearance + grow
    return box(-half, half).moved(seat.T_design_box)


def dense(seat: BoxSeat, step: float = 0.003) -> np.ndarray:
    half = np.array(seat.size) / 2 + seat.clearance
    axes = [np.linspace(-h, h, int(2 * h / step) + 2) for h in half]
    local = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return local @ seat.T_design_box[:3, :3].T + seat.T_design_box[:3, 3]


def solved(blueprint: Blueprint) -> Blueprint:
    answer = SOLVER.solve(blueprint)
    assert isinstance(answer, Blueprint), str(answer)
    return answer


@pytest.fixture(scope="module")
def torso() -> Blueprint:
    """A bone that takes both boxes, an arm on a motor above its end."""
    bones = [box_bone((0.30, 0.30, 0.30), (0.24, 0.13, 0.11)), box_bone((0.47, 0.30, 0.38), (0.10, 0.10, 0.16))]
    return blueprint_of(bones, [(0, 1, (0.44, 0.30, 0.32), (0, 1, 0))])


@pytest.fixture(scope="module")
def placed(torso: Blueprint) -> Blueprint:
    return solved(torso)


def test_both_boxes_go_into_the_largest_bone(placed: Blueprint) -> None:
    assert [box.kind for box in placed.boxes] == ["battery", "controller"]
    assert {box.body for box in placed.boxes} == {0}


def test_cavities_are_as_deep_as_the_wall_in_a_dense_sampling(placed: Blueprint) -> None:
    for seat in placed.boxes:
        points = dense(seat)
        # The corners decide: the bone is a box, its field is exact, and 0.1 mm is the error of trilinear samples.
        assert placed.bodies[0].bone.sample(points).min() >= SOLVER.wall - 1e-4
        assert envelope_depth(points, placed.seats[0].T_design_motor, MOUNT, SOLVER.wall).max() <= 1e-4


def test_cavities_lie_in_the_exact_bone_and_share_nothing(placed: Blueprint) -> None:
    bone = from_field(placed.bodies[0].bone, 0)
    motor = envelope(MOUNT, 0.0).moved(placed.seats[0].T_design_motor)
    rooms = [cavity(seat) for seat in placed.boxes]
    for room in rooms:
        assert (room - bone).volume < 1e-10
        assert room.overlap(motor) == 0.0
    assert cavity(placed.boxes[0], SOLVER.wall - 1e-5).overlap(rooms[1]) == 0.0


def test_the_pair_is_centred_on_the_centre_of_mass(placed: Blueprint) -> None:
    corners = [
        (np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * (np.array(s.size) / 2 + s.clearance))
        @ s.T_design_box[:3, :3].T + s.T_design_box[:3, 3]
        for s in placed.boxes
    ]  # fmt: skip
    both = np.concatenate(corners)
    centre = (both.min(0) + both.max(0)) / 2
    assert centre == pytest.approx(free_depth(placed, 0).centroid(), abs=1e-9)


def test_poses_are_rigid_and_sizes_are_the_catalogues(placed: Blueprint) -> None:
    for seat, size in zip(placed.boxes, (PAPER.battery.size, PAPER.computer.size), strict=True):
        R = seat.T_design_box[:3, :3]
        assert pytest.approx(np.eye(3), abs=1e-12) == R.T @ R
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert sorted(seat.size) == pytest.approx(sorted(size))


def test_shafts_end_outside_and_never_too_far(placed: Blueprint) -> None:
    bone = placed.bodies[0].bone
    for seat in placed.boxes:
        half = np.array(seat.size) / 2 + seat.clearance
        across = np.stack(np.meshgrid(*[np.linspace(-h, h, 30) for h in half[:2]]), axis=-1).reshape(-1, 2)
        heights = np.arange(half[2], 0.4, 0.001)
        local = np.concatenate([np.column_stack([across, np.full(len(across), z)]) for z in heights])
        points = local @ seat.T_design_box[:3, :3].T + seat.T_design_box[:3, 3]
        inside = (bone.sample(points).reshape(len(heights), -1) > 0).any(axis=1)
        last = heights[np.flatnonzero(inside)[-1]]
        assert last < seat.shaft <= last + 0.0101


def test_the_same_blueprint_gives_the_same_seats(torso: Blueprint, placed: Blueprint) -> None:
    again = solved(torso)
    for a, b in zip(placed.boxes, again.boxes, strict=True):
        assert (a.T_design_box == b.T_design_box).all()
        assert (a.size, a.shaft) == (b.size, b.shaft)
    assert again.scores == placed.scores


def test_a_tilted_bone_is_served_along_its_principal_axes() -> None:
    # Too slim for boxes along the design axes.
    placed = solved(blueprint_of([box_bone((0.3, 0.3, 0.3), (0.25, 0.085, 0.065), TILT)]))
    bone = from_field(placed.bodies[0].bone, 0)
    for seat in placed.boxes:
        assert np.abs(TILT.T @ seat.T_design_box[:3, :3]).max(axis=0) == pytest.approx(np.ones(3), abs=0.02)
        assert (cavity(seat) - bone).volume < 1e-9


def test_boxes_spread_over_the_two_largest_bones_that_take_them() -> None:
    bones = [
        box_bone((0.35, 0.2, 0.2), (0.08, 0.07, 0.045)),  # Takes the controller only.
        box_bone((0.20, 0.2, 0.2), (0.056, 0.048, 0.116)),  # Too slim for the controller beside the battery.
        box_bone((0.50, 0.2, 0.2), (0.08, 0.07, 0.044)),  # Takes the controller too, but is smaller.
    ]
    placed = solved(blueprint_of(bones))
    assert [(seat.kind, seat.body) for seat in placed.boxes] == [("battery", 1), ("controller", 0)]
    for seat in placed.boxes:
        assert (cavity(seat) - from_field(bones[seat.body], 0)).volume < 1e-9


def test_no_room_says_how_much_is_missing() -> None:
    # The battery needs 34 + 2 mm and twice the wall: 42 mm; the bone has 38.
    answer = SOLVER.solve(blueprint_of([box_bone((0.3, 0.3, 0.3), (0.2, 0.2, 0.038))]))
    assert isinstance(answer, Failure)
    assert (answer.stage, answer.reason) == (Stage.ELECTRONICS, Reason.NO_ROOM)
    assert "battery 2.0 mm short in body_0" in answer.detail
    assert "controller fits body_0" in answer.detail


def test_a_motor_in_the_middle_leaves_no_room() -> None:
    bone = box_bone((0.3, 0.3, 0.3), (0.15, 0.15, 0.15))
    far = box_bone((0.5, 0.3, 0.3), (0.05, 0.05, 0.05))
    assert isinstance(SOLVER.solve(blueprint_of([bone, far])), Blueprint)
    answer = SOLVER.solve(blueprint_of([bone, far], [(0, 1, (0.3, 0.3, 0.3), (0, 0, 1))]))
    assert isinstance(answer, Failure)
    assert answer.reason == Reason.NO_ROOM


@pytest.mark.parametrize(("extra", "fits"), [(0.003, True), (-0.001, False)])
def test_the_wall_is_the_threshold(extra: float, fits: bool) -> None:
    # Between the two lies what trilinear samples lose at the edges of a box, at most a quarter of the lattice.
    sides = np.array([0.105 + 0.008, 0.034 + 0.030 + 0.004 + 0.003 + 0.006, 0.060 + 0.008]) + extra
    answer = SOLVER.solve(blueprint_of([box_bone((0.3, 0.3, 0.3), sides)]))
    assert isinstance(answer, Blueprint) == fits


def test_containment_below_one_tolerates_what_sticks_out() -> None:
    blueprint = blueprint_of([box_bone((0.3, 0.3, 0.3), (0.2, 0.2, 0.038))])
    assert isinstance(SOLVER.solve(blueprint), Failure)
    assert isinstance(replace(SOLVER, containment=0.5).solve(blueprint), Blueprint)


def test_free_depth_is_the_distance_to_bone_surface_and_mounts(torso: Blueprint) -> None:
    free, bone = free_depth(torso, 0), torso.bodies[0].bone
    solid = envelope(MOUNT, 0.0).moved(torso.seats[0].T_design_motor)
    rng = np.random.default_rng(0)
    inside = np.argwhere(bone.values > 0)
    picked = inside[rng.choice(len(inside), 40, replace=False)]
    triangles = solid.vertices[solid.triangles]
    weights = rng.dirichlet(np.ones(3), 400)
    cloud = np.einsum("tvc,wv->twc", triangles, weights).reshape(-1, 3)
    for index in picked:
        point = (index + bone.corner) * bone.spacing
        away = np.linalg.norm(cloud - point, axis=1).min()
        if envelope_depth(point[None], torso.seats[0].T_design_motor, MOUNT)[0] > 0:
            assert free.values[tuple(index)] <= 0
        else:
            assert free.values[tuple(index)] == pytest.approx(min(bone.values[tuple(index)], away), abs=1.5e-3)


def test_an_opening_that_a_limb_blocks_is_avoided() -> None:
    # A slab with room for the boxes lying flat; one of its two large faces is covered by another body.
    slab = box_bone((0.3, 0.3, 0.2), (0.2, 0.16, 0.056))
    for side in (1, -1):
        cover = box_bone((0.3, 0.3, 0.2 + side * 0.05), (0.25, 0.25, 0.03))
        placed = solved(blueprint_of([slab, cover]))
        assert {seat.body for seat in placed.boxes} == {0}
        for seat in placed.boxes:
            assert seat.T_design_box[2, 2] * side < 0.5
        assert placed.scores.electronics_install == pytest.approx(1.0)


def test_a_buried_host_scores_less() -> None:
    slab = box_bone((0.3, 0.3, 0.3), (0.2, 0.16, 0.056))
    free = solved(blueprint_of([slab]))
    # A cage of six slabs close by: there is no way in.
    walls = []
    for axis in range(3):
        for sign in (-1, 1):
            centre, size = np.full(3, 0.3), np.full(3, 0.12)
            centre[axis] += sign * (0.13, 0.11, 0.06)[axis]
            size[axis] = 0.05
            walls.append(box_bone(centre, size))
    caged = solved(blueprint_of([slab, *walls]))
    assert free.scores.electronics_install == 1.0
    assert caged.scores.electronics_install is not None
    assert caged.scores.electronics_install < 0.9
