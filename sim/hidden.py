"""What only the simulator knows of a copy: for the critic of a training, never for the policy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.randomisation import EXACT, Draws
from sim.tasks import along

Array = NDArray[np.float64]

ROBOT, MOTION, PHASE = 8, 7, 2  # how many numbers each part has
TURN_SCALE = 2.0  # an ordinary yaw rate, read as 1 [rad/s]


def robot(draws: Draws) -> Array:
    """How the copies differ from the model, each number about -2 to 2 over `sim.randomisation.WIDE`, (k, ROBOT)."""
    found = np.zeros((len(draws.gyro_bias), ROBOT))
    scales = {
        "friction": 0.5,
        "contact_time": 0.7,
        "stiffness": 0.2,
        "damping": 0.2,
        "voltage": 0.06,
        "mass": 0.1,
        "skin": 0.6,
    }
    for place, (name, scale) in enumerate(scales.items()):
        value = getattr(draws, name)
        if value is not None:
            mean = np.log(value / getattr(EXACT, name)[0]).reshape(len(value), -1).mean(axis=1)
            found[:, place] = mean / scale
    if draws.latency is not None:
        found[:, -1] = (draws.latency - EXACT.latency[0]) / 0.016
    return found


def motion(
    velocity: Array, pace: Array, yaw_rate: Array, height: Array, fade: Array, heading: float, target: float
) -> Array:
    """How the copies move, (k, MOTION): forward and left by the moment and by the stride, yaw, height, take-over.

    Args:
        velocity: of the root in the body's heading frame [m/s], (k, 2).
        pace: its mean over about a stride [m/s], (k, 2).
        yaw_rate: [rad/s], (k,).
        height: of the root over where it stood, in lengths of the body, (k,).
        fade: how far the policy has taken over, 0 to 1, (k,).
        heading: of the task [rad].
        target: speed read as 1 [m/s].
    """
    parts = (*along(velocity, heading), *along(pace, heading))
    return np.stack([*(part / target for part in parts), yaw_rate / TURN_SCALE, height, fade], axis=1)


def phase(frequency: float, time: Array) -> Array:
    """Where in the stride of a rhythm [Hz] the copies are at times (k,) [s], (k, PHASE)."""
    angle = 2.0 * np.pi * frequency * time
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)
