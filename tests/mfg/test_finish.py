from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from blueprints import SPACING, ball_bone, blueprint_of, box_bone, sampled
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from decoder.latent import make_decoder, sample_latents
from experiments.foreign_check import overlaps
from mfg import finish, mounts
from mfg.blueprint import Blueprint, BoxSeat, WireRun
from mfg.exact import (
    attachment,
    body_overlap,
    box_room,
    box_solid,
    conflict,
    core,
    filled_mounts,
    interference_above,
    largest_ball,
    motor_solid,
    opened_tunnel,
    straightened,
    surface_points,
    tunnel,
)
from mfg.fields import Field
from mfg.finish import FinishSolver, own_mounts, soft_region
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import J60_6
from mfg.pipeline import DEFAULT, RULES, Outcome, build, score
from mfg.retreat import RETREAT
from mfg.solids import Solid, ball_chain, box, from_field, union
from mfg.stl import MM_PER_M, torn_edges, welded

TOUCH = 1e-9
MOUNT = mount_of(J60_6)


def placed(*place: float) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, 3] = place
    return T


def bones_of(blueprint: Blueprint) -> list[Solid]:
    return [from_field(body.bone) for body in blueprint.bodies]


@pytest.fixture(scope="module")
def pair() -> Blueprint:
    """Two blocks on either side of a motor whose axis is y, each cut by the joint's cylinder."""
    axis, centre = np.array([0.0, 1.0, 0.0]), np.array([0.3, 0.3, 0.3])

    def half(side: float) -> Field:
        middle, reach = centre + np.array([side * 0.061, 0, 0]), np.array([0.06, 0.07, 0.05])
        low, high = middle - reach, middle + reach

        def depth(p: NDArray[np.float64]) -> NDArray[np.float64]:
            block = np.minimum(p - low, high - p).min(-1)
            radial = np.hypot(*np.moveaxis((p - centre)[..., [0, 2]], -1, 0))
            return np.minimum(block, radial - MOUNT.attach_radius)

        return sampled(depth, low, high)

    return blueprint_of([half(-1), half(1)], [(0, 1, centre, axis)])


# What a build must be.


def test_parts_are_whole_closed_and_separate(built: Outcome) -> None:
    for part in built.blueprint.parts:
        assert len(part.solid.components()) == 1
        assert part.solid.volume > 0
        assert len(torn_edges(welded(part.solid)[1])) == 0
    for a, b in itertools.combinations(built.blueprint.parts, 2):
        assert a.solid.overlap(b.solid) <= TOUCH / 1000, (a.name, b.name)


def test_all_parts_and_hardware_of_a_robot_share_nothing_on_the_lattice_of_their_files(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A film as thick as the lattice is fine where they touch, if they did not step back from one another."""
    made = {}
    for depth in ("none", "as it is"):
        if depth == "none":
            monkeypatch.setattr(finish, "retreated", lambda solid, _: solid)
        else:
            monkeypatch.undo()
        made[depth] = []
        for kind, seed in (("vae", 11), ("genome", 3)):
            for design in make_decoder(kind).decode(sample_latents(2, np.random.default_rng(seed))):
                blueprint = build(design, rules="search").blueprint
                if len(blueprint.parts) > 3:
                    solids = {part.name: stored(part.solid) for part in blueprint.parts}
                    made[depth].append(sum(overlaps(blueprint, solids).values()))
    assert len(made["none"]) >= 3
    assert min(made["none"]) > TOUCH / 20
    assert max(made["as it is"]) < TOUCH / 1000


def test_a_part_that_has_to_be_tidied_steps_back_by_as_much_more(
    built: Outcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    part, solver = built.blueprint.parts[0], FinishSolver()
    closes = FinishSolver._opened
    tried = []

    def second(self: FinishSolver, solid: Solid) -> Solid | None:
        tried.append(solid)
        return closes(self, solid) if len(tried) > 2 else None

    monkeypatch.setattr(FinishSolver, "_opened", second)
    made = solver._whole(part)
    assert not isinstance(made, Failure)
    lost = [(part.solid.volume - solid.volume) / part.solid.area for solid in tried]
    assert_allclose(lost, RETREAT + np.array([0.0, *finish.TIDIER[:2]]), rtol=0.1)
    assert made.solid is tried[-1]


def stored(solid: Solid) -> Solid:
    """As the files hold it."""
    vertices, triangles = welded(solid)
    return Solid(vertices / MM_PER_M, triangles)


def test_nothing_printed_is_where_hardware_goes(built: Outcome) -> None:
    blueprint = built.blueprint
    hardware = [motor_solid(blueprint, seat) for seat in blueprint.seats] + [box_solid(b) for b in blueprint.boxes]
    for part, thing in itertools.product(blueprint.parts, hardware + [tunnel(wire) for wire in blueprint.wires]):
        assert part.solid.overlap(thing) <= TOUCH


def test_every_mount_is_whole_but_for_its_cable(built: Outcome) -> None:
    blueprint = built.blueprint
    tunnels = [opened_tunnel(blueprint, wire) for wire in blueprint.wires]
    lids = {lid.part for lid in blueprint.lids}
    bones = [p for p in blueprint.parts if p.material == "rigid" and p.name not in lids]
    assert [part.body for part in bones] == list(range(len(blueprint.bodies)))
    for index, part in enumerate(bones):
        for own in own_mounts(blueprint, index, MOUNT):
            missing = own.volume - part.solid.overlap(own)
            assert missing <= sum(own.overlap(t) for t in tunnels) + RETREAT * own.area + TOUCH


def test_a_cable_gets_through_both_mouths_of_its_tunnel(built: Outcome) -> None:
    """The whole thickness of the cable, from well inside the bone until its middle is in the cavity."""
    blueprint = built.blueprint
    radius = blueprint.catalogue.wire.diameter / 2
    box_seat = blueprint.box("controller")
    cavity = np.asarray(box_seat.size) / 2 + box_seat.clearance
    for wire in blueprint.wires:
        T = blueprint.seats[wire.seat].T_design_motor
        on_axis = T[:3, 3] + ((wire.path[-1] - T[:3, 3]) @ T[:3, 2]) * T[:3, 2]
        B = box_seat.T_design_box
        local = (wire.path[0] - B[:3, 3]) @ B[:3, :3]
        in_box = B[:3, 3] + B[:3, :3] @ np.clip(local, -cavity, cavity)
        away = np.linalg.norm(wire.path[-1] - on_axis)
        into_motor = wire.path[-1] + (on_axis - wire.path[-1]) * (1 - (MOUNT.cavity_radius - 1e-3) / away)
        for path in (np.stack([wire.path[-3], wire.path[-2], wire.path[-1], into_motor]),
                     np.stack([wire.path[2], wire.path[1], wire.path[0], in_box])):  # fmt: skip
            cable = ball_chain(path, radius, 16)
            assert sum(part.solid.overlap(cable) for part in blueprint.parts) < TOUCH, wire.name
        # A tunnel that ends with its path opens by no more than a slit.
        plain = ball_chain(wire.path[-3:], wire.radius, 8)
        cup = holder_of(blueprint, wire).minus([plain])
        assert cup.overlap(ball_chain(np.stack([wire.path[-1], into_motor]), radius, 16)) > 10 * TOUCH


def holder_of(blueprint: Blueprint, wire: WireRun) -> Solid:
    return mounts.holder(MOUNT).moved(blueprint.seats[wire.seat].T_design_motor)


def test_what_is_cut_for_a_cable_holds_its_tunnel(built: Outcome) -> None:
    for wire in built.blueprint.wires:
        run = tunnel(wire)
        assert (run - opened_tunnel(built.blueprint, wire)).volume < TOUCH / 1000


def test_screws_and_screwdrivers_find_their_way(built: Outcome) -> None:
    blueprint = built.blueprint
    for seat in blueprint.seats:
        for pattern, low, high in (
            (J60_6.body_screws, MOUNT.base_low - 0.03, MOUNT.housing_low),
            (J60_6.output_screws, MOUNT.connector_low, MOUNT.connector_high + 0.03),
        ):
            for hole in mounts.screw_holes(pattern, low, high):
                way = hole.moved(seat.T_design_motor)
                assert all(part.solid.overlap(way) < 1e-9 for part in blueprint.parts)


def assert_motors_slide_in(blueprint: Blueprint) -> None:
    for seat in blueprint.seats:
        own = [part.solid for part in blueprint.parts if part.body == seat.holder]
        for height in np.linspace(0.0, MOUNT.holder_top - MOUNT.housing_low, 8):  # at the top it is out of its cup
            lifted = replace(seat, T_design_motor=seat.T_design_motor @ placed(0, 0, height))
            motor = motor_solid(blueprint, lifted)
            assert all(motor.overlap(solid) <= TOUCH for solid in own), (seat.hinge, height)


def test_a_motor_can_be_slid_into_its_holder(built: Outcome) -> None:
    assert_motors_slide_in(built.blueprint)


@pytest.mark.parametrize("lid", [0.075, 0.085])
def test_a_lid_of_the_holders_own_bone_is_opened_for_the_motor(lid: float) -> None:
    """The lid begins within what the motor needs above its cup; only a bone processor that cut less leaves it."""
    axis, centre = np.array([0.0, 1.0, 0.0]), np.array([0.3, 0.3, 0.3])

    def depth(p: NDArray[np.float64]) -> NDArray[np.float64]:
        side = np.minimum(0.06 - np.abs(p[..., 0] - 0.239), 0.05 - np.abs(p[..., 2] - 0.3))
        side = np.minimum(side, 0.105 - np.abs(p[..., 1] - 0.3))
        over = np.minimum(0.12 - np.abs(p[..., 0] - 0.299), 0.05 - np.abs(p[..., 2] - 0.3))
        over = np.minimum(over, np.minimum(p[..., 1] - 0.3 - lid, 0.405 - p[..., 1]))
        radial = np.hypot(p[..., 0] - 0.3, p[..., 2] - 0.3)
        return np.maximum(np.minimum(side, radial - MOUNT.attach_radius), over)

    holder = sampled(depth, (0.17, 0.19, 0.24), (0.43, 0.41, 0.36))
    other = box_bone((0.361, 0.33, 0.3), (0.05, 0.06, 0.05))
    blueprint = blueprint_of([holder, other], [(0, 1, centre, axis)])
    finished = FinishSolver().solve(blueprint)
    assert isinstance(finished, Blueprint), str(finished)
    lifted = replace(blueprint.seats[0], T_design_motor=blueprint.seats[0].T_design_motor @ placed(0, 0, 0.06))
    assert motor_solid(blueprint, lifted).overlap(from_field(holder)) > 1e-6  # it was in the way
    assert_motors_slide_in(finished)


def test_a_box_can_be_lowered_into_its_body(built: Outcome) -> None:
    blueprint = built.blueprint
    for seat in blueprint.boxes:
        bone = next(p for p in blueprint.parts if p.body == seat.body and p.material == "rigid").solid
        shaft = box_room(seat)
        in_the_way = bone.overlap(shaft)
        assert in_the_way <= sum(shaft.overlap(own) for own in own_mounts(blueprint, seat.body, MOUNT)) + TOUCH
        for height in np.linspace(0, seat.shaft, 5):
            lifted = replace(seat, T_design_box=seat.T_design_box @ placed(0, 0, height))
            assert bone.overlap(box_solid(lifted)) <= in_the_way + TOUCH


def test_bone_and_skin_fill_what_the_body_had_but_for_the_hardware(built: Outcome) -> None:
    blueprint = built.blueprint
    for index, body in enumerate(blueprint.bodies):
        outer = from_field(body.skin or body.bone)
        own = union(own_mounts(blueprint, index, MOUNT))
        printed = union([part.solid for part in blueprint.parts if part.body == index])
        assert (printed - outer - own).volume < 2e-3 * outer.volume  # nothing beyond, but for rounding
        assert printed.volume > 0.5 * outer.volume


def test_build_and_score_agree_on_the_scores(built: Outcome) -> None:
    fast = score(built.design).scores
    assert_allclose(built.scores.values(), fast.values(), atol=0.05)


def test_the_solver_repeats_itself_and_leaves_its_input_alone(built: Outcome) -> None:
    fast = score(built.design).blueprint
    again = RULES[DEFAULT][-1].solve(fast)
    assert fast.parts == ()
    assert isinstance(again, Blueprint)
    for a, b in zip(again.parts, built.blueprint.parts, strict=True):
        assert np.array_equal(a.solid.vertices, b.solid.vertices)
        assert np.array_equal(a.solid.triangles, b.solid.triangles)


# Exact volumes against brute force.


def test_attachment_is_the_volume_counted_point_by_point(pair: Blueprint) -> None:
    seat, bones = pair.seats[0], bones_of(pair)
    V_h, V_c = attachment(pair, seat, bones)
    rng = np.random.default_rng(0)
    n, reach = 400_000, 0.05
    local = rng.uniform(-reach, reach, (n, 3))
    radius = np.hypot(local[:, 0], local[:, 1])
    points = local @ seat.T_design_motor[:3, :3].T + seat.T_design_motor[:3, 3]
    for V, body, outer, low, high in (
        (V_h, seat.holder, MOUNT.holder_radius, MOUNT.base_low, MOUNT.holder_top),
        (V_c, seat.connector, MOUNT.connector_radius, MOUNT.connector_low, MOUNT.connector_high),
    ):
        ring = (radius > MOUNT.attach_radius) & (radius < outer) & (local[:, 2] > low) & (local[:, 2] < high)
        share = (ring & (pair.bodies[body].bone.sample(points) > 0)).mean() * (2 * reach) ** 3
        assert_allclose(V, share, rtol=0.05)


def test_body_overlap_is_the_overlap_of_the_whole_bodies(pair: Blueprint, built: Outcome) -> None:
    for blueprint in (pair, built.blueprint):
        bones = bones_of(blueprint)
        cup, disc = filled_mounts(MOUNT)
        whole = [
            union([bone, *(cup.moved(s.T_design_motor) for s in blueprint.seats if s.holder == index),
                   *(disc.moved(s.T_design_motor) for s in blueprint.seats if s.connector == index)])
            for index, bone in enumerate(bones)
        ]  # fmt: skip
        brute = sum(a.overlap(b) for a, b in itertools.combinations(whole, 2))
        assert brute > 0
        assert_allclose(body_overlap(blueprint, bones), brute, rtol=1e-4)


@pytest.mark.parametrize("radius", [0.02, 0.045])
def test_the_largest_ball_in_a_ball_is_the_ball(radius: float) -> None:
    blueprint = blueprint_of([ball_bone((0.3, 0.3, 0.3), radius)])
    assert_allclose(largest_ball(blueprint, 0, from_field(blueprint.bodies[0].bone)), radius, atol=4e-4)


def test_the_largest_ball_in_a_block_touches_its_nearest_faces() -> None:
    blueprint = blueprint_of([box_bone((0.3, 0.3, 0.3), (0.12, 0.08, 0.05))])
    assert_allclose(largest_ball(blueprint, 0, from_field(blueprint.bodies[0].bone)), 0.025, atol=3e-4)


def test_the_largest_ball_keeps_clear_of_mounts(pair: Blueprint) -> None:
    bone = bones_of(pair)[0]
    assert largest_ball(pair, 0, bone) < largest_ball(replace(pair, seats=()), 0, bone)


def test_interference_above_counts_what_stands_in_the_way() -> None:
    host, lid = box_bone((0.3, 0.3, 0.25), (0.15, 0.15, 0.08)), box_bone((0.3, 0.3, 0.33), (0.15, 0.15, 0.02))
    seat = BoxSeat("controller", 0, (0.06, 0.04, 0.03), placed(0.3, 0.3, 0.25), 0.001, 0.045)
    blueprint = replace(blueprint_of([host, lid]), boxes=(seat,))
    V = interference_above(blueprint, seat, bones_of(blueprint))
    assert_allclose(V, 0.062 * 0.042 * (0.25 + 0.045 + 0.032 - 0.32), rtol=0.02)
    assert interference_above(replace(blueprint, boxes=(replace(seat, shaft=0.02),)),
                              replace(seat, shaft=0.02), bones_of(blueprint)) == 0.0  # fmt: skip


def test_surface_points_lie_on_the_surface_and_cover_it() -> None:
    solid = box((0, 0, 0), (0.1, 0.05, 0.02))
    points = surface_points(solid, 0.006)
    depth = np.minimum(points, [0.1, 0.05, 0.02] - points).min(1)
    assert_allclose(depth, 0, atol=1e-12)
    probes = np.column_stack([np.linspace(0, 0.1, 50), np.full(50, 0.017), np.zeros(50)])
    assert np.linalg.norm(probes[:, None] - points, axis=2).min(1).max() <= 0.006


def test_a_straightened_path_keeps_its_ends_and_its_shape() -> None:
    t = np.linspace(0, 3, 200)
    path = np.column_stack([0.1 * np.cos(t), 0.1 * np.sin(t), 0.05 * t])
    short = straightened(path, 1e-4)
    assert len(short) < 80
    assert_allclose(short[[0, -1]], path[[0, -1]])
    fine = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(short)])
    assert np.linalg.norm(path[:, None] - fine, axis=2).min(1).max() < 1.1e-4
    assert_allclose(straightened(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), 1e-4), [[0, 0, 0], [2, 0, 0]])


def test_the_core_reaches_what_the_bone_processor_cut_and_both_screw_faces() -> None:
    for offset in (-0.04, 0.0, 0.04):
        low, high = core(MOUNT, offset, 0.08).bounds[:, 2]
        assert low <= min(-0.08 - offset, MOUNT.base_low - 0.03)
        assert high >= max(0.08 - offset, MOUNT.connector_high + 0.03)


# Failures.


def test_a_bone_in_two_pieces_is_severed(pair: Blueprint) -> None:
    body = pair.bodies[0]
    other = box_bone((0.12, 0.3, 0.3), (0.05, 0.14, 0.1))
    apart = sampled(lambda p: np.maximum(body.bone.sample(p), other.sample(p)), (0.09, 0.22, 0.24), (0.31, 0.38, 0.36))
    failure = FinishSolver().solve(replace(pair, bodies=(replace(body, bone=apart), pair.bodies[1])))
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.PRINT, Reason.BONE_SEVERED)
    assert "2 pieces" in failure.detail


def test_a_crumb_is_dropped_and_noted(pair: Blueprint) -> None:
    body = pair.bodies[0]
    crumb = box_bone((0.12, 0.3, 0.3), (0.01, 0.01, 0.01))
    with_crumb = sampled(
        lambda p: np.maximum(body.bone.sample(p), crumb.sample(p)), (0.09, 0.22, 0.24), (0.31, 0.38, 0.36)
    )
    made = FinishSolver().solve(replace(pair, bodies=(replace(body, bone=with_crumb), pair.bodies[1])))
    assert isinstance(made, Blueprint)
    assert any("dropped 1 loose piece" in note for note in made.notes)
    assert all(len(part.solid.components()) == 1 for part in made.parts)


def test_a_mount_that_hangs_in_the_air_is_found(pair: Blueprint) -> None:
    away = replace(pair.seats[0], T_design_motor=pair.seats[0].T_design_motor @ placed(0, 0, 0.2))
    failure = FinishSolver(max_loss=0.9).solve(replace(pair, seats=(away,)))
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.BONE_SEVERED
    assert "not attached" in failure.detail


def test_a_body_larger_than_the_printer_is_refused(pair: Blueprint) -> None:
    small = replace(pair.catalogue, printer=replace(pair.catalogue.printer, volume=(0.1, 0.1, 0.1)))
    failure = FinishSolver().solve(replace(pair, catalogue=small))
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.TOO_LARGE
    assert "no way up fits" in failure.detail


def test_two_bodies_in_one_place_end_up_apart(pair: Blueprint) -> None:
    left, right = pair.bodies
    wider = right.bone.with_values(right.bone.values + np.float32(0.004))  # 3 mm into the other
    made = FinishSolver().solve(replace(pair, bodies=(left, replace(right, bone=wider))))
    assert isinstance(made, Blueprint)
    assert made.parts[0].solid.overlap(made.parts[1].solid) <= TOUCH


def test_too_little_hold_is_a_motor_failure(pair: Blueprint) -> None:
    solver = FinishSolver()
    failure = replace(solver, min_overlap=1e-3).solve(pair)
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.MOTOR, Reason.NO_OVERLAP)


def test_hardware_in_hardware_is_a_conflict(pair: Blueprint) -> None:
    centre = pair.seats[0].T_design_motor[:3, 3]
    inside = BoxSeat("battery", 0, (0.03, 0.03, 0.03), placed(*centre), 0.001, 0.02)
    found = conflict(replace(pair, boxes=(inside,)), TOUCH)
    assert found is not None
    assert "joint_1" in found.detail
    assert "battery" in found.detail
    wire = WireRun("wire_1", 0, centre + np.array([[-0.1, 0, 0], [0.1, 0, 0]]), 0.0035)
    through = replace(pair, wires=(wire,))
    found = conflict(through, TOUCH)
    assert found is not None
    assert "wire_1" in found.detail
    assert conflict(pair, TOUCH) is None


# Skin.


def test_the_soft_region_is_nowhere_thinner_than_asked() -> None:
    bone = ball_bone((0.3, 0.3, 0.3), 0.04)
    skin = sampled(
        lambda p: np.maximum(0.04 - np.linalg.norm(p - 0.3, axis=-1),
                             0.05 - np.linalg.norm(p - [0.31, 0.3, 0.3], axis=-1)),
        (0.2, 0.2, 0.2), (0.4, 0.4, 0.4),
    )  # fmt: skip
    soft = from_field(soft_region(skin, bone, 0.002)) - from_field(bone)
    assert not soft.is_empty
    above = np.linalg.norm(soft.vertices - 0.3, axis=1)
    outer = above > 0.041
    # On the bare side, where skin and bone coincide, nothing soft is left.
    assert soft.bounds[0, 0] > 0.3 - 0.04 - SPACING / 2
    assert outer.any()
    assert len(soft.components()) == 1


def test_a_film_of_skin_is_no_part(pair: Blueprint, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thinning its triangles leaves nothing, which must not pass for a bug."""
    body = pair.bodies[0]
    film = body.bone.with_values(np.full_like(body.bone.values, -SPACING))
    film.values[5, 5, 5] = 1e-5
    with pytest.raises(ValueError, match="volume 0"):
        from_field(film, FinishSolver().tolerance)
    monkeypatch.setattr("mfg.finish.soft_region", lambda *_: film)
    made = FinishSolver().solve(replace(pair, bodies=(replace(body, skin=body.bone), pair.bodies[1])))
    assert isinstance(made, Blueprint)
    assert [part.name for part in made.parts] == ["body_0_bone", "body_1_bone"]
