"""What a robot is trained for: tasks, and their rewards as pure functions of what just happened."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SCALE = 0.1  # of every reward, so that returns stay of the order of one


class Goal(StrEnum):
    """What counts."""

    SPEED = "speed"  # as fast as `target_speed` along a heading of the body
    COMMAND = "command"  # follow a commanded velocity, which is in the observation
    STAND = "stand"  # stay upright and still
    RECOVER = "recover"  # come to stand after a fall from a random attitude


@dataclass(frozen=True, slots=True)
class Task:
    """A goal with its weights; speeds are those of the root in the body's heading frame.

    The frame turns with the body's yaw, because a robot that cannot measure its yaw cannot be asked to hold one.

    Attributes:
        goal: what counts.
        heading: direction of the body that is forward, from the x axis it stood in [rad].
        target_speed: no mean speed beyond it earns more [m/s].
        haste: weight of going faster than that. Without it a robot that is quicker than it need be loses nothing, and
            what it keeps under variation is a smaller share: it is to go at the target whatever it stands on.
        commands: greatest forward, left and yaw speed that is commanded [m/s, m/s, rad/s].
        lateral: weight of speed across the heading.
        turning: weight of the yaw rate.
        tilting: weight of leaving the attitude it stood in.
        action_rate: weight of changes of what the policy says from one period to the next.
        torque: weight of what the warmest motor is loaded beyond what it bears for long: 1 at 1.4 times as much.
        power: weight of the mechanical power, per weight of the robot [s/m].
        fall: what a fall costs, beyond the end of the episode.
    """

    goal: Goal = Goal.SPEED
    heading: float = 0.0
    target_speed: float = 0.8
    haste: float = 0.0
    commands: tuple[float, float, float] = (0.4, 0.2, 0.6)
    lateral: float = 0.1
    turning: float = 0.1
    tilting: float = 0.2
    action_rate: float = 0.007
    torque: float = 0.3
    power: float = 0.015
    fall: float = 40.0

    def __post_init__(self) -> None:
        """Check the bounds."""
        if not np.isfinite(self.heading):
            raise ValueError(f"task: heading is {self.heading}; it must be a finite angle [rad]")
        if not 0.0 < self.target_speed <= 10.0:
            raise ValueError(f"task: target_speed is {self.target_speed}; it must lie in (0, 10] m/s")
        for name in ("haste", "lateral", "turning", "tilting", "action_rate", "torque", "power", "fall"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ValueError(f"task: {name} is {getattr(self, name)}; a weight is finite and not negative")


FAST = Task()  # as fast as is useful, along the x axis that the body stood in
STEADY = Task(haste=4.0, tilting=0.4, torque=1.0, fall=100.0)  # so that motors stay cool and falls are rare


@dataclass(frozen=True, eq=False, slots=True)
class Moment:
    """What happened to k copies in one control period.

    Attributes:
        velocity: of the root in the body's heading frame, before turning by the task's heading [m/s], (k, 2).
        pace: mean of the velocity over about a stride [m/s], (k, 2).
        yaw_rate: [rad/s], (k,).
        up: height of the direction that was up when the robot stood: 1 as it stood, -1 upside down, (k,).
        joint_speed: [rad/s], (k, n).
        said: what the policy said, (k, n).
        said_before: in the period before, (k, n).
        heat: mean over some seconds of the square of torque over the continuous rating, (k, n).
        power: mechanical power of all motors over the robot's weight [m/s], (k,).
        command: forward, left [m/s], yaw rate [rad/s], (k, 3).
    """

    velocity: Array
    pace: Array
    yaw_rate: Array
    up: Array
    joint_speed: Array
    said: Array
    said_before: Array
    heat: Array
    power: Array
    command: Array


def along(velocity: Array, heading: float) -> tuple[Array, Array]:
    """Forward and left speed (...) of velocities (..., 2) for a heading [rad]."""
    c, s = np.cos(heading), np.sin(heading)
    return c * velocity[..., 0] + s * velocity[..., 1], c * velocity[..., 1] - s * velocity[..., 0]


def terms(task: Task, moment: Moment) -> dict[str, Array]:
    """Every part of the reward by name, each (k,); their sum is the reward."""
    forward, left = along(moment.velocity, task.heading)
    effort = {
        "action_rate": -task.action_rate * np.square(moment.said - moment.said_before).sum(axis=1),
        "torque": -task.torque * np.maximum(moment.heat - 1.0, 0.0).max(axis=1),
        "power": -task.power * np.maximum(moment.power, 0.0),
        "tilting": -task.tilting * (1.0 - moment.up),
    }
    match task.goal:
        case Goal.SPEED:
            beyond = np.maximum(along(moment.pace, task.heading)[0] - task.target_speed, 0.0)
            earned = {
                "speed": 2.0 * (np.maximum(forward, -1.0) - beyond),
                "haste": -task.haste * beyond,
                "lateral": -task.lateral * np.abs(left),
                "turning": -task.turning * np.abs(moment.yaw_rate),
            }
        case Goal.COMMAND:
            wanted = moment.command
            miss = np.square(forward - wanted[:, 0]) + np.square(left - wanted[:, 1])
            # Kernels as legged_gym has them, that of the speed four times as narrow: these robots are slower.
            earned = {
                "tracking": np.exp(-miss / 0.25 * 4),
                "turning": 0.5 * np.exp(-np.square(moment.yaw_rate - wanted[:, 2]) / 0.25),
            }
        case Goal.STAND:
            earned = {"upright": moment.up, "still": -_stir(moment)}
        case Goal.RECOVER:
            earned = {"upright": 2.0 * moment.up, "still": -0.5 * np.maximum(moment.up, 0.0) * _stir(moment)}
    return {name: SCALE * value for name, value in (earned | effort).items()}


def _stir(moment: Moment) -> Array:
    return np.linalg.norm(moment.velocity, axis=1) + 0.1 * np.abs(moment.joint_speed).mean(axis=1)
