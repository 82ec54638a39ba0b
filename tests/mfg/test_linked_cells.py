"""Cells that hang together, against flooding a grid one neighbour at a time."""

from __future__ import annotations

import numpy as np
import pytest

from mfg.linked_cells import AZIMUTHS, linked


@pytest.mark.parametrize("seed", range(30))
def test_linked_is_what_three_steps_reach(seed: int) -> None:
    rng = np.random.default_rng(seed)
    filled = rng.random((int(rng.integers(1, 40)), AZIMUTHS)) < rng.uniform(0, 1)
    marked = rng.random(filled.shape) < rng.uniform(0, 0.3)
    found = marked
    for _ in range(3):
        wide = found | np.roll(found, 1, axis=1) | np.roll(found, -1, axis=1)
        tall = np.pad(wide, ((1, 1), (0, 0)))
        found = filled & (tall[:-2] | tall[1:-1] | tall[2:])
    np.testing.assert_array_equal(linked(filled, marked), found)


def test_a_row_goes_all_the_way_around() -> None:
    filled, marked = np.ones((1, AZIMUTHS), bool), np.zeros((1, AZIMUTHS), bool)
    marked[0, 0] = True
    assert np.flatnonzero(linked(filled, marked)[0]).tolist() == [0, 1, 2, 3, 45, 46, 47]
