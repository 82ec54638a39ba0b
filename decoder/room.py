"""Room between the parts of a body: for a motor at every hinge, and between bones that share none. In torch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from decoder.formulas import Bodies
from decoder.parts import BONES_APART, HINGES_APART, MAX_PARTS

BALLS = 5  # that stand for a bone


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parts of n bodies are, every bone as a row of balls. Lengths in voxels, positions in the grid.

    Attributes:
        alive: which parts exist, (n, 8).
        parent: index of the carrying part, (n, 8).
        hinge: a point on the hinge towards it, (n, 8, 3).
        centre: of the balls, (n, 8, 5, 3).
        radius: of the balls, (n, 8, 5).
    """

    alive: Tensor
    parent: Tensor
    hinge: Tensor
    centre: Tensor
    radius: Tensor


def shortfalls(layout: Layout) -> tuple[Tensor, Tensor]:
    """By how much hinges, and bones without a common hinge, are too near each other, (n, 8, 8) each [voxels]."""
    alive = layout.alive
    hinged = alive.clone()
    hinged[:, 0] = False
    hinges = (HINGES_APART - torch.cdist(layout.hinge, layout.hinge)).clamp(min=0) * _pairs(hinged)
    centre, radius = layout.centre.flatten(1, 2), layout.radius.flatten(1)
    gap = torch.cdist(centre, centre) - radius[:, :, None] - radius[:, None]
    gap = gap.view(len(alive), MAX_PARTS, BALLS, MAX_PARTS, BALLS).amin(dim=(2, 4))
    carries = layout.parent[:, None, :] == torch.arange(MAX_PARTS, device=alive.device)[:, None]
    strangers = _pairs(alive) & ~carries & ~carries.mT
    return hinges, (BONES_APART - gap).clamp(min=0) * strangers


def _pairs(of: Tensor) -> Tensor:
    """Which pairs of different parts are both chosen, each pair once, (n, 8, 8) from (n, 8)."""
    return (of[:, :, None] & of[:, None]).triu(1)


def layout_of(bodies: Bodies) -> Layout:
    """The layout of bodies given as formulas; the torso, which is flat and has no core line, is a row along x."""
    along = torch.linspace(0.0, 1.0, BALLS, device=bodies.alive.device)
    step = along * bodies.length[..., None]
    radius = bodies.half[..., :2].mean(2)[..., None] * (1 + (bodies.taper[..., None] - 1) * along)
    y, z, x = bodies.half[:, 0].unbind(1)
    radius[:, 0] = (0.5 * (torch.minimum(x, y) + z))[:, None]
    step[:, 0] = (2 * along - 1) * (x[:, None] - radius[:, 0]).clamp(min=0)
    centre = bodies.start[:, :, None] + step[..., None] * bodies.frame[:, :, None, :, 2]
    return Layout(bodies.alive, bodies.parent, bodies.position, centre, radius)
