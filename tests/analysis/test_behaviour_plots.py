"""The figures of a behaviour are pictures for any number of joints and links, and the same for the same numbers."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from analysis import behaviour_plots as plots


def picture(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def names(count: int) -> list[str]:
    return [f"joint_{k}" for k in range(1, count + 1)]


def motors(n: int, k: int = 60) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(0)
    one = np.ones(n)
    return (
        rng.uniform(-9, 9, (k, n)), rng.uniform(-9, 9, (k, n)), 20 * one, 40 * one, 24 * one, 6 * one,
        np.linspace(3, 9, n),
    )  # fmt: skip


@pytest.mark.parametrize("n", [1, 2, 5, 14])
def test_there_is_a_figure_for_any_number_of_joints(n: int) -> None:
    angle = np.sin(np.arange(60))[:, None] * np.ones(n)
    bounds = np.tile([-1.2, 1.2], (n, 1))
    touching = np.random.default_rng(0).random((60, n + 1)) < 0.4
    for make in (
        lambda: plots.torque_speed(names(n), *motors(n)),
        lambda: plots.joint_traces(names(n), angle, bounds, 0.02, 5.0),
        lambda: plots.gait_diagram(["root", *names(n)], touching, 0.02, 5.0),
    ):
        found = picture(make())
        assert found.shape[1] > 300
        assert len(np.unique(found.reshape(-1, 3), axis=0)) > 10
        assert make() == make()


def test_more_contact_is_more_ink() -> None:
    def blue(share: float) -> int:
        touching = np.zeros((100, 2), bool)
        touching[: round(100 * share), 1] = True
        found = picture(plots.gait_diagram(["root", "leg"], touching, 0.02)).astype(int)
        return int((np.abs(found - [0x1F, 0x6F, 0x8B]).sum(axis=-1) < 30).sum())

    assert blue(0.0) == 0
    assert blue(0.8) == pytest.approx(2 * blue(0.4), rel=0.05)


def test_only_a_motor_beyond_its_rating_is_red() -> None:
    def red(rms: float) -> bool:
        torque, speed, *limits, _ = motors(1)
        found = picture(plots.torque_speed(["a"], torque, speed, *limits, np.array([rms]))).astype(int)
        return bool((np.abs(found - [0xD1, 0x49, 0x5B]).sum(axis=-1) < 30).any())

    assert not red(5.9)
    assert red(6.1)


@pytest.mark.parametrize("reach", [0.0, 1e-6, 3.0])
def test_a_path_of_any_length_is_drawn(reach: float) -> None:
    way = np.column_stack([np.linspace(0, reach, 200), 0.1 * reach * np.sin(np.arange(200))])
    for heading in (None, 1.0):
        found = picture(plots.path_from_above(way, heading, 0.02))
        assert found.shape[0] < found.shape[1]
