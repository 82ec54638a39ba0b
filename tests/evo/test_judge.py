"""One judge for every command: given parts, or parts sized to each body, with the design's key as the only seed."""

from __future__ import annotations

import functools
import pickle
from dataclasses import replace

import pytest
from gaits_in_brief import TINY

import evo.sizing as sizing
from decoder.design import VoxelDesign
from evo.judge import DEFAULT_JUDGE, Judge
from evo.sizing import End, Sized, sized
from mfg.library import Library, read_library
from mfg.outcome import Failure, Reason, Stage
from mfg.parts import PAPER
from mfg.pipeline import build, score
from sim.rollout import Diverged

LIBRARY = read_library()


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Sized]:
    """Make sizing quick, and keep what it came to."""
    found: list[Sized] = []

    def quick(*args, **kwargs) -> Sized:
        found.append(sized(*args, **kwargs, budget=TINY))
        return found[-1]

    monkeypatch.setattr(sizing, "sized", quick)
    return found


def verdict(outcome):
    return outcome.failure, outcome.scores, outcome.blueprint.catalogue, outcome.blueprint.notes


def test_given_parts_are_judged_by_the_pipeline_alone(hinge: VoxelDesign, calls: list[Sized]):
    for rules in ("paper", "search"):
        judge = Judge(rules)
        assert verdict(judge.score(hinge)) == verdict(score(hinge, PAPER, rules))
        assert verdict(judge.build(hinge)) == verdict(build(hinge, PAPER, rules))
    assert calls == []


def test_sized_parts_go_into_the_blueprint_and_are_told(quadruped: VoxelDesign, calls: list[Sized]):
    judge = pickle.loads(pickle.dumps(Judge(library=LIBRARY)))  # as a worker gets it
    told: list[tuple[int, int, str]] = []
    first = judge.score(quadruped, lambda *step: told.append(step))
    assert first.ok
    assert (calls[0].failure, calls[0].end in (End.FIXED, End.CYCLE)) == (None, True)
    assert told[0][0] == 1
    parts = first.to_json()["catalogue"]
    assert parts == {"name": "auto", "motor": "J60-6", "battery": parts["battery"], "controller": parts["controller"],
                     "wire": parts["wire"]}  # fmt: skip
    assert f"J60-6, {parts['battery']}, {parts['controller']}, {parts['wire']}" in first.blueprint.notes[-1]
    built = judge.build(quadruped)
    assert built.ok
    assert built.blueprint.parts
    assert built.blueprint.catalogue == first.blueprint.catalogue
    assert calls[1].rounds == calls[0].rounds
    assert set(built.seconds) == {*first.seconds, "finish"}


def test_parts_that_do_not_bear_their_robot_are_a_failure_of_one_line(
    monkeypatch: pytest.MonkeyPatch, quadruped: VoxelDesign
):
    weak = replace(PAPER.motor, name="weak", peak_torque=1.0, continuous_torque=0.2, voltage_range=(18.0, 36.0))
    monkeypatch.setattr(sizing, "sized", functools.partial(sized, budget=TINY))
    found = Judge(library=LIBRARY.only([weak])).score(quadruped)
    assert found.failure is not None
    assert (found.failure.stage, found.failure.reason) == (Stage.MOTOR, Reason.NO_PART)
    assert "the closest, weak, gives" in found.failure.detail
    assert "\n" not in found.failure.detail
    assert found.blueprint.catalogue.motor.name == "weak"
    built = Judge(library=LIBRARY.only([weak])).build(quadruped)
    assert (built.failure, built.blueprint.parts) == (found.failure, ())


def test_without_a_motor_that_fits_it_is_the_failure_of_the_closest_try(quadruped: VoxelDesign, calls: list[Sized]):
    huge = replace(PAPER.motor, name="huge", diameter=0.19, length=0.2, voltage_range=(18.0, 36.0))
    found = Judge(library=LIBRARY.only([huge])).score(quadruped)
    own = score(quadruped, replace(found.blueprint.catalogue))
    assert found.failure is not None and own.failure is not None  # noqa: PT018
    assert (found.failure.stage, found.failure.reason) == (own.failure.stage, own.failure.reason)
    assert found.failure.detail == f"no motor of 1 fits; closest, huge: {own.failure.detail}"
    empty = Judge(library=Library()).score(quadruped)
    assert empty.failure == Failure(
        Stage.MOTOR, Reason.NO_PART, "there is no motor with a battery, a controller and a wire"
    )


def test_what_has_no_skeleton_is_told_at_once(hinge: VoxelDesign, calls: list[Sized]):
    still = VoxelDesign(hinge.material, hinge.segment, hinge.pitch, ())
    found = Judge(library=LIBRARY).score(still)
    assert found.failure == DEFAULT_JUDGE.score(still).failure
    assert len(calls[0].refused) == 1


def test_physics_that_explodes_is_a_lost_measurement(monkeypatch: pytest.MonkeyPatch, quadruped: VoxelDesign):
    def exploding(*_, **__):
        raise Diverged("planted")

    monkeypatch.setattr(sizing, "search_gait", exploding)
    failure = Judge(library=LIBRARY).score(quadruped).failure
    assert failure is not None
    assert (failure.stage, failure.reason) == (Stage.WORKER, Reason.CRASHED)
    assert "planted" in failure.detail


def test_a_robot_that_shall_be_driven_gets_motors_that_can_be(quadruped: VoxelDesign, calls: list[Sized]):
    """Of the two motors left one is stronger and lighter, and no driver speaks to it."""
    fine = replace(PAPER.motor, name="fine", mass=0.3, driver="none", voltage_range=(18.0, 36.0))
    huge = replace(PAPER.motor, name="huge", diameter=0.19, length=0.2, voltage_range=(18.0, 36.0))
    both = LIBRARY.only([fine, huge])
    prefer, only = Judge(library=both).score(quadruped), Judge(library=both, drivers="only").score(quadruped)
    assert prefer.ok
    assert prefer.blueprint.catalogue.motor == fine
    assert "no driver for fine" in prefer.blueprint.notes[-1]
    assert only.failure is not None
    assert only.failure.detail.startswith("no motor of 1 fits; closest, huge: ")
