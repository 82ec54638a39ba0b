"""Placing parts: bones that share a hinge meet, and a part that is where it should be stays there."""

from __future__ import annotations

import numpy as np
import pytest

from decoder.parts import LATTICE, lattice_points
from decoder.placing import GAP, MOTORS_APART, Part, seated, spaced


@pytest.mark.parametrize("away", [0.0, 2.0, 7.0])
def test_a_part_is_pushed_until_the_bones_meet(away: float):
    radius = (np.linalg.norm(lattice_points() * 9.0, axis=1) - 5.0).reshape(LATTICE).clip(-4, 4).astype(np.float32)
    ball = np.stack([radius, radius - 1])
    across = np.array([0.0, 1.0, 0.0])

    def part(x: float, hinge: float) -> Part:
        return Part(0, np.array([x, 32.0, 32.0]), np.eye(3), np.full(3, 9.0), np.array([hinge, 32.0, 32.0]), across,
                    1.0, np.array([-1.0, 1.0]), ball)  # fmt: skip

    torso, limb = part(20.0, 20.0), part(30.0 + away, 25.0 + away / 2)
    pushed = seated(limb, torso)
    gap = pushed.centre[0] - torso.centre[0] - 10.0
    if away == 0.0:
        assert pushed is limb
    else:
        assert 0.3 < gap < GAP + 0.1
        assert pushed.hinge - pushed.centre == pytest.approx(limb.hinge - limb.centre)


def test_a_part_is_pushed_away_from_hinges_where_its_motor_would_meet_theirs():
    def part(hinge: list[float]) -> Part:
        where = np.array(hinge)
        return Part(0, where + 5.0, np.eye(3), np.full(3, 9.0), where, np.eye(3)[1], 1.0, np.array([-1.0, 1.0]),
                    np.zeros((2, *LATTICE), np.float32))  # fmt: skip

    near, far = np.array([30.0, 32.0, 32.0]), np.array([60.0, 32.0, 32.0])
    limb = part([34.0, 32.0, 32.0])
    pushed = spaced(limb, [near, far])
    assert pushed.hinge == pytest.approx([30.0 + MOTORS_APART, 32.0, 32.0])
    assert pushed.centre - pushed.hinge == pytest.approx(limb.centre - limb.hinge)
    assert spaced(pushed, [near]).hinge == pytest.approx(pushed.hinge)
    assert spaced(limb, [limb.hinge.copy()]) is limb  # where there is no direction to push in
