"""Cut bodies: every piece is one closed solid that fits, and together they are the body less the pegs' clearance."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from blueprints import blueprint_of, box_bone
from numpy.testing import assert_allclose

from mfg.blueprint import Blueprint, BoxSeat, PrintedPart, WireRun
from mfg.catalogue import Size
from mfg.exact import box_room
from mfg.export import blueprint_files, print_objects
from mfg.finish import FinishSolver
from mfg.manifest import NAME
from mfg.mounts import envelope, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import J60_6, PAPER
from mfg.pipeline import Outcome, run
from mfg.pipeline import build as build_whole
from mfg.plate import arrange, fits_printer
from mfg.printability import PrintabilitySolver
from mfg.retreat import RETREAT
from mfg.solids import box, from_field, union
from mfg.splitting import SplitSolver, pieces
from mfg.stl import torn_edges, welded

SOLVER = SplitSolver()
# What a peg of a hole of 48 sides leaves open.
SIDES = 48 * math.sin(2 * math.pi / 48) / 2
LOST = SIDES * (
    (SOLVER.peg_radius + SOLVER.clearance) ** 2 * (SOLVER.peg_length + SOLVER.ground)
    - SOLVER.peg_radius**2 * SOLVER.peg_length
)


def small_printer(blueprint: Blueprint, *volume: float) -> Blueprint:
    size: Size = (volume[0], volume[1], volume[2])
    return replace(blueprint, catalogue=replace(PAPER, printer=replace(PAPER.printer, volume=size)))


def beam(length: float, printer: tuple[float, float, float], **more: object) -> Blueprint:
    """A beam along x with a jacket above it, its corner at (0.2, 0.27, 0.27), on a small printer."""
    bone = box_bone((0.2 + length / 2, 0.30, 0.30), (length, 0.06, 0.06))
    blueprint = small_printer(blueprint_of([bone], **more), *printer)  # type: ignore[arg-type]
    jacket = box((0.2, 0.27, 0.33), (0.2 + length, 0.33, 0.345))
    parts = (
        PrintedPart("body_0_bone", 0, "rigid", box((0.2, 0.27, 0.27), (0.2 + length, 0.33, 0.33))),
        PrintedPart("body_0_skin_1", 0, "soft", jacket),
    )
    return replace(blueprint, parts=parts)


def checked(
    before: Blueprint, after: Blueprint | Failure, rounding: float = 1e-10, *, retreat: float = 0.0
) -> Blueprint:
    """What must hold of anything that was cut; the mesh kernel moves curved surfaces by some `rounding` [m3].

    Finished parts step back from all of their faces by `retreat` [m], from those of the cuts, too.
    """
    assert isinstance(after, Blueprint), str(after)
    volume = after.catalogue.printer.volume
    for piece in pieces(after):
        assert fits_printer(piece.points, volume), piece.name
        assert sum(part.material == "rigid" for part in piece.parts) == 1
    for part in after.parts:
        assert len(part.solid.components()) == 1, part.name
        assert len(torn_edges(welded(part.solid)[1])) == 0, part.name
    for a, b in itertools.combinations(after.parts, 2):
        assert a.solid.overlap(b.solid) < 1e-12, (a.name, b.name)
    for index in range(len(after.bodies)):
        for material in ("rigid", "soft"):
            old = [p.solid for p in before.parts if p.body == index and p.material == material]
            new = [p.solid for p in after.parts if p.body == index and p.material == material]
            if not old:
                continue
            cuts = len(new) - 1 if material == "rigid" else 0
            lost = sum(s.volume for s in old) - sum(s.volume for s in new)
            if material == "rigid":
                faces = sum(s.area for s in new) - sum(s.area for s in old)
                assert lost == pytest.approx(2 * cuts * LOST + retreat * faces, abs=rounding)
            else:
                assert -rounding < lost < 1e-5
            assert (union(new) - union(old)).volume < rounding
    assert len({part.name for part in after.parts}) == len(after.parts)
    return after


def test_a_beam_twice_as_long_as_the_printer_becomes_pieces_that_fit() -> None:
    before = beam(0.30, (0.17, 0.1, 0.1))
    after = checked(before, SOLVER.solve(before))
    assert [piece.name for piece in pieces(after)] == ["body_0_1", "body_0_2"]
    assert [part.name for part in after.parts] == [
        "body_0_bone_1",
        "body_0_skin_1_1",
        "body_0_bone_2",
        "body_0_skin_1_2",
    ]
    assert "cut into 2 pieces" in after.notes[-1]


def test_more_cuts_are_made_where_one_is_not_enough() -> None:
    before = beam(0.45, (0.12, 0.1, 0.1))
    assert len(pieces(checked(before, SOLVER.solve(before)))) >= 4


def test_what_fits_stays_as_it_is() -> None:
    before = beam(0.30, (0.32, 0.1, 0.1))
    after = SOLVER.solve(before)
    assert isinstance(after, Blueprint)
    assert after.parts == before.parts
    assert after.notes == before.notes


def test_pegs_go_into_their_holes_with_the_clearance_all_around() -> None:
    before = beam(0.30, (0.17, 0.1, 0.1))
    after = checked(before, SOLVER.solve(before))
    first, second = (p.solid for p in after.parts if p.material == "rigid")
    assert first.overlap(second) == 0
    # The piece with pegs is longer than its face by the length of a peg: find the face, then move the pieces.
    along = int(np.argmax(np.ptp(np.concatenate([first.vertices, second.vertices]), axis=0)))
    overlap = min(first.bounds[1, along], second.bounds[1, along]) - max(
        first.bounds[0, along], second.bounds[0, along]
    )
    assert overlap == pytest.approx(SOLVER.peg_length, abs=1e-6)
    shift = np.eye(4)
    for axis, by in itertools.product(range(3), (-0.9, 0.9)):
        if axis == along:
            continue
        T = shift.copy()
        T[axis, 3] = by * SOLVER.clearance
        # Slid aside by less than the clearance the faces only rub; by more, pegs run into bone.
        assert first.moved(T).overlap(second) < 1e-9
        T[axis, 3] *= 2
        assert first.moved(T).overlap(second) > 1e-9


@pytest.mark.parametrize("place", [0.29, 0.33, 0.37, 0.41])
def test_no_cut_goes_through_a_motor_or_a_box(place: float) -> None:
    seats = [(0, 0, (place, 0.40, 0.30), (0, 1, 0))]
    T = np.eye(4)
    T[:3, 3] = 0.70 - place, 0.30, 0.30
    seat = BoxSeat("battery", 0, (0.04, 0.03, 0.03), T, 1e-3, 0.03)
    before = replace(beam(0.30, (0.24, 0.1, 0.1), seats=seats), boxes=(seat,))
    motor = envelope(mount_of(J60_6)).moved(before.seats[0].T_design_motor)
    after = SOLVER.solve(before)
    if isinstance(after, Failure):
        assert "too near a motor or a box" in after.detail
        return
    first, second = (p.solid for p in checked(before, after).parts if p.material == "rigid")
    face = (min(first.bounds[1, 0], second.bounds[1, 0]) + max(first.bounds[0, 0], second.bounds[0, 0])) / 2
    for low, high in (motor.bounds[:, 0], box_room(seat).bounds[:, 0]):
        assert face + SOLVER.peg_length / 2 < low or face - SOLVER.peg_length / 2 > high


def test_a_tunnel_is_crossed_steeply_or_not_at_all() -> None:
    along = WireRun("wire_1", 0, np.array([[0.21, 0.30, 0.30], [0.49, 0.30, 0.30]]), 4e-3)
    before = beam(0.30, (0.17, 0.1, 0.1))
    assert isinstance(SOLVER.solve(replace(before, wires=(along,))), Blueprint)
    # A cable that runs across every cut which leaves two pieces that fit.
    zigzag = np.array([[0.21 + 0.28 * k / 60, 0.28 + 0.04 * (k % 2), 0.30] for k in range(61)])
    refused = SOLVER.solve(replace(before, wires=(replace(along, path=zigzag),)))
    assert isinstance(refused, Failure)
    assert (refused.stage, refused.reason) == (Stage.PRINT, Reason.TOO_LARGE)
    assert "along a tunnel" in refused.detail


def test_a_bone_too_thin_for_pegs_is_refused_with_the_reason() -> None:
    before = beam(0.30, (0.17, 0.1, 0.1))
    thin = box_bone((0.35, 0.30, 0.30), (0.30, 0.012, 0.012))
    before = replace(
        before,
        bodies=(replace(before.bodies[0], bone=thin),),
        parts=(replace(before.parts[0], solid=from_field(thin)),),
    )
    refused = SOLVER.solve(before)
    assert isinstance(refused, Failure)
    assert "no room for two pegs" in refused.detail
    assert "\n" not in refused.detail


def test_a_body_of_more_volume_than_its_pieces_can_have_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    before = beam(0.30, (0.17, 0.1, 0.1))
    space = before.parts[0].solid.volume / SOLVER.most
    monkeypatch.setattr(SplitSolver, "_halved", lambda *_: pytest.fail("looked for a cut"))
    printer = replace(before.catalogue.printer, volume=(0.99 * space ** (1 / 3),) * 3)
    refused = SOLVER.solve(replace(before, catalogue=replace(before.catalogue, printer=printer)))
    assert isinstance(refused, Failure)
    assert (refused.stage, refused.reason) == (Stage.PRINT, Reason.TOO_LARGE)
    assert "more than 16 pieces would be needed" in refused.detail


def test_without_the_option_a_finish_is_as_before_and_with_it_nothing_changes_for_what_fits(plain: Outcome) -> None:
    assert FinishSolver().split is False
    before = build_whole(plain.design, rules="paper")
    again = FinishSolver(split=True).solve(replace(before.blueprint, parts=(), notes=()))
    assert isinstance(again, Blueprint)
    for a, b in zip(plain.blueprint.parts, again.parts, strict=True):
        assert a.name == b.name
        assert_allclose(a.solid.vertices, b.solid.vertices, atol=0)


@pytest.fixture(scope="module")
def cut(plain: Outcome) -> Blueprint:
    """The creature for a printer of half the size."""
    from mfg.pipeline import SCORING

    catalogue = small_printer(plain.blueprint, 0.21, 0.21, 0.21).catalogue
    solvers = tuple(s for s in SCORING if not isinstance(s, PrintabilitySolver))
    ready = run(solvers, Blueprint(plain.design, catalogue))
    assert ready.ok, ready.failure
    refused = FinishSolver().solve(ready.blueprint)
    assert isinstance(refused, Failure)
    assert refused.reason is Reason.TOO_LARGE
    made = FinishSolver(split=True).solve(ready.blueprint)
    return checked(plain.blueprint, made, 1e-9, retreat=RETREAT)


def test_a_robot_is_cut_and_its_files_know_the_pieces(cut: Blueprint) -> None:
    files = blueprint_files(cut)
    document = json.loads(files[NAME])
    assert [p["name"] for p in document["pieces"]] == [piece.name for piece in pieces(cut)]
    assert len(document["pieces"]) > len(document["bodies"])
    named = [name for piece in document["pieces"] for name in piece["parts"]]
    assert sorted(named) == sorted(part.name for part in cut.parts)
    assert {f"parts/{name}.stl" for name in named} <= set(files)
    lays = arrange([piece.points for piece in pieces(cut)], cut.catalogue.printer.volume)
    assert [thing.name for thing in print_objects(cut, lays)] == [piece.name for piece in pieces(cut)]
    assert sum(m.mass for m in cut.masses) > 0
    assert blueprint_files(cut)[NAME] == files[NAME]


def test_a_whole_robot_has_no_list_of_pieces(plain: Outcome) -> None:
    assert "pieces" not in json.loads(blueprint_files(plain.blueprint)[NAME])
    assert [piece.name for piece in pieces(plain.blueprint)] == [body.name for body in plain.blueprint.bodies]
