"""Printability: the fast verdicts about pieces and size agree with the solids that would be printed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import CENTRES, ellipsoid, painted

from decoder.design import Joint, VoxelDesign
from mfg.blueprint import Blueprint
from mfg.motion import MotionSolver
from mfg.motors import MotorSolver
from mfg.mounts import connector, envelope, holder, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.pipeline import BODIES, run
from mfg.printability import PrintabilitySolver, outline_points, with_hardware
from mfg.solids import from_field
from mfg.voxel_fields import smooth_field

MOUNT = mount_of(PAPER.motor)


def seated(design: VoxelDesign) -> Blueprint:
    outcome = run((*BODIES, MotionSolver(), MotorSolver()), Blueprint(design, PAPER))
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


@pytest.mark.parametrize("turn", [0.0, 0.4, 0.785])
def test_the_outline_is_the_surface_of_the_meshed_body(turn: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    local = (CENTRES - 32) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    field = smooth_field(((local / (13, 7, 5)) ** 4).sum(-1) < 1, 0.01, 0.8)
    outline, mesh = outline_points(field), from_field(field, 0.0).vertices
    for direction in np.random.default_rng(0).normal(size=(20, 3)):
        unit = direction / np.linalg.norm(direction)
        assert (outline @ unit).max() == pytest.approx((mesh @ unit).max(), abs=2.5e-3)


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
