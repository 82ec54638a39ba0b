"""Room between the parts of a body: for a motor at every hinge, and between bones that share none. In torch."""

from __future__ import annotations

import torch
from torch import Tensor

from decoder.formulas import Bodies
from decoder.parts import BONES_APART, HINGES_APART, MAX_PARTS

_BALLS = 5  # that stand for a bone


def shortfalls(bodies: Bodies) -> tuple[Tensor, Tensor]:
    """By how much hinges, and bones without a common hinge, are too near each other, (n, 8, 8) each [voxels].

    Every pair counts once. A bone is a row of balls along its core line; the torso, which has none, along x.
    """
    alive = bodies.alive
    hinged = alive.clone()
    hinged[:, 0] = False
    hinges = (HINGES_APART - torch.cdist(bodies.position, bodies.position)).clamp(min=0) * _pairs(hinged)
    along = torch.linspace(0.0, 1.0, _BALLS, device=alive.device)
    step = along * bodies.length[..., None]
    radius = bodies.half[..., :2].mean(2)[..., None] * (1 + (bodies.taper[..., None] - 1) * along)
    y, z, x = bodies.half[:, 0].unbind(1)
    radius[:, 0] = (0.5 * (torch.minimum(x, y) + z))[:, None]
    step[:, 0] = (2 * along - 1) * (x[:, None] - radius[:, 0]).clamp(min=0)
    centre = (bodies.start[:, :, None] + step[..., None] * bodies.frame[:, :, None, :, 2]).flatten(1, 2)
    radius = radius.flatten(1)
    gap = torch.cdist(centre, centre) - radius[:, :, None] - radius[:, None]
    gap = gap.view(len(alive), MAX_PARTS, _BALLS, MAX_PARTS, _BALLS).amin(dim=(2, 4))
    carries = bodies.parent[:, None, :] == torch.arange(MAX_PARTS, device=alive.device)[:, None]
    strangers = _pairs(alive) & ~carries & ~carries.mT
    return hinges, (BONES_APART - gap).clamp(min=0) * strangers


def _pairs(of: Tensor) -> Tensor:
    """Which pairs of different parts are both chosen, each pair once, (n, 8, 8) from (n, 8)."""
    return (of[:, :, None] & of[:, None]).triu(1)
