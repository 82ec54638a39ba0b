"""Gaits that hold: what a walk is worth, and that every gait meets the same robots whatever walks beside it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from mfg.description import Description
from sim.actor import Gait, Perceptron
from sim.closed_loop import roll_out_actor
from sim.environment import action_map
from sim.gaits import decode
from sim.herd import with_latency_room
from sim.model import make_spec
from sim.observation import ObservationLayout, normaliser
from sim.randomisation import EXACT, WIDE, draw
from sim.rollout import Behaviour, measure
from sim.skin import Fidelity
from sim.sturdy import Course, Trial, _ends, _Walker, trial_of, worth

GAIT = Gait(1.2, np.full(4, 0.4), np.arange(4.0), np.zeros(4))
WALK = Behaviour(
    seconds=4.0, distance=1.2, speed=0.3, heading=0.5, body_length=0.4, fell=False, upright=1.0,
    cost_of_transport=1.0, max_torque=5.0, overload=0.5, steps_per_s=1.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def course(quadruped: Description) -> Course:
    links = tuple(replace(link, skin_thickness=0.02) for link in quadruped.links)
    sprung = with_latency_room(make_spec(replace(quadruped, links=links), fidelity=Fidelity.SPRUNG))
    model = with_latency_room(make_spec(quadruped))
    return Course(model, (sprung,), 0.2, seconds=1.0, generations=2, population=4)


@pytest.fixture(scope="module")
def found(course: Course) -> tuple[Trial, ...]:
    return course([GAIT])


def _asked(monkeypatch: pytest.MonkeyPatch, score: Callable[[Gait], float]) -> list[tuple[str, int, float]]:
    """What a course asks of its robots from now on, for how many gaits, and the mean of their frequencies [Hz].

    Scores are given; searches stay near where they begin.
    """
    asked: list[tuple[str, int, float]] = []

    def tried(name: str) -> Any:
        def some(self: Any, points: Any) -> list[Trial]:
            gaits = [decode(self.drive, point, self.band) for point in points]
            asked.append((name, len(gaits), float(np.mean([gait.frequency for gait in gaits]))))
            return [Trial(gait, 0.0, score(gait), 0.0) for gait in gaits]

        return some

    for name in ("brief", "halved", "trials"):
        monkeypatch.setattr(_Walker, name, tried(name))
    monkeypatch.setattr("sim.sturdy.SPREAD", 0.01)
    return asked


def test_a_walk_is_worth_its_speed_along_the_heading_up_to_the_pace() -> None:
    assert worth(WALK, 0.5, 0.4) == pytest.approx(0.3)
    assert worth(WALK, 0.5 + np.pi / 3, 0.4) == pytest.approx(0.15)
    assert worth(WALK, 0.5 + np.pi, 0.4) == pytest.approx(-0.3)
    assert worth(None, 0.5, 0.4) == -0.4  # an explosion is worse than standing still


@pytest.mark.parametrize(("speed", "value"), [(0.3, 0.3), (0.4, 0.2), (0.6, 0.0), (0.9, 0.0)])
def test_what_is_beyond_the_pace_costs_as_much_as_what_is_short_of_it(speed: float, value: float) -> None:
    assert worth(replace(WALK, speed=speed), 0.5, 0.3) == pytest.approx(value)


def test_falls_and_hot_motors_cost() -> None:
    assert worth(replace(WALK, fell=True, upright=0.8), 0.5, 0.4) == pytest.approx(0.3 * 0.8 / 2)
    assert worth(replace(WALK, overload=1.5), 0.5, 0.4) == pytest.approx(0.2)
    back = replace(WALK, fell=True, upright=0.1, overload=3.0)
    assert worth(back, 0.5 + np.pi, 0.4) == pytest.approx(-0.3)  # neither makes a walk backwards better


def test_a_search_repeats_and_its_result_walked_at_least_as_well_as_what_was_given(
    course: Course, found: tuple[Trial, ...]
) -> None:
    best, second = found
    assert best.score >= second.score
    assert best.score >= replace(course, generations=0)([GAIT])[0].score - 0.05  # beside others, under other pushes
    again = course([GAIT])[0]
    assert (again.score, again.least, again.heading) == (best.score, best.least, best.heading)
    np.testing.assert_array_equal(again.gait.offset, best.gait.offset)
    assert replace(course, seed=1)([GAIT])[0].score != pytest.approx(best.score)


def test_the_worst_walk_counts_as_much_as_all() -> None:
    trial = trial_of(GAIT, [WALK, replace(WALK, speed=0.1), replace(WALK, speed=0.2)], [], 0.4)
    assert trial.heading == 0.5
    assert trial.least == pytest.approx(0.1)
    assert trial.score == pytest.approx((0.2 + 0.1) / 2)


def test_walks_with_pushes_count_in_the_mean_and_together_as_one_of_the_others() -> None:
    walks, fallen = [WALK, replace(WALK, speed=0.2)], replace(WALK, fell=True, upright=0.0)
    trial = trial_of(GAIT, walks, [fallen, WALK], 0.4)
    assert trial.least == pytest.approx(0.15)
    assert trial.score == pytest.approx((0.2 + 0.15) / 2)
    assert trial_of(GAIT, walks, [WALK, WALK], 0.4).least == pytest.approx(0.2)


def test_a_gait_under_which_the_model_itself_explodes_comes_last() -> None:
    lost = trial_of(GAIT, [None, WALK], [WALK], 0.4)
    assert lost.score == lost.least == -0.4
    assert trial_of(GAIT, [WALK, None], [], 0.4).score == pytest.approx((-0.05 - 0.4) / 2)


def test_every_gait_meets_the_same_robots_whoever_walks_beside_it(course: Course) -> None:
    walker = _Walker(course, 0)
    rng = np.random.default_rng(0)
    points = [rng.random(13), rng.random(13), rng.random(13)]
    together = walker.trials(points)
    # Pushes and noise are drawn for all copies at once, so these are the walks without them.
    assert all(robots[2].push_speed is None for robots in (*walker._few, *walker._rest))
    walker._pushed = []
    quiet = walker.trials(points)
    for k, point in enumerate(points):
        (alone,) = walker.trials([point])
        assert (alone.score, alone.heading) == pytest.approx((quiet[k].score, quiet[k].heading))
        assert alone.heading == pytest.approx(together[k].heading)


def test_a_gait_is_tried_as_a_silent_policy_follows_it(course: Course) -> None:
    """Its direction on the model is that of a perceptron of zeros whose rhythm it is."""
    model = course.model
    (trial,) = _Walker(course, 0).trials([np.linspace(0.2, 0.8, 13)])
    actions = action_map(model)
    centre, gain = normaliser(ObservationLayout(model.nu), actions)
    silent = Perceptron(((np.zeros((centre.size, model.nu)), np.zeros(model.nu)),), centre, gain, actions,
                        rhythm=trial.gait)  # fmt: skip
    draws = draw(EXACT, np.random.default_rng(0), 1, model.nu, model.nbody - 1)
    behaviour = measure(model, roll_out_actor(model, silent, course.seconds, draws=draws))[0]
    assert behaviour is not None
    assert trial.heading == pytest.approx(behaviour.heading)


def test_a_course_begins_with_the_robot_as_it_is_and_differs_by_ends_of_ranges() -> None:
    first, *others = _ends(WIDE)
    assert first == EXACT
    changed = [{f.name for f in fields(EXACT) if getattr(end, f.name) != getattr(EXACT, f.name)} for end in others]
    assert changed == [
        {"friction"}, {"friction"}, {"contact_time"}, {"contact_time"}, {"latency"}, {"stiffness", "damping"},
    ]  # fmt: skip
    assert others[0].friction[0] == WIDE.friction[0]
    assert others[1].friction[0] == WIDE.friction[1]


def test_other_robots_are_on_the_course_too(course: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr("sim.sturdy.roll_out_actor", lambda model, *_, copies, **__: seen.append((model, copies)))
    monkeypatch.setattr("sim.sturdy.measure", lambda *_: [WALK] * 100)
    walker, points = _Walker(course, 0), [np.full(13, 0.5)] * 4

    def asked() -> list[tuple[bool, int]]:
        found = [(model is course.model, copies) for model, copies in seen]
        seen.clear()
        return found

    few, rest = [(True, 12), (False, 4)], [(True, 16), (False, 8), (True, 8), (False, 8)]
    walker.trials(points)
    assert asked() == few + rest
    walker.brief(points)
    assert asked() == few
    walker.halved(points)
    assert asked() == few + [(own, copies // 2) for own, copies in rest]


def test_the_half_that_is_tried_on_all_robots_goes_before_the_other(course: Course) -> None:
    walker, rng = _Walker(course, 0), np.random.default_rng(1)
    points = [rng.random(13) for _ in range(5)]
    found = walker.brief(points), walker.halved(points)
    brief, halved = (np.array([trial.score for trial in trials]) for trials in found)
    order = np.argsort(-brief, kind="stable")
    assert halved[order[:3]].min() > halved[order[3]] > halved[order[4]]
    assert halved[order[3]] - halved[order[4]] == pytest.approx(brief[order[3]] - brief[order[4]])
    together = walker.trials([points[k] for k in order[:3]])
    np.testing.assert_allclose(halved[order[:3]], [trial.score for trial in together])


def test_pads_are_tried_at_both_ends_of_their_stiffness(course: Course) -> None:
    drawn = [draws.skin for model, _, draws in _Walker(course, 0)._rest if model is not course.model]
    assert len(drawn) == 1
    assert drawn[0] is not None
    np.testing.assert_allclose(drawn[0], WIDE.skin)


def test_of_slow_gaits_the_search_that_comes_farthest_goes_on(course: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = [replace(GAIT, frequency=frequency) for frequency in (0.8, 1.2, 1.6)]
    asked = _asked(monkeypatch, lambda gait: -abs(gait.frequency - 1.2))
    replace(course, generations=12)(slow)
    assert [name for name, *_ in asked] == ["brief"] * 6 + ["brief"] * 3 + ["halved"] * 7 + ["trials"]
    assert [round(frequency, 1) for *_, frequency in asked[:6]] == [0.8, 0.8, 1.2, 1.2, 1.6, 1.6]
    assert all(1.0 < frequency < 1.4 for *_, frequency in asked[6:])


def test_of_quick_gaits_the_best_on_all_robots_is_searched_about(
    course: Course, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = [replace(GAIT, frequency=frequency) for frequency in (3.0, 4.0, 5.0)]
    asked = _asked(monkeypatch, lambda gait: -abs(gait.frequency - 4.0))
    replace(course, generations=12)(quick)
    assert [name for name, *_ in asked] == ["trials"] * 3 + ["brief"] * 5 + ["halved"] * 7 + ["trials"]
    assert [round(frequency, 1) for *_, frequency in asked[:3]] == [3.0, 4.0, 5.0]
    assert all(3.5 < frequency < 4.5 for *_, frequency in asked[3:])


def test_a_search_is_brief_before_it_is_whole(course: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = itertools.count()
    asked = _asked(monkeypatch, lambda _: next(scores))
    best, second = replace(course, generations=5)([GAIT])
    assert [name for name, *_ in asked] == ["brief"] * 2 + ["halved"] * 3 + ["trials"]
    assert asked[-1][1] == 5  # what was given, three generations' best, the mean
    assert next(scores) - best.score == best.score - second.score == 1


def test_a_course_takes_gaits_of_one_band(course: Course) -> None:
    with pytest.raises(ValueError, match="one band of frequencies, these are of 2"):
        course([GAIT, replace(GAIT, frequency=3.0)])
