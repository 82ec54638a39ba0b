"""Proximal policy optimisation by Stable-Baselines3 on the batched environment: the door to that library."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from sim.environment import Environment
from sim.gym_env import spaces_of
from sim.mixture import Mixture
from sim.observation import normaliser
from sim.plan import Ppo

Array = NDArray[np.float64]

# Weight of the critic's loss. The gradients of policy and critic are cut to one length together: at the usual 0.5 the
# critic's, greatest where robots fall, left little of the policy's just there. Adam hardly minds its scale.
CRITIC = 0.01
LOG_ROOT = 0.5 * math.log(2.0 * math.pi)  # of a normal density


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
    """The library's, but that the critic may see more than the policy; the same numbers in fewer operations.

    There is no entropy to reward, and the spread is a schedule's: its own gradient could come out rounded otherwise.
    """

    def __init__(self, *args: Any, seen: int, units: int, **kwargs: Any) -> None:
        """`seen`: how many numbers of an observation the policy sees, the first ones; `units` of each hidden layer."""
        self._seen, self._units = seen, units
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = Networks(self._seen, self.features_dim, self._units)

    def forward(
        self,
        obs: torch.Tensor,
        deterministic: bool = False,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """What the policy says, what the critic expects, and the logarithm of the former's density."""
        mean, value = self._mean_and_value(obs)
        noise = 0.0 if deterministic else torch.randn(mean.shape) * self.log_std.exp()
        said = mean + noise
        return said, value, self._log_density(said, mean)

    def evaluate_actions(self, obs: torch.Tensor, actions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, None]:
        """What the critic expects, the logarithm of the density of what was said, and no entropy."""
        mean, value = self._mean_and_value(obs)
        return value, self._log_density(actions, mean), None

    def _mean_and_value(self, obs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        latent, known = self.mlp_extractor(self.features_extractor(obs))
        return self.action_net(latent), self.value_net(known)

    def _log_density(self, said: torch.Tensor, mean: torch.Tensor) -> torch.Tensor:
        std = self.log_std.exp()
        return (-((said - mean) ** 2) / (2.0 * std**2) - std.log() - LOG_ROOT).sum(dim=1)


class LeanPPO(PPO):  # type: ignore[misc]
    """The library's with normalised advantages and one limit to the ratio, and nothing else that an update may have.

    Weights come out the same; the statistics that the library works out beside them nothing reads.
    """

    def train(self) -> None:
        """Go over the experience of a horizon."""
        policy, clip = self.policy, self.clip_range(1.0)
        policy.set_training_mode(True)
        self._update_learning_rate(policy.optimizer)
        weights = [weight for weight in policy.parameters() if weight.requires_grad]
        for _ in range(self.n_epochs):
            (shuffled,) = self.rollout_buffer.get(None)
            for batch in zip(*(part.split(self.batch_size) for part in shuffled), strict=True):
                seen, said, _, old, advantage, expected = batch
                value, log_density, _ = policy.evaluate_actions(seen, said)
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                ratio = torch.exp(log_density - old)
                gain = torch.min(advantage * ratio, advantage * ratio.clamp(1.0 - clip, 1.0 + clip)).mean()
                loss = self.vf_coef * torch.nn.functional.mse_loss(expected, value.flatten()) - gain
                policy.optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(weights, self.max_grad_norm)
                policy.optimizer.step()

    def _update_info_buffer(self, infos: Any, dones: Any = None) -> None:
        """Keep no statistics of episodes: `Vector` does."""


def ppo_on(vector: VecEnv, environment: Environment | Mixture, settings: Ppo, seed: int) -> LeanPPO:
    """PPO on any vector of environments like this one."""
    centre, gain = normaliser(environment.layout, environment.map)
    ppo = LeanPPO(
        ActorCritic, vector, learning_rate=settings.learning_rate, n_steps=settings.horizon,
        batch_size=min(settings.minibatch, settings.update), n_epochs=settings.epochs, gamma=settings.gamma,
        gae_lambda=settings.trace, clip_range=settings.clip, vf_coef=CRITIC, max_grad_norm=1.0,
        policy_kwargs={
            "seen": environment.layout.size, "units": settings.units, "log_std_init": float(np.log(settings.spread)),
            "features_extractor_class": Normalise,
            "features_extractor_kwargs": {"centre": centre.tolist(), "gain": gain.tolist()},
            "optimizer_kwargs": {"eps": 1e-5, "fused": True},  # eps as the library has it
        },
        device="cpu", seed=seed,
    )  # fmt: skip
    ppo.set_logger(Logger(None, []))  # its own would leave a folder behind at every call
    return ppo


def _seen(observation: Array, hidden: Array) -> NDArray[np.float32]:
    """What the library sees: what the policy sees, then what only the critic does."""
    return np.concatenate([observation, hidden], axis=1, dtype=np.float32)
