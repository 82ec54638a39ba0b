"""Room for hands and keys: the points stand for the exact rooms, and the search leaves none of them closed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from decoder.latent import make_decoder, sample_latents
from mfg.blueprint import MotorSeat
from mfg.exact import ACCESS, filled_mounts
from mfg.mounts import motor_pose, mount_of
from mfg.parts import J60_6
from mfg.pipeline import build
from mfg.solids import Solid, cylinder, tube
from mfg.tool_access import MARGIN, reach, shortfall
from mfg.ways import TOOLS, Scene, motor_way, tool_room

MOUNT = mount_of(J60_6)


def seat(
    holder: int, connector: int, position: tuple[float, float, float], axis: tuple[float, float, float]
) -> MotorSeat:
    a = np.array(axis) / np.linalg.norm(axis)
    return MotorSeat(0, holder, connector, 0.0, motor_pose(np.array(position), a, 0.0), 0.0, 0.0, 0.0)


def rooms(one: MotorSeat, grown: float = 0.0) -> list[tuple[set[int], Solid]]:
    """The rooms of a seat as solids, and the bodies whose mounts must stay out of them."""
    body, output = J60_6.body_screws, J60_6.output_screws
    base = tube(body.circle_radius + body.head_diameter / 2 + grown,
                body.circle_radius - body.head_diameter / 2 - grown,
                MOUNT.base_low - ACCESS - grown, MOUNT.base_low - MARGIN + grown)  # fmt: skip
    disc = tube(output.circle_radius + output.head_diameter / 2 + grown,
                output.circle_radius - output.head_diameter / 2 - grown,
                MOUNT.connector_high + MARGIN - grown, MOUNT.connector_high + ACCESS + grown)  # fmt: skip
    way = cylinder(MOUNT.housing_radius + grown, MOUNT.connector_low + MARGIN - grown,
                   MOUNT.holder_top + J60_6.length + 2e-3 + grown)  # fmt: skip
    both = {one.holder, one.connector}
    return [(who, solid.moved(one.T_design_motor)) for who, solid in (({one.holder}, base), (both, disc),
                                                                      ({one.holder}, way))]  # fmt: skip


def met(one: MotorSeat, other: MotorSeat, grown: float = 0.0) -> float:
    halves = {other.holder: filled_mounts(MOUNT)[0], other.connector: filled_mounts(MOUNT)[1]}
    return sum(solid.overlap(half.moved(other.T_design_motor)) for who, solid in rooms(one, grown)
               for body, half in halves.items() if body in who)  # fmt: skip


@pytest.mark.parametrize("trial", range(60))
def test_what_is_called_free_is_free_and_what_is_not_nearly_is_not(trial: int) -> None:
    rng = np.random.default_rng(trial)
    one = seat(0, 1, (0.3, 0.3, 0.3), (0, 0, 1))
    away = rng.normal(size=3)
    away *= rng.uniform(0.08, 0.2) / np.linalg.norm(away)
    bodies = ((0, 2), (2, 0), (1, 2), (2, 1))[trial % 4]
    other = seat(*bodies, tuple(0.3 + away), tuple(rng.normal(size=3)))  # type: ignore[arg-type]
    exact, near = met(one, other) + met(other, one), met(one, other, MARGIN) + met(other, one, MARGIN)
    if shortfall(one, other, MOUNT) > 0:
        assert near > 0
    else:
        assert exact == 0.0


def test_back_to_back_they_need_a_screwdriver_between_them_and_far_apart_nothing() -> None:
    down, one = (0.0, 0.0, -1.0), seat(0, 1, (0.3, 0.3, 0.3), (0, 0, 1))
    bases = 2 * abs(MOUNT.base_low)
    for gap in (0.010, 0.020, 0.030):
        other = seat(0, 2, (0.3, 0.3, 0.3 - bases - gap), down)
        assert shortfall(one, other, MOUNT) == pytest.approx(ACCESS - gap, abs=7e-3)
    assert shortfall(one, seat(0, 2, (0.3, 0.3, 0.3 - bases - ACCESS - MARGIN - 1e-3), down), MOUNT) == 0.0
    # Of another body there is nothing yet when the screws are driven.
    assert shortfall(one, seat(3, 2, (0.3, 0.3, 0.3 - bases - 0.01), down), MOUNT) == 0.0
    assert reach(MOUNT) > ACCESS


def test_no_robot_of_the_search_hides_its_screws_behind_a_mount() -> None:
    """By the guide's own measure, on the printed parts."""
    hidden = looked = 0
    for kind, seed in (("vae", 3), ("genome", 3)):
        for design in make_decoder(kind).decode(sample_latents(4, np.random.default_rng(seed))):
            outcome = build(design, rules="search")
            if not outcome.ok:
                continue
            robot = outcome.blueprint
            scene = Scene.of(robot)
            for a, b in itertools.combinations(robot.seats, 2):
                assert shortfall(a, b, MOUNT) == 0.0
            for k, one in enumerate(robot.seats):
                looked += 1
                room = tool_room(scene, k, [one.holder], output=False)[0]
                output = tool_room(scene, k, [one.holder, one.connector], output=True)[0]
                hidden += min(room, output) < TOOLS[-1] or not motor_way(scene, k).free
    assert looked > 10
    assert hidden == 0
