"""The environment as Gymnasium and Stable-Baselines3 know environments."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO

from mfg.description import Description
from mfg.robot_files import mesh_files, mjcf
from sim.gym_env import ID, register


@pytest.fixture(scope="module")
def robot(quadruped: Description, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robot")
    (folder / "robot.xml").write_text(mjcf(quadruped), encoding="utf-8")
    for name, content in mesh_files(quadruped, ()).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    return folder / "robot.xml"


def test_the_registered_environment_passes_gymnasiums_check(robot: Path) -> None:
    register()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # observations have no bounds, and there is nothing to render
        check_env(gymnasium.make(ID, robot=robot).unwrapped, skip_render_check=True)


def test_a_seed_fixes_the_episode(robot: Path) -> None:
    def episode(seed: int) -> np.ndarray:
        env: Any = gymnasium.make(ID, robot=robot)
        seen = [env.reset(seed=seed)[0]]
        seen += [env.step(np.full(4, 0.2, np.float32))[0] for _ in range(20)]
        return np.array(seen)

    np.testing.assert_array_equal(episode(1), episode(1))
    assert not np.array_equal(episode(1), episode(2))


def test_stable_baselines_learns_on_it_as_it_is(robot: Path) -> None:
    learner = PPO("MlpPolicy", gymnasium.make(ID, robot=robot), n_steps=64, batch_size=32, n_epochs=1, device="cpu")
    learner.learn(64)
    action, _ = learner.predict(np.zeros(18, np.float32))
    assert action.shape == (4,)


def test_an_action_that_is_no_number_ends_the_episode(robot: Path) -> None:
    env: Any = gymnasium.make(ID, robot=robot).unwrapped
    env.reset(seed=0)
    observation, reward, terminated, _, _ = env.step(np.array([0.1, np.nan, 0.0, 0.0], np.float32))
    assert terminated
    assert np.isfinite(observation).all()
    assert np.isfinite(reward)
