"""Mounts: the printed halves, the motor and their clearances never meet, and depths agree with the solids."""

from __future__ import annotations

import numpy as np
import pytest

from mfg import mounts
from mfg.parts import J60_6

MOUNT = mounts.mount_of(J60_6)
PARTS = {"housing": mounts.housing, "holder": mounts.holder, "connector": mounts.connector}


@pytest.mark.parametrize("name", PARTS)
def test_each_part_is_one_solid(name: str) -> None:
    solid = PARTS[name](MOUNT)
    assert len(solid.components()) == 1
    assert solid.volume > 0


def test_parts_and_rooms_are_disjoint() -> None:
    housing, holder, connector = (make(MOUNT) for make in PARTS.values())
    for a, b in ((housing, holder), (housing, connector), (holder, connector)):
        assert a.overlap(b) < 1e-15  # They touch at the faces that are screwed together.
    assert holder.overlap(mounts.connector_keepout(MOUNT)) == 0.0
    assert connector.overlap(mounts.holder_keepout(MOUNT)) == 0.0
    assert (housing - mounts.cavity(MOUNT)).volume == pytest.approx(0.0, abs=1e-12)
    whole = mounts.envelope(MOUNT, 0.0)
    for part in (housing, holder, connector):
        assert (part - whole).volume < 1e-9


def test_screw_holes_are_open_on_both_sides() -> None:
    for solid, pattern, depth in (
        (mounts.holder(MOUNT), J60_6.body_screws, MOUNT.housing_low - MOUNT.base_low),
        (mounts.connector(MOUNT), J60_6.output_screws, MOUNT.connector_high - MOUNT.connector_low),
    ):
        for hole in mounts.screw_holes(pattern, -1.0, 1.0):
            thin = hole.overlap(solid)
            assert thin < 1e-10
            assert depth > 0


def test_the_envelope_depth_agrees_with_the_solid() -> None:
    solid = mounts.envelope(MOUNT, 0.0)
    T = mounts.motor_pose(np.array([0.1, 0.2, 0.3]), np.array([0.6, 0.0, 0.8]), 0.01)
    rng = np.random.default_rng(1)
    low, high = solid.bounds - np.array([[0.01], [-0.01]])
    points = rng.uniform(low, high, (200_000, 3))
    inside = mounts.envelope_depth(points @ T[:3, :3].T + T[:3, 3], T, MOUNT) > 0
    assert inside.mean() * np.prod(high - low) == pytest.approx(solid.volume, rel=0.015)


def test_output_bolts_fall_inside_the_housing_and_body_bolts_inside_the_cup() -> None:
    for pattern in (J60_6.body_screws, J60_6.output_screws):
        assert pattern.circle_radius + pattern.head_diameter / 2 < MOUNT.housing_radius
        assert pattern.circle_radius - pattern.head_diameter / 2 > mounts.BORE
