"""What only the simulator knows reaches the critic, and nothing of it the policy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from trainings_in_brief import CORRECTED, FREE, SMALL

from mfg.description import Description
from sim import hidden
from sim.environment import Environment
from sim.herd import with_latency_room
from sim.learning import Learner
from sim.model import make_spec
from sim.ppo import Vector
from sim.randomisation import WIDE, at_end, draw, nominal
from sim.training import environment_of


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Any:
    return with_latency_room(make_spec(quadruped))


def test_the_robot_of_the_model_is_nought() -> None:
    np.testing.assert_array_equal(hidden.robot(nominal(3, 4)), np.zeros((3, hidden.ROBOT)))


def test_every_range_has_a_place_of_its_own_and_is_of_the_order_of_one() -> None:
    names = ("friction", "contact_time", "stiffness", "damping", "voltage", "mass", "skin", "latency")
    places = []
    for name in names:
        ends = [hidden.robot(draw(at_end(WIDE, end, name), np.random.default_rng(0), 1, 4, 5))[0] for end in (0, 1)]
        (place,) = np.flatnonzero(np.abs(ends[1] - ends[0]) > 1e-9)
        assert 1.0 < abs(ends[1][place] - ends[0][place]) < 5.0
        assert max(np.abs(ends[0]).max(), np.abs(ends[1]).max()) < 3.0
        places.append(int(place))
    assert sorted(places) == list(range(hidden.ROBOT))


def test_motion_is_seen_along_the_heading() -> None:
    velocity, none = np.array([[0.0, 0.6]]), np.zeros((1, 2))
    found = hidden.motion(velocity, none, np.zeros(1), np.zeros(1), np.ones(1), np.pi / 2, 0.3)
    np.testing.assert_allclose(found, [[2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]], atol=1e-12)


def test_a_rhythm_s_phase_is_where_its_stride_is() -> None:
    np.testing.assert_allclose(hidden.phase(2.0, np.array([0.0, 0.125, 0.5])), [[0, 1], [1, 0], [0, 1]], atol=1e-12)


@pytest.mark.parametrize("start", [FREE, CORRECTED])
def test_an_environment_tells_what_it_knows(model: Any, start: Any) -> None:
    world = environment_of(model, SMALL, start, count=3)
    world.reset(np.random.default_rng(0))
    assert world.hidden().shape == (3, world.hidden_size)
    step = world.step(np.zeros((3, 4)))
    assert step.last_hidden.shape == (0, world.hidden_size)
    assert np.isfinite(world.hidden()).all()
    assert np.abs(world.hidden()[:, 1 : 1 + hidden.ROBOT]).min() > 0.0  # drawn, so nothing is as in the model


def test_the_end_of_an_episode_is_told_before_the_next_begins(model: Any) -> None:
    world = Environment(model, 2, randomisation=WIDE)
    world.reset(np.random.default_rng(0))
    before = world.hidden()
    step = world.step(np.full((2, 4), np.nan))  # counts as a fall
    assert step.terminated.all()
    robots = slice(1, 1 + hidden.ROBOT)
    np.testing.assert_array_equal(step.last_hidden[:, robots], before[:, robots])
    assert not np.allclose(world.hidden()[:, robots], before[:, robots])
    np.testing.assert_array_equal(world.hidden()[:, 1 + hidden.ROBOT :][:, :5], 0.0)  # a fresh copy does not move


def test_a_lost_copy_tells_numbers(model: Any) -> None:
    world = Environment(model, 2)
    world.reset(np.random.default_rng(0))
    world.herd.qvel[0, 0] = 1e6
    step = world.step(np.zeros((2, 4)))
    assert np.isfinite(world.hidden()).all()
    np.testing.assert_array_equal(step.last_hidden, np.zeros((1, world.hidden_size)))


def test_the_critic_sees_it_and_the_policy_does_not(model: Any) -> None:
    world = environment_of(model, SMALL, CORRECTED)
    learner = Learner(world, SMALL.ppo, 0)
    seen = torch.randn(5, world.layout.size + world.hidden_size)
    other = torch.cat([seen[:, : world.layout.size], torch.randn(5, world.hidden_size)], dim=1)
    policy = learner.ppo.policy
    with torch.no_grad():
        said, worth = policy.get_distribution(seen).mode(), policy.predict_values(seen)
        again, otherwise = policy.get_distribution(other).mode(), policy.predict_values(other)
    torch.testing.assert_close(said, again, rtol=0, atol=0)
    assert not torch.allclose(worth, otherwise)
    actor = learner.exported()
    assert actor.layers[0][0].shape[0] == world.layout.size
    np.testing.assert_allclose(actor.say(seen[:, : world.layout.size].numpy()), said.numpy(), atol=1e-5)


def test_the_learner_s_vector_carries_both(model: Any) -> None:
    world = Environment(model, 2, randomisation=replace(WIDE, noise=None))
    vector = Vector(world, np.random.default_rng(0))
    seen = vector.reset()
    assert seen.shape == (2, world.layout.size + world.hidden_size) == (2, *vector.observation_space.shape)
    np.testing.assert_array_equal(seen[:, world.layout.size :], world.hidden().astype(np.float32))
