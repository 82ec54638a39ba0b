"""Rewards are pure functions, and each weight acts on its own part."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim.tasks import FAST, SCALE, Goal, Moment, Task, along, terms

WEIGHTS = ("haste", "lateral", "turning", "tilting", "action_rate", "torque", "power")


def moment(k: int = 3, seed: int = 0, **changes: Any) -> Moment:
    rng = np.random.default_rng(seed)
    plain = Moment(
        velocity=rng.normal(size=(k, 2)) * 0.3, pace=rng.normal(size=(k, 2)) + FAST.target_speed,
        yaw_rate=rng.normal(size=k), up=rng.uniform(0.6, 1.0, k),
        joint_speed=rng.normal(size=(k, 2)), said=rng.uniform(-1, 1, (k, 2)), said_before=rng.uniform(-1, 1, (k, 2)),
        heat=rng.uniform(1.0, 3.0, (k, 2)), power=rng.uniform(0.1, 1, k), command=rng.normal(size=(k, 3)) * 0.2,
    )  # fmt: skip
    return replace(plain, **changes)


def test_a_heading_turns_what_is_forward() -> None:
    forward, left = along(np.array([[0.0, 2.0]]), np.pi / 2)
    assert forward == pytest.approx([2.0])
    assert left == pytest.approx([0.0], abs=1e-12)
    velocity = np.random.default_rng(0).normal(size=(5, 2))
    forward, left = along(velocity, 0.7)
    np.testing.assert_allclose(np.hypot(forward, left), np.linalg.norm(velocity, axis=1))


def test_speed_earns_up_to_the_target_and_no_more() -> None:
    speeds = np.linspace(-0.5, 1.5, 41)
    steady = moment(41, velocity=(velocity := np.stack([speeds, 0 * speeds], axis=1)), pace=velocity)
    earned = terms(FAST, steady)["speed"]
    assert (np.diff(earned[speeds <= FAST.target_speed]) > 0).all()
    assert (np.diff(earned[speeds >= FAST.target_speed]) < 1e-12).all()
    assert earned.max() == pytest.approx(2 * SCALE * FAST.target_speed)
    # No stride is even: a moment may be faster than the stride, and its mean is what is earned.
    uneven = terms(FAST, moment(2, velocity=np.array([[-0.6, 0.0], [1.4, 0.0]]), pace=np.full((2, 2), 0.4)))["speed"]
    assert uneven.mean() == pytest.approx(2 * SCALE * 0.4)
    hasty = terms(replace(FAST, haste=2.0), steady)
    assert (np.diff((hasty["speed"] + hasty["haste"])[speeds >= FAST.target_speed]) < 0).all()
    assert (hasty["haste"][speeds <= FAST.target_speed] == 0).all()


@pytest.mark.parametrize("weight", WEIGHTS)
def test_each_weight_acts_on_its_own_part_and_only_costs(weight: str) -> None:
    task = replace(FAST, haste=1.0)
    before = terms(task, moment())
    after = terms(replace(task, **{weight: 2 * getattr(task, weight)}), moment())
    for name in before:
        np.testing.assert_allclose(after[name], before[name] * (2 if name == weight else 1))
    assert (before[weight] <= 0).all()


def test_torque_costs_beyond_what_the_warmest_motor_bears_for_long() -> None:
    cost = terms(FAST, moment(3, heat=np.array([[1.0, 0.2], [0.5, 1.5], [2.0, 0.0]])))["torque"]
    np.testing.assert_allclose(cost, -SCALE * FAST.torque * np.array([0.0, 0.5, 1.0]), atol=1e-15)


def test_a_command_is_followed_best_exactly() -> None:
    task = Task(Goal.COMMAND)
    exact = moment(1)
    exact = replace(exact, velocity=exact.command[:, :2], yaw_rate=exact.command[:, 2])
    off = replace(exact, velocity=exact.velocity + 0.1)
    assert terms(task, exact)["tracking"] > terms(task, off)["tracking"]
    assert terms(task, exact)["tracking"] == pytest.approx(SCALE)


@pytest.mark.parametrize("goal", [Goal.STAND, Goal.RECOVER])
def test_standing_upright_and_still_is_best(goal: Goal) -> None:
    zero = {"velocity": np.zeros((1, 2)), "joint_speed": np.zeros((1, 2)), "up": np.ones(1)}
    best = sum(terms(Task(goal), moment(1, **zero)).values())
    for spoilt in ({"velocity": np.ones((1, 2))}, {"up": np.zeros(1)}, {"joint_speed": np.full((1, 2), 5.0)}):
        assert sum(terms(Task(goal), moment(1, **(zero | spoilt))).values()) < best


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"heading": np.nan}, "heading is nan"), ({"target_speed": 0.0}, "target_speed is 0.0"),
     ({"target_speed": 11.0}, "target_speed"), *(({name: -1.0}, f"{name} is -1.0") for name in (*WEIGHTS, "fall"))],
)  # fmt: skip
def test_bounds_are_named(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(FAST, **changes)
