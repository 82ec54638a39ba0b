"""The learner of a training: a policy in the making, whose state is plain arrays."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from sim.actor import Perceptron
from sim.environment import Environment
from sim.mixture import Mixture
from sim.observation import normaliser
from sim.plan import Ppo
from sim.ppo import Vector, ppo_on

Array = NDArray[np.float64]


class Unlearnable(RuntimeError):
    """A training came to nothing; the message says why."""


class Learner:
    """PPO on an environment; its state is plain arrays, and what it draws comes from the generators it is given."""

    def __init__(self, environment: Environment | Mixture, settings: Ppo, seed: int) -> None:
        """Make a fresh policy; the same seed makes the same one."""
        torch.set_num_threads(1)
        self.environment, self.settings = environment, settings
        self._vector = Vector(environment, np.random.default_rng(seed))
        self.ppo = ppo_on(self._vector, environment, settings, seed)
        # How widely to explore is a schedule, not learned: learned, it grew on robots that move by jitter.
        self.ppo.policy.log_std.requires_grad_(False)

    def learn(
        self, steps: int, rng: np.random.Generator, learning_rate: float, spread: float
    ) -> tuple[dict[str, float], float]:
        """Gather and learn for at least `steps` control periods from a fresh reset; gives curves and CPU seconds.

        Raises:
            Unlearnable: if the policy's weights are no numbers any more.
        """
        ppo, vector = self.ppo, self._vector
        ppo.set_random_seed(int(rng.integers(2**31)))
        vector.begin(rng)
        ppo.lr_schedule = lambda _: learning_rate
        with torch.no_grad():
            ppo.policy.log_std.fill_(float(np.log(spread)))
        before = time.process_time()
        ppo.learn(steps, reset_num_timesteps=True)
        seconds = time.process_time() - before
        if not all(bool(torch.isfinite(value).all()) for value in ppo.policy.state_dict().values()):
            raise Unlearnable(
                f"learning diverged: the policy's weights are no numbers any more at a learning rate of "
                f"{learning_rate:g}; try a smaller one, or another seed"
            )
        return vector.curves() | {"spread": spread, "learning_rate": learning_rate}, seconds

    def exported(self, command: tuple[float, ...] = ()) -> Perceptron:
        """The actor as plain arrays; it says what the mean of the policy says."""
        policy, environment = self.ppo.policy, self.environment
        layers = [module for module in policy.mlp_extractor.policy_net if isinstance(module, torch.nn.Linear)]
        arrays = tuple((_array(layer.weight).T, _array(layer.bias)) for layer in [*layers, policy.action_net])
        centre, gain = normaliser(environment.layout, environment.map)
        if environment.layout.commanded and not command:
            command = (environment.task.commands[0], 0.0, 0.0)
        return Perceptron(
            arrays, centre, gain, environment.map, environment.layout.history, command, environment.rhythm
        )  # fmt: skip

    def state(self) -> dict[str, Array]:
        """Weights and the optimiser's moments by name."""
        found = {f"policy/{name}": _array(value) for name, value in self.ppo.policy.state_dict().items()}
        for place, entry in self.ppo.policy.optimizer.state_dict()["state"].items():
            found |= {f"adam/{place}/{name}": _array(value) for name, value in entry.items()}
        return found

    def restore(self, state: Mapping[str, Array]) -> None:
        """Take back what `state` gave.

        Raises:
            KeyError: an array is missing.
            ValueError: an array has another shape.
        """
        policy = self.ppo.policy
        weights = {}
        for name, value in policy.state_dict().items():
            weights[name] = _tensor(name, state[f"policy/{name}"], tuple(value.shape))
        policy.load_state_dict(weights)
        document = policy.optimizer.state_dict()
        parameters = [p for group in policy.optimizer.param_groups for p in group["params"]]
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for place, parameter in enumerate(parameters):
            if f"adam/{place}/step" not in state:
                continue  # a parameter that is not trained has no moments
            shapes = {"step": (), "exp_avg": tuple(parameter.shape), "exp_avg_sq": tuple(parameter.shape)}
            moments[place] = {
                name: _tensor(name, state[f"adam/{place}/{name}"], shape) for name, shape in shapes.items()
            }
        policy.optimizer.load_state_dict(document | {"state": moments})


def _array(value: torch.Tensor) -> Array:
    # Half as many digits are needed, but double precision is what numpy reads and writes without thought.
    return value.detach().cpu().numpy().astype(np.float64)


def _tensor(name: str, value: Array, shape: tuple[int, ...]) -> torch.Tensor:
    if np.shape(value) != shape:
        raise ValueError(f"{name} has shape {np.shape(value)}, this learner's is {shape}")
    return torch.tensor(np.asarray(value), dtype=torch.float32)
