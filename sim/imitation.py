"""Teach a fresh policy an open-loop gait, so that learning begins with a robot that walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.actor import Gait
from sim.environment import Environment

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Lesson:
    """How a gait is taught.

    Attributes:
        periods: control periods of every copy that are shown.
        noise: standard deviation that is added to what is done, not to what is taught: the way back is learned, too.
        epochs: passes over the examples.
        minibatch: samples of one step.
        learning_rate: the greatest, of Adam.
    """

    periods: int = 160
    noise: float = 0.25
    epochs: int = 16
    minibatch: int = 256
    learning_rate: float = 2e-3


LESSON = Lesson()


def said_of(gait: Gait, environment: Environment, time: Array, previous: Array) -> Array:
    """What a policy would have to say, (k, n), to go from targets `previous` (k, n) to the gait's at `time` (k,) [s]."""
    actions = environment.map
    wanted = previous + (gait.targets(time) - previous) / actions.blend
    return np.clip((wanted - actions.centre) / np.maximum(actions.scale, 1e-9), -1.0, 1.0)


def examples(
    gait: Gait, environment: Environment, rng: np.random.Generator, lesson: Lesson = LESSON
) -> tuple[Array, Array]:
    """Observations (m, size) of copies that follow the gait under noise, and what should have been said (m, n)."""
    observation = environment.reset(rng)
    action = environment.layout.action
    # Each copy has a clock of its own, so that the whole cycle is shown from the start.
    clock = rng.uniform(0.0, 1.0 / max(gait.frequency, 1e-3), environment.count)
    seen, taught = [], []
    for _ in range(lesson.periods):
        clock = clock + environment.herd.period
        said = said_of(gait, environment, clock, observation[:, action])
        seen.append(observation)
        taught.append(said)
        noisy = said + lesson.noise * rng.standard_normal(said.shape)
        observation = environment.step(np.clip(noisy, -1.0, 1.0)).observation
    return np.concatenate(seen), np.concatenate(taught)
