"""The band's banded arithmetic against the matrices that it stands for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cho_solve_banded, cholesky_banded

from mfg.elastic_band import TENSION, _force, _stiffness


@pytest.mark.parametrize("count", [1, 2, 3, 25])
def test_a_smoothing_is_the_solution_of_the_whole_system(count: int) -> None:
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count + 7, 3))
    free, fixed = slice(4, 4 + count), np.r_[:4, 4 + count : count + 7]
    bend, pull = np.diff(np.eye(len(points)), n=2, axis=0), np.diff(np.eye(len(points)), axis=0)
    energy = bend.T @ bend + TENSION * pull.T @ pull
    ends = points.copy()
    ends[free] = 0.0
    np.testing.assert_allclose(_force(ends)[free], energy[free][:, fixed] @ points[fixed], atol=1e-12)
    right = rng.normal(size=(count, 3))
    found = cho_solve_banded((cholesky_banded(_stiffness(count, 40.0)), False), right)
    np.testing.assert_allclose((np.eye(count) + 40.0 * energy[free, free]) @ found, right, atol=1e-10)
