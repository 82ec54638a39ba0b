"""Verdicts: what they measure, and that a policy which keeps its speed goes before one that is fast on one robot."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trainings_in_brief import CORRECTED, FREE, SMALL

from mfg.description import Description
from sim.herd import with_latency_room
from sim.model import make_spec
from sim.randomisation import EXACT
from sim.skin import Fidelity
from sim.tasks import Goal, Task
from sim.training import Trainer
from sim.verdict import Verdict, cornered_speeds, evaluate, mean_reward, share_kept, shared_out, stood, verdict_of

pytestmark = pytest.mark.usefixtures("short_evaluation")
PLAIN = Verdict(0.5, 0.4, 0, 10, 0, target=0.45, kept=0.8)


@pytest.fixture(scope="module")
def robot(quadruped: Description) -> Any:
    return stood(with_latency_room(make_spec(quadruped)))


@pytest.fixture(scope="module")
def sprung(quadruped: Description) -> Any:
    links = tuple(replace(link, skin_thickness=0.02) for link in quadruped.links)
    return stood(with_latency_room(make_spec(replace(quadruped, links=links), fidelity=Fidelity.SPRUNG)))


@pytest.fixture(scope="module")
def walker(robot: Any) -> Any:
    """A policy that has learned nothing, about a gait that moves the robot."""
    return Trainer(robot.model, SMALL, CORRECTED).actor()


def test_what_is_kept_of_the_target_counts_and_falls_cost() -> None:
    assert PLAIN.score == pytest.approx(0.45 * 0.8)
    assert replace(PLAIN, speed=0.9).score == PLAIN.score
    assert replace(PLAIN, speed=0.3).score == pytest.approx(0.3 * 0.8)
    assert replace(PLAIN, kept=0.9).score > PLAIN.score > replace(PLAIN, falls=1).score
    assert replace(PLAIN, kept=1.3).score == replace(PLAIN, kept=1.0).score
    assert replace(PLAIN, kept=None).score == pytest.approx((0.45 + 0.4) / 2)
    assert replace(PLAIN, reward=0.07).score == 0.07
    assert replace(PLAIN, falls=1).score == pytest.approx(0.8 * PLAIN.score)  # of ten episodes; it counts twice
    assert replace(PLAIN, falls=7).score == 0.0


def test_policies_that_keep_nothing_somewhere_are_told_apart_by_their_speed() -> None:
    lost = replace(PLAIN, kept=0.0)
    assert PLAIN.score > lost.score > replace(lost, speed=0.3).score > 0.0


@pytest.mark.parametrize("verdict", [PLAIN, replace(PLAIN, kept=None, reward=-0.2), Verdict(0.1, 0.2, 3, 10, 1)])
def test_a_verdict_survives_the_checkpoint(verdict: Verdict) -> None:
    assert verdict_of(verdict.array()) == verdict


def test_the_worst_is_compared_with_the_robot_as_it_is() -> None:
    assert share_kept(np.array([0.4, 0.5, 0.3])) == pytest.approx(0.75)
    assert share_kept(np.array([0.0, 0.5])) == 0.0


def test_whoever_loses_its_speed_at_an_end_of_a_range_keeps_less(
    robot: Any, walker: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.verdict.EVALUATION_SECONDS", 2.0)
    # A robot that the evaluation may not even tell from the model in its random episodes: only the corners find it.
    slippery = replace(EXACT, friction=(0.01, 0.8))
    same, lost = (evaluate(robot, walker, replace(SMALL, claimed=ranges)).kept for ranges in (EXACT, slippery))
    assert same is not None
    assert lost is not None
    assert same > 0.8  # the same robot at every corner, but for a hair
    assert lost < 0.5 * same
    assert evaluate(robot, walker, SMALL, cornered=False).kept is None


def test_what_training_draws_beyond_what_is_claimed_is_not_asked_for(robot: Any, walker: Any) -> None:
    wild = replace(SMALL, claimed=EXACT, randomisation=replace(EXACT, friction=(0.01, 5.0)))
    assert evaluate(robot, walker, wild) == evaluate(robot, walker, replace(wild, randomisation=None))


def test_walks_at_a_corner_do_not_depend_on_the_others_nor_on_threads(robot: Any, walker: Any) -> None:
    icy = replace(EXACT, friction=(0.01, 0.01))
    both = cornered_speeds(robot, (EXACT, icy), walker, 0)
    assert both.shape == (2,)
    assert cornered_speeds(robot, (EXACT,), walker, 0)[0] == pytest.approx(both[0])
    np.testing.assert_array_equal(both, cornered_speeds(robot, (EXACT, icy), walker, 0, nthread=2))


def test_the_models_that_check_are_corners_too(
    robot: Any, sprung: Any, walker: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, int]] = []

    def cornered(one: Any, places: Any, *_: Any) -> Any:
        asked.append((one, len(places)))
        return np.full(len(places), 0.4 if one is robot else 0.1)

    monkeypatch.setattr("sim.verdict.cornered_speeds", cornered)
    assert evaluate(robot, walker, SMALL, checks=(sprung,)).kept == pytest.approx(0.25)
    assert [one for one, _ in asked] == [robot, sprung]
    assert evaluate(robot, walker, SMALL, others=(sprung,)).kept == pytest.approx(1.0)


def test_models_check_only_what_could_still_be_the_best(
    robot: Any, sprung: Any, walker: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def cornered(one: Any, places: Any, *_: Any) -> Any:
        asked.append(one)
        return np.full(len(places), 0.4 if one is robot else 0.2)

    monkeypatch.setattr("sim.verdict.cornered_speeds", cornered)
    whole = evaluate(robot, walker, SMALL, checks=(sprung, sprung))
    assert asked == [robot, sprung, sprung]
    for better, rest in ((0.0, [sprung, sprung]), (1.5 * whole.score, [sprung]), (3.0 * whole.score, [])):
        asked.clear()
        verdict = evaluate(robot, walker, SMALL, checks=(sprung, sprung), to_beat=better)
        assert asked == [robot, *rest]
        assert verdict.score == whole.score or whole.score < verdict.score <= better  # never taken for better


def test_every_model_has_its_share() -> None:
    assert shared_out(64, 0.25, 0) == [64]
    assert shared_out(64, 0.25, 1) == [48, 16]
    assert shared_out(10, 0.4, 2) == [6, 2, 2]
    assert shared_out(4, 0.0, 1) == [3, 1]
    for share, n, others in itertools.product((0.0, 0.25, 0.9), range(10, 70), range(3)):
        counts = shared_out(n, share, others)
        assert sum(counts) == n
        assert min(counts) > 0


def test_an_evaluation_has_episodes_on_other_models(robot: Any, sprung: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, int]] = []

    def randomised(model: Any, *_: Any, episodes: int, **__: Any) -> list[None]:
        asked.append((model, episodes))
        return [None] * episodes

    monkeypatch.setattr("sim.verdict.randomised", randomised)
    verdict = evaluate(robot, Trainer(robot.model, SMALL, FREE).actor(), SMALL, others=(sprung,))
    assert asked == [(robot.model, 15), (sprung.model, 5)]
    assert verdict.lost == verdict.episodes == 20


def test_other_tasks_are_judged_by_their_reward(robot: Any) -> None:
    model = robot.model
    still, running = Trainer(model, SMALL, FREE).actor(), Trainer(model, SMALL, CORRECTED).actor()
    stand = replace(SMALL, task=Task(Goal.STAND))
    assert evaluate(robot, still, stand).score > evaluate(robot, running, stand).score
    assert evaluate(robot, still, stand).kept is None
    assert evaluate(robot, still, SMALL).reward is None
    one, two = (mean_reward(model, still, replace(SMALL, task=Task(goal))) for goal in (Goal.STAND, Goal.RECOVER))
    assert one != two
    assert mean_reward(model, still, stand) == mean_reward(model, still, stand, nthread=2)
