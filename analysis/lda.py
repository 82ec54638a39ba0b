"""Where failures lie in latent space: shrunk linear discriminants, judged on designs they have not seen.

With 512 latent dimensions and some hundred failures, discriminants always separate the points they were fitted to, even
in pure noise. So every figure here is held out: each failure is classified, and drawn, by a fit without it, and a
permutation test says how often labels dealt at random do as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import ledoit_wolf

from analysis.passthrough import ORDER, PASSED, wilson
from mfg.outcome import Stage

FOLDS, REPEATS, PERMUTATIONS = 5, 4, 199
LEAST = 2 * FOLDS  # a class with fewer designs has not two in every fold

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


@dataclass(frozen=True, eq=False, slots=True)
class FailureLda:
    """What linear discriminants know about failure classes.

    Attributes:
        classes: that were told apart.
        sizes: designs in each.
        left_out: classes with fewer than `LEAST` designs, and those lost by a worker, with their sizes.
        labels: (m,) index into `classes` of every failure used.
        fitted: (m, 2) on the discriminants of all failures, as the paper's Fig. 3A; columns beyond classes - 1 are 0.
        held_out: (m, 2) on discriminants fitted without the point, turned to match.
        balanced_accuracy: mean over classes of the share that was recognised, held out; None with fewer than 2 classes.
        interval: of it, 95 %.
        permutation_p: share of random labellings that do as well, the true one included.
    """

    classes: tuple[str, ...]
    sizes: tuple[int, ...]
    left_out: dict[str, int]
    labels: Labels
    fitted: Floats
    held_out: Floats
    balanced_accuracy: float | None = None
    interval: tuple[float, float] | None = None
    permutation_p: float | None = None

    @property
    def chance(self) -> float | None:
        """Balanced accuracy of guessing."""
        return 1.0 / len(self.classes) if len(self.classes) > 1 else None

    def to_json(self) -> dict[str, Any]:
        """The object under `lda` in study.json."""
        return {
            "classes": list(self.classes),
            "balanced_accuracy": _rounded(self.balanced_accuracy),
            "balanced_accuracy_95": None if self.interval is None else [_rounded(bound) for bound in self.interval],
            "chance": _rounded(self.chance),
            "permutation_p": self.permutation_p,
            "sizes": list(self.sizes),
            "left_out": self.left_out,
        }


def failure_lda(
    latents: NDArray[np.floating],
    outcomes: Sequence[str],
    rng: np.random.Generator,
    permutations: int = PERMUTATIONS,
) -> FailureLda:
    """Tell failure classes apart by latents.

    The classifier is the nearest class mean after whitening by the Ledoit-Wolf covariance of all latents, passed ones
    included. No label enters the whitening, so it may be worked out once, which makes the permutation test quick; and
    classes count alike however many designs they have.

    Args:
        latents: (n, d) of all designs.
        outcomes: (n,) failure class or "passed" of each.
        rng: deals folds and permutations.
        permutations: random labellings, at least 1.

    Raises:
        ValueError: if the lengths differ.
    """
    if len(latents) != len(outcomes):
        raise ValueError(f"{len(latents)} latents and {len(outcomes)} outcomes: give one outcome for each latent")
    counts = {stage: sum(outcome == stage for outcome in outcomes) for stage in ORDER}
    classes = tuple(stage for stage in ORDER if counts[stage] >= LEAST and stage != Stage.WORKER)
    if len(classes) < 2:  # one class alone is told apart from nothing.
        classes = ()
    left_out = {stage: count for stage, count in counts.items() if count and stage not in classes}
    if not classes:
        return FailureLda((), (), left_out, *_nothing())
    index = {name: k for k, name in enumerate(classes)}
    used = [row for row, outcome in enumerate(outcomes) if outcome != PASSED and outcome in index]
    labels = np.array([index[outcomes[row]] for row in used], np.intp)
    points = _span(whitened(latents)[used])
    size = len(classes)
    recalls = _recalls(points, labels, size, rng)
    accuracy = float(recalls.mean())
    # The true labelling is one of the random ones, so it counts on both sides.
    better = sum(
        float(_recalls(points, rng.permutation(labels), size, rng).mean()) >= accuracy - 1e-12
        for _ in range(permutations)
    )
    axes = discriminants(points, labels, size)
    return FailureLda(
        classes, tuple(counts[c] for c in classes), left_out, labels, _drawn(points, axes),
        _held_out(points, labels, axes, rng), accuracy, _interval(recalls, np.bincount(labels)),
        (1 + better) / (1 + permutations),
    )  # fmt: skip


def whitened(latents: NDArray[np.floating]) -> Floats:
    """Latents (n, d) in coordinates in which their shrunk covariance is the identity."""
    x = np.asarray(latents, np.float64)
    covariance, _ = ledoit_wolf(x)
    values, vectors = np.linalg.eigh(covariance)
    # A latent that never varies has no scale; it tells nobody apart either.
    scale = np.where(values > 1e-12, 1.0 / np.sqrt(np.maximum(values, 1e-12)), 0.0)
    return (x - x.mean(0)) @ vectors * scale


def discriminants(points: Floats, labels: Labels, classes: int) -> Floats:
    """The first at most two discriminants of whitened points, (d, min(2, classes - 1)), orthonormal columns."""
    means = _sums(points, labels, classes) / np.bincount(labels, minlength=classes)[:, None]
    weights = np.sqrt(np.bincount(labels, minlength=classes) / len(labels))
    _, _, axes = np.linalg.svd(weights[:, None] * (means - points.mean(0)), full_matrices=False)
    return axes[: min(2, classes - 1)].T


def _folds(labels: Labels, classes: int, rng: np.random.Generator) -> Labels:
    """Deal every class evenly over the folds, (m,)."""
    fold = np.zeros(len(labels), np.intp)
    for k in range(classes):
        members = np.flatnonzero(labels == k)
        fold[members] = rng.permutation((np.arange(len(members)) + rng.integers(FOLDS)) % FOLDS)
    return fold


def _recalls(points: Floats, labels: Labels, classes: int, rng: np.random.Generator) -> Floats:
    """Share of each class that is recognised by fits without it, (classes,), mean over repeats."""
    sizes, hits = np.bincount(labels, minlength=classes), np.zeros(classes)
    for _ in range(REPEATS):
        fold = _folds(labels, classes, rng)
        cell = fold * classes + labels
        within = _sums(points, cell, FOLDS * classes).reshape(FOLDS, classes, -1)
        count = np.bincount(cell, minlength=FOLDS * classes).reshape(FOLDS, classes)
        means = (within.sum(0) - within) / (sizes - count)[:, :, None]
        affinity = points @ means.reshape(FOLDS * classes, -1).T - (means**2).sum(2).ravel() / 2
        of_fold = affinity.reshape(len(points), FOLDS, classes)[np.arange(len(points)), fold]
        hits += np.bincount(labels[of_fold.argmax(1) == labels], minlength=classes)
    return hits / (REPEATS * sizes)


def _held_out(points: Floats, labels: Labels, axes: Floats, rng: np.random.Generator) -> Floats:
    fold = _folds(labels, int(labels.max()) + 1, rng)
    drawn = np.zeros((len(points), 2))
    for k in range(FOLDS):
        rest = fold != k
        own = discriminants(points[rest], labels[rest], int(labels.max()) + 1)
        # A discriminant has no sign, and near ties turn pairs of them: take the turn that brings it closest.
        u, _, v = np.linalg.svd(own.T @ axes)
        drawn[~rest] = _drawn(points[~rest], own @ (u @ v))
    return drawn


def _drawn(points: Floats, axes: Floats) -> Floats:
    flat = points @ axes
    return np.pad(flat, ((0, 0), (0, 2 - flat.shape[1])))


def _sums(points: Floats, labels: Labels, groups: int) -> Floats:
    member = np.zeros((groups, len(points)))
    member[labels, np.arange(len(points))] = 1.0
    return member @ points


def _span(points: Floats) -> Floats:
    """The same points in coordinates of the space they span: distances stay, dimensions beyond their number go."""
    centred = points - points.mean(0)
    if len(points) > points.shape[1]:
        return centred
    u, s, _ = np.linalg.svd(centred, full_matrices=False)
    return u * s


def _interval(recalls: Floats, sizes: Labels) -> tuple[float, float]:
    """95 % interval of the mean recall, from the Wilson intervals of its terms (variance estimates recovery)."""
    bounds = np.array([wilson(float(r * n), int(n)) for r, n in zip(recalls, sizes, strict=True)])
    middle, k = float(recalls.mean()), len(recalls)
    below = float(np.sqrt(((recalls - bounds[:, 0]) ** 2).sum())) / k
    above = float(np.sqrt(((bounds[:, 1] - recalls) ** 2).sum())) / k
    return max(0.0, middle - below), min(1.0, middle + above)


def _nothing() -> tuple[Labels, Floats, Floats]:
    return np.zeros(0, np.intp), np.zeros((0, 2)), np.zeros((0, 2))


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6)
