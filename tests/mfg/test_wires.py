"""Cable tunnels: near the true geodesic, clear of all hardware, apart from each other, open at both ends."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from blueprints import ball_bone, blueprint_of, box_bone, tube_bone
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import sparse
from scipy.sparse import csgraph

from mfg.blueprint import Blueprint, BoxSeat
from mfg.electronics import ElectronicsSolver
from mfg.fields import box_distance, cylinder_distance
from mfg.mounts import cavity, housing, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.solids import Solid, ball_chain, box, from_field, surface
from mfg.wires import (
    Hardware,
    WireSolver,
    _bridged,
    _Net,
    box_references,
    curvature,
    merged,
    mesh_edges,
    motor_references,
    moving_average,
    resampled,
)

SOLVER = WireSolver()
MOUNT = mount_of(PAPER.motor)
RADIUS = PAPER.wire.diameter / 2 + SOLVER.clearance


def box_solid(seat: BoxSeat, grow: float = 0.0) -> Solid:
    half = np.array(seat.size) / 2 + grow
    return box(-half, half).moved(seat.T_design_box)


@pytest.fixture(scope="module")
def robot() -> Blueprint:
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


@pytest.fixture(scope="module")
def wired(robot: Blueprint) -> Blueprint:
    answer = SOLVER.solve(robot)
    assert isinstance(answer, Blueprint), str(answer)
    return answer


def test_every_motor_has_its_wire(wired: Blueprint) -> None:
    assert [wire.seat for wire in wired.wires] == [0, 1, 2]
    assert len({wire.name for wire in wired.wires}) == 3
    assert wired.notes == ()
    assert wired.scores.cable is not None
    assert 0 < wired.scores.cable < 1


def test_wires_run_from_the_controller_to_their_motor(wired: Blueprint) -> None:
    for wire in wired.wires:
        seat, hub = wired.seats[wire.seat], wired.box("controller")
        start = box_distance(wire.path[0], hub.T_design_box, np.array(hub.size) / 2)
        end = cylinder_distance(wire.path[-1], seat.T_design_motor, MOUNT.housing_radius, MOUNT.housing_low,
                                MOUNT.housing_high)  # fmt: skip
        # Between touching the part and missing its cavity.
        assert wire.radius < start < wire.radius + hub.clearance
        assert wire.radius < end < wire.radius + MOUNT.cavity_radius - MOUNT.housing_radius


def test_tunnels_meet_no_motor_and_no_box_and_open_into_their_cavities(wired: Blueprint) -> None:
    for wire in wired.wires:
        tunnel = ball_chain(wire.path, wire.radius)
        for seat in wired.seats:
            assert tunnel.overlap(housing(MOUNT).moved(seat.T_design_motor)) == 0.0
        for seat in wired.boxes:
            assert tunnel.overlap(box_solid(seat)) == 0.0
        assert tunnel.overlap(box_solid(wired.box("controller"), wired.box("controller").clearance)) > 0.0
        assert tunnel.overlap(cavity(MOUNT).moved(wired.seats[wire.seat].T_design_motor)) > 0.0


def test_tunnels_keep_their_gap_from_what_they_do_not_serve(wired: Blueprint) -> None:
    hardware = Hardware.of(wired)
    for wire in wired.wires:
        need = hardware.needs(wire.seat, RADIUS, SOLVER.gap)
        assert (hardware.distance(resampled(wire.path, 0.001)) >= need[:, None] - 3e-4).all()


def test_tunnels_stay_apart(wired: Blueprint) -> None:
    for a, b in itertools.combinations(wired.wires, 2):
        assert np.linalg.norm(a.path[:, None] - b.path, axis=2).min() > 2 * RADIUS


def test_tunnels_stay_with_the_body(wired: Blueprint) -> None:
    # On the merged surface or, where smoothing cut a corner, inside.
    body = merged(wired, 1)
    for wire in wired.wires:
        assert body.sample(wire.path).min() > -0.008


def test_the_same_blueprint_gives_the_same_paths(robot: Blueprint, wired: Blueprint) -> None:
    again = SOLVER.solve(robot)
    assert isinstance(again, Blueprint)
    assert all((a.path == b.path).all() for a, b in zip(wired.wires, again.wires, strict=True))


def test_a_motor_that_nothing_reaches_is_a_wire_failure(robot: Blueprint) -> None:
    # A bone with a motor of its own, half a metre away.
    lone = blueprint_of(
        [body.bone for body in robot.bodies[:1]] + [box_bone((0.9, 0.3, 0.3), (0.12, 0.1, 0.1))],
        [(1, 1, (0.9, 0.3, 0.3), (0, 1, 0))],
    )
    answer = SOLVER.solve(replace(lone, boxes=robot.boxes))
    assert isinstance(answer, Failure)
    assert (answer.stage, answer.reason) == (Stage.WIRE, Reason.NO_ROUTE)
    assert "wire_1" in answer.detail


def test_a_wire_that_is_too_long_is_a_failure(robot: Blueprint) -> None:
    answer = replace(SOLVER, max_length=0.1).solve(robot)
    assert isinstance(answer, Failure)
    assert (answer.stage, answer.reason) == (Stage.WIRE, Reason.NO_ROUTE)
    assert "at most 0.10 m" in answer.detail


def test_wires_may_share_a_channel_and_say_so(robot: Blueprint) -> None:
    net = _Net(robot, Hardware.of(robot), SOLVER, RADIUS)
    free, taken = net.route(0, []), net.route(0, [net.vertices])
    assert free is not None
    assert taken is not None
    assert free[1] == ""
    assert taken[1] == "shares a channel with an earlier wire"


def test_a_gap_that_nothing_can_keep_is_a_failure(robot: Blueprint) -> None:
    answer = replace(SOLVER, gap=0.05).solve(robot)
    assert isinstance(answer, Failure)
    assert answer.reason == Reason.NO_ROUTE


@pytest.mark.parametrize(("first", "second"), [(0.0, 0.0), (0.0, 2.0), (1.0, -1.5)])
@pytest.mark.parametrize("stride", [1, 2])
def test_graph_paths_on_a_cylinder_are_near_the_geodesic(first: float, second: float, stride: int) -> None:
    # A cylinder unrolls: the geodesic is hypot(axial, radius * angle).
    radius = 0.06
    vertices, triangles = surface(merged(blueprint_of([tube_bone(radius, 0.2)]), stride))
    tail, head = mesh_edges(triangles)
    graph = sparse.csr_matrix(
        (np.linalg.norm(vertices[tail] - vertices[head], axis=1), (tail, head)), shape=(len(vertices),) * 2
    )

    def at(x: float, angle: float) -> int:
        point = np.array([x, 0.3 + radius * math.cos(angle), 0.3 + radius * math.sin(angle)])
        return int(np.linalg.norm(vertices - point, axis=1).argmin())

    a, b = at(0.18, first), at(0.42, second)
    angles = [math.atan2(vertices[i, 2] - 0.3, vertices[i, 1] - 0.3) for i in (a, b)]
    turn = abs((angles[1] - angles[0] + math.pi) % (2 * math.pi) - math.pi)
    true = math.hypot(vertices[b, 0] - vertices[a, 0], radius * turn)
    length = csgraph.dijkstra(graph, indices=[a])[0, b]
    assert 0.97 * true <= length <= 1.15 * true


def test_smoothed_routes_are_no_longer_than_the_way_around_the_body(wired: Blueprint) -> None:
    for wire in wired.wires:
        straight = float(np.linalg.norm(wire.path[-1] - wire.path[0]))
        assert straight <= wire.length <= 2.0 * straight + 0.06


def test_merged_is_the_greatest_depth_of_all_bones_and_mounts(robot: Blueprint) -> None:
    whole, coarse = merged(robot, 1), merged(robot, 2)
    near = coarse.values > -0.009
    assert whole.sample(coarse.points()[near]) == pytest.approx(coarse.values[near], abs=1e-6)
    for body in robot.bodies:
        assert (body.bone.on_lattice_of(whole) <= whole.values).all()
    centres = np.array([seat.T_design_motor[:3, 3] for seat in robot.seats])
    assert (whole.sample(centres) > 0.03).all()


def test_separate_pieces_are_bridged_only_across_small_gaps() -> None:
    blueprint = blueprint_of([ball_bone((0.3, 0.3, 0.3), 0.04), ball_bone((0.4, 0.3, 0.3), 0.04)])
    vertices, triangles = surface(merged(blueprint, 1))
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    assert len(_bridged(vertices, tail, head, 0.015)[0]) == len(tail)
    more_tail, more_head = _bridged(vertices, tail, head, 0.03)
    assert len(more_tail) == len(tail) + 2
    assert np.linalg.norm(vertices[more_tail[-1]] - vertices[more_head[-1]]) == pytest.approx(0.02, abs=0.003)


def test_box_references_are_apart_outside_and_not_at_the_opening(robot: Blueprint) -> None:
    hub = robot.box("controller")
    points = box_references(hub, RADIUS, SOLVER.gap)
    local = (points - hub.T_design_box[:3, 3]) @ hub.T_design_box[:3, :3]
    half = np.array(hub.size) / 2
    assert box_distance(points, hub.T_design_box, half) == pytest.approx(
        np.full(len(points), RADIUS + hub.clearance / 2)
    )
    assert local[:, 2].max() < half[2]
    spread = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))
    assert spread.min() >= 2 * RADIUS + SOLVER.gap


def test_motor_references_face_the_holders_bone(robot: Blueprint) -> None:
    for seat in robot.seats:
        points = motor_references(robot, seat, MOUNT, RADIUS)
        distance = cylinder_distance(points, seat.T_design_motor, MOUNT.housing_radius, MOUNT.housing_low,
                                     MOUNT.housing_high)  # fmt: skip
        assert distance == pytest.approx(np.full(len(points), RADIUS + 2e-4))
        outward = points - seat.T_design_motor[:3, 3]
        outward -= np.outer(outward @ seat.T_design_motor[:3, 2], seat.T_design_motor[:3, 2])
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        beyond = points + outward * (MOUNT.holder_radius - MOUNT.housing_radius)
        assert (robot.bodies[seat.holder].bone.sample(beyond) > -1e-3).all()


polylines = hnp.arrays(np.float64, st.tuples(st.integers(3, 40), st.just(3)), elements=st.floats(-0.5, 0.5)).filter(
    lambda p: np.linalg.norm(np.diff(p, axis=0), axis=1).min() > 1e-4
)


@settings(max_examples=30)
@given(polylines, st.integers(1, 8))
def test_moving_average_keeps_the_ends_and_the_hull(path: np.ndarray, span: int) -> None:
    smooth = moving_average(path, span)
    assert smooth[[0, -1]] == pytest.approx(path[[0, -1]], abs=1e-12)
    assert (smooth.min(0) >= path.min(0) - 1e-12).all()
    assert (smooth.max(0) <= path.max(0) + 1e-12).all()


@settings(max_examples=30)
@given(polylines, st.floats(0.002, 0.05))
def test_resampling_keeps_the_ends_and_shortens_nothing_but_corners(path: np.ndarray, step: float) -> None:
    even = resampled(path, step)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    pieces = np.linalg.norm(np.diff(even, axis=0), axis=1)
    assert even[[0, -1]] == pytest.approx(path[[0, -1]], abs=1e-12)
    assert pieces.max() <= max(step, length / 2) + 1e-9
    assert pieces.sum() <= length + 1e-9


@given(st.floats(0.015, 0.3), st.floats(0.3, 3.0))
def test_curvature_of_an_arc_is_one_over_its_radius(radius: float, angle: float) -> None:
    t = np.linspace(0, max(angle, 0.025 / radius), 400)
    arc = radius * np.column_stack([np.cos(t), np.sin(t), np.zeros_like(t)])
    assert curvature(arc) == pytest.approx(1 / radius, rel=0.02)


def test_curvature_of_a_line_is_zero_and_a_bend_counts_wherever_it_is() -> None:
    line = np.column_stack([np.linspace(0, 0.3, 50), np.zeros(50), np.zeros(50)])
    assert curvature(line) == pytest.approx(0.0, abs=1e-6)
    for where in (0.05, 0.15, 0.25):
        bent = np.array([[0, 0, 0], [where, 0, 0], [where, 0.3 - where, 0]])
        assert curvature(bent) > 100


def test_distances_agree_with_the_exact_solids(robot: Blueprint) -> None:
    hardware = Hardware.of(robot)
    solids = [housing(MOUNT).moved(seat.T_design_motor) for seat in robot.seats] + [box_solid(b) for b in robot.boxes]
    points = np.random.default_rng(0).uniform((0.05, 0.2, 0.2), (0.65, 0.4, 0.4), (30, 3))
    distance = hardware.distance(points)
    for row, solid in zip(distance, solids, strict=True):
        for value, point in zip(row, points, strict=True):
            ball = ball_chain(point[None], max(value - 4e-4, 1e-4), 24) if value > 5e-4 else None
            if ball is not None:
                assert ball.overlap(solid) == 0.0
                assert ball_chain(point[None], (value + 3e-4) * 1.03, 64).overlap(solid) > 0.0


def test_surface_of_a_field_is_the_surface_of_its_solid() -> None:
    bone = ball_bone((0.3, 0.3, 0.3), 0.05)
    vertices, triangles = surface(bone)
    assert Solid(vertices, triangles).volume == pytest.approx(from_field(bone, 0).volume)
