"""A mixture is its parts, row by row, whatever else is in it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mfg.description import Description
from sim.environment import Environment
from sim.herd import with_latency_room
from sim.mixture import Mixture
from sim.model import make_spec
from sim.randomisation import RANDOMISED
from sim.skin import Fidelity


@pytest.fixture(scope="module")
def models(quadruped: Description) -> tuple[Any, Any]:
    padded = replace(quadruped, links=tuple(replace(link, skin_thickness=0.02) for link in quadruped.links))
    soft, sprung = (with_latency_room(make_spec(padded, fidelity=level)) for level in
                    (Fidelity.COMPLIANT, Fidelity.SPRUNG))  # fmt: skip
    assert sprung.nv > soft.nv
    return soft, sprung


def parts(models: tuple[Any, Any]) -> list[Environment]:
    return [Environment(model, count, randomisation=RANDOMISED) for model, count in zip(models, (3, 2), strict=True)]


def test_it_is_its_parts_row_by_row(models: tuple[Any, Any]) -> None:
    mixed, alone = Mixture(parts(models)), parts(models)
    seen = mixed.reset(np.random.default_rng(1))
    expected = [p.reset(child) for p, child in zip(alone, np.random.default_rng(1).spawn(2), strict=True)]
    np.testing.assert_array_equal(seen, np.concatenate(expected))
    said = np.random.default_rng(2).uniform(-1, 1, (120, 5, mixed.map.num_joints))
    ended = 0
    for orders in said:
        step = mixed.step(orders)
        one, two = (p.step(rows) for p, rows in zip(alone, (orders[:3], orders[3:]), strict=True))
        for name in ("observation", "reward", "terminated", "truncated", "last", "lengths", "returns"):
            joined = np.concatenate([getattr(one, name), getattr(two, name)])
            np.testing.assert_array_equal(getattr(step, name), joined)
        # The last observations come in the order of the copies.
        assert len(step.last) == (step.terminated | step.truncated).sum()
        ended += len(step.last)
        for name, mean in step.parts.items():
            assert mean == pytest.approx((3 * one.parts[name] + 2 * two.parts[name]) / 5)
    assert ended > 0


def test_the_critic_is_told_which_model_a_copy_is(models: tuple[Any, Any]) -> None:
    mixed, alone = Mixture(parts(models)), parts(models)
    mixed.reset(np.random.default_rng(1))
    for part, child in zip(alone, np.random.default_rng(1).spawn(2), strict=True):
        part.reset(child)
    unseen = mixed.hidden()
    assert unseen.shape == (5, mixed.hidden_size)
    np.testing.assert_array_equal(unseen[:, 0], [0, 0, 0, 1, 1])
    np.testing.assert_array_equal(unseen[:, 1:], np.concatenate([part.hidden()[:, 1:] for part in alone]))
    mixed.step(np.zeros((5, mixed.map.num_joints)))
    for part in alone:
        part.step(np.zeros((part.count, mixed.map.num_joints)))
    np.testing.assert_array_equal(mixed.hidden()[:, 1:], np.concatenate([part.hidden()[:, 1:] for part in alone]))


def test_what_is_lost_is_counted_and_kept_for_all(models: tuple[Any, Any]) -> None:
    mixed = Mixture(parts(models))
    mixed.reset(np.random.default_rng(0))
    mixed.parts[1].herd.qvel[0, 0] = 1e6
    mixed.step(np.zeros((5, mixed.map.num_joints)))
    assert mixed.lost == 1
    assert len(mixed.explosions) == 1
    assert len(mixed.explosions[0].state) > len(mixed.parts[0].herd.batch.state[0])  # of a robot with pads


def test_parts_must_fit_together(models: tuple[Any, Any], pendulum: Description) -> None:
    with pytest.raises(ValueError, match="at least one"):
        Mixture([])
    other = Environment(with_latency_room(make_spec(pendulum)), 1)
    with pytest.raises(ValueError, match="same joints"):
        Mixture([Environment(models[0], 1), other])
