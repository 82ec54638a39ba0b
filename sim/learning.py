"""Proximal policy optimisation by Stable-Baselines3 on the batched environment: the only importer of that library."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from sim.actor import Perceptron
from sim.environment import Environment
from sim.gym_env import spaces_of
from sim.mixture import Mixture
from sim.observation import normaliser

Array = NDArray[np.float64]


class Unlearnable(RuntimeError):
    """A training came to nothing; the message says why."""


@dataclass(frozen=True, slots=True)
class Ppo:
    """Settings of the learner.

    Attributes:
        copies: robots that gather experience together.
        horizon: control periods between two updates.
        epochs: passes over the experience of one update.
        minibatch: samples of one gradient step.
        learning_rate: of Adam.
        gamma: discount of one control period.
        trace: lambda of the generalised advantage.
        clip: of the probability ratio.
        spread: first standard deviation of what the policy says.
        units: width of both hidden layers.
    """

    copies: int = 64
    horizon: int = 32
    epochs: int = 4
    minibatch: int = 512
    learning_rate: float = 1e-3
    gamma: float = 0.99
    trace: float = 0.95
    clip: float = 0.2
    spread: float = 0.6
    units: int = 64

    @property
    def update(self) -> int:
        """Samples of one update."""
        return self.copies * self.horizon


USUAL = Ppo()
# Weight of the critic's loss. The gradients of policy and critic are cut to one length together: at the usual 0.5 the
# critic's, greatest where robots fall, left little of the policy's just there. Adam hardly minds its scale.
CRITIC = 0.01


class Vector(VecEnv):  # type: ignore[misc]  # the library ships no types
    """The environment as Stable-Baselines3 wants it; after what the policy sees comes what only the critic sees."""

    def __init__(self, environment: Environment | Mixture, rng: np.random.Generator) -> None:
        """Wrap an environment; `rng` is that of its next reset."""
        self.environment, self.rng = environment, rng
        self.begin(rng)
        observation, action = spaces_of(environment, environment.hidden_size)
        super().__init__(environment.count, observation, action)
        self._nothing: list[dict[str, Any]] = [{} for _ in range(environment.count)]

    def begin(self, rng: np.random.Generator) -> None:
        """Forget the curves so far; `rng` is that of the next reset."""
        self.rng = rng
        self.parts: list[dict[str, float]] = []
        self.lengths: list[NDArray[np.int64]] = []
        self.returns: list[Array] = []

    def curves(self) -> dict[str, float]:
        """Means since `begin`: every part of the reward, and length and return of the episodes that ended."""
        found = {name: float(np.mean([part[name] for part in self.parts])) for name in (self.parts or [{}])[0]}
        lengths, returns = np.concatenate([[], *self.lengths]), np.concatenate([[], *self.returns])
        if len(lengths):
            found |= {"episode_periods": float(lengths.mean()), "episode_return": float(returns.mean())}
        return found

    def reset(self) -> NDArray[np.float32]:
        """Begin every copy anew."""
        return _seen(self.environment.reset(self.rng), self.environment.hidden())

    def step_async(self, actions: Array) -> None:
        """Keep the actions."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, Any]:
        """Act, and begin new episodes where one ended."""
        step = self.environment.step(self._actions)
        done = step.terminated | step.truncated
        infos: list[dict[str, Any]] = list(self._nothing)
        last = _seen(step.last, step.last_hidden)
        for place, index in enumerate(np.flatnonzero(done)):
            infos[index] = {
                "terminal_observation": last[place],
                "TimeLimit.truncated": bool(step.truncated[index]),
            }
        self.parts.append(dict(step.parts))
        self.lengths.append(step.lengths)
        self.returns.append(step.returns)
        return _seen(step.observation, self.environment.hidden()), step.reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The wrapped environment's attribute, once per copy."""
        return [getattr(self.environment, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ARG002 - the library's form
        """Attributes are set on the environment itself."""
        raise AttributeError(f"set {attr_name} on the environment, not through the vector")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:  # noqa: ARG002
        """Methods are called on the environment itself."""
        raise AttributeError(f"call {method_name} on the environment, not through the vector")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:  # noqa: ARG002
        """No copy is wrapped."""
        return [False] * len(list(self._get_indices(indices)))


class Normalise(BaseFeaturesExtractor):  # type: ignore[misc]
    """The fixed affine map of the observation that every policy begins with; what follows it passes unchanged."""

    def __init__(self, observation_space: Any, centre: Sequence[float], gain: Sequence[float]) -> None:
        """Keep the map as constants."""
        size = observation_space.shape[0]
        super().__init__(observation_space, size)
        more = size - len(centre)
        self.register_buffer("centre", torch.tensor([*centre, *[0.0] * more], dtype=torch.float32))
        self.register_buffer("gain", torch.tensor([*gain, *[1.0] * more], dtype=torch.float32))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """(observations - centre) gain."""
        return (observations - self.centre) * self.gain


class Networks(torch.nn.Module):  # type: ignore[misc]  # as are torch's
    """Two hidden layers for the policy, which sees the first `seen` of the features, and two for the critic."""

    def __init__(self, seen: int, size: int, units: int) -> None:
        """Make them as the library does."""
        super().__init__()

        def hidden(inputs: int) -> torch.nn.Sequential:
            layers = [torch.nn.Linear(inputs, units), torch.nn.Tanh(), torch.nn.Linear(units, units), torch.nn.Tanh()]
            return torch.nn.Sequential(*layers)

        self.seen = seen
        self.policy_net, self.value_net = hidden(seen), hidden(size)
        self.latent_dim_pi = self.latent_dim_vf = units

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Of both."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Of the policy."""
        latent: torch.Tensor = self.policy_net(features[..., : self.seen])
        return latent

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """Of the critic."""
        latent: torch.Tensor = self.value_net(features)
        return latent


class ActorCritic(ActorCriticPolicy):  # type: ignore[misc]
    """The library's, but that the critic may see more than the policy."""

    def __init__(self, *args: Any, seen: int, units: int, **kwargs: Any) -> None:
        """`seen`: how many numbers of an observation the policy sees, the first ones; `units` of each hidden layer."""
        self._seen, self._units = seen, units
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = Networks(self._seen, self.features_dim, self._units)


def ppo_on(vector: VecEnv, environment: Environment | Mixture, settings: Ppo, seed: int) -> PPO:
    """The library's PPO on any vector of environments like this one."""
    centre, gain = normaliser(environment.layout, environment.map)
    # Checking the arguments of every distribution costs as much as evaluating it; `Learner.learn` looks at the result.
    torch.distributions.Distribution.set_default_validate_args(False)
    return PPO(
        ActorCritic, vector, learning_rate=settings.learning_rate, n_steps=settings.horizon,
        batch_size=min(settings.minibatch, settings.update), n_epochs=settings.epochs, gamma=settings.gamma,
        gae_lambda=settings.trace, clip_range=settings.clip, ent_coef=0.0, vf_coef=CRITIC, max_grad_norm=1.0,
        policy_kwargs={
            "seen": environment.layout.size, "units": settings.units, "log_std_init": float(np.log(settings.spread)),
            "features_extractor_class": Normalise,
            "features_extractor_kwargs": {"centre": centre.tolist(), "gain": gain.tolist()},
            "optimizer_kwargs": {"eps": 1e-5, "fused": True},  # eps as the library has it
        },
        device="cpu", seed=seed,
    )  # fmt: skip


class Learner:
    """PPO on an environment; its state is plain arrays, and what it draws comes from the generators it is given."""

    def __init__(self, environment: Environment | Mixture, settings: Ppo, seed: int) -> None:
        """Make a fresh policy; the same seed makes the same one."""
        torch.set_num_threads(1)
        self.environment, self.settings = environment, settings
        self._vector = Vector(environment, np.random.default_rng(seed))
        self.ppo = ppo_on(self._vector, environment, settings, seed)
        self.ppo.set_logger(Logger(None, []))  # its own would leave a folder behind at every call
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
        set_random_seed(int(rng.integers(2**31)))
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


def _seen(observation: Array, hidden: Array) -> NDArray[np.float32]:
    """What the library sees: what the policy sees, then what only the critic does."""
    return np.concatenate([observation, hidden], axis=1, dtype=np.float32)


def _array(value: torch.Tensor) -> Array:
    # Half as many digits are needed, but double precision is what numpy reads and writes without thought.
    return value.detach().cpu().numpy().astype(np.float64)


def _tensor(name: str, value: Array, shape: tuple[int, ...]) -> torch.Tensor:
    if np.shape(value) != shape:
        raise ValueError(f"{name} has shape {np.shape(value)}, this learner's is {shape}")
    return torch.tensor(np.asarray(value), dtype=torch.float32)
