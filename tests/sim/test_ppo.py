"""The learner's shortcuts: fewer operations than the library's, and the same bytes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy

from mfg.description import Description
from sim.environment import Environment
from sim.herd import with_latency_room
from sim.learning import Learner
from sim.model import make_spec
from sim.plan import USUAL, Ppo
from sim.ppo import ActorCritic, LeanPPO

BRIEF = replace(USUAL, copies=8, horizon=24, minibatch=64, epochs=2)


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Any:
    return with_latency_room(make_spec(quadruped))


def _learned(model: Any, settings: Ppo) -> dict[str, Any]:
    learner = Learner(Environment(model, settings.copies), settings, 3)
    learner.learn(2 * settings.update, np.random.default_rng(1), 1e-3, 0.5)
    return learner.state()


@pytest.mark.parametrize("clip", [0.2, 0.01])
def test_the_policy_comes_out_as_by_the_library_alone(model: Any, monkeypatch: pytest.MonkeyPatch, clip: float) -> None:
    lean = _learned(model, replace(BRIEF, clip=clip))
    unlimited = _learned(model, replace(BRIEF, clip=10.0))
    assert any((unlimited[name] != value).any() for name, value in lean.items())  # the limit was met
    for name in ("forward", "evaluate_actions"):
        monkeypatch.setattr(ActorCritic, name, getattr(ActorCriticPolicy, name))
    monkeypatch.setattr(LeanPPO, "train", PPO.train)
    plain = _learned(model, replace(BRIEF, clip=clip))
    assert lean.keys() == plain.keys()
    for name, value in plain.items():
        np.testing.assert_array_equal(lean[name], value, err_msg=name)


def test_no_minibatch_is_a_single_sample() -> None:
    with pytest.raises(ValueError, match="minibatches of 32 samples leave a single one of the 33 of an update"):
        Ppo(copies=3, horizon=11, minibatch=32)


def test_a_deterministic_policy_says_its_mean(model: Any) -> None:
    learner = Learner(Environment(model, BRIEF.copies), BRIEF, 3)
    policy = learner.ppo.policy
    seen = torch.randn(5, learner.environment.layout.size + learner.environment.hidden_size)
    with torch.no_grad():
        said, value, density = policy.forward(seen, deterministic=True)
        theirs = ActorCriticPolicy.forward(policy, seen, deterministic=True)
    for ours, library in zip((said, value, density), theirs, strict=True):
        np.testing.assert_array_equal(ours.numpy(), library.numpy())
