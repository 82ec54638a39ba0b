"""What a learned decoder is worth: reconstruction of held-out bodies, samples of the prior, interpolation, cost.

Every function takes an iterable and looks at one body at a time, so that a thousand bodies need no more memory than
one, and the caller can show progress by wrapping the iterable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from decoder.design import VoxelDesign
from decoder.figures import Bound
from decoder.latent import sample_latents
from decoder.prior import Interpolation, Prior, arc, decoded, interpolation_figures, prior_figures
from decoder.reconstruction import BATCH, Codec, Reconstruction, reconstruction_figures, reconstructions

HELD_OUT_SEED = 2_000_000_011  # no training may draw its bodies from this seed
T = TypeVar("T")


class Watch(Protocol):
    """Passes items through while it shows how far it is."""

    def __call__(self, iterable: Iterable[T], total: int | None, label: str) -> Iterator[T]:
        """Give the same items in the same order."""
        ...


def unwatched(iterable: Iterable[T], total: int | None, label: str) -> Iterator[T]:  # noqa: ARG001 - as `Watch` asks.
    """Show nothing."""
    return iter(iterable)


@dataclass(frozen=True, slots=True)
class Cost:
    """What decoding takes on one machine.

    Attributes:
        machine: in words.
        single: seconds per body at batch 1, median.
        batched: seconds per body at batch 32, median.
        encoding: seconds per body to encode, median.
        repeats: bodies that were decoded each way.
        peak: peak memory of a fresh process that decodes a batch of 32 [MiB].
        same_bytes: whether 32 latents decode to the same bytes in batches of 1, 3 and 32.
    """

    machine: str
    single: float
    batched: float
    encoding: float
    repeats: int
    peak: float
    same_bytes: bool


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All figures of one set of weights."""

    reconstruction: Reconstruction
    prior: Prior
    interpolation: Interpolation
    cost: Cost | None = None

    def bounds(self) -> tuple[Bound, ...]:
        """The goals, in a fixed order, each with what was measured."""
        r, p, i = self.reconstruction, self.prior, self.interpolation
        found: tuple[Bound, ...] = (
            Bound("body IoU", 0.90, "at least", r.body_iou.value, r.n),
            Bound("bone IoU", 0.80, "at least", r.bone_iou.value, r.n),
            Bound("IoU per segment", 0.70, "at least", r.segment_iou.value, r.n),
            Bound("segment count exact", 85.0, "at least", 100 * r.segment_count.value, r.n, "%"),
            Bound("joints found within 2 voxels", 90.0, "at least", 100 * r.joint_recall.value, r.joint_recall.n, "%"),
            Bound("axis error, median", 10.0, "at most", r.axis_error.value, r.axis_error.n, "°"),
            Bound("one connected tree with at least 2 joints", 85.0, "at least", 100 * p.one_tree.value, p.n, "%"),
            Bound("distinct joint counts", 5, "at least", len(p.tree_joint_counts), p.n),
            Bound("distinct tree shapes", 30, "at least", len(p.tree_shapes), p.n),
            Bound("axis change per 1 % step, 95 % quantile", 10.0, "at most", i.axis.value, i.axis.n, "°"),
        )
        if p.passing.n:
            share = 100 * p.passing.value
            found = (*found, Bound("prior samples that can be built", 65.0, "at least", share, p.passing.n, "%"))
        if self.cost is None:
            return found
        c = self.cost
        return (
            *found,
            Bound("seconds per body, batch 1", 0.3, "at most", c.single, c.repeats, "s", weighed=False),
            Bound("seconds per body, batch 32", 0.08, "at most", c.batched, c.repeats, "s", weighed=False),
            Bound("peak memory", 2048.0, "at most", c.peak, 1, "MiB", weighed=False),
            Bound("same bytes at any batch size", 100.0, "at least", 100.0 * c.same_bytes, c.repeats, "%",
                  weighed=False),
        )  # fmt: skip


def evaluate(
    codec: Codec,
    held_out: Sequence[VoxelDesign],
    *,
    prior_n: int = 1000,
    pairs: int = 24,
    seed: int = HELD_OUT_SEED,
    passes: Callable[[VoxelDesign], bool] | None = None,
    watch: Watch = unwatched,
    batch: int = BATCH,
) -> Evaluation:
    """Measure everything but the cost. Two codecs given the same arguments are measured on the same bodies and draws.

    Args:
        codec: what is measured.
        held_out: bodies that no training has seen.
        prior_n: samples of the prior.
        pairs: of latents to interpolate between.
        seed: of latents, of the bootstrap, and of the held-out bodies if they were drawn from one.
        passes: whether a body can be built, which some of the prior's are asked.
        watch: shows progress.
        batch: bodies decoded at once; the figures do not depend on it.
    """
    rng = np.random.default_rng(seed)
    latents, ends = sample_latents(prior_n, rng), sample_latents(2 * pairs, rng)
    copies = watch(reconstructions(codec, held_out, batch), len(held_out), "reconstructing held-out bodies")
    reconstructed = reconstruction_figures(copies, seed)
    samples = watch(decoded(codec, latents, batch), prior_n, "decoding samples of the prior")
    sampled = prior_figures(samples, seed, passes)
    walks = (decoded(codec, arc(a, b), batch) for a, b in zip(ends[::2], ends[1::2], strict=True))
    return Evaluation(reconstructed, sampled, interpolation_figures(watch(walks, pairs, "interpolating"), seed))
