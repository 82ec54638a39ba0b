"""Evaluating a codec: perfect for one that forgets nothing, honest about one that does, the same at any batch size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.design import GRID, Joint, Material, VoxelDesign
from decoder.evaluation import Cost, Evaluation, evaluate
from decoder.figures import better
from decoder.genome import GenomeDecoder
from decoder.latent import LATENT_DIM, sample_latents
from decoder.prior import JUDGED, arc, interpolation_figures, prior_figures
from decoder.reconstruction import Copy, reconstruction_figures

T = TypeVar("T")
SEED = 5
GENOME = GenomeDecoder()


class Remembering:
    """A codec that knows the latent of every body it is asked about, but for some noise."""

    def __init__(self, latents: NDArray[np.float32], designs: Sequence[VoxelDesign], noise: float) -> None:
        self.noise = noise
        self.latents = {d.key: z for z, d in zip(latents, designs, strict=True)}
        self.batches: list[int] = []

    def decode(self, latents: NDArray[np.floating]) -> list[VoxelDesign]:
        self.batches.append(len(latents))
        return GENOME.decode(latents)

    def encode(self, designs: Sequence[VoxelDesign]) -> NDArray[np.float32]:
        exact = np.stack([self.latents[d.key] for d in designs])
        return (exact + self.noise * np.cos(np.arange(LATENT_DIM) + 1000 * exact)).astype(np.float32)


@pytest.fixture(scope="module")
def codec() -> Callable[[float], tuple[Remembering, list[VoxelDesign]]]:
    latents = sample_latents(10, np.random.default_rng(SEED))
    designs = GENOME.decode(latents)
    return lambda noise: (Remembering(latents, designs, noise), designs)


def measured(codec: Callable[[float], tuple[Remembering, list[VoxelDesign]]], noise: float, batch: int) -> Evaluation:
    remembering, held_out = codec(noise)
    result = evaluate(remembering, held_out, prior_n=6, pairs=1, seed=SEED, batch=batch)
    assert max(remembering.batches) <= batch
    return result


def test_a_codec_that_forgets_nothing_is_perfect(codec: Callable[..., tuple[Remembering, list[VoxelDesign]]]) -> None:
    result = measured(codec, 0.0, 4)
    r = result.reconstruction
    for figure in (r.body_iou, r.bone_iou, r.segment_iou, r.segment_count, r.same_tree, r.joint_recall,
                   r.joint_precision):  # fmt: skip
        assert figure.value == figure.high == 1.0
    for figure in (r.axis_error, r.axis_error_p95, r.range_error, r.joint_distance):
        assert figure.value == figure.low == figure.high == 0.0
    assert (r.n, r.seed, r.body_iou.n, r.joint_recall.n) == (10, SEED, 10, r.axis_error.n)
    assert r.latent_power.value == pytest.approx(1.0, abs=0.05)
    assert (result.prior.n, result.prior.seed, result.prior.passing.n) == (6, SEED, 0)
    assert (result.interpolation.pairs, result.interpolation.steps) == (1, 100)
    assert result.interpolation.axis.value < 10.0


def test_the_figures_do_not_depend_on_the_batch(codec: Callable[..., tuple[Remembering, list[VoxelDesign]]]) -> None:
    assert repr(measured(codec, 0.1, 3)) == repr(measured(codec, 0.1, 32))


def test_a_forgetful_codec_is_worse(codec: Callable[..., tuple[Remembering, list[VoxelDesign]]]) -> None:
    exact, forgetful = measured(codec, 0.0, 32), measured(codec, 0.3, 32)
    assert forgetful.reconstruction.body_iou.value < 0.9
    assert better(exact.bounds(), forgetful.bounds())
    assert not better(forgetful.bounds(), exact.bounds())


def test_progress_is_shown_of_every_body(codec: Callable[..., tuple[Remembering, list[VoxelDesign]]]) -> None:
    seen: dict[str, tuple[int | None, int]] = {}

    def watch(iterable: Iterable[T], total: int | None, label: str) -> Iterator[T]:
        for k, item in enumerate(iterable, start=1):
            seen[label] = total, k
            yield item

    remembering, held_out = codec(0.0)
    evaluate(remembering, held_out, prior_n=5, pairs=1, watch=watch)
    assert sorted(seen.values()) == [(1, 1), (5, 5), (10, 10)]


def test_every_goal_has_its_row() -> None:
    codec_of_nothing = reconstruction_figures([], SEED)
    empty = Evaluation(codec_of_nothing, prior_figures([], SEED), interpolation_figures([], SEED))
    assert len(empty.bounds()) == 10
    assert not any(bound.reached for bound in empty.bounds())
    cost = Cost("a machine", 0.1, 0.05, 0.1, 3, 500.0, True)
    full = Evaluation(empty.reconstruction, empty.prior, empty.interpolation, cost)
    assert [(b.name, b.reached, b.weighed) for b in full.bounds()[10:]] == [
        ("seconds per body, batch 1", True, False),
        ("seconds per body, batch 32", True, False),
        ("peak memory", True, False),
        ("same bytes at any batch size", True, False),
    ]


def segments(count: int, gap: int = 0) -> VoxelDesign:
    """A chain of boxes along x."""
    material = np.zeros((GRID,) * 3, np.uint8)
    segment = np.zeros((GRID,) * 3, np.int16)
    for k in range(count):
        box = np.s_[4 + k * (8 + gap) : 12 + k * (8 + gap), 20:28, 20:28]
        material[box], segment[box] = Material.RIGID, k + 1
    joints = tuple(
        Joint(np.array([0.04 + 0.01 * k * (8 + gap), 0.24, 0.24]), np.array([0.0, 0.0, 1.0]), np.array([-1.0, 1.0]),
              k, k + 1) for k in range(1, count)
    )  # fmt: skip
    return VoxelDesign(material, segment, joints=joints)


def test_the_prior_counts_joints_and_shapes_of_trees_only() -> None:
    bodies = [segments(1), segments(2), segments(3), segments(3), segments(4), segments(3, gap=5)]
    prior = prior_figures(bodies, SEED, passes=lambda design: len(design.joints) == 2)
    assert prior.one_tree.value == pytest.approx(3 / 6)
    assert prior.passing.value == pytest.approx(3 / 6)
    assert prior.joint_counts == {0: 1, 1: 1, 2: 3, 3: 1}
    assert prior.tree_joint_counts == {2: 2, 3: 1}
    assert list(prior.tree_shapes.items()) == [("(()())", 2), ("((())())", 1)]


def test_no_more_bodies_are_judged_than_need_be() -> None:
    asked = []
    prior = prior_figures([segments(3)] * (JUDGED + 20), SEED, passes=lambda design: bool(asked.append(design)))
    assert (prior.n, prior.passing.n, len(asked)) == (JUDGED + 20, JUDGED, JUDGED)


def test_steps_that_change_the_tree_are_counted_and_not_compared() -> None:
    walk = [segments(3), segments(3), segments(4), segments(4)]
    figures = interpolation_figures([walk], SEED)
    assert (figures.pairs, figures.steps, figures.changing_steps) == (1, 3, 1)
    assert figures.same_tree.value == pytest.approx(2 / 3)
    assert (figures.axis.n, figures.axis.value, figures.position.value) == (2 + 3, 0.0, 0.0)
    assert figures.body_iou.value == pytest.approx((1 + 3 / 4 + 1) / 3)


def test_copies_are_compared_one_by_one() -> None:
    z = np.full(LATENT_DIM, 2.0, np.float32)
    figures = reconstruction_figures([Copy(segments(3), z, segments(3)), Copy(segments(4), z, segments(2))], SEED)
    assert figures.segment_count.value == 0.5
    assert figures.joint_recall.value == pytest.approx(3 / 5)
    assert figures.joint_precision.value == 1.0
    assert figures.latent_power.value == pytest.approx(4.0)


def test_an_arc_keeps_the_length_and_turns_evenly() -> None:
    a, b = sample_latents(2, np.random.default_rng(0)).astype(np.float64)
    a, b = a / np.linalg.norm(a), 4 * b / np.linalg.norm(b)
    way = arc(a, b).astype(np.float64)
    assert way.shape == (101, LATENT_DIM)
    assert way[0] == pytest.approx(a, abs=1e-6)
    assert way[-1] == pytest.approx(b, abs=1e-6)
    lengths = np.linalg.norm(way, axis=1)
    assert lengths[50] == pytest.approx(2.0, rel=1e-5)
    turns = np.arccos((way[1:] * way[:-1]).sum(axis=1) / (lengths[1:] * lengths[:-1]))
    assert turns == pytest.approx(turns.mean(), rel=1e-3)
    assert arc(a, a) == pytest.approx(np.tile(a, (101, 1)), abs=1e-7)
