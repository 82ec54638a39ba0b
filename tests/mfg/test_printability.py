"""Printability: the fast verdicts about pieces and size agree with the solids that would be printed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import ellipsoid, painted
from hypothesis import given
from hypothesis import strategies as st

from decoder.design import Joint, VoxelDesign
from mfg.blueprint import Blueprint
from mfg.bones import smooth_field
from mfg.motion import MotionSolver
from mfg.motors import MotorSolver
from mfg.mounts import connector, envelope, holder, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.pipeline import VIRTUAL, run
from mfg.printability import PrintabilitySolver, fits, print_extents, with_hardware
from mfg.solids import from_field

MOUNT = mount_of(PAPER.motor)


def seated(design: VoxelDesign) -> Blueprint:
    outcome = run((*VIRTUAL, MotionSolver(), MotorSolver()), Blueprint(design, PAPER))
    assert outcome.ok, outcome.failure
    return outcome.blueprint


def test_hardware_on_the_field_is_hardware_in_the_solid(creature: VoxelDesign) -> None:
    blueprint = seated(creature)
    for index in range(len(blueprint.bodies)):
        solid = from_field(with_hardware(blueprint, index, MOUNT, 1.5e-3))
        for seat in blueprint.seats:
            if index == seat.holder:
                mine, room = holder(MOUNT), connector(MOUNT)
            elif index == seat.connector:
                mine, room = connector(MOUNT), holder(MOUNT)
            else:
                assert solid.overlap(envelope(MOUNT, 0.0).moved(seat.T_design_motor)) < 1e-6
                continue
            assert solid.overlap(mine.moved(seat.T_design_motor)) > 0.9 * mine.volume
            assert solid.overlap(room.moved(seat.T_design_motor)) < 0.03 * room.volume


def test_a_body_beyond_the_printer_is_too_large(creature: VoxelDesign) -> None:
    printer = replace(PAPER.printer, volume=(0.2, 0.2, 0.2))
    blueprint = replace(seated(creature), catalogue=replace(PAPER, printer=printer))
    failure = PrintabilitySolver().solve(blueprint)
    assert isinstance(failure, Failure)
    assert (failure.stage, failure.reason) == (Stage.PRINT, Reason.TOO_LARGE)
    assert "200 x 200 x 200" in failure.detail


def test_a_good_body_passes_unchanged(creature: VoxelDesign) -> None:
    blueprint = seated(creature)
    assert PrintabilitySolver().solve(blueprint) is blueprint


def test_extents_agree_with_the_meshed_body() -> None:
    field = smooth_field(ellipsoid((31.3, 32, 32), (14.2, 8, 5)), 0.01, 0.8)
    near = (field.values > 0) & (field.values <= field.spacing)
    points = (np.argwhere(near) + field.corner) * field.spacing
    fast = print_extents(points, field.values[near].astype(np.float64))
    np.testing.assert_allclose(np.sort(fast), np.sort(np.ptp(from_field(field).bounds, axis=0)), atol=3e-3)


def test_hardware_that_cuts_a_bone_in_two_is_noticed() -> None:
    # Two thin necks lead through the envelope of a motor that belongs to other bodies.
    bones = [ellipsoid((20, 32, 32), (8, 6, 6)), ellipsoid((36, 32, 32), (8, 6, 6))]
    blueprint = seated(painted(bones, (Joint((0.28, 0.32, 0.32), (0, 1, 0), (-1, 1), 1, 2),)))
    bar = ellipsoid((28, 32, 32), (4, 26, 4))
    third = replace(blueprint.bodies[0], name="body_9", bone=smooth_field(bar, 0.01, 0.8))
    failure = PrintabilitySolver().solve(replace(blueprint, bodies=(*blueprint.bodies, third)))
    assert isinstance(failure, Failure)
    assert failure.reason == Reason.BONE_SEVERED
    assert "body_9" in failure.detail


@given(st.permutations([0, 1, 2]), st.floats(0.05, 0.4))
def test_fit_does_not_depend_on_axis_order(order: list[int], size: float) -> None:
    extents = np.array([size, 0.1, 0.05])
    assert fits(extents[order], (0.3, 0.32, 0.32)) == fits(extents, (0.3, 0.32, 0.32)) == (size <= 0.32)


def test_a_tilted_slab_is_measured_along_itself() -> None:
    rng = np.random.default_rng(0)
    slab = rng.uniform(-0.5, 0.5, (4000, 3)) * (0.25, 0.15, 0.1)
    c = np.sqrt(0.5)
    tilted = slab @ np.array([[c, c, 0], [-c, c, 0], [0, 0, 1.0]])
    assert np.ptp(tilted, axis=0).max() > 0.27
    assert np.sort(print_extents(tilted, np.zeros(len(tilted))))[-1] == pytest.approx(0.25, abs=0.01)
