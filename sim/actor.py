"""What drives the joints: open-loop gaits and learned policies (numpy and the standard library only)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.observation import COMMAND_SIZE, ActionMap, ObservationLayout

Array = NDArray[np.float64]


def smooth_step(x: ArrayLike) -> Array:
    """Go from 0 to 1 with no speed and no acceleration at either end, 10 x^3 - 15 x^4 + 6 x^5, of any shape.

    By this law a policy takes over from the pose before it, in simulation and on the motors.
    """
    x = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
    return np.asarray(x * x * x * (10.0 + x * (6.0 * x - 15.0)))


class Actor(Protocol):
    """Anything that turns time and an observation into joint targets."""

    @property
    def num_joints(self) -> int:
        """How many joints it drives."""
        ...

    @property
    def layout(self) -> ObservationLayout:
        """What it sees."""
        ...

    def act(self, time: float, observation: Array) -> Array:
        """Give the joint targets (n,) [rad] at `time` [s] since the policy took over."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class Gait:
    """An open-loop central pattern generator, q*_j(t) = offset_j + amplitude_j sin(2 pi f t + phase_j).

    Raises:
        ValueError: A parameter is not finite, is not (n,), or the frequency is negative.
    """

    frequency: float  # f, shared by all joints [Hz]
    amplitude: Array  # (n,) [rad]
    phase: Array  # (n,) [rad]
    offset: Array  # (n,) [rad]

    def __post_init__(self) -> None:
        frequency = float(self.frequency)
        if not (math.isfinite(frequency) and frequency >= 0.0):
            raise ValueError(f"Gait frequency must be finite and >= 0 Hz, got {frequency}.")
        object.__setattr__(self, "frequency", frequency)
        shape = np.shape(self.amplitude)
        for name in ("amplitude", "phase", "offset"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.ndim != 1 or value.size == 0 or value.shape != shape:
                raise ValueError(f"Gait {name} must be (n,) with one number per joint, got {value.shape} for {shape}.")
            if not np.isfinite(value).all():
                raise ValueError(f"Gait {name} must be finite, got {value.tolist()}.")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def num_joints(self) -> int:
        """How many joints it drives."""
        return int(self.amplitude.size)

    @property
    def layout(self) -> ObservationLayout:
        """What it could see; it looks at nothing."""
        return ObservationLayout(self.num_joints)

    def targets(self, time: ArrayLike) -> Array:
        """Evaluate the law at time(s) of any shape (...) [s]; returns (..., n) [rad]."""
        angle = 2.0 * np.pi * self.frequency * np.asarray(time, dtype=np.float64)[..., None]
        return np.asarray(self.offset + self.amplitude * np.sin(angle + self.phase))

    def act(self, time: float, observation: Array) -> Array:  # noqa: ARG002 - open loop: no feedback.
        """Give the joint targets (n,) [rad] at `time` [s]; the observation is not used."""
        return self.targets(time)

    def arranged(self, order: Sequence[int]) -> Gait:
        """The same gait for joints in another order: its joint k is joint `order[k]` of this one."""
        places = _permutation(order, self.num_joints)
        return Gait(self.frequency, self.amplitude[places], self.phase[places], self.offset[places])


@dataclass(frozen=True, eq=False, slots=True)
class Perceptron:
    """A learned policy, said = W_k f(... f(W_1 (o - c) g + b_1) ...) + b_k with f = tanh, then `actions`.

    With a rhythm the policy corrects an open-loop gait: the gait's targets stand for the centre of its actions.

    Attributes:
        layers: weight (inputs, outputs) and bias (outputs,) of each layer, the last one linear.
        input_centre: c, (layout.size,).
        input_gain: g, (layout.size,).
        actions: from what the last layer says to joint targets.
        history: frames that it sees.
        command: velocity command it was told to follow, (3,) or empty where it takes none.
        rhythm: gait that it corrects; None where the policy alone makes the movement.

    Raises:
        ValueError: Sizes disagree with each other or with the observation, or a number is not finite.
    """

    layers: tuple[tuple[Array, Array], ...]
    input_centre: Array
    input_gain: Array
    actions: ActionMap
    history: int = 1
    command: tuple[float, ...] = ()
    rhythm: Gait | None = None

    def __post_init__(self) -> None:
        size = self.layout.size
        if not self.layers:
            raise ValueError("A perceptron needs at least one layer.")
        for name in ("input_centre", "input_gain"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (size,) or not np.isfinite(value).all():
                raise ValueError(f"Perceptron {name} must be {size} finite numbers, got shape {value.shape}.")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if len(self.command) not in (0, COMMAND_SIZE) or not all(math.isfinite(v) for v in self.command):
            raise ValueError(f"A perceptron's command is none or {COMMAND_SIZE} finite numbers, got {self.command}.")
        if self.rhythm is not None and self.rhythm.num_joints != self.num_joints:
            raise ValueError(f"The rhythm drives {self.rhythm.num_joints} joints, the policy {self.num_joints}.")
        layers = []
        for index, (weight, bias) in enumerate(self.layers):
            W, b = np.array(weight, dtype=np.float64), np.array(bias, dtype=np.float64)
            if W.ndim != 2 or b.ndim != 1 or W.shape != (size, b.size):
                raise ValueError(f"Layer {index}: weight must be ({size}, outputs) and bias (outputs,), "
                                 f"got {W.shape} and {b.shape}.")  # fmt: skip
            if not (np.isfinite(W).all() and np.isfinite(b).all()):
                raise ValueError(f"Layer {index}: every number must be finite.")
            W.setflags(write=False)
            b.setflags(write=False)
            layers.append((W, b))
            size = b.size
        if size != self.num_joints:
            raise ValueError(f"The last layer has {size} outputs, the robot has {self.num_joints} joints.")
        object.__setattr__(self, "layers", tuple(layers))

    @property
    def num_joints(self) -> int:
        """How many joints it drives."""
        return self.actions.num_joints

    @property
    def layout(self) -> ObservationLayout:
        """What it sees."""
        return ObservationLayout(self.num_joints, self.history, bool(self.command))

    def say(self, observation: ArrayLike) -> Array:
        """What the last layer says, (..., n), on observations (..., size); not finite where the numbers overflow.

        It is the same to the bit however many observations are given together.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # who commands a motor looks for it in any case
            x = (np.asarray(observation, dtype=np.float64) - self.input_centre) * self.input_gain
            # Row by row: one product of all rows would round by how many they are, and feet do not forgive a bit.
            x = x[..., None, :]
            for W, b in self.layers[:-1]:
                x = np.tanh(x @ W + b)
            W, b = self.layers[-1]
            return np.asarray(x @ W + b)[..., 0, :]

    def silenced(self) -> Perceptron:
        """One that says 0 whatever it sees: about a rhythm, that gait as it is."""
        *rest, (W, b) = self.layers
        return replace(self, layers=(*rest, (np.zeros_like(W), np.zeros_like(b))))

    def act(self, time: float, observation: Array) -> Array:
        """Give the joint targets (..., n) [rad]; they start from the previous ones, which are in the observation."""
        centre = None if self.rhythm is None else self.rhythm.targets(time)
        return self.actions.targets(self.say(observation), observation[..., self.layout.action], centre)

    def arranged(self, order: Sequence[int]) -> Perceptron:
        """The same policy for joints in another order: its joint k is joint `order[k]` of this one."""
        joints, layout = _permutation(order, self.num_joints), self.layout
        frame = np.arange(layout.frame_size)
        for place in (layout.position, layout.velocity, layout.action):
            frame[place] = frame[place][joints]
        seen = np.concatenate([k * layout.frame_size + frame for k in range(layout.history)])
        (W, b), *rest = self.layers
        layers = [(W[seen], b), *rest]
        W, b = layers[-1]
        layers[-1] = (W[:, joints], b[joints])
        return replace(
            self, layers=tuple(layers), input_centre=self.input_centre[seen], input_gain=self.input_gain[seen],
            actions=self.actions.arranged(joints),
            rhythm=None if self.rhythm is None else self.rhythm.arranged(order),
        )  # fmt: skip


Policy: TypeAlias = Gait | Perceptron  # what a policy bundle can hold


def _permutation(order: Sequence[int], count: int) -> NDArray[np.intp]:
    if sorted(order) != list(range(count)):
        raise ValueError(f"An order of {count} joints has each of 0 to {count - 1} once, got {list(order)}.")
    return np.array(order, dtype=np.intp)


def low_pass(previous: Array, target: Array, dt: float, time_constant: float) -> Array:
    """Filter an action to first order, y + (1 - exp(-dt / tau)) (x - y); tau = 0 passes it through."""
    if time_constant <= 0.0:
        return target
    return np.asarray(previous + (1.0 - math.exp(-dt / time_constant)) * (target - previous))
