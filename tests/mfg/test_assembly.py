"""The assembly order: complete, in order, and free where it says so, by exact booleans along the way."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pytest

from decoder.latent import make_decoder, sample_latents
from mfg.assembly import Step, assembly_steps, part_names
from mfg.blueprint import Blueprint
from mfg.exact import box_solid, motor_solid
from mfg.guide import panels
from mfg.mounts import mount_of
from mfg.pipeline import Outcome, build, score
from mfg.solids import Solid, box, union
from mfg.ways import FREE, turned

STOPS = 24  # places along a way at which overlaps are taken


@pytest.fixture(scope="module")
def robots(built: Outcome) -> list[Blueprint]:
    """The creature and the first two designs of the default decoder that build."""
    found = [built.blueprint]
    for design in make_decoder("vae").decode(sample_latents(16, np.random.default_rng(11))):
        outcome = build(design)
        if outcome.ok:
            found.append(outcome.blueprint)
        if len(found) == 3:
            break
    return found


@pytest.fixture(scope="module")
def plans(robots: list[Blueprint]) -> list[tuple[Blueprint, tuple[Step, ...]]]:
    return [(robot, assembly_steps(robot)) for robot in robots]


def shifted(solid: Solid, shift: np.ndarray) -> Solid:
    T = np.eye(4)
    T[:3, 3] = shift
    return solid.moved(T)


def places(step: Step) -> list[np.ndarray]:
    """Offsets from the final place along the legs, from outside to inside."""
    back, out = np.zeros(3), []
    for leg in reversed(step.legs):
        reach = leg.travel if leg is not step.legs[0] else max(leg.travel, 0.3)
        out += [back - leg.direction * reach * k / STOPS for k in range(STOPS + 1)]
        back = back - leg.direction * leg.travel
    return out


def parts_of(robot: Blueprint, bodies: set[int], soft: bool, without: Collection[str] = ()) -> list[Solid]:
    chosen = (p for p in robot.parts if p.body in bodies and p.name not in without)
    return [p.solid for p in chosen if soft or p.material == "rigid"]


def motors_of(robot: Blueprint, bodies: set[int]) -> list[Solid]:
    return [motor_solid(robot, seat) for seat in robot.seats if seat.holder in bodies]


def worst(moved: list[Solid], fixed: list[Solid], offsets: list[np.ndarray]) -> float:
    return max(sum(shifted(m, at).overlap(f) for m in moved for f in fixed) for at in offsets)


def test_every_part_comes_exactly_once_and_nothing_needs_what_comes_later(plans) -> None:
    for robot, steps in plans:
        assert sorted(name for step in steps for name in step.adds) == sorted(part_names(robot))
        for at, step in enumerate(steps):
            assert all(0 <= need < at for need in step.needs)


def test_the_order_is_the_one_that_hands_can_follow(plans) -> None:
    for robot, steps in plans:
        at = {(step.kind, step.index): k for k, step in enumerate(steps)}
        for k, seat in enumerate(robot.seats):
            assert at["place", seat.holder] < at["cable", k] < at["motor", k] < at["body_screws", k] < at["join", k]
            assert at["join", k] + 1 == at["output_screws", k]
            assert at["place", seat.connector] < at["join", k]
        controller = next(k for k, b in enumerate(robot.boxes) if b.kind == "controller")
        if not steps[at["box", controller]].trouble:
            assert all(at["cable", k] < at["box", controller] for k in range(len(robot.seats)))


def test_joins_bring_all_bodies_together_two_groups_at_a_time(plans) -> None:
    for robot, steps in plans:
        groups = [{b} for b in range(len(robot.bodies))]
        for step in steps:
            if step.kind != "join":
                continue
            seat = robot.seats[step.index]
            moved, stay = (next(g for g in groups if b in g) for b in (step.moved[0], step.body))
            assert moved == set(step.moved)
            assert moved is not stay
            assert {seat.holder in moved, seat.connector in moved} == {True, False}
            groups = [g for g in groups if g is not moved and g is not stay] + [moved | stay]
        assert len(groups) == 1


def test_motors_and_boxes_pass_by_exact_booleans_of_what_they_sweep(plans) -> None:
    for robot, steps in plans:
        groups = [{b} for b in range(len(robot.bodies))]
        inside: list[Solid] = []
        open_still = {lid.part for lid in robot.lids}
        for step in steps:
            if step.kind == "lid":
                open_still.remove(robot.lids[step.index].part)
            if step.kind == "join":
                one, two = (next(g for g in groups if b in g) for b in (step.moved[0], step.body))
                groups = [g for g in groups if g is not one and g is not two] + [one | two]
            if step.kind not in ("motor", "box") or step.trouble:
                continue
            if step.kind == "motor":
                mover = motor_solid(robot, robot.seats[step.index])
                fixed = parts_of(robot, {step.body}, not step.soft, open_still)
            else:
                mover = box_solid(robot.boxes[step.index])
                group = next(g for g in groups if step.body in g)
                fixed = parts_of(robot, group, not step.soft, open_still) + motors_of(robot, group) + inside
                inside.append(mover)
            ends = [np.zeros(3)]
            for leg in reversed(step.legs):
                ends.append(ends[-1] - leg.direction * (0.6 if leg is step.legs[0] else leg.travel))
            # A convex solid sweeps the hull of its two ends.
            swept = [union([shifted(mover, a), shifted(mover, b)]).hull() for a, b in itertools.pairwise(ends)]
            resting = sum(mover.overlap(f) for f in fixed)
            assert sum(s.overlap(f) for s in swept for f in fixed) <= 4 * FREE + len(swept) * resting, step


def test_joins_pass_by_exact_booleans_along_the_way(plans) -> None:
    for robot, steps in plans:
        groups = [{b} for b in range(len(robot.bodies))]
        for step in steps:
            if step.kind != "join":
                continue
            moved, stay = (next(g for g in groups if b in g) for b in (step.moved[0], step.body))
            groups = [g for g in groups if g is not moved and g is not stay] + [moved | stay]
            hinge = robot.hinges[robot.seats[step.index].hinge]
            T = turned(hinge.position, hinge.axis, step.angle)
            mover = [s.moved(T) for s in parts_of(robot, moved, not step.soft) + motors_of(robot, moved)]
            fixed = parts_of(robot, stay, not step.soft) + motors_of(robot, stay)
            if not step.trouble:
                assert worst(mover, fixed, places(step)) <= 4 * FREE, step


def test_a_wall_across_a_shaft_is_found_and_named(built: Outcome) -> None:
    robot = built.blueprint
    seat = robot.box("battery")
    half = np.array(seat.size) / 2
    wall = box([-half[0] / 2, -half[1] / 2, seat.shaft + 0.01], [half[0] / 2, half[1] / 2, seat.shaft + 0.02])
    planted = [
        replace(p, solid=p.solid + wall.moved(seat.T_design_box))
        if p.body == seat.body and p.material == "rigid" else p
        for p in robot.parts
    ]  # fmt: skip
    steps = assembly_steps(replace(robot, parts=tuple(planted)))
    battery = next(s for s in steps if s.adds == ("battery",))
    name = robot.bodies[seat.body].name
    assert f"the bone of {name} stands in the way" in battery.trouble
    assert sorted(name for step in steps for name in step.adds) == sorted(part_names(robot))
    assert "battery" not in [s.adds for s in assembly_steps(robot) if s.trouble]


def test_soft_skin_over_a_shaft_is_pressed_aside_and_said_so(built: Outcome) -> None:
    robot = built.blueprint
    seat = robot.box("battery")
    half = np.array(seat.size) / 2
    flap = box([-half[0], -half[1], seat.shaft + 0.01], [half[0], half[1], seat.shaft + 0.014])
    extra = replace(robot.parts[0], name="flap", body=seat.body, material="soft", solid=flap.moved(seat.T_design_box))
    battery = next(s for s in assembly_steps(replace(robot, parts=(*robot.parts, extra))) if s.adds == ("battery",))
    assert battery.soft
    assert not battery.trouble


def test_a_lid_over_the_screws_leaves_no_room_for_a_tool(built: Outcome) -> None:
    robot = built.blueprint
    seat, mount = robot.seats[0], mount_of(robot.catalogue.motor)
    low = mount.base_low - 0.012
    lid = box([-0.04, -0.04, low - 0.004], [0.04, 0.04, low]).moved(seat.T_design_motor)
    extra = replace(robot.parts[0], name="lid", body=seat.holder, material="rigid", solid=lid)
    before = {(s.kind, s.index): s for s in assembly_steps(robot)}
    after = {(s.kind, s.index): s for s in assembly_steps(replace(robot, parts=(*robot.parts, extra)))}
    assert before["body_screws", 0].room >= 0.035
    assert after["body_screws", 0].room == 0
    assert "covers the screw heads" in after["body_screws", 0].trouble


def test_panels_hold_every_step_once_and_in_order(plans) -> None:
    for _, steps in plans:
        shown = list(panels(steps))
        assert [step for panel in shown for step in panel] == list(steps)
        assert all(sum(step.kind in ("motor", "join", "box", "lid") for step in panel) == 1 for panel in shown)


def test_a_design_without_parts_is_refused(built: Outcome) -> None:
    with pytest.raises(ValueError, match="no printed parts"):
        assembly_steps(score(built.design).blueprint)
