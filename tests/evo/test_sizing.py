"""Sizing ends at parts that bear the robot they make, the same every time, and says so where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gaits_in_brief import TINY

import evo.sizing as sizing
from decoder.design import VoxelDesign
from evo.sizing import End, Round, Sized, sized
from mfg.library import Library, read_library
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.pipeline import score
from mfg.selection import JointNeed, Margins, Needs, select, unmet

LIBRARY = read_library()


def of_seed(quadruped: VoxelDesign, seed: int, **more) -> Sized:
    rng = np.random.default_rng(seed)
    return sized(quadruped, rng, LIBRARY, budget=TINY, margins=Margins(drivers="any"), **more)


@pytest.fixture(scope="module")
def seed(quadruped: VoxelDesign) -> int:
    """The first one whose gait leads to a choice that repeats: with so small a budget not every one does."""
    return next(seed for seed in range(6) if of_seed(quadruped, seed).end is End.FIXED)


@pytest.fixture(scope="module")
def robot(quadruped: VoxelDesign, seed: int) -> Sized:
    return of_seed(quadruped, seed)


def test_the_quadruped_gets_parts_that_bear_it(robot: Sized):
    assert robot.end is End.FIXED
    assert robot.catalogue is not None
    last = robot.rounds[-1]
    assert last.catalogue == robot.catalogue == robot.outcome.blueprint.catalogue
    assert robot.outcome.ok
    assert last.lacking is None
    assert unmet(robot.catalogue, last.needs) is None
    assert robot.catalogue.battery.energy >= last.chosen.energy  # type: ignore[union-attr]
    again = select(last.needs, LIBRARY, PAPER, Margins(drivers="any"))
    assert not hasattr(again, "what")
    assert again.catalogue.motor == robot.catalogue.motor  # type: ignore[union-attr]


def test_the_same_randomness_sizes_alike(quadruped: VoxelDesign, robot: Sized, seed: int):
    told: list[tuple[int, int, str]] = []
    again = of_seed(quadruped, seed, progress=lambda *step: told.append(step))
    assert again.rounds == robot.rounds
    assert again.catalogue == robot.catalogue
    assert [step[0] for step in told] == list(range(1, len(robot.rounds) + 1))


def test_what_is_preferred_is_a_motor_that_can_be_driven(quadruped: VoxelDesign):
    found = sized(quadruped, np.random.default_rng(1), LIBRARY, budget=TINY)
    assert found.catalogue is not None
    assert found.catalogue.motor.driver == "j60"


def test_a_motor_too_large_for_the_body_is_refused_and_named(quadruped: VoxelDesign):
    huge = LIBRARY.only([replace(PAPER.motor, name="huge", diameter=0.19, length=0.2, voltage_range=(18.0, 36.0))])
    found = sized(quadruped, np.random.default_rng(1), huge, budget=TINY)
    assert (found.end, found.catalogue, found.rounds) == (End.NO_FIT, None, ())
    assert found.refused[0][0] == "huge"
    assert "no motor fits the body" in found.reason
    assert not found.outcome.ok
    none = sized(quadruped, np.random.default_rng(1), Library(), budget=TINY)
    assert (none.end, none.catalogue) == (End.NO_FIT, None)


def test_a_need_that_no_motor_meets_is_said(quadruped: VoxelDesign):
    weak = replace(PAPER.motor, name="weak", peak_torque=1.0, continuous_torque=0.2, voltage_range=(18.0, 36.0))
    found = sized(quadruped, np.random.default_rng(1), LIBRARY.only([weak]), budget=TINY)
    assert (found.end, found.catalogue) == (End.NO_FIT, None)
    assert "the closest, weak, gives" in found.reason
    assert len(found.rounds) == 1


def scripted(monkeypatch: pytest.MonkeyPatch, torque: dict[str, float]) -> None:
    """Replace the gait by the torque that each motor's robot is said to need."""

    def measured(blueprint, seed, budget, duration, parts, base, margins):
        motor = blueprint.catalogue.motor
        needs = Needs((JointNeed("joint_1", torque[motor.name], 0.5, 0.1, 1.0, 0.5),), duration)
        return Round(blueprint.catalogue, motor.mass, 0.1, needs, select(needs, parts, base, margins),
                     unmet(blueprint.catalogue, needs, margins))  # fmt: skip

    monkeypatch.setattr(sizing, "_measured", measured)


def test_a_cycle_is_found_and_the_robot_that_bears_itself_is_kept(monkeypatch, quadruped: VoxelDesign):
    light, heavy = (m for m in LIBRARY.motors if m.name in ("DM-J4310-2EC", "CyberGear"))
    scripted(monkeypatch, {light.name: 8.0, heavy.name: 2.0})
    found = sized(quadruped, np.random.default_rng(1), LIBRARY.only([light, heavy]))
    assert found.end is End.CYCLE
    assert found.catalogue is not None
    assert found.catalogue.motor == heavy
    assert "goes round" in found.reason
    assert "kept CyberGear" in found.reason


def test_a_robot_that_no_motor_bears_is_not_called_sized(monkeypatch, quadruped: VoxelDesign):
    motors = [m for m in LIBRARY.motors if m.name in ("DM-J4310-2EC", "CyberGear")]
    scripted(monkeypatch, {"DM-J4310-2EC": 8.0, "CyberGear": 11.0})
    found = sized(quadruped, np.random.default_rng(1), LIBRARY.only(motors))
    assert (found.end, found.catalogue) == (End.NO_FIT, None)
    assert [r.catalogue.motor.name for r in found.rounds] == ["DM-J4310-2EC", "CyberGear"]


def test_a_choice_that_never_settles_ends_after_the_rounds(monkeypatch, quadruped: VoxelDesign):
    ladder = [replace(PAPER.motor, name=f"step {k}", mass=0.3 + k / 100, peak_torque=1.0 + k, continuous_torque=0.5,
                      voltage_range=(18.0, 36.0)) for k in range(9)]  # fmt: skip
    scripted(monkeypatch, {m.name: (m.peak_torque + 0.5) / 1.25 for m in ladder})
    found = sized(quadruped, np.random.default_rng(1), LIBRARY.only(ladder), rounds=4)
    assert (found.end, found.catalogue, len(found.rounds)) == (End.ROUNDS, None, 4)
    assert "still changing after 4 rounds" in found.reason


def test_a_body_passes_if_some_choice_bears_the_robot_that_it_makes(monkeypatch, quadruped: VoxelDesign, robot: Sized):
    assert (robot.end, robot.failure, robot.verdict.ok) == (End.FIXED, None, True)
    light, heavy = (m for m in LIBRARY.motors if m.name in ("DM-J4310-2EC", "CyberGear"))
    scripted(monkeypatch, {light.name: 8.0, heavy.name: 2.0})
    kept = sized(quadruped, np.random.default_rng(1), LIBRARY.only([light, heavy]))
    assert (kept.end, kept.failure, kept.verdict.ok) == (End.CYCLE, None, True)
    assert kept.verdict.blueprint.catalogue.motor == heavy
    assert "the choice did not repeat (cycle)" in kept.verdict.blueprint.notes[-1]
    assert "did not repeat" not in robot.verdict.blueprint.notes[-1]
    ladder = [replace(PAPER.motor, name=f"step {k}", mass=0.3 + k / 100, peak_torque=1.0 + k, continuous_torque=0.5,
                      voltage_range=(18.0, 36.0)) for k in range(9)]  # fmt: skip
    scripted(monkeypatch, {m.name: (m.peak_torque + 0.5) / 1.25 for m in ladder})
    lost = sized(quadruped, np.random.default_rng(1), LIBRARY.only(ladder), rounds=3)
    assert lost.outcome.ok
    assert lost.failure == lost.verdict.failure == Failure(Stage.MOTOR, Reason.UNSETTLED, lost.reason)
    assert lost.verdict.blueprint is lost.outcome.blueprint


def test_no_other_controller_is_tried_where_the_motors_fail(quadruped: VoxelDesign):
    huge = replace(PAPER.motor, name="huge", diameter=0.19, length=0.2, voltage_range=(18.0, 36.0))
    tried: list[str] = []

    def counted(design, catalogue):
        tried.append(catalogue.computer.name)
        return score(design, catalogue)

    assert len(LIBRARY.controllers) > 1
    found = sized(quadruped, np.random.default_rng(1), LIBRARY.only([huge]), solve=counted)
    assert found.failure is not None
    assert found.failure.stage in (Stage.SKELETON, Stage.MOTOR)
    assert len(tried) == 1
