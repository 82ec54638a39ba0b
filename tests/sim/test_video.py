"""The pictures show a robot that moves, and the video plays as long as the rollout took."""

from __future__ import annotations

from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from mfg.description import Description
from sim.actor import Gait
from sim.model import Model, compile_model
from sim.rollout import Rollouts, roll_out
from sim.video import film, save_strip, save_video, strip

SIZE = (96, 64)


@pytest.fixture(scope="module")
def walk(quadruped: Description) -> tuple[Model, Rollouts]:
    model = compile_model(quadruped)
    return model, roll_out(model, [Gait(1.0, np.full(4, 0.5), np.arange(4) * 1.5, np.zeros(4))], 1.0)


def test_a_strip_shows_different_moments_and_is_reproducible(walk: tuple[Model, Rollouts], tmp_path: Path) -> None:
    picture = strip(*walk, count=3, size=SIZE)
    assert picture.shape == (SIZE[1], 3 * SIZE[0], 3)
    first, _, last = np.split(picture, 3, axis=1)
    assert (first != last).any(axis=2).mean() > 0.05
    assert picture.std() > 10  # not a blank sheet
    assert strip(*walk, count=3, size=SIZE).tobytes() == picture.tobytes()
    save_strip(tmp_path / "strip.png", *walk, count=2)
    with Image.open(tmp_path / "strip.png") as image:
        assert image.size == (640, 240)


def test_a_film_has_one_frame_per_tick(walk: tuple[Model, Rollouts]) -> None:
    frames = list(film(*walk, size=SIZE, rate=10))
    assert len(frames) == 11
    assert all(frame.shape == (SIZE[1], SIZE[0], 3) for frame in frames)


def test_a_video_plays_in_real_time(walk: tuple[Model, Rollouts], tmp_path: Path) -> None:
    path = tmp_path / "walk.mp4"
    save_video(path, *walk, size=SIZE, rate=10)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == 11
    assert seconds == pytest.approx(1.1, abs=0.11)


def test_a_video_that_cannot_be_written_is_an_error_before_any_drawing(
    walk: tuple[Model, Rollouts], tmp_path: Path
) -> None:
    with pytest.raises(FileNotFoundError):
        save_video(tmp_path / "nowhere" / "walk.mp4", *walk, size=SIZE)
    with pytest.raises(ValueError, match="multiples of 16"):
        save_video(tmp_path / "walk.mp4", *walk, size=(100, 64))
