"""Cables in the inside: exact solids keep apart, bends are measured anew, and the slack is tried by turning joints."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone, three_motor_robot
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse import csgraph

from mfg.blueprint import Blueprint
from mfg.exact import box_room, box_solid, motor_solid, tunnel
from mfg.masses import component_moments
from mfg.moments import total
from mfg.mounts import cavity, connector, holder, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.route_field import AROUND, Margins, Obstacles, RouteField, passed
from mfg.route_graph import RouteGraph
from mfg.tables import wiring_table
from mfg.wire_search import SearchWireSolver, bends
from mfg.wire_slack import taut_length
from mfg.wires import resampled

SOLVER = SearchWireSolver(surface=False)
MOUNT = mount_of(PAPER.motor)
RADIUS = PAPER.wire.diameter / 2 + SOLVER.clearance


@pytest.fixture(scope="module")
def robot() -> Blueprint:
    made = three_motor_robot()
    hinges = (*made.hinges[:2], replace(made.hinges[2], parent=1))  # the hand hangs on the first arm
    return replace(made, hinges=hinges)


@pytest.fixture(scope="module")
def wired(robot: Blueprint) -> Blueprint:
    answer = SOLVER.solve(robot)
    assert isinstance(answer, Blueprint), str(answer)
    return answer


def turned(blueprint: Blueprint, hinge: int, angle: float, point: np.ndarray) -> np.ndarray:
    """A point of the child when its joint stands at `angle` (Rodrigues)."""
    a, centre = blueprint.hinges[hinge].axis, blueprint.hinges[hinge].position
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return centre + (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K) @ (point - centre)


def test_every_motor_has_its_wire_and_nothing_was_given_up(wired: Blueprint) -> None:
    assert [wire.seat for wire in wired.wires] == [0, 1, 2]
    assert wired.notes == ()
    assert wired.scores.cable is not None
    assert 0 < wired.scores.cable < 1


def test_tunnels_meet_no_hardware_no_foreign_mount_and_not_each_other(wired: Blueprint) -> None:
    for wire in wired.wires:
        run = tunnel(wire)
        for k, seat in enumerate(wired.seats):
            assert run.overlap(motor_solid(wired, seat)) == 0.0
            assert run.overlap(connector(MOUNT).moved(seat.T_design_motor)) == 0.0
            assert (run.overlap(holder(MOUNT).moved(seat.T_design_motor)) > 0) == (k == wire.seat)
        assert all(run.overlap(box_solid(seat)) == 0.0 for seat in wired.boxes)
    for a, b in itertools.combinations(wired.wires, 2):
        assert tunnel(a).overlap(tunnel(b)) == 0.0


def test_tunnels_open_into_the_cavities_that_they_serve_and_into_no_shaft(wired: Blueprint) -> None:
    box = wired.box("controller")
    for wire in wired.wires:
        run = tunnel(wire)
        cell = box_room(replace(box, shaft=0.0))
        assert run.overlap(cell) > 0.0
        assert run.overlap(cavity(MOUNT).moved(wired.seats[wire.seat].T_design_motor)) > 0.0
        for room in wired.boxes:
            assert run.overlap(box_room(room) - cell) == 0.0


def test_ends_are_straight(wired: Blueprint) -> None:
    box = wired.box("controller")
    for wire in wired.wires:
        for path in (wire.path, wire.path[::-1]):
            fine = resampled(path, 0.0005)
            near = fine[np.linalg.norm(fine - fine[0], axis=1) <= SOLVER.approach]
            line = near[-1] - near[0]
            offset = np.linalg.norm(np.cross(near - near[0], line / np.linalg.norm(line)), axis=1)
            assert offset.max() < 1e-4
        out = (wire.path[1] - wire.path[0]) @ box.T_design_box[:3, :3]
        assert np.sort(np.abs(out / np.linalg.norm(out))) == pytest.approx([0, 0, 1], abs=1e-6)  # square to a face


def test_no_bend_is_sharper_than_the_cable_allows(wired: Blueprint) -> None:
    for wire in wired.wires:
        fine = resampled(wire.path, 0.001)
        for i in range(5, len(fine) - 5):
            a, b, c = fine[i - 5], fine[i], fine[i + 5]
            sides = np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(c - a)
            area = np.linalg.norm(np.cross(b - a, c - a)) / 2
            assert math.prod(sides) > 4 * area * 0.95 * PAPER.wire.bend_radius  # R = a b c / 4 A


def test_away_from_joints_a_wall_is_left(wired: Blueprint) -> None:
    checked = 0
    for wire in wired.wires:
        fine = resampled(wire.path, 0.001)
        far = np.ones(len(fine), bool)
        for seat in wired.seats:
            local = (fine - seat.T_design_motor[:3, 3]) @ seat.T_design_motor[:3, :3]
            far &= np.hypot(local[:, 0], local[:, 1]) > MOUNT.envelope_radius + AROUND[0] + 0.01
        depth = np.max([body.bone.sample(fine[far]) for body in wired.bodies], axis=0)
        checked += len(depth)
        assert (depth > RADIUS + SOLVER.wall - 1e-3).all()
    assert checked > 10


def test_cables_pass_from_body_to_body_at_their_joint_only(wired: Blueprint) -> None:
    joints = [{hinge.parent, hinge.body} for hinge in wired.hinges]
    for wire in wired.wires:
        depth = np.stack([body.bone.sample(resampled(wire.path, 0.001)) for body in wired.bodies])
        owner = depth.argmax(axis=0)[depth.max(axis=0) > 0]
        changes = [{int(a), int(b)} for a, b in itertools.pairwise(owner) if a != b]
        assert all(change in joints for change in changes)
        assert {c.hinge for c in wire.crossings} >= {joints.index(change) for change in changes}


def test_the_slack_lets_every_joint_turn_to_both_ends(wired: Blueprint) -> None:
    crossed = 0
    for wire in wired.wires:
        for crossing in wire.crossings:
            hinge = wired.hinges[crossing.hinge]
            # The free stretch: the part of the path about the crossing that is as long as its span.
            fine = resampled(wire.path, 0.0005)
            travelled = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
            middle = travelled[np.linalg.norm(fine - crossing.position, axis=1).argmin()]
            ends = [fine[np.abs(travelled - middle - s * crossing.span / 2).argmin()] for s in (-1, 1)]
            for angle in np.linspace(*hinge.range, 9):
                apart = np.linalg.norm(turned(wired, crossing.hinge, angle, ends[0]) - ends[1])
                other = np.linalg.norm(ends[0] - turned(wired, crossing.hinge, angle, ends[1]))
                assert min(apart, other) < crossing.span + crossing.slack
            assert max(crossing.needed) <= crossing.span + crossing.slack - SOLVER.reserve + 1e-9
            crossed += 1
    assert crossed > 0


@settings(max_examples=40, deadline=None)
@given(st.floats(0.06, 0.12), st.floats(0.06, 0.12), st.floats(0.0, 3.0), st.floats(-1.5, 1.5), st.floats(0.0, 0.02))
def test_a_taut_string_is_the_shortest_around_the_mount(a: float, b: float, f: float, turn: float, rise: float) -> None:
    blueprint = blueprint_of([box_bone((0.3, 0.3, 0.3), (0.1, 0.1, 0.1))] * 2, [(0, 1, (0.3, 0.3, 0.3), (0, 0, 1))])
    T = blueprint.seats[0].T_design_motor
    angle = np.linspace(0, f, 50)
    r = np.linspace(a, b, 50)
    local = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.linspace(0, rise, 50)])
    got = taut_length(blueprint, blueprint.seats[0], local @ T[:3, :3].T + T[:3, 3], turn, 0.003)
    c, g = min(MOUNT.envelope_radius + 0.003, a, b), abs(f + turn)
    A, B = np.array([a, 0.0]), b * np.array([np.cos(g), np.sin(g)])
    foot = np.clip(-(A @ (B - A)) / max((B - A) @ (B - A), 1e-12), 0, 1)
    best = float(np.linalg.norm(B - A)) if g < np.pi and np.linalg.norm(A + foot * (B - A)) >= c else np.inf
    # Touch the circle anywhere from the first tangent on, leave it anywhere up to the last.
    s = np.linspace(0, math.acos(min(1.0, c / a)), 300)[:, None]
    t = g - np.linspace(0, math.acos(min(1.0, c / b)), 300)
    around = np.hypot(a - c * np.cos(s), c * np.sin(s)) + c * (t - s)
    around = around + np.hypot(b - c * np.cos(g - t), c * np.sin(g - t))
    best = min(best, float(np.where(t >= s, around, np.inf).min()))
    assert got == pytest.approx(math.hypot(best, rise), abs=2e-4)


def test_searches_that_count_what_is_added_find_the_same_lengths(robot: Blueprint) -> None:
    margins = Margins(RADIUS, SOLVER.gap, SOLVER.wall)
    graph = RouteGraph(robot, RouteField.of(robot, margins), margins, SOLVER.approach)
    tree = graph.tree(2, graph.taken(2, [], 0.0), set())
    assert tree is not None
    other, cost = graph.linked()
    row, step = np.nonzero(np.isfinite(cost))
    column, weight = other[row, step], cost[row, step]
    node = graph.ends[2].node
    n = len(graph.cells)
    arcs = tree.cost - graph.rest[node]
    least = {int(end): float(arcs[node == end].min()) for end in np.unique(node)}
    tails = np.concatenate([row, np.full(len(least), n)])
    heads = np.concatenate([column, list(least)])
    plain = sparse.coo_matrix((np.concatenate([weight, list(least.values())]), (tails, heads)), shape=(n + 1, n + 1))
    length = csgraph.dijkstra(plain.tocsr(), indices=[n])[0, :n]
    known = np.isfinite(tree.length)
    assert known[graph.starts.node].any()
    assert tree.length[known] == pytest.approx(length[known], rel=1e-6, abs=1e-4)


def test_what_a_tunnel_takes_is_all_that_is_nearer_to_it_than_it_must_be(robot: Blueprint) -> None:
    margins = Margins(RADIUS, SOLVER.gap, SOLVER.wall)
    graph = RouteGraph(robot, RouteField.of(robot, margins), margins, SOLVER.approach)
    start = graph.points[len(graph.points) // 2]
    paths = [
        start + np.linspace(0, 1, 120)[:, None] * v for v in ((0.3, 0.1, 0.05), (-0.4, 0.2, 0.0))
    ]  # out of it, too
    for apart in (0.004, 0.0125):
        taken = graph.taken(0, paths, apart)
        nearest = np.linalg.norm(graph.points[:, None] - np.concatenate(paths), axis=2).min(axis=1)
        assert (taken.cells == (nearest < apart)).all()
        assert taken.cells.any()
        assert not taken.cells.all()
    assert not graph.taken(0, [], 0.01).cells.any()


def test_the_field_is_the_distance_to_what_is_in_the_way(robot: Blueprint) -> None:
    margins = Margins(RADIUS, SOLVER.gap, SOLVER.wall)
    field = RouteField.of(robot, margins)
    assert field.clearance.values[field.label >= 0].min() >= 0
    where = np.argwhere(field.label >= 0)[::37]
    points = (where + field.clearance.corner) * field.clearance.spacing
    away = Obstacles.of(robot).distance(points).min(axis=0)
    assert (away >= RADIUS + SOLVER.gap - 1e-5).all()
    labels = field.label[tuple(where.T)]
    for body in range(len(robot.bodies)):
        depth = robot.bodies[body].bone.sample(points[labels == body])
        assert (depth >= RADIUS + SOLVER.wall - 1e-5).all()


def test_only_bodies_on_the_way_are_passed(robot: Blueprint) -> None:
    assert robot.box("controller").body == 0
    assert passed(robot) == {0, 1, 2}  # the hand's motor sits in the arm


def test_the_same_blueprint_gives_the_same_paths(robot: Blueprint, wired: Blueprint) -> None:
    again = SOLVER.solve(robot)
    assert isinstance(again, Blueprint)
    assert all((a.path == b.path).all() for a, b in zip(wired.wires, again.wires, strict=True))


def test_a_motor_that_nothing_reaches_is_a_failure_that_names_it(robot: Blueprint) -> None:
    lone = blueprint_of(
        [body.bone for body in robot.bodies[:1]] + [box_bone((0.9, 0.3, 0.3), (0.12, 0.1, 0.1))],
        [(1, 0, (0.9, 0.3, 0.3), (0, 1, 0))],
    )
    answer = SOLVER.solve(replace(lone, boxes=robot.boxes))
    assert isinstance(answer, Failure)
    assert (answer.stage, answer.reason) == (Stage.WIRE, Reason.NO_ROUTE)
    assert "wire_1" in answer.detail
    assert "joint_1" in answer.detail


def test_a_tunnel_too_wide_is_refused_with_the_room_that_there_is(robot: Blueprint) -> None:
    thick = replace(PAPER, wire=replace(PAPER.wire, diameter=0.026, bend_radius=0.03))
    answer = SOLVER.solve(replace(robot, catalogue=thick))
    assert isinstance(answer, Failure)
    assert answer.stage == Stage.WIRE
    assert "mm" in answer.detail
    assert "would mend it" in answer.detail


def test_where_the_inside_is_closed_the_surface_is_noted(robot: Blueprint) -> None:
    stiff = replace(PAPER, wire=replace(PAPER.wire, bend_radius=0.2))
    answer = replace(SOLVER, surface=True).solve(replace(robot, catalogue=stiff))
    assert isinstance(answer, Blueprint), str(answer)
    assert any("along the surface" in note and "mm" in note for note in answer.notes)
    assert isinstance(SOLVER.solve(replace(robot, catalogue=stiff)), Failure)


def test_slack_is_bought_and_weighed(wired: Blueprint) -> None:
    bare = replace(wired, wires=tuple(replace(wire, crossings=()) for wire in wired.wires))
    slack = sum(wire.slack for wire in wired.wires)
    assert slack > 0
    heavier = total(m for _, m in component_moments(wired)).mass - total(m for _, m in component_moments(bare)).mass
    assert heavier == pytest.approx(slack * PAPER.wire.mass_per_metre, rel=1e-9)
    for line, wire in zip(wiring_table(wired).splitlines()[1:], wired.wires, strict=True):
        assert float(line.split(",")[3]) == pytest.approx(1e3 * (wire.length + wire.slack), abs=0.5)


@given(st.floats(0.012, 0.1))
def test_the_bend_of_an_arc_is_one_over_its_radius(radius: float) -> None:
    t = np.arange(0, 0.06, 0.001) / radius
    arc = radius * np.column_stack([np.cos(t), np.sin(t), 0 * t])
    assert bends(arc).max() == pytest.approx(1 / radius, rel=0.01)
