"""Learned policies that were written by hand; imported by name from the tests beside it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.actor import Perceptron
from sim.observation import ActionMap, ObservationLayout, normaliser


def action_map(num_joints: int, **changes: Any) -> ActionMap:
    """Half a radian about zero, by at most 0.3 rad a period."""
    one = np.ones(num_joints)
    fields: dict[str, Any] = {
        "centre": 0 * one, "scale": 0.5 * one, "low": -0.6 * one, "high": 0.6 * one, "blend": 1.0, "step": 0.3
    }  # fmt: skip
    return ActionMap(**(fields | changes))


def perceptron(
    num_joints: int, seed: int = 0, history: int = 1, command: tuple[float, ...] = (), units: Sequence[int] = (8, 6),
    gain: float = 1.0, actions: ActionMap | None = None,
) -> Perceptron:  # fmt: skip
    """Weights from a seed, of order one at the output of every layer."""
    rng = np.random.default_rng(seed)
    layout = ObservationLayout(num_joints, history, bool(command))
    actions = action_map(num_joints) if actions is None else actions
    sizes = [layout.size, *units, num_joints]
    layers = tuple(
        (gain * rng.normal(size=(a, b)) / np.sqrt(a), 0.1 * rng.normal(size=b)) for a, b in itertools.pairwise(sizes)
    )
    return Perceptron(layers, *normaliser(layout, actions), actions, history, command)


def holding(pose: NDArray[np.float64], blend: float = 0.3) -> Perceptron:
    """Goes to a pose [rad] and stays there, whatever it sees."""
    actions = action_map(len(pose), centre=pose, blend=blend)
    layout = ObservationLayout(len(pose))
    layer = (np.zeros((layout.size, len(pose))), np.zeros(len(pose)))
    return Perceptron((layer,), *normaliser(layout, actions), actions)


def oscillator(num_joints: int, frequency: float = 1.5, period: float = 0.02, amplitude: float = 0.8) -> Perceptron:
    """Swings by itself: u' = A tanh((1.03 (2 cos w u - u_before) + bias) / A) of the targets u, w = 2 pi f period.

    Its fixed point is unstable and lies beside where it starts, so that nothing has to give it a push.
    """
    actions = action_map(num_joints)
    layout = ObservationLayout(num_joints, history=2)
    centre, gain = normaliser(layout, actions)
    weight = np.zeros((layout.size, num_joints))
    now = np.arange(num_joints) + layout.action.start
    joints = np.arange(num_joints)
    weight[now, joints] = 1.03 * 2.0 * np.cos(2.0 * np.pi * frequency * period) / amplitude
    weight[now + layout.frame_size, joints] = -1.03 / amplitude
    hidden = (weight, np.full(num_joints, 0.0005) / amplitude)
    return Perceptron((hidden, (amplitude * np.eye(num_joints), np.zeros(num_joints))), centre, gain, actions, 2)
