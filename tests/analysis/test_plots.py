from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from analysis import plots
from analysis.lda import failure_lda
from analysis.passthrough import OUTCOMES, pass_through
from analysis.words import REASONS, SCORE_COLUMNS, STAGES
from mfg.outcome import Reason, Stage


def ink(png: bytes) -> float:
    """Share of pixels that are not white."""
    image = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
    assert image.shape[0] > 100
    assert image.shape[1] > 300
    return float((image != 255).any(2).mean())


@pytest.mark.parametrize("outcomes", [list(OUTCOMES) * 3, ["passed"], ["skeleton"], []])
def test_pass_through_bars(outcomes):
    assert ink(plots.pass_through_bars(pass_through(outcomes))) > 0.02


def test_more_designs_that_pass_make_longer_bars():
    few = ink(plots.pass_through_bars(pass_through(["motor"] * 9 + ["passed"])))
    many = ink(plots.pass_through_bars(pass_through(["motor"] + ["passed"] * 9)))
    assert many != few


@pytest.mark.parametrize(
    ("passed", "failed", "winner"), [([3.0, 4.2], [0.0, 1.1], 4.2), ([], [], None), ([5.0], [], None)]
)
def test_histogram(passed, failed, winner):
    assert ink(plots.score_histogram(passed, failed, winner)) > 0.005


@pytest.mark.parametrize("classes", [2, 3, 5])
def test_map(classes):
    names = ["skeleton", "motor", "electronics", "wire", "print"][:classes]
    outcomes = [name for name in names for _ in range(12)]
    latents = np.random.default_rng(0).standard_normal((len(outcomes), 8))
    png = plots.lda_map(failure_lda(latents, outcomes, np.random.default_rng(0), 3))
    assert png is not None
    assert ink(png) > 0.005


def test_no_map_without_classes():
    assert plots.lda_map(failure_lda(np.zeros((2, 3)), ["motor"] * 2, np.random.default_rng(0))) is None


def test_fitness_curve_bears_gaps_and_says_nothing_about_nothing():
    generation = np.array([0, 0, 1, 1, 3])
    fitness = np.array([np.nan, np.nan, 0.2, np.nan, 0.1])
    png = plots.fitness_curve(generation, fitness, np.isfinite(fitness))
    assert png is not None
    assert ink(png) > 0.005
    assert plots.fitness_curve(generation, np.full(5, np.nan), np.zeros(5, bool)) is None


def test_a_score_that_was_not_reached_has_no_bar():
    assert ink(plots.score_bars({"a": 1.0, "b": None})) != ink(plots.score_bars({"a": 1.0, "b": 1.0}))


def test_figures_are_the_same_bytes_every_time():
    assert plots.score_histogram([3.0], [1.0]) == plots.score_histogram([3.0], [1.0])


def test_every_word_of_the_vocabulary_is_explained():
    assert set(REASONS) == set(Reason)
    assert set(STAGES) == set(Stage)
    assert set(plots.COLOURS) == set(OUTCOMES)
    assert len(SCORE_COLUMNS) == 5


@pytest.mark.parametrize("count", [0, 1, 3, 5])
@pytest.mark.parametrize("end", [1.0, 300.0, 1e5])
def test_a_training_curve_has_a_panel_per_figure(count, end):
    values = [[0.1, float("nan"), 0.9], [-1.0, 0.0, 1.0], [float("nan")] * 3, [1.0, 2.0, 3.0], [5.0] * 3][:count]
    figures = {f"loss_{k}" if k % 2 else f"figure_{k}": value for k, value in enumerate(values)}
    assert ink(plots.training_curve([0.0, end / 2, end], [0, 8, 16], figures)) > 0.002
