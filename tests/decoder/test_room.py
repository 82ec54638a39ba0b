"""Room between parts: measured right, and never missing in a sample."""

from __future__ import annotations

import pytest
import torch

from decoder.formulas import Bodies
from decoder.growth import grown
from decoder.parts import BONES_APART, HINGES_APART
from decoder.room import shortfalls
from decoder.synthetic import generator, sample_bodies


def test_a_sample_has_room():
    hinges, bones = shortfalls(sample_bodies(128, generator(1, 0)))
    assert hinges.max() == 0.0
    assert bones.max() == 0.0
    hinges, bones = shortfalls(grown(128, generator(1, 0)))  # so that the choice among bodies is one
    assert hinges.max() > 1.0
    assert bones.max() > 1.0


def test_what_is_too_near_counts_once():
    bodies = grown(1, generator(1, 0))
    values = {name: getattr(bodies, name).clone() for name in Bodies.__dataclass_fields__}
    values["alive"][:] = torch.arange(8) < 4
    values["parent"][:] = torch.tensor([0, 0, 0, 2, 0, 0, 0, 0])
    values["position"][:] = 100.0 * torch.arange(8)[None, :, None]
    values["position"][0, 2] = values["position"][0, 1] + torch.tensor([0.0, 4.0, 0.0])
    values["start"][:] = 100.0 * torch.arange(8)[None, :, None]
    values["start"][0, 3] = values["start"][0, 1] + torch.tensor([0.0, 0.0, 7.0])  # 3 hangs on 2, and is near 1
    values["start"][0, 2] = values["start"][0, 3]  # where it hangs it may touch
    values["length"][:] = 0.0
    values["half"][:] = 3.0
    values["half"][0, 2] = 1.0
    values["taper"][:] = 1.0
    hinges, bones = shortfalls(Bodies(**values))
    assert float(hinges.sum()) == pytest.approx(HINGES_APART - 4.0, abs=1e-3)
    assert float(bones[0, 1, 3]) == pytest.approx(BONES_APART - 1.0, abs=1e-3)
    assert float(bones[0, 2, 3]) == 0.0
    assert torch.equal(bones, bones.triu(1))
