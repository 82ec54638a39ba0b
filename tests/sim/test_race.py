"""A race sorts starts by what they learn, and repeats itself to the last bit."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trainings_in_brief import CORRECTED, FREE, GAIT, SMALL

from mfg.description import Description
from sim.herd import with_latency_room
from sim.model import make_spec
from sim.race import AsItIs, Heat, Runner, headings, speed, starts, winner
from sim.training import Trainer
from sim.verdict import Verdict, stood

pytestmark = pytest.mark.usefixtures("short_evaluation")


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Any:
    return with_latency_room(make_spec(quadruped))


def bytes_of(runner: Runner) -> bytes:
    return b"".join(np.asarray(value).tobytes() for _, value in sorted(runner.learned.items()))


def test_candidates_are_the_gait_and_free_headings_all_around() -> None:
    found = starts(GAIT, 3.0, 4)
    assert [start.rhythm is GAIT for start in found] == [True, False, False, False]
    assert len(starts(GAIT, 3.0, 1)) == 1
    angles = np.array(headings(3.0, 3))
    assert (np.abs(angles) <= np.pi).all()
    np.testing.assert_allclose(np.exp(1j * angles).sum(), 0, atol=1e-12)


def test_an_even_number_of_free_headings_has_the_opposite_of_the_gait_s() -> None:
    assert {round(float(np.cos(start.heading - 3.0))) for start in starts(GAIT, 3.0, 5)} == {-1, 0, 1}


def test_those_go_on_who_walk_without_falls_or_find_steps_while_exploring() -> None:
    def runner(exploring: float, policy: float, falls: int) -> Runner:
        return Runner(FREE, exploring, Verdict(policy, policy, falls, 10, 0), {"weights": np.ones(1)})

    still, seeking, falling, walking = (
        runner(0.0, 0.0, 0), runner(0.05, 0.0, 0), runner(0.2, 0.2, 9), runner(0.2, 0.2, 0),
    )  # fmt: skip
    order = [walking, falling, seeking, still]
    assert all(winner(order[k:][::-1]) is order[k] for k in range(4))
    twin = runner(0.2, 0.2, 0)
    assert winner([walking, twin]) is walking
    assert winner([twin, walking]) is twin


def test_a_heat_repeats_itself_and_can_be_sent(model: Any) -> None:
    heat = Heat(model, SMALL, 192)
    once = heat(Runner(CORRECTED))
    assert once.verdict is not None
    sent: Runner = pickle.loads(pickle.dumps(once))
    assert bytes_of(sent) == bytes_of(once) == bytes_of(heat(Runner(CORRECTED)))
    assert bytes_of(once) != bytes_of(Heat(model, SMALL, 384)(Runner(CORRECTED)))


def test_a_training_goes_on_from_the_winner_s_last_heat(model: Any) -> None:
    runner = Heat(model, SMALL, 192)(Runner(FREE))
    trainer = Trainer(model, SMALL, FREE, learned=runner.learned)
    found = trainer.learner.state()
    assert found.keys() == runner.learned.keys()
    for name, value in runner.learned.items():
        np.testing.assert_array_equal(found[name], value)
    assert trainer.done == 0


@pytest.mark.filterwarnings("ignore")  # numpy and torch say on the way what becomes of such numbers
def test_who_diverges_stands_still(model: Any) -> None:
    wild = replace(SMALL, ppo=replace(SMALL.ppo, learning_rate=1e38))
    runner = Heat(model, wild, 192)(Runner(FREE))
    assert (runner.diverged, runner.merit, runner.verdict) == (True, -np.inf, None)
    assert not runner.learned
    assert speed(model, wild, 192, FREE) == 0.0


def test_the_speed_of_a_start_is_that_of_a_heat_without_a_verdict(model: Any) -> None:
    judged = Heat(model, SMALL, 96)(Runner(FREE))
    unjudged = Heat(model, SMALL, 96, judged=False)(Runner(FREE))
    assert unjudged.verdict is None
    assert unjudged.merit == unjudged.exploring == judged.exploring == speed(model, SMALL, 96, FREE)
    assert np.isfinite(unjudged.exploring)


def test_a_gait_is_judged_without_a_heat_and_can_be_sent(model: Any) -> None:
    judge = AsItIs(stood(model), (), SMALL)
    runner = judge(CORRECTED)
    assert runner.verdict is not None
    assert runner.verdict.kept is not None
    assert not runner.learned
    assert pickle.loads(pickle.dumps(judge))(CORRECTED).verdict == runner.verdict
    # As the policy that knows nothing yet would do if it said nothing: the learner's seed has no part in it.
    other = replace(SMALL, ppo=replace(SMALL.ppo, units=8))
    assert replace(judge, training=other)(CORRECTED).verdict == runner.verdict


def test_a_gait_as_it_is_races_by_its_score_without_the_corner() -> None:
    verdict = Verdict(0.3, 0.2, 1, 10, 0, 1.0, kept=0.1)
    gait = Runner(CORRECTED, verdict=verdict)
    assert gait.merit == pytest.approx(0.25 * 0.8)
    learned = Runner(FREE, 0.1, verdict, {"weights": np.ones(1)})
    assert learned.merit == pytest.approx((0.1 + 0.2) / 2)
