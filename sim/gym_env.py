"""The environment under Gymnasium's interface, registered as `bodyplan/Walk-v0`: the only importer of that library."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from sim.environment import TEN_SECONDS, Environment, Episode
from sim.herd import with_latency_room
from sim.mixture import Mixture
from sim.model import Model, load_spec
from sim.randomisation import Randomisation
from sim.tasks import FAST, Task

ID = "bodyplan/Walk-v0"


def spaces_of(environment: Environment | Mixture, more: int = 0) -> tuple[Any, Any]:
    """Gymnasium's spaces of one copy's observation, with so many more numbers behind it, and of its action."""
    size, n = environment.layout.size + more, environment.map.num_joints
    observation = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
    return observation, gymnasium.spaces.Box(-1.0, 1.0, (n,), np.float32)


class WalkEnv(gymnasium.Env):  # type: ignore[misc]  # the library's types are skipped
    """One copy of a robot; observations, actions and rewards are those of `sim.environment.Environment`."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        robot: Path | str | Model,
        task: Task | None = None,
        randomisation: Randomisation | None = None,
        episode: Episode | None = None,
    ) -> None:
        """Take a robot: its MJCF file (`robot.xml` of a blueprint) or a compiled model."""
        model = with_latency_room(load_spec(robot)) if isinstance(robot, str | Path) else robot
        self.environment = Environment(model, 1, task or FAST, None, randomisation, episode or TEN_SECONDS)
        self.observation_space, self.action_space = spaces_of(self.environment)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed, options=options)
        return self.environment.reset(self.np_random)[0].astype(np.float32), {}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Let one control period pass; an observation after the end is that of the end."""
        step = self.environment.step(np.asarray(action, dtype=np.float64)[None])
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        observation = step.last[0] if terminated or truncated else step.observation[0]
        info = {"reward": dict(step.parts), "lost": self.environment.lost}
        return observation.astype(np.float32), float(step.reward[0]), terminated, truncated, info


def register() -> None:
    """Make `gymnasium.make("bodyplan/Walk-v0", robot=...)` work; registering twice does nothing."""
    if ID not in gymnasium.registry:
        gymnasium.register(id=ID, entry_point="sim.gym_env:WalkEnv")


register()
