"""The model card of a learned decoder: measure, draw, write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from decoder.evaluation import HELD_OUT_SEED, Evaluation, Watch, evaluate, unwatched
from decoder.genome import GenomeDecoder
from decoder.latent import sample_latents
from decoder.population import Population, population_of
from decoder.reconstruction import Codec, Reconstruction, reconstruction_figures, reconstructions
from decoder.sketch import load_design
from experiments.decoder_cost import measure_cost
from experiments.decoder_pictures import write_sheets
from experiments.decoder_text import Card, card_text
from mfg.pipeline import score

if TYPE_CHECKING:
    from decoder.design import VoxelDesign
    from decoder.weights import Weights

ROOT = Path(__file__).resolve().parent.parent
CARD = ROOT / "decoder" / "MODEL_CARD.md"
PICTURES = ROOT / "docs" / "decoder"
EXAMPLES = ROOT / "experiments" / "examples"
N, PRIOR_N, PAIRS = 500, 1000, 24
GENOME_N, GENOME_SEED = 100, 0


def held_out_bodies(n: int = N, seed: int = HELD_OUT_SEED) -> list[VoxelDesign]:
    """Bodies of the training distribution from a seed that no training uses."""
    from decoder.synthetic import sample_designs

    return sample_designs(n, seed)


def measure(
    codec: Codec, held_out: Sequence[VoxelDesign], name: str | None = "vae", *,
    prior_n: int = PRIOR_N, pairs: int = PAIRS, seed: int = HELD_OUT_SEED, watch: Watch = unwatched,
) -> Evaluation:  # fmt: skip
    """Every figure of the card's goals.

    Args:
        codec: what is measured.
        held_out: see `held_out_bodies`.
        name: what `make_decoder` knows the codec by; None leaves out what it costs, which no weights are chosen by.
        prior_n: samples of the prior.
        pairs: of latents to interpolate between.
        seed: of all draws but the held-out bodies.
        watch: shows progress.
    """
    found = evaluate(codec, held_out, prior_n=prior_n, pairs=pairs, seed=seed, passes=can_be_built, watch=watch)
    return found if name is None else replace(found, cost=measure_cost(codec, name))


def can_be_built(design: VoxelDesign) -> bool:
    """Whether the paper's rules find a place for all that has to go into the design, by their fast verdict.

    Not the default rules: weights are compared by this figure with those that shipped before.
    """
    return score(design, rules="paper").ok


def write_card(
    codec: Codec, weights: Weights, out: Path = CARD, pictures: Path = PICTURES, *,
    name: str = "vae", evaluation: Evaluation | None = None, held_out: Sequence[VoxelDesign] | None = None,
    n: int = N, prior_n: int = PRIOR_N, pairs: int = PAIRS, seed: int = HELD_OUT_SEED, curve: bytes | None = None,
    watch: Watch = unwatched,
) -> Evaluation:  # fmt: skip
    """Measure what is not given, draw the pictures, write the card.

    Args:
        codec: what the card is about.
        weights: what it was made from.
        out: the Markdown file; replaced as a whole, last.
        pictures: folder of the pictures; those of an earlier card are overwritten.
        name: what `make_decoder` knows the codec by.
        evaluation: from `measure` on the same held-out bodies, if it is at hand.
        held_out: bodies that no training has seen; None draws n.
        n: held-out bodies to draw.
        prior_n: samples of the prior.
        pairs: of latents to interpolate between.
        seed: of every draw.
        curve: picture of the figures over the training (PNG), if there is one.
        watch: shows progress.

    Returns:
        The figures that the card shows.
    """
    held_out = held_out_bodies(n, seed) if held_out is None else held_out
    if evaluation is None:
        evaluation = measure(codec, held_out, None, prior_n=prior_n, pairs=pairs, seed=seed, watch=watch)
    if evaluation.cost is None:
        evaluation = replace(evaluation, cost=measure_cost(codec, name))
    sheets = list(write_sheets(codec, held_out, pictures, seed, watch))
    if curve is not None:
        sheets.append(pictures / "curve.png")
        sheets[-1].write_bytes(curve)
    card = Card(
        evaluation=evaluation,
        held_out=population_of(held_out),
        foreign=dict(foreign_bodies(codec, watch)),
        sha256=weights.sha256,
        numbers=sum(array.size for array in weights.arrays.values()),
        about=weights.about,
        pictures=tuple(sheets),
        folder=out.parent,
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    draft = out.with_name(f".{out.name}.part")
    draft.write_text(card_text(card), "utf-8")
    draft.replace(out)
    return evaluation


def foreign_bodies(codec: Codec, watch: Watch = unwatched) -> Iterator[tuple[str, tuple[Population, Reconstruction]]]:
    """Reconstruction of bodies that were not drawn from the training distribution."""
    genome = GenomeDecoder().decode(sample_latents(GENOME_N, np.random.default_rng(GENOME_SEED)))
    sketches = {f"sketch `{path.name}`": [load_design(path)] for path in sorted(EXAMPLES.glob("*.vox"))}
    for label, bodies in {f"bodies of the `genome` decoder, seed {GENOME_SEED}": genome, **sketches}.items():
        copies = watch(reconstructions(codec, bodies), len(bodies), "reconstructing foreign bodies")
        yield label, (population_of(bodies), reconstruction_figures(copies, GENOME_SEED))
