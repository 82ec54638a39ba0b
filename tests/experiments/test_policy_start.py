"""What a training begins with: candidates of several gaits, and a race whose winner no number of workers changes."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import cli
from experiments.policy_config import Policy
from experiments.policy_start import Impossible, _judged, best_start, candidates, gaits, sturdier, told
from sim.gaits import BANDS, band_of
from sim.herd import with_latency_room
from sim.model import load_spec
from sim.race import Runner
from sim.rollout import Diverged
from sim.sturdy import Trial
from sim.surfaces import body_length
from sim.verdict import Verdict

TRIPOD = Path(cli.__file__).parent / "examples" / "tripod.vox"
CONFIG = Policy("policy", "tripod", seed=3, generations=0, starts=3, race_steps=1000, copies=8)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("blueprint") / "tripod"
    assert cli.main(["build", str(TRIPOD), "--no-guide", "--out", str(folder)]) == 0
    return with_latency_room(load_spec(folder / "robot.xml"))


@pytest.fixture(scope="module")
def found(model: Any) -> Any:
    return gaits(CONFIG, model, 0)


def test_gaits_are_searched_in_each_band_and_the_best_comes_first(found: Any) -> None:
    assert len(found) == 6
    assert all(one.score >= next.score for one, next in itertools.pairwise(found))
    assert {band_of(result.gait) for result in found} == set(BANDS)


def test_no_number_of_workers_changes_the_gaits(model: Any, found: Any) -> None:
    again = gaits(CONFIG, model, 2)
    assert [result.score for result in again] == [result.score for result in found]


def test_a_robot_that_explodes_under_every_gait_is_told(model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def diverged(*_: Any, **__: Any) -> None:
        raise Diverged("no number")

    monkeypatch.setattr("sim.gaits.search_gait", diverged)
    with pytest.raises(Impossible, match="no gait of tripod: its physics explodes under each that was tried"):
        gaits(CONFIG, model, 0)


def test_each_gait_is_corrected_and_the_first_gives_the_headings(found: Any) -> None:
    starts = candidates(found[0], found[:2], 6)
    assert [start.rhythm is not None for start in starts] == [True, True, False, False, False, False]
    assert [start.rhythm for start in starts[:2]] == [found[0].gait, found[1].gait]
    assert starts[2].heading == found[0].heading
    assert [start.rhythm for start in candidates(found[0], found, 2)] == [found[0].gait, found[1].gait]
    assert [start.rhythm for start in candidates(found[0], found[:1], 1)] == [found[0].gait]


def test_free_starts_go_along_the_gait_of_the_model_alone(found: Any) -> None:
    held = [replace(found[1], behaviour=replace(found[1].behaviour, heading=1.5))]
    corrected, along, opposite = candidates(found[0], held, 3)
    assert corrected.heading == 1.5
    assert along.heading == found[0].heading
    assert np.cos(opposite.heading - along.heading) == pytest.approx(-1.0)
    np.testing.assert_array_equal(along.posture, found[0].gait.offset)


def test_no_number_of_workers_changes_the_winner(model: Any, capsys: pytest.CaptureFixture[str]) -> None:
    here, there = (best_start(CONFIG, model, (), (), workers) for workers in (0, 2))
    assert here.exploring == there.exploring
    assert here.verdict == there.verdict
    assert here.learned.keys() == there.learned.keys() != set()
    for name, value in here.learned.items():
        np.testing.assert_array_equal(value, there.learned[name])
    said = capsys.readouterr().err
    assert "3 starts race for 1000 control periods each" in said
    assert "making them hold" not in said


def test_gaits_are_made_to_hold_before_they_race_by_any_number_of_workers(model: Any, found: Any) -> None:
    from msgspec.structs import replace as changed

    brief = changed(CONFIG, generations=2)
    here, there = (sturdier(found, brief, model, (model,), workers) for workers in (0, 2))
    assert [(trial.score, trial.least, trial.heading) for trial in here] == [
        (trial.score, trial.least, trial.heading) for trial in there
    ]
    assert len(here) == 4
    assert all(one.score >= next.score for one, next in itertools.pairwise(here))


def test_each_band_has_a_course_with_its_best_gait_first(
    model: Any, found: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def course(_: Any, gaits: Any) -> tuple[Trial, ...]:
        asked.append(gaits)
        return (Trial(gaits[0], 0.0, 0.1, 0.0),)

    monkeypatch.setattr("sim.sturdy.Course.__call__", course)
    sturdier(found, CONFIG, model, (), 0)
    assert [{band_of(gait) for gait in gaits} for gaits in asked] == [{band} for band in BANDS]
    places = [[[result.gait for result in found].index(gait) for gait in gaits] for gaits in asked]
    assert all(order == sorted(order) for order in places)
    asked.clear()
    sturdier(found[:1], CONFIG, model, (), 0)
    assert asked == [[found[0].gait]]


def test_gaits_that_hold_come_in_the_order_of_their_scores(
    model: Any, found: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = iter([0.3, 0.4])

    def course(_: Any, gaits: Any) -> tuple[Trial, ...]:
        best = Trial(gaits[0], 0.0, next(scores), 0.0)
        return best, replace(best, score=best.score - 0.15)

    monkeypatch.setattr("sim.sturdy.Course.__call__", course)
    held = sturdier(found, CONFIG, model, (), 0)
    assert [trial.score for trial in held] == pytest.approx([0.4, 0.3, 0.25, 0.15])
    slow, quick = (next(result.gait for result in found if band_of(result.gait) == band) for band in BANDS)
    assert [trial.gait for trial in held] == [quick, slow, quick, slow]


def test_gaits_that_come_to_nothing_are_told(
    model: Any, found: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pace = CONFIG.training(model).task.target_speed
    lost, walks = Trial(found[0].gait, 0.0, -pace, -pace), Trial(found[1].gait, 0.0, 0.1, 0.0)
    trials = iter([lost, walks, lost])
    monkeypatch.setattr("sim.sturdy.Course.__call__", lambda *_: (next(trials),))
    (left,) = sturdier(found, CONFIG, model, (), 0)
    assert left.gait is found[1].gait
    assert "a gait was lost: its physics explodes" in capsys.readouterr().err
    with pytest.raises(Impossible, match="no gait of tripod could be tried: its physics explodes"):
        sturdier(found[:1], CONFIG, model, (), 0)


def test_the_best_of_the_gaits_that_hold_races_without_a_heat(model: Any, found: Any) -> None:
    from msgspec.structs import replace as changed

    config = changed(CONFIG, generations=1)
    starts = candidates(found[0], found, 2)
    one, two = (_judged(config, model, (), [start], 0) for start in starts)
    best = _judged(config, model, (), starts, 2)
    assert one.verdict is not None
    assert two.verdict is not None
    assert best.verdict == max((one.verdict, two.verdict), key=lambda verdict: verdict.score)
    assert not best.learned


def test_a_single_start_and_other_tasks_do_not_race(model: Any) -> None:
    from msgspec.structs import replace as changed

    alone = best_start(changed(CONFIG, starts=1), model, (), (), 0)
    assert alone.start.rhythm is not None
    exact = best_start(changed(CONFIG, starts=1, generations=9, randomise=False), model, (), (), 0)
    np.testing.assert_array_equal(exact.start.posture, alone.start.posture)
    standing = best_start(changed(CONFIG, task="stand"), model, (), (), 0)
    assert standing.start.rhythm is None
    assert not alone.learned
    assert not standing.learned


def test_a_pace_is_one_of_the_robot_s_own_lengths(model: Any) -> None:
    from msgspec.structs import replace as changed

    task = changed(CONFIG, pace=0.5).training(model).task
    assert task.target_speed == pytest.approx(0.5 * body_length(model))
    assert task.haste > 0.0


def test_a_runner_is_told_in_one_line(found: Any) -> None:
    runner = Runner(candidates(found[0], found, 1)[0], 0.123, learned={"weights": np.ones(1)})
    assert told(runner).endswith("0.12 m/s exploring")
    judged = replace(runner, verdict=Verdict(0.2, 0.1, 3, 10, 0))
    assert told(judged).endswith("0.12 m/s exploring; the policy itself 0.20 m/s, 0.10 m/s randomised with 3 falls")
    gait = Runner(runner.start, verdict=Verdict(0.2, 0.1, 3, 10, 0, kept=0.85))
    assert "gait, heading" in told(gait)
    assert told(gait).endswith(" rad: 0.20 m/s, 0.10 m/s randomised with 3 falls; keeps 0.85 in the worst corner")
