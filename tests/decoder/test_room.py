"""Room between parts: the same whether bodies are formulas or what a network says, and never less than asked for."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from decoder.examples import Examples, examples
from decoder.formulas import Bodies
from decoder.growth import grown
from decoder.parts import HINGES_APART
from decoder.room import Layout, layout_of, layout_said, shortfalls
from decoder.synthetic import generator, sample_bodies


@pytest.fixture(scope="module")
def bodies() -> Bodies:
    return sample_bodies(128, generator(1, 0))


def said_of(batch: Examples) -> torch.Tensor:
    """What a perfect network would say of these bodies."""
    alive = torch.where(batch.alive, 4.0, -4.0)[..., None]
    return torch.cat([alive, 4.0 * functional.one_hot(batch.parent, 8), batch.pose], 2)


def test_a_sample_has_room(bodies: Bodies):
    hinges, bones = shortfalls(layout_of(bodies))
    assert hinges.max() == 0.0
    assert (bones.amax(dim=(1, 2)) > 0).float().mean() < 0.05
    wild = grown(128, generator(1, 0))
    assert shortfalls(layout_of(wild))[0].max() > 1.0  # so that the choice among bodies is one


def test_parts_said_are_where_they_were_seen(bodies: Bodies):
    batch = examples(bodies)
    layout = layout_said(said_of(batch))
    assert torch.equal(layout.alive, batch.alive)
    assert torch.equal(torch.where(batch.alive, layout.parent, 0), batch.parent)
    middle = layout.centre[:, :, 2]
    assert (middle - batch.centre)[batch.alive].abs().max() < 1e-2
    hinges, bones = shortfalls(layout)
    assert hinges.max() < 1e-2
    assert (bones.amax(dim=(1, 2)) > 0.05).float().mean() < 0.1


def test_a_part_without_a_carrier_is_not_there(bodies: Bodies):
    said = said_of(examples(bodies))
    said[:, 1, 0] = -4.0  # those that part 1 carries go with it
    alive = layout_said(said).alive
    carried = said[..., 1:9].argmax(2) == 1
    assert not alive[:, 1].any()
    assert not alive[carried].any()


def test_hinges_too_near_are_pushed_apart():
    alive = torch.zeros(1, 8, dtype=torch.bool)
    alive[:, :3] = True
    hinge = torch.zeros(1, 8, 3)
    hinge[0, 2, 0] = 4.0
    hinge.requires_grad_(True)
    far = 100.0 * torch.arange(8.0)[None, :, None, None].expand(1, 8, 5, 3)
    hinges, bones = shortfalls(Layout(alive, torch.zeros(1, 8, dtype=torch.int64), hinge, far, torch.ones(1, 8, 5)))
    # The torso has no hinge, and each pair counts once.
    assert float(hinges.detach().sum()) == pytest.approx(HINGES_APART - 4.0, abs=1e-3)
    assert float(bones.detach().sum()) == 0.0
    hinges.sum().backward()
    assert hinge.grad is not None
    assert hinge.grad[0, 1, 0] > 0 > hinge.grad[0, 2, 0]
