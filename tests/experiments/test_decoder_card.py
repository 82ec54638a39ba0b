"""The model card: every goal with its n, pictures that exist, missed goals named, the old card kept on failure."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.design import VoxelDesign
from decoder.evaluation import Cost, Evaluation
from decoder.genome import GenomeDecoder
from decoder.latent import LATENT_DIM, sample_latents
from decoder.sketch import load_design
from decoder.weights import Weights
from experiments import decoder_card, decoder_pictures
from experiments.decoder_card import can_be_built, measure, write_card
from experiments.decoder_cost import measure_cost, peak_of_fresh_process, same_bytes

GENOME = GenomeDecoder()


class Forgetful:
    """Knows the latents of some bodies; others become the body of the latent 0."""

    def __init__(self, known: dict[str, NDArray[np.float32]]) -> None:
        self.known = known

    def decode(self, latents: NDArray[np.floating]) -> list[VoxelDesign]:
        return GENOME.decode(latents)

    def encode(self, designs: Sequence[VoxelDesign]) -> NDArray[np.float32]:
        return np.stack([self.known.get(d.key, np.zeros(LATENT_DIM, np.float32)) for d in designs])


@pytest.fixture(scope="module")
def held_out() -> list[VoxelDesign]:
    return GENOME.decode(sample_latents(5, np.random.default_rng(1)))


@pytest.fixture(scope="module")
def codec(held_out: list[VoxelDesign]) -> Forgetful:
    latents = sample_latents(5, np.random.default_rng(1))
    return Forgetful({d.key: z for d, z in zip(held_out, latents, strict=True)})


@pytest.fixture(scope="module")
def weights() -> Weights:
    return Weights({"w": np.zeros((30, 40), np.float32)}, "ab" * 32, {"steps": "12", "machine": "two cores"})


@pytest.fixture(scope="module")
def written(
    codec: Forgetful, held_out: list[VoxelDesign], weights: Weights, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Evaluation]:
    folder = tmp_path_factory.mktemp("card")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"PAIRS": 3, "PAIR_COLUMNS": 2, "SAMPLES": 2, "WALKS": 1, "FRAMES": 2}.items():
            patch.setattr(decoder_pictures, name, value)
        for name in ("PAIR_SIZE", "SAMPLE_SIZE", "FRAME_SIZE"):
            patch.setattr(decoder_pictures, name, (48, 36))
        patch.setattr(decoder_card, "GENOME_N", 2)
        found = write_card(
            codec, weights, folder / "decoder" / "CARD.md", folder / "docs" / "pictures", name="genome",
            held_out=held_out, prior_n=4, pairs=1, curve=b"\x89PNG curve",
        )  # fmt: skip
    return folder, found


def test_the_card_has_every_goal_with_its_n(written: tuple[Path, Evaluation]) -> None:
    folder, evaluation = written
    text = (folder / "decoder" / "CARD.md").read_text("utf-8")
    bounds = evaluation.bounds()
    assert len(bounds) == 15
    for bound in bounds:
        (row,) = re.findall(rf"^\| {re.escape(bound.name)} \| at (?:least|most) .*$", text, re.MULTILINE)
        assert row.endswith(f"| {bound.n} | {'yes' if bound.reached else '**no**'} |")
        assert (f"- Missed goal: {bound.name}, " in text) is not bound.reached
    assert f"{sum(b.reached for b in bounds)} of 15 goals are reached." in text


def test_the_card_names_seed_digest_training_and_other_bodies(written: tuple[Path, Evaluation]) -> None:
    text = (written[0] / "decoder" / "CARD.md").read_text("utf-8")
    for expected in ("ab" * 32, "1,200 numbers", f"seed {written[1].prior.seed}", "| machine | two cores |",
                     "| steps | 12 |", "sketch `quadruped.vox` | 1 |", "`genome` decoder, seed 0 | 2 |"):  # fmt: skip
        assert expected in text
    assert "nan" not in text


def test_every_table_of_the_card_is_rectangular(written: tuple[Path, Evaluation]) -> None:
    text = (written[0] / "decoder" / "CARD.md").read_text("utf-8")
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(tables) >= 8
    for table in tables:
        assert len({line.count("|") for line in table}) == 1


def test_the_pictures_of_the_card_exist(written: tuple[Path, Evaluation]) -> None:
    card = written[0] / "decoder" / "CARD.md"
    named = re.findall(r"!\[[a-z]+\]\(([^)]+)\)", card.read_text("utf-8"))
    assert [Path(name).stem for name in named] == ["reconstructions", "samples", "interpolations", "curve"]
    for name in named:
        assert (card.parent / name).read_bytes()[:4] == b"\x89PNG"
    assert sorted(p.name for p in card.parent.iterdir()) == ["CARD.md"]


def test_a_failure_leaves_the_old_card(
    codec: Forgetful, held_out: list[VoxelDesign], weights: Weights, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "CARD.md").write_text("old")
    monkeypatch.setattr(decoder_card, "write_sheets", lambda *_: 1 / 0)
    evaluation = measure(codec, held_out[:1], None, prior_n=1, pairs=1)
    evaluation = Evaluation(evaluation.reconstruction, evaluation.prior, evaluation.interpolation,
                            Cost("here", 1.0, 1.0, 1.0, 1, 1.0, False))  # fmt: skip
    with pytest.raises(ZeroDivisionError):
        write_card(codec, weights, tmp_path / "CARD.md", tmp_path, evaluation=evaluation, held_out=held_out)
    assert (tmp_path / "CARD.md").read_text() == "old"


def test_a_decoder_whose_bytes_follow_the_batch_is_found_out(codec: Forgetful) -> None:
    class Sloppy(Forgetful):
        def decode(self, latents: NDArray[np.floating]) -> list[VoxelDesign]:
            return GENOME.decode(latents + 0.01 * (len(latents) > 3))

    assert same_bytes(codec, 4)
    assert not same_bytes(Sloppy({}), 4)


def test_cost_is_measured(codec: Forgetful) -> None:
    cost = measure_cost(codec, "genome", size=3)
    assert 0 < cost.single < 30
    assert 0 < cost.batched < 30
    assert cost.encoding >= 0
    assert (cost.repeats, cost.same_bytes) == (3, True)
    assert 20 < cost.peak < 2048


def test_a_fresh_process_is_lighter_than_this_one(codec: Forgetful) -> None:
    ballast = np.ones(60_000_000)  # half a gigabyte that a child must not be charged for
    assert peak_of_fresh_process("genome", 1) < ballast.nbytes / 2**20


def test_what_can_be_built_is_what_all_solvers_accept() -> None:
    buildable = load_design(decoder_card.EXAMPLES / "quadruped.vox")
    assert can_be_built(buildable)
    assert not can_be_built(VoxelDesign(buildable.material, buildable.segment))
