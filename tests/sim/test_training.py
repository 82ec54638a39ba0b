"""Training gives the same bytes whatever the threads and the interruptions, and exports what it learned."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from trainings_in_brief import CORRECTED, FREE, GAIT, SMALL

from mfg.description import Description
from sim.environment import TEN_SECONDS, Environment
from sim.herd import with_latency_room
from sim.learning import Unlearnable
from sim.model import make_spec
from sim.ppo import Vector
from sim.skin import Fidelity
from sim.training import Start, Trainer, first_rate, first_spread, start_of
from sim.verdict import Verdict

pytestmark = pytest.mark.usefixtures("short_evaluation")


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Any:
    return with_latency_room(make_spec(quadruped))


def run(model: Any, start: Start = FREE, chunks: int = 3, **how: Any) -> Trainer:
    trainer = Trainer(model, SMALL, start, **how)
    for _ in range(chunks):
        trainer.advance()
    return trainer


def bytes_of(trainer: Trainer) -> bytes:
    return b"".join(np.asarray(value).tobytes() for _, value in sorted(trainer.state().items()))


@pytest.fixture(scope="module")
def whole(model: Any) -> Trainer:
    return run(model)


def test_the_same_seed_gives_the_same_weights_on_any_number_of_threads(model: Any, whole: Trainer) -> None:
    assert bytes_of(run(model, nthread=2)) == bytes_of(whole)
    other = Trainer(model, replace(SMALL, seed=6), FREE)
    assert bytes_of(other) != bytes_of(Trainer(model, SMALL, FREE))


def test_a_resumed_training_is_the_uninterrupted_one(model: Any, whole: Trainer) -> None:
    half = run(model, chunks=2)
    later = Trainer(model, SMALL, start_of(half.state()))
    later.restore(half.state())
    later.advance()
    assert bytes_of(later) == bytes_of(whole)


@pytest.fixture(scope="module")
def sprung(quadruped: Description) -> Any:
    links = tuple(replace(link, skin_thickness=0.02) for link in quadruped.links)
    return with_latency_room(make_spec(replace(quadruped, links=links), fidelity=Fidelity.SPRUNG))


def test_a_share_of_the_experience_is_on_other_models(model: Any, sprung: Any, whole: Trainer) -> None:
    trainer = run(model, others=(sprung,))
    assert [part.count for part in trainer.environment.parts] == [3, 1]
    assert trainer.environment.parts[1].model is sprung
    assert bytes_of(run(model, others=(sprung,), nthread=2)) == bytes_of(trainer) != bytes_of(whole)
    half = run(model, chunks=2, others=(sprung,))
    later = Trainer(model, SMALL, start_of(half.state()), others=(sprung,))
    later.restore(half.state())
    later.advance()
    assert bytes_of(later) == bytes_of(trainer)


def test_the_exported_policy_says_what_the_learner_means(whole: Trainer) -> None:
    actor, policy = whole.actor(), whole.learner.ppo.policy
    seen = np.random.default_rng(0).normal(size=(50, actor.layout.size))
    unseen = np.random.default_rng(1).normal(size=(50, whole.environment.hidden_size))
    with torch.no_grad():
        both = torch.tensor(np.hstack([seen, unseen]), dtype=torch.float32)
        meant = policy.get_distribution(both).mode().numpy()
    np.testing.assert_allclose(actor.say(seen), meant, atol=1e-5)


def test_a_rhythm_and_its_start_survive_the_checkpoint(model: Any) -> None:
    trainer = run(model, CORRECTED, chunks=1)
    again = start_of(trainer.state())
    assert again.heading == CORRECTED.heading
    assert again.rhythm is not None
    np.testing.assert_array_equal(again.rhythm.targets(0.37), GAIT.targets(0.37))
    assert trainer.actor().rhythm is GAIT
    assert start_of(FREE.state()).rhythm is None


def test_the_best_so_far_has_the_best_verdict(model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    speeds = iter([0.1, 0.3, 0.2])
    monkeypatch.setattr("sim.training.evaluate", lambda *_, **__: Verdict(s := next(speeds), s, 0, 10, 0))
    trainer, actors = Trainer(model, SMALL, FREE), []
    for _ in range(3):
        trainer.advance()
        actors.append(trainer.actor())
    assert trainer.best_verdict is not None
    assert trainer.best_verdict.score == pytest.approx(0.3)
    assert trainer.best is not None
    for (W, _), (best, _), (last, _) in zip(actors[1].layers, trainer.best.layers, actors[2].layers, strict=True):
        np.testing.assert_array_equal(best, W)
        assert not np.array_equal(best, last)


def test_a_gait_as_it_is_comes_first_and_stays_until_a_policy_does_better(
    model: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    speeds, beaten = iter([0.3, 0.2, 0.4]), []

    def judged(*_: Any, to_beat: float, **__: Any) -> Verdict:
        beaten.append(to_beat)
        return Verdict(speed := next(speeds), speed, 0, 10, 0)

    monkeypatch.setattr("sim.training.evaluate", judged)
    trainer = run(model, CORRECTED, chunks=1)
    assert trainer.best is not None
    assert trainer.best.rhythm is GAIT
    assert not trainer.best.layers[-1][0].any()
    assert trainer.best_verdict is not None
    assert trainer.best_verdict.speed == 0.3
    later = Trainer(model, SMALL, CORRECTED)
    later.restore(trainer.state())
    later.advance()
    assert later.best_verdict is not None
    assert later.best_verdict.speed == 0.4
    assert beaten == [-np.inf, 0.3, 0.3]
    assert later.best is not None
    assert later.best.layers[-1][0].any()


def test_a_policy_that_is_fast_on_the_model_alone_is_not_kept(model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by its speed, by its randomised speed, nor by what is left of it in the worst corner [m/s]."""
    fast, sturdy = Verdict(0.80, 0.75, 0, 10, 0, 0.4, 0.55), Verdict(0.41, 0.40, 0, 10, 0, 0.4, 0.90)
    verdicts = iter([sturdy, fast])
    monkeypatch.setattr("sim.training.evaluate", lambda *_, **__: next(verdicts))
    trainer = run(model, chunks=2)
    assert trainer.best_verdict == sturdy
    later = Trainer(model, SMALL, FREE)
    later.restore(trainer.state())
    assert later.best_verdict == sturdy


def test_a_checkpoint_judged_by_another_rule_is_refused(model: Any, whole: Trainer) -> None:
    with pytest.raises(ValueError, match="verdict has shape"):
        Trainer(model, SMALL, FREE).restore(whole.state() | {"verdict": np.zeros(6)})


def test_a_learner_hears_how_an_episode_ended(model: Any) -> None:
    """By time, with the last observation and a value to go on with; by a fall, without."""
    short, long = (
        Vector(Environment(model, 2, episode=replace(TEN_SECONDS, seconds=s)), np.random.default_rng(3))
        for s in (0.4, 10)
    )
    for vector in (short, long):
        vector.reset()
        vector.environment._age[:] = vector.environment._born[:] = 0  # not staggered: all end together
    for k in range(20):
        for vector in (short, long):
            vector.step_async(np.full((2, model.nu), 0.1))
        _, _, done, infos = short.step_wait()
        observation, *_ = long.step_wait()
        assert done.tolist() == [k == 19] * 2
    for index, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        np.testing.assert_array_equal(info["terminal_observation"], observation[index])
    long.environment.herd.qpos[1, 3:7] = 0.0, 1.0, 0.0, 0.0
    long.step_async(np.zeros((2, model.nu)))
    _, _, done, infos = long.step_wait()
    assert done.tolist() == [False, True]
    assert infos[0] == {}
    assert infos[1]["TimeLimit.truncated"] is False


def test_a_checkpoint_of_another_learner_is_refused(model: Any, whole: Trainer) -> None:
    wider = Trainer(model, replace(SMALL, ppo=replace(SMALL.ppo, units=8)), FREE)
    with pytest.raises(ValueError, match="has shape"):
        wider.restore(whole.state())
    with pytest.raises(KeyError):
        whole.restore({"done": np.array(1)})


def test_learning_leaves_nothing_behind(model: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    Trainer(model, SMALL, FREE).advance()
    assert not list(tmp_path.iterdir())


def test_exploration_narrows_as_planned(model: Any) -> None:
    trainer = Trainer(model, SMALL, FREE)
    spreads = []
    for _ in range(3):
        trainer.advance()
        (spread,) = set(trainer.learner.ppo.policy.log_std.exp().tolist())  # of every joint, and the policy's own
        spreads.append(spread)
    assert spreads[0] == pytest.approx(SMALL.ppo.spread)
    assert spreads == sorted(spreads, reverse=True)
    assert spreads[-1] == pytest.approx(SMALL.last_spread)


def test_a_rhythm_is_explored_about_and_learned_as_the_training_says() -> None:
    held = replace(SMALL, rhythm_spread=0.25, rhythm_rate=0.5)
    assert first_spread(held, FREE) == first_spread(SMALL, FREE) == SMALL.ppo.spread
    assert first_spread(held, CORRECTED) == pytest.approx(0.25 * SMALL.ppo.spread)
    assert first_spread(replace(held, rhythm_spread=0.01), CORRECTED) == held.last_spread
    assert (first_rate(held, FREE), first_rate(held, CORRECTED)) == (
        SMALL.ppo.learning_rate,
        SMALL.ppo.learning_rate / 2,
    )


@pytest.mark.filterwarnings("ignore")  # numpy and torch say on the way what becomes of such numbers
def test_learning_that_diverges_says_so(model: Any) -> None:
    wild = replace(SMALL, ppo=replace(SMALL.ppo, learning_rate=1e38))
    trainer = Trainer(model, wild, Start(0.0, np.zeros(model.nu)))
    with pytest.raises(Unlearnable, match="no numbers any more at a learning rate of 1e\\+38"):
        trainer.advance()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps 0"),
        ({"chunk": 0}, "chunk 0"),
        ({"last_spread": 0.9}, "last_spread"),
        ({"rhythm_spread": 0.0}, "rhythm_spread is 0.0"),
        ({"rhythm_rate": 1.5}, "rhythm_rate is 1.5"),
    ],
)
def test_bounds_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(SMALL, **changes)
