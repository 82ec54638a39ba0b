"""The room above electronics boxes: shafts and interference, against dense sampling and exact booleans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blueprints import ball_bone, blueprint_of, box_bone
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mfg.blueprint import Blueprint, BoxSeat
from mfg.insertion import Room, interference_above, obstacle_depth, shaft_height
from mfg.mounts import envelope, mount_of
from mfg.parts import PAPER
from mfg.solids import box, from_field, union

MOUNT = mount_of(PAPER.motor)
TILT = Rotation.from_euler("xyz", [0.4, 0.3, 0.5]).as_matrix()


def crowded() -> Blueprint:
    """A box seat below another body, a motor and a second box."""
    bones = [ball_bone((0.3, 0.3, 0.25), 0.09), box_bone((0.34, 0.30, 0.42), (0.06, 0.2, 0.05), TILT)]
    blueprint = blueprint_of(bones, [(1, 0, (0.26, 0.27, 0.37), (0.3, 1, 0.5))])
    T, U = np.eye(4), np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", [0.1, -0.2, 0.3]).as_matrix(), (0.3, 0.3, 0.25)
    U[:3, 3] = (0.33, 0.33, 0.31)
    below = BoxSeat("battery", 0, (0.105, 0.034, 0.045), T, 0.001, 0.0)
    above = BoxSeat("controller", 0, (0.060, 0.048, 0.030), U, 0.001, 0.08)
    below = replace(below, shaft=shaft_height(bones[0], below))
    return replace(blueprint, boxes=(below, above))


def test_interference_above_equals_the_exact_boolean() -> None:
    blueprint = crowded()
    seat, other = blueprint.boxes
    half = np.array(seat.size) / 2 + seat.clearance
    top = seat.shaft + 2 * half[2]
    room = box([-half[0], -half[1], half[2]], [half[0], half[1], top]).moved(seat.T_design_box)
    obstacles = union([
        from_field(blueprint.bodies[1].bone, 0),
        envelope(MOUNT, 0.0).moved(blueprint.seats[0].T_design_motor),
        box(-np.array(other.size) / 2, np.array(other.size) / 2).moved(other.T_design_box),
    ])  # fmt: skip
    exact = room.overlap(obstacles)
    assert exact > 5e-5
    assert interference_above(blueprint, seat) == pytest.approx(exact, rel=0.03)


def test_own_bone_above_the_box_does_not_count() -> None:
    blueprint = crowded()
    alone = replace(blueprint, seats=(), boxes=blueprint.boxes[:1], bodies=blueprint.bodies[:1])
    assert interference_above(alone, alone.boxes[0]) == 0.0


@settings(max_examples=15)
@given(st.integers(0, 10**6))
def test_the_coarse_room_agrees_with_sampling(seed: int) -> None:
    blueprint = crowded()
    rng = np.random.default_rng(seed)
    frame, anchor = Rotation.random(rng=rng).as_matrix(), np.array([0.3, 0.3, 0.25])
    centre, half = rng.uniform(-0.02, 0.02, (1, 3)), rng.uniform(0.015, 0.05, (1, 3))
    room = Room(blueprint, 0, anchor, frame, 0.006, centre, half)
    axis, sign = int(rng.integers(3)), int(rng.choice([-1, 1]))
    low, high, shaft = room.shafts(centre, half, axis, sign)
    assert shaft[0] >= half[0, axis]
    # The run starts at the cavity's face and ends one module height beyond the mouth.
    assert (high - low)[0, axis] == pytest.approx(shaft[0] + half[0, axis])
    local = rng.uniform(low, high, (20000, 3))
    inside = obstacle_depth(blueprint, 0, anchor + local @ frame.T) > 0
    volume = (high - low).prod()
    assert room.blocked(low, high)[0] == pytest.approx(inside.mean() * volume, abs=0.03 * volume + 2e-6)
