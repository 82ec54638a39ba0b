"""Room between parts: measured right, and never missing in a sample."""

from __future__ import annotations

import pytest
import torch

from decoder.formulas import Bodies
from decoder.growth import grown
from decoder.parts import HINGES_APART
from decoder.room import Layout, layout_of, shortfalls
from decoder.synthetic import generator, sample_bodies


@pytest.fixture(scope="module")
def bodies() -> Bodies:
    return sample_bodies(128, generator(1, 0))


def test_a_sample_has_room(bodies: Bodies):
    hinges, bones = shortfalls(layout_of(bodies))
    assert hinges.max() == 0.0
    assert (bones.amax(dim=(1, 2)) > 0).float().mean() < 0.05
    wild = grown(128, generator(1, 0))
    assert shortfalls(layout_of(wild))[0].max() > 1.0  # so that the choice among bodies is one


def test_hinges_too_near_are_counted_once():
    alive = torch.zeros(1, 8, dtype=torch.bool)
    alive[:, :3] = True
    hinge = torch.zeros(1, 8, 3)
    hinge[0, 2, 0] = 4.0
    far = 100.0 * torch.arange(8.0)[None, :, None, None].expand(1, 8, 5, 3)
    hinges, bones = shortfalls(Layout(alive, torch.zeros(1, 8, dtype=torch.int64), hinge, far, torch.ones(1, 8, 5)))
    # The torso has no hinge, and each pair counts once.
    assert float(hinges.sum()) == pytest.approx(HINGES_APART - 4.0, abs=1e-3)
    assert float(bones.sum()) == 0.0
