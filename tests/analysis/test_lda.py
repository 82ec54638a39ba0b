from __future__ import annotations

import numpy as np
import pytest
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from analysis.lda import LEAST, PERMUTATIONS, discriminants, failure_lda, whitened


def planted(rng, sizes, dimensions=64, shift=0.0):
    """Latents whose failure classes are moved apart along axes of their own."""
    outcomes = [name for name, size in sizes.items() for _ in range(size)]
    latents = rng.standard_normal((len(outcomes), dimensions)).astype(np.float32)
    for k, name in enumerate(sizes):
        latents[np.array(outcomes) == name, k] += shift
    order = rng.permutation(len(outcomes))
    return latents[order], [outcomes[i] for i in order]


SIZES = {"skeleton": 30, "motor": 50, "electronics": 60, "passed": 160}


def test_planted_clusters_are_found():
    latents, outcomes = planted(np.random.default_rng(0), SIZES, shift=5.0)
    found = failure_lda(latents, outcomes, np.random.default_rng(1), permutations=60)
    assert found.classes == ("skeleton", "motor", "electronics")
    assert found.sizes == (30, 50, 60)
    assert found.chance == pytest.approx(1 / 3)
    assert found.balanced_accuracy > 0.95
    low, high = found.interval
    assert low <= found.balanced_accuracy <= high
    assert low > found.chance
    assert found.permutation_p == pytest.approx(1 / 61)


def test_more_dimensions_than_failures_still_find_what_is_there():
    latents, outcomes = planted(np.random.default_rng(2), SIZES, dimensions=512, shift=5.0)
    found = failure_lda(latents, outcomes, np.random.default_rng(1), permutations=40)
    assert found.balanced_accuracy > 0.7
    assert found.permutation_p == pytest.approx(1 / 41)


def test_noise_is_not_taken_for_structure():
    p, accuracy = [], []
    for draw in range(12):
        latents, outcomes = planted(np.random.default_rng(draw), SIZES, dimensions=200)
        found = failure_lda(latents, outcomes, np.random.default_rng(draw), permutations=39)
        p.append(found.permutation_p)
        accuracy.append(found.balanced_accuracy)
        low, high = found.interval
        assert low < 1 / 3 + 0.12
        assert high > 1 / 3 - 0.12
    # p is uniform without structure: twelve of them below 0.2 on average would be a miracle.
    assert np.mean(p) > 0.2
    assert np.mean(accuracy) == pytest.approx(1 / 3, abs=0.04)


def test_in_noise_only_the_fitted_map_shows_clusters():
    latents, outcomes = planted(np.random.default_rng(5), SIZES, dimensions=512)
    found = failure_lda(latents, outcomes, np.random.default_rng(1), permutations=1)

    def apart(points):
        centres = np.array([points[found.labels == k].mean(0) for k in range(3)])
        return centres.var(0).sum() / points.var(0).sum()

    assert apart(found.fitted) > 0.3
    assert apart(found.held_out) < 0.1


def test_small_and_lost_classes_are_left_out_and_named():
    sizes = {"motor": 20, "electronics": 20, "wire": LEAST - 1, "worker": 30, "passed": 40}
    latents, outcomes = planted(np.random.default_rng(3), sizes)
    found = failure_lda(latents, outcomes, np.random.default_rng(1), permutations=9)
    assert found.classes == ("motor", "electronics")
    assert found.left_out == {"worker": 30, "wire": LEAST - 1}
    assert len(found.labels) == 40
    assert not found.held_out[:, 1].any()


@pytest.mark.parametrize("sizes", [{}, {"passed": 30}, {"motor": 40, "passed": 30}, {"motor": 3, "wire": 3}])
def test_less_than_two_classes_is_no_analysis(sizes):
    latents, outcomes = planted(np.random.default_rng(4), sizes)
    found = failure_lda(latents, outcomes, np.random.default_rng(1))
    assert found.to_json() == {
        "classes": [], "balanced_accuracy": None, "balanced_accuracy_95": None, "chance": None, "permutation_p": None,
        "sizes": [], "left_out": {name: size for name, size in sizes.items() if name != "passed"},
    }  # fmt: skip


def test_the_same_seed_gives_the_same_answer():
    latents, outcomes = planted(np.random.default_rng(6), SIZES, shift=1.0)
    first, second = (failure_lda(latents, outcomes, np.random.default_rng(8), 20) for _ in range(2))
    assert first.to_json() == second.to_json()
    np.testing.assert_array_equal(first.held_out, second.held_out)


def test_discriminants_are_those_of_a_plain_lda_where_it_has_data_enough():
    latents, outcomes = planted(np.random.default_rng(7), {"motor": 900, "electronics": 700, "wire": 400}, 5, 2.0)
    labels = np.array([("motor", "electronics", "wire").index(o) for o in outcomes])
    points = whitened(latents)
    ours = points @ discriminants(points, labels, 3)
    theirs = LinearDiscriminantAnalysis().fit(latents.astype(float), labels).transform(latents.astype(float))
    # The same plane: each of their coordinates is a linear function of ours.
    design = np.column_stack([ours, np.ones(len(ours))])
    _, residual, *_ = np.linalg.lstsq(design, theirs, rcond=None)
    assert (residual / ((theirs - theirs.mean(0)) ** 2).sum(0) < 1e-3).all()


def test_a_latent_that_never_varies_is_harmless():
    latents, outcomes = planted(np.random.default_rng(9), SIZES, shift=5.0)
    latents[:, 10] = 3.0
    assert failure_lda(latents, outcomes, np.random.default_rng(1), 9).balanced_accuracy > 0.9


def test_lengths_must_agree():
    with pytest.raises(ValueError, match="3 latents and 2 outcomes"):
        failure_lda(np.zeros((3, 4)), ["passed", "motor"], np.random.default_rng(0))


def test_permutations_by_default_can_reach_significance():
    assert 1 / (1 + PERMUTATIONS) <= 0.01
