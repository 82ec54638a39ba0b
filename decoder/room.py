"""Room between the parts of a body: for a motor at every hinge, and between bones that share none. In torch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from decoder.formulas import Bodies
from decoder.parts import (
    ATTACH,
    BONES_APART,
    DIRECTION,
    DISTANCE,
    HINGES_APART,
    MAX_PARTS,
    MIDDLE,
    POSE,
    REACH,
    SPREAD,
    box_of,
    frames_along,
    torso_frame,
)

BALLS = 5  # that stand for a bone
_LONG, _WIDE = 1.3, 1.6  # a bone's outermost balls lie so far from its centre, and are so wide [standard deviations]


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
    hinges = (HINGES_APART - _distances(layout.hinge, layout.hinge)).clamp(min=0) * _pairs(hinged)
    centre, radius = layout.centre.flatten(1, 2), layout.radius.flatten(1)
    gap = _distances(centre, centre) - radius[:, :, None] - radius[:, None]
    gap = gap.view(len(alive), MAX_PARTS, BALLS, MAX_PARTS, BALLS).amin(dim=(2, 4))
    carries = layout.parent[:, None, :] == torch.arange(MAX_PARTS, device=alive.device)[:, None]
    strangers = _pairs(alive) & ~carries & ~carries.mT
    return hinges, (BONES_APART - gap).clamp(min=0) * strangers


def _distances(a: Tensor, b: Tensor) -> Tensor:
    # Where two points are one, the root has no slope; a little is added.
    return ((a[:, :, None] - b[:, None]).square().sum(-1) + 1e-6).sqrt()


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


def layout_said(said: Tensor) -> Layout:
    """The layout of what the network says of parts (n, 8, SAID), placed as `decoder.vae` places them."""
    n, pose = len(said), said[..., -POSE:]
    alive = said[..., 0] > 0
    alive[:, 0] = True
    guess = said[..., 1 : 1 + MAX_PARTS].masked_fill(
        torch.ones(MAX_PARTS, MAX_PARTS, dtype=torch.bool, device=said.device).triu(), -torch.inf
    )
    parent = guess[:, 1:].argmax(2)
    parent = torch.cat([torch.zeros_like(parent[:, :1]), parent], 1)
    spread = 3.0 * pose[..., SPREAD].clamp(-1.5, 1.5).exp()
    box = box_of(spread)
    direction = functional.normalize(pose[..., DIRECTION], dim=-1, eps=1e-3)
    frame = frames_along(direction, torch)
    torso = torch.as_tensor(torso_frame(), device=said.device).expand(n, 3, 3)
    frames, middle = [torso], [MIDDLE + REACH * pose[:, 0, ATTACH].clamp(-1.6, 1.6)]
    hinges = [middle[0]]
    rows = torch.arange(n, device=said.device)
    for k in range(1, MAX_PARTS):
        before = parent[:, k]
        local = box[rows, before] * pose[:, k, ATTACH].clamp(-1.2, 1.2)
        carrying = torch.stack(frames, 1)[rows, before]
        hinges.append(torch.stack(middle, 1)[rows, before] + (carrying @ local[..., None])[..., 0])
        reach = 8.0 * pose[:, k, DISTANCE].clamp(-2.0, 1.2).exp()
        middle.append(hinges[k] + reach * direction[:, k])
        frames.append(frame[:, k])
        alive[:, k] &= alive[rows, before]
    along = torch.linspace(-_LONG, _LONG, BALLS, device=said.device) * spread[..., 2, None]
    centre = torch.stack(middle, 1)[:, :, None] + along[..., None] * torch.stack(frames, 1)[:, :, None, :, 2]
    radius = (_WIDE * spread[..., :2].mean(2))[..., None].expand(-1, -1, BALLS)
    return Layout(alive, parent, torch.stack(hinges, 1), centre, radius)
