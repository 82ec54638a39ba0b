"""The routing graph and the hardware in its way, against analytic geodesics and exact solids."""

from __future__ import annotations

import math

import numpy as np
import pytest
from blueprints import ball_bone, blueprint_of, three_motor_robot, tube_bone
from scipy import sparse
from scipy.sparse import csgraph

from mfg.blueprint import Blueprint
from mfg.fields import box_distance, cylinder_distance
from mfg.mounts import housing, mount_of
from mfg.parts import PAPER
from mfg.routing import Hardware, box_references, bridged, merged, mesh_edges, motor_references
from mfg.solids import Solid, ball_chain, box, from_field, surface
from mfg.wires import WireSolver

SOLVER = WireSolver()
MOUNT = mount_of(PAPER.motor)
RADIUS = PAPER.wire.diameter / 2 + SOLVER.clearance


@pytest.fixture(scope="module")
def robot() -> Blueprint:
    return three_motor_robot()


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
    assert len(bridged(vertices, tail, head, 0.015)[0]) == len(tail)
    more_tail, more_head = bridged(vertices, tail, head, 0.03)
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


def test_distances_agree_with_the_exact_solids(robot: Blueprint) -> None:
    hardware = Hardware.of(robot)
    solids = [housing(MOUNT).moved(seat.T_design_motor) for seat in robot.seats]
    solids += [box(-np.array(b.size) / 2, np.array(b.size) / 2).moved(b.T_design_box) for b in robot.boxes]
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
