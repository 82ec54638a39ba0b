"""The benchmark's rows of training, small."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from experiments import bench_training
from experiments.bench import replaced, row
from sim.environment import Environment
from sim.model import Model


@pytest.fixture(scope="module")
def model() -> Model:
    return bench_training.reference()


def test_the_replay_is_the_episodes_of_the_learner(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    step = Environment.step

    def watch(self: Any, said: Any) -> Any:
        found = step(self, said)
        seen.append((type(self), np.array(said), found.reward.copy()))
        return found

    monkeypatch.setattr(Environment, "step", watch)
    rates = bench_training.against_environment(model, 0, 4096)
    assert all(rate > 0 for rate in rates)
    learned = [entry for entry in seen if entry[0] is bench_training.Watched]
    others = [entry for entry in seen if entry[0] is not bench_training.Watched][32:]  # after the warm-up
    replayed = [*others[:32], *others[64:96]]
    assert len(learned) == len(replayed) == 64
    for (_, said, reward), (_, again, same) in zip(learned, replayed, strict=True):
        np.testing.assert_array_equal(said, again)
        np.testing.assert_array_equal(reward, same)


def test_walking_is_given_up_or_reached(model: Model) -> None:
    seconds, reached = bench_training.time_to_walk(model, 0, most=4096, speed=10.0)
    assert seconds > 0
    assert not reached
    sooner, reached = bench_training.time_to_walk(model, 0, most=8192, speed=-1.0)
    assert reached
    assert sooner > 0


def test_rows_say_what_was_not_reached(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_training, "against_environment", lambda *_: (4.0, 2.0, 1.5))
    monkeypatch.setattr(bench_training, "on_batch", lambda *_: 6.0)
    monkeypatch.setattr(bench_training, "on_processes", lambda _, seed, count: float(count == 4) + seed + 1)
    monkeypatch.setattr(bench_training, "time_to_walk", lambda _, seed: (10.0 + seed, seed == 0))
    rows = {found["what"]: found for found in bench_training.training(row, 2, model)}
    assert rows["training against bare environment"]["value"] == 0.75
    assert rows["- the same, random actions in the bare one"]["value"] == 0.375
    assert rows["training on SubprocVecEnv, wall time"]["note"].startswith("4 processes")
    assert rows["times faster than SubprocVecEnv"]["value"] == 2.0
    assert "10.0, > 11.0, > 12.0" in rows["CPU-seconds to 0.5 m/s, at least"]["note"]


def test_rows_measured_again_take_their_places() -> None:
    rows = [row("a", 1.0, "s"), row("b", 2.0, "s"), row("c", 3.0, "s")]
    found = replaced(rows, [row("b", 5.0, "s")])
    assert [entry["value"] for entry in found] == [1.0, 5.0, 3.0]
    with pytest.raises(ValueError, match="no row 'd'"):
        replaced(rows, [row("d", 1.0, "s")])
