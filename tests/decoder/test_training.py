"""Training: exact where it goes on, two stages that leave each other alone, and a guard against what is not finite."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from decoder import training
from decoder.training import Diverged, Settings, Training, TrainingError

TINY = Settings(steps=3, flow_steps=2, batch=2, warmup=1, threads=1, start_bodies=0)
Arrays = dict[str, np.ndarray]


def begun(settings: Settings = TINY) -> Training:
    return Training.start(settings, None)


def taken(state: Training, steps: int) -> Arrays:
    for _ in range(steps):
        state.advance()
    return {name: array.copy() for name, array in state.weights().items()}


def test_a_training_that_was_stopped_goes_on_byte_for_byte(tmp_path: Path):
    straight = taken(begun(), 5)
    first = begun()
    for stop in (2, 2):  # within each stage
        taken(first, stop)
        first.save(tmp_path / "state")
        first = Training.load(tmp_path / "state", TINY)
    again = taken(first, 1)
    assert first.step == 5
    assert {name: array.tobytes() for name, array in straight.items()} == {n: a.tobytes() for n, a in again.items()}


def test_the_flow_learns_after_the_rest_and_alone():
    state = begun()
    start, learned = taken(state, 0), taken(state, 3)
    for name, array in start.items():
        moved = not np.array_equal(array, learned[name])
        assert moved is not name.startswith("flow."), name
    flowing = taken(state, 2)
    for name, array in learned.items():
        moved = not np.array_equal(array, flowing[name])
        assert moved is name.startswith("flow."), name


def test_the_rate_rises_and_falls_in_both_stages():
    state = begun(replace(TINY, steps=100, flow_steps=50, warmup=10, learning_rate=1.0))
    rates = []
    for step in range(150):
        state.step = step
        rates.append(state._learning_rate())
    for stage in (rates[:100], rates[100:]):
        assert stage[0] == pytest.approx(0.1, rel=0.05)
        assert max(stage) == pytest.approx(1.0, rel=0.05)
        assert np.argmax(stage) in (9, 10)
        assert stage[-1] < 0.02


def test_steps_that_are_not_finite_change_nothing_and_twenty_are_enough(monkeypatch: pytest.MonkeyPatch):
    state = begun()
    before = taken(state, 1)

    def broken(w: dict[str, torch.Tensor], *_: object) -> dict[str, torch.Tensor]:
        return {"loss": (w["said.place"] * float("nan")).sum()}

    monkeypatch.setattr(training, "losses", broken)
    monkeypatch.setattr(training, "flow_losses", broken)
    after = taken(state, 19)
    assert all(np.array_equal(before[name], after[name]) for name in before)
    with pytest.raises(Diverged, match="no finite value for 20 steps, the last of them 21"):
        state.advance()


@pytest.mark.parametrize("bad", [b"", b"no checkpoint", b"PK\x03\x04 cut short"])
def test_what_is_no_checkpoint_is_refused(tmp_path: Path, bad: bytes):
    (tmp_path / "state").write_bytes(bad)
    with pytest.raises(TrainingError, match="not a readable checkpoint"):
        Training.load(tmp_path / "state", TINY)


def test_a_checkpoint_of_other_settings_is_refused_but_the_machine_may_change(tmp_path: Path):
    state = begun()
    state.save(tmp_path / "state")
    assert Training.load(tmp_path / "state", replace(TINY, threads=2)).step == 0
    with pytest.raises(TrainingError, match="flow_steps was 2, now it is 7"):
        Training.load(tmp_path / "state", replace(TINY, flow_steps=7))
