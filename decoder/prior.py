"""What the prior holds: bodies of random latents, and how bodies change on the way from one to another."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.comparison import Change, change
from decoder.design import VoxelDesign
from decoder.figures import NOTHING, Figure, mean_of, quantile_of, share_of
from decoder.kinematics import is_one_tree, tree_shape
from decoder.latent import Decoder

BATCH = 32
JUDGED = 200  # bodies that are put to a further test, which may take its time
STEPS = 100  # of an interpolation, so that one step is 1 % of the way
Latents = NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class Prior:
    """Bodies of latents z ~ N(0, I).

    Attributes:
        n: bodies.
        seed: of the draw.
        one_tree: share that is one connected tree with at least two joints (`decoder.kinematics.is_one_tree`).
        passing: share of the first 200 that the caller's own test passes; n is 0 without one.
        joint_counts: how many bodies have so many joints, ascending.
        tree_joint_counts: the same among the connected trees only.
        tree_shapes: how many connected trees have that shape (`decoder.kinematics.free_tree_shape`), commonest first.
    """

    n: int
    seed: int
    one_tree: Figure
    passing: Figure
    joint_counts: Mapping[int, int]
    tree_joint_counts: Mapping[int, int]
    tree_shapes: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Interpolation:
    """Steps of 1 % along the arc between pairs of latents from the prior.

    Attributes:
        pairs: how many.
        steps: of all pairs together.
        seed: of the draw.
        same_tree: share of steps that keep the tree. Axes and positions are compared over these steps only.
        changing_steps: how many do not.
        axis: 95 % quantile of a joint's axis change per step [degrees].
        axis_p99: 99 % quantile of the same [degrees].
        position: 95 % quantile of a joint's displacement per step [voxels].
        body_iou: mean IoU of a body with the next one, over all steps.
        body_iou_p05: 5 % quantile of the same.
    """

    pairs: int
    steps: int
    seed: int
    same_tree: Figure
    changing_steps: int
    axis: Figure
    axis_p99: Figure
    position: Figure
    body_iou: Figure
    body_iou_p05: Figure


def decoded(decoder: Decoder, latents: Latents, batch: int = BATCH) -> Iterator[VoxelDesign]:
    """Decode latents (n, 512) one batch after the other."""
    for start in range(0, len(latents), batch):
        yield from decoder.decode(latents[start : start + batch])


def prior_figures(
    designs: Iterable[VoxelDesign], seed: int, passes: Callable[[VoxelDesign], bool] | None = None
) -> Prior:
    """Figures over decoded samples of the prior; the seed is recorded."""
    counts: Counter[int] = Counter()
    tree_counts: Counter[int] = Counter()
    shapes: Counter[str] = Counter()
    trees: list[bool] = []
    passing: list[bool] = []
    for design in designs:
        counts[len(design.joints)] += 1
        trees.append(is_one_tree(design))
        shape = tree_shape(design)
        if trees[-1] and shape is not None:
            tree_counts[len(design.joints)] += 1
            shapes[shape] += 1
        if passes is not None and len(passing) < JUDGED:
            passing.append(passes(design))
    ranked = dict(sorted(shapes.items(), key=lambda item: (-item[1], item[0])))
    return Prior(len(trees), seed, share_of(trees), share_of(passing) if passing else NOTHING,
                 dict(sorted(counts.items())), dict(sorted(tree_counts.items())), ranked)  # fmt: skip


def interpolation_figures(walks: Iterable[Iterable[VoxelDesign]], seed: int) -> Interpolation:
    """Figures over walks, each a series of designs at equal steps; the bootstrap draws whole walks."""
    taken = [_changes(walk) for walk in walks]
    kept = [step.same_tree for steps in taken for step in steps]
    angles = [np.degrees(np.concatenate([step.axis for step in steps])) for steps in taken if steps]
    moves = [np.concatenate([step.position for step in steps]) for steps in taken if steps]
    ious = [np.array([step.body_iou for step in steps]) for steps in taken]
    return Interpolation(
        pairs=len(taken),
        steps=len(kept),
        seed=seed,
        same_tree=share_of(kept),
        changing_steps=len(kept) - sum(kept),
        axis=quantile_of(angles, 0.95, seed),
        axis_p99=quantile_of(angles, 0.99, seed),
        position=quantile_of(moves, 0.95, seed),
        body_iou=mean_of(ious, seed),
        body_iou_p05=quantile_of(ious, 0.05, seed),
    )


def _changes(walk: Iterable[VoxelDesign]) -> list[Change]:
    found, before = [], None
    for design in walk:
        if before is not None:
            found.append(change(before, design))
        before = design
    return found


def arc(start: Latents, end: Latents, steps: int = STEPS) -> NDArray[np.float32]:
    """Latents (steps + 1, 512) at equal angles along the arc from one latent to another, ends included.

    The length changes in equal ratios. A straight line would leave the prior: half-way it is 30 % too short.
    """
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    long, other = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    angle = math.acos(float(np.clip(a @ b / (long * other), -1.0, 1.0)))
    t = np.linspace(0.0, 1.0, steps + 1)[:, None]
    if angle < 1e-6:
        return ((1 - t) * a + t * b).astype(np.float32)
    direction = (np.sin((1 - t) * angle) * a / long + np.sin(t * angle) * b / other) / math.sin(angle)
    return (direction * long ** (1 - t) * other**t).astype(np.float32)
