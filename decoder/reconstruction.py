"""How well bodies survive being encoded and decoded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from decoder.comparison import Comparison, compare
from decoder.design import VoxelDesign
from decoder.figures import Figure, mean_of, quantile_of, ratio_of, share_of

BATCH = 32


class Codec(Protocol):
    """A decoder that can also encode."""

    def decode(self, latents: NDArray[np.floating]) -> list[VoxelDesign]:
        """Decode latents (n, 512) into n designs."""
        ...

    def encode(self, designs: Sequence[VoxelDesign]) -> NDArray[np.float32]:
        """Latents (n, 512) of n designs."""
        ...


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """Encode, decode, compare, over n bodies; see `decoder.comparison.Comparison` for what is compared.

    Attributes:
        n: bodies.
        seed: of the bootstrap, and of the bodies where they were drawn.
        body_iou, bone_iou, segment_iou: means over bodies.
        segment_count: share of bodies whose number of segments is exact.
        same_tree: share of bodies whose segments are linked as in the original.
        joint_recall: found joints over joints of the originals.
        joint_precision: found joints over joints of the copies.
        joint_distance: median over found joints [voxels].
        axis_error: median over found joints [degrees].
        axis_error_p95: 95 % quantile over found joints [degrees].
        range_error: mean over found joints [degrees].
        latent_power: mean of |z|^2 / 512 over bodies; 1 for latents that follow the prior.
    """

    n: int
    seed: int
    body_iou: Figure
    bone_iou: Figure
    segment_iou: Figure
    segment_count: Figure
    same_tree: Figure
    joint_recall: Figure
    joint_precision: Figure
    joint_distance: Figure
    axis_error: Figure
    axis_error_p95: Figure
    range_error: Figure
    latent_power: Figure


@dataclass(frozen=True, eq=False, slots=True)
class Copy:
    """A body, its latent (512,), and what that decodes to."""

    design: VoxelDesign
    latent: NDArray[np.float32]
    copy: VoxelDesign


def reconstructions(codec: Codec, designs: Iterable[VoxelDesign], batch: int = BATCH) -> Iterator[Copy]:
    """Encode and decode designs one batch after the other."""
    waiting: list[VoxelDesign] = []
    for design in designs:
        waiting.append(design)
        if len(waiting) == batch:
            yield from _copies(codec, waiting)
            waiting = []
    if waiting:
        yield from _copies(codec, waiting)


def _copies(codec: Codec, designs: list[VoxelDesign]) -> Iterator[Copy]:
    latents = codec.encode(designs)
    for design, latent, copy in zip(designs, latents, codec.decode(latents), strict=True):
        yield Copy(design, latent, copy)


def reconstruction_figures(copies: Iterable[Copy], seed: int) -> Reconstruction:
    """Figures over copies; the seed is recorded and feeds the bootstrap."""
    found: list[Comparison] = []
    power: list[float] = []
    for copy in copies:
        found.append(compare(copy.design, copy.copy))
        power.append(float(np.square(copy.latent, dtype=np.float64).mean()))

    def mean(values: Iterable[float]) -> Figure:
        return mean_of([np.array([value]) for value in values], seed)

    matched = [len(c.distance) for c in found]
    angles, spans = [np.degrees(c.axis_error) for c in found], [np.degrees(c.range_error) for c in found]
    return Reconstruction(
        n=len(found),
        seed=seed,
        body_iou=mean(c.body_iou for c in found),
        bone_iou=mean(c.bone_iou for c in found),
        segment_iou=mean(c.segment_iou for c in found),
        segment_count=share_of([c.same_count for c in found]),
        same_tree=share_of([c.same_tree for c in found]),
        joint_recall=ratio_of(matched, [c.joints for c in found], seed),
        joint_precision=ratio_of(matched, [c.copied_joints for c in found], seed),
        joint_distance=quantile_of([c.distance for c in found], 0.5, seed),
        axis_error=quantile_of(angles, 0.5, seed),
        axis_error_p95=quantile_of(angles, 0.95, seed),
        range_error=mean_of(spans, seed),
        latent_power=mean(power),
    )
