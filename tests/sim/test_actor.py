"""Gaits keep their law, and a learned policy is its layers and its action map and nothing else."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from policies import action_map, holding, oscillator, perceptron

from sim.actor import Gait, Perceptron, low_pass, smooth_step
from sim.observation import ObservationLayout, normaliser

finite = st.floats(-10.0, 10.0)


@given(st.floats(0.0, 3.0), finite, finite, finite, st.floats(0.0, 20.0))
def test_gait_follows_its_law_and_its_period(
    frequency: float, amplitude: Any, phase: Any, offset: float, time: float
) -> None:
    gait = Gait(frequency, np.array([amplitude, 0.0]), np.array([phase, phase]), np.array([offset, 1.0]))
    expected = offset + amplitude * np.sin(2 * np.pi * frequency * time + phase)
    np.testing.assert_allclose(gait.targets(time), [expected, 1.0], atol=1e-12)
    if frequency > 0.1:
        np.testing.assert_allclose(gait.targets(time + 1 / frequency), gait.targets(time), atol=1e-9)
    np.testing.assert_array_equal(gait.act(time, np.zeros(12)), gait.targets(time))


def test_gait_of_many_times_is_the_gait_of_each() -> None:
    gait = Gait(1 / 3, np.array([0.1, np.pi / 7]), np.array([0.0, 1e-17]), np.array([0.2, -0.3]))
    times = np.linspace(0, 2, 6).reshape(2, 3)
    batch = gait.targets(times)
    assert batch.shape == (2, 3, 2)
    np.testing.assert_allclose(batch[1, 2], gait.targets(times[1, 2]), rtol=1e-15)


def test_gait_keeps_its_own_frozen_copy() -> None:
    amplitude = np.ones(2)
    gait = Gait(1.0, amplitude, np.zeros(2), np.zeros(2))
    amplitude[0] = 5.0
    assert gait.amplitude[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        gait.amplitude[0] = 2.0


@pytest.mark.parametrize(
    ("frequency", "amplitude", "phase", "message"),
    [
        (np.nan, np.ones(2), np.ones(2), "frequency"),
        (-1.0, np.ones(2), np.ones(2), "frequency"),
        (1.0, np.array([1.0, np.inf]), np.ones(2), "amplitude must be finite"),
        (1.0, np.ones(2), np.ones(3), "phase must be"),
        (1.0, np.ones((2, 1)), np.ones((2, 1)), "amplitude must be"),
    ],
)
def test_gait_refuses_bad_parameters(frequency: float, amplitude: Any, phase: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Gait(frequency, amplitude, phase, np.zeros(2))


def test_low_pass_composes_in_time_and_settles() -> None:
    start, target = np.zeros(2), np.array([1.0, -2.0])
    twice = low_pass(low_pass(start, target, 0.01, 0.1), target, 0.01, 0.1)
    np.testing.assert_allclose(twice, low_pass(start, target, 0.02, 0.1), rtol=1e-12)
    np.testing.assert_allclose(low_pass(start, target, 10.0, 0.1), target, rtol=1e-12)
    assert low_pass(start, target, 0.02, 0.0) is target


@given(st.floats(-1.0, 2.0), st.floats(-1.0, 2.0))
def test_smooth_step_goes_up_from_0_to_1_and_never_faster_than_15_over_8(a: float, b: float) -> None:
    low, high = smooth_step(min(a, b)), smooth_step(max(a, b))
    assert 0.0 <= low <= high <= 1.0
    assert high - low <= 15 / 8 * abs(a - b) + 1e-12


def said_by_hand(policy: Perceptron, observation: np.ndarray) -> list[float]:
    """The law of the docstring, one multiplication at a time."""
    x = [(o - c) * g for o, c, g in zip(observation, policy.input_centre, policy.input_gain, strict=True)]
    for index, (W, b) in enumerate(policy.layers):
        y = [b[k] + sum(x[i] * W[i, k] for i in range(len(x))) for k in range(len(b))]
        x = y if index == len(policy.layers) - 1 else [math.tanh(v) for v in y]
    return x


@given(st.integers(1, 6), st.integers(1, 3), st.booleans(), st.lists(st.integers(1, 9), max_size=3), st.integers(0, 99))
def test_a_perceptron_says_what_its_layers_say(
    num_joints: int, history: int, commanded: bool, units: list[int], seed: int
) -> None:
    policy = perceptron(num_joints, seed, history, (0.3, 0.0, -0.2) if commanded else (), units)
    observations = np.random.default_rng(seed).normal(size=(3, policy.layout.size))
    said = policy.say(observations)
    assert said.shape == (3, num_joints)
    for row, observation in zip(said, observations, strict=True):
        np.testing.assert_allclose(row, said_by_hand(policy, observation), atol=1e-12)
        assert policy.say(observation).tobytes() == row.tobytes()


@given(st.integers(0, 99), st.floats(0.05, 1.0), st.floats(0.01, 0.5), st.floats(0.0, 50.0))
def test_its_targets_start_from_the_previous_ones_and_keep_every_bound(
    seed: int, blend: float, step: float, gain: float
) -> None:
    actions = action_map(3, blend=blend, step=step, low=np.array([-0.4, -0.1, 0.0]), high=np.array([0.4, 0.3, 0.2]))
    policy = perceptron(3, seed, history=2, gain=gain, actions=actions)
    rng = np.random.default_rng(seed)
    observation = rng.normal(size=policy.layout.size)
    previous = rng.uniform(actions.low, actions.high)
    observation[policy.layout.action] = previous
    targets = policy.act(3.0, observation)
    said = np.clip(policy.say(observation), -1, 1)
    wanted = np.clip(actions.centre + actions.scale * said, actions.low, actions.high)
    np.testing.assert_allclose(targets, previous + np.clip(blend * (wanted - previous), -step, step), atol=1e-12)
    assert (np.abs(targets - previous) <= step + 1e-12).all()
    assert (targets >= actions.low - 1e-12).all()
    assert (targets <= actions.high + 1e-12).all()
    np.testing.assert_array_equal(policy.act(0.0, observation), targets)  # time tells it nothing


def test_only_the_latest_frame_says_what_the_previous_targets_were() -> None:
    policy = holding(np.array([0.5, -0.5]), blend=0.25)
    policy = Perceptron(
        ((np.zeros((2 * policy.layout.size, 2)), np.zeros(2)),),
        *normaliser(ObservationLayout(2, 2), policy.actions), policy.actions, history=2,
    )  # fmt: skip
    observation = np.zeros(policy.layout.size)
    observation[policy.layout.action] = 0.1, 0.1
    observation[policy.layout.frame_size :] = 7.0
    np.testing.assert_allclose(policy.act(0.0, observation), [0.1 + 0.25 * 0.4, 0.1 - 0.25 * 0.6])


def test_what_is_no_number_comes_out_as_no_number_and_without_a_warning() -> None:
    policy = perceptron(2)
    observation = np.zeros(policy.layout.size)
    observation[0] = np.nan
    assert np.isnan(policy.act(0.0, observation)).all()
    wide = perceptron(2, gain=1e200)
    assert not np.isfinite(wide.say(np.full(wide.layout.size, 1e200))).all()


def test_a_perceptron_keeps_its_own_frozen_copies() -> None:
    plain = perceptron(2)
    weight = plain.layers[0][0].copy()
    policy = Perceptron(
        ((weight, plain.layers[0][1]), *plain.layers[1:]), plain.input_centre, plain.input_gain, plain.actions
    )
    weight[0, 0] = 9.0
    assert policy.layers[0][0][0, 0] == plain.layers[0][0][0, 0]
    for array in (policy.layers[1][0], policy.layers[1][1], policy.input_centre, policy.input_gain):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


@given(st.permutations(range(4)), st.integers(1, 3), st.booleans(), st.integers(0, 99))
def test_a_policy_in_another_order_of_joints_is_the_same_policy(
    order: list[int], history: int, commanded: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    actions = action_map(4, centre=rng.uniform(-0.1, 0.1, 4), scale=rng.uniform(0.2, 0.5, 4))
    policy = perceptron(4, seed, history, (0.1, 0.2, 0.3) if commanded else (), actions=actions)
    layout = policy.layout
    frames = [{n: rng.normal(size=s.stop - s.start) for n, s in layout.slices.items()} for _ in range(history)]
    moved = [
        {n: v[order] if n in ("position", "velocity", "action") else v for n, v in frame.items()} for frame in frames
    ]
    ours, theirs = (np.concatenate([layout.pack(**f) for f in fs]) for fs in (frames, moved))
    np.testing.assert_allclose(policy.arranged(order).act(0.0, theirs), policy.act(0.0, ours)[order], atol=1e-12)
    gait = Gait(1.0, *rng.normal(size=(3, 4)))
    np.testing.assert_array_equal(gait.arranged(order).targets(0.3), gait.targets(0.3)[order])


@pytest.mark.parametrize("order", [[0], [0, 0], [1, 2], [0, 1, 2]])
def test_an_order_that_leaves_a_joint_out_is_refused(order: list[int]) -> None:
    for actor in (perceptron(2), Gait(1.0, np.zeros(2), np.zeros(2), np.zeros(2))):
        with pytest.raises(ValueError, match="each of 0 to 1 once"):
            actor.arranged(order)


def test_the_oscillator_of_the_tests_swings() -> None:
    policy = oscillator(2)
    layout = policy.layout
    observation = layout.begin(np.zeros(layout.frame_size))
    swing = []
    for _ in range(400):
        targets = policy.act(0.0, observation)
        swing.append(targets)
        frame = np.zeros(layout.frame_size)
        frame[layout.action] = targets
        observation = layout.push(observation, frame)
    last = np.array(swing)[-100:, 0]
    assert last.max() - last.min() > 0.2
    assert 2 <= (np.diff(np.sign(last - last.mean())) > 0).sum() <= 4  # periods in two seconds


LAYER = (np.zeros((12, 2)), np.zeros(2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layers": ()}, "needs at least one layer"),
        ({"layers": ((np.zeros((11, 2)), np.zeros(2)),)}, r"Layer 0: weight must be \(12, outputs\)"),
        ({"layers": ((np.zeros((12, 2)), np.zeros(3)),)}, r"Layer 0: .* got \(12, 2\) and \(3,\)"),
        ({"layers": ((np.zeros((12, 5)), np.zeros(5)), (np.zeros((4, 2)), np.zeros(2)))}, r"Layer 1: weight must be"),
        ({"layers": ((np.zeros((12, 3)), np.zeros(3)),)}, "last layer has 3 outputs, the robot has 2 joints"),
        ({"layers": ((np.full((12, 2), np.nan), np.zeros(2)),)}, "Layer 0: every number must be finite"),
        ({"layers": ((np.zeros((12, 2)), np.array([0.0, np.inf])),)}, "Layer 0: every number must be finite"),
        ({"input_centre": np.zeros(11)}, "input_centre must be 12 finite numbers"),
        ({"input_gain": np.full(12, np.nan)}, "input_gain must be 12 finite numbers"),
        ({"history": 0}, "history >= 1"),
        ({"history": 2}, "input_centre must be 24 finite numbers"),
        ({"command": (0.1,)}, "input_centre must be 15 finite numbers"),
        ({"command": (0.1,), "input_centre": np.zeros(15), "input_gain": np.ones(15)}, "command is none or 3"),
        ({"command": (0.1, 0.0, np.nan), "input_centre": np.zeros(15), "input_gain": np.ones(15)}, "3 finite numbers"),
    ],
)
def test_a_perceptron_refuses_what_does_not_fit(changes: dict[str, Any], message: str) -> None:
    fields: dict[str, Any] = {
        "layers": (LAYER,), "input_centre": np.zeros(12), "input_gain": np.ones(12), "actions": action_map(2)
    }  # fmt: skip
    assert Perceptron(**fields).num_joints == 2
    with pytest.raises(ValueError, match=message):
        Perceptron(**(fields | changes))


def test_a_silenced_policy_says_nothing_and_stays_what_it_is_otherwise() -> None:
    policy = perceptron(3, history=2)
    silent = policy.silenced()
    seen = np.random.default_rng(0).normal(size=(5, policy.layout.size))
    np.testing.assert_array_equal(silent.say(seen), np.zeros((5, 3)))
    assert policy.say(seen).any()
    assert (silent.layout, silent.actions, silent.rhythm) == (policy.layout, policy.actions, policy.rhythm)
