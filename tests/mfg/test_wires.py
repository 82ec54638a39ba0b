"""Cable tunnels: near the true geodesic, clear of all hardware, apart from each other, open at both ends."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone, three_motor_robot
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mfg.blueprint import Blueprint, BoxSeat
from mfg.fields import box_distance, cylinder_distance
from mfg.mounts import cavity, housing, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.routing import Hardware, Net, merged
from mfg.solids import Solid, ball_chain, box
from mfg.wires import CHORD, WireSolver, curvature, moving_average, resampled

SOLVER = WireSolver()
MOUNT = mount_of(PAPER.motor)
RADIUS = PAPER.wire.diameter / 2 + SOLVER.clearance


def box_solid(seat: BoxSeat, grow: float = 0.0) -> Solid:
    half = np.array(seat.size) / 2 + grow
    return box(-half, half).moved(seat.T_design_box)


@pytest.fixture(scope="module")
def robot() -> Blueprint:
    return three_motor_robot()


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


def test_a_corner_too_sharp_for_a_cable_is_a_failure(robot: Blueprint, wired: Blueprint) -> None:
    sharpest = max(turned(wire.path) for wire in wired.wires)
    assert isinstance(replace(SOLVER, max_turn=1.01 * sharpest).solve(robot), Blueprint)
    answer = replace(SOLVER, max_turn=0.99 * sharpest).solve(robot)
    assert isinstance(answer, Failure)
    assert (answer.stage, answer.reason) == (Stage.WIRE, Reason.SHARP_BEND)
    assert "degrees within 20 mm" in answer.detail


@pytest.mark.parametrize("turn", [0.3, 1.0, np.pi / 2])
def test_a_kink_is_measured_by_its_angle(turn: float) -> None:
    assert turned(kink(turn)) == pytest.approx(turn, rel=0.03)


def test_a_right_angle_passes_and_a_hairpin_does_not() -> None:
    arc = np.linspace(0, np.pi, 60)
    assert turned(kink(np.pi / 2)) < SOLVER.max_turn < turned(kink(2.6))
    assert turned(0.012 * np.stack([np.cos(arc), np.sin(arc), 0 * arc], axis=1)) == pytest.approx(0.85, abs=0.05)


def kink(turn: float) -> np.ndarray:
    """Two straight legs of 100 mm."""
    return np.array([[-0.1, 0, 0], [0, 0, 0], [0.1 * np.cos(turn), 0.1 * np.sin(turn), 0]])


def turned(path: np.ndarray) -> float:
    """Angle between two chords, from the curvature."""
    return float(2 * np.arcsin(min(1.0, curvature(path) * CHORD / 2)))


def test_a_way_that_is_taken_is_taken(robot: Blueprint) -> None:
    net = Net(robot, Hardware.of(robot), RADIUS, SOLVER.gap, SOLVER.stride, SOLVER.bridge)
    assert net.route(0, []) is not None
    assert net.route(0, [net.vertices]) is None


def test_a_gap_that_nothing_can_keep_is_a_failure(robot: Blueprint) -> None:
    answer = replace(SOLVER, gap=0.05).solve(robot)
    assert isinstance(answer, Failure)
    assert answer.reason == Reason.NO_ROUTE


def test_smoothed_routes_are_no_longer_than_the_way_around_the_body(wired: Blueprint) -> None:
    for wire in wired.wires:
        straight = float(np.linalg.norm(wire.path[-1] - wire.path[0]))
        assert straight <= wire.length <= 2.0 * straight + 0.06


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
