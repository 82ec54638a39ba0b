"""Synthetic bodies as the learned decoder reads and writes them: poses and lattices of their parts, in torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor
from torch.nn import functional

from decoder.parts import (
    MAX_PARTS,
    MIDDLE,
    REACH,
    SHARPNESS,
    TRUNCATION,
    box_of,
    frames_along,
    lattice_points,
    order_key,
    tensor_of,
    torso_frame,
)
from decoder.synthetic import Bodies, field

PASS = (8, 8, 12)  # nodes of the first, coarse look at a bone
FAR = 1e3
NEAR = 400  # nodes around a hinge where the neighbour's claim is measured
CHUNK = 16  # parts measured at once: their arrays stay in the processor's cache


@dataclass(frozen=True, eq=False)
class Examples:
    """A batch of n bodies, parts in canonical order.

    Attributes:
        alive: which parts exist, (n, 8).
        parent: index of the carrying part, (n, 8); 0 for the torso and for unused parts.
        centre: centre of each bone in the grid [voxels], (n, 8, 3).
        pose: see `decoder.parts`, (n, 8, 18); 0 for unused parts.
        occupancy: smoothed bone and body as a voxel design shows them, (n, 8, 2, 2304); what the encoder sees.
        distance: truncated signed distances of the part's own bone and skin [voxels], (n, 8, 2, 2304).
    """

    alive: Tensor
    parent: Tensor
    centre: Tensor
    pose: Tensor
    occupancy: Tensor
    distance: Tensor

    def to(self, device: str | torch.device) -> Examples:
        """The same on another device."""
        return Examples(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})


def examples(bodies: Bodies) -> Examples:
    """Measure bodies the way `decoder.features` measures a voxel design, from their formulas instead of voxels."""
    n, device = len(bodies), bodies.alive.device
    spread, centre = _moments(bodies)
    depth = _depth(bodies)
    key = order_key(depth.to(torch.float32), centre, centre[:, :1], torch)
    key = key.masked_fill(~bodies.alive, math.inf)
    key[:, 0] = -1.0
    order = torch.argsort(key, dim=1, stable=True)
    bodies = bodies.take(order)
    rows = torch.arange(n, device=device)[:, None]
    spread, centre = spread[rows, order], centre[rows, order]
    offset = centre - bodies.position
    distance = offset.norm(dim=2).clamp(min=1.0)
    direction = offset / distance[..., None]
    frame = _frames(direction)
    spread = _projected(spread, frame)
    box = box_of(spread)
    nodes = torch.tensor(lattice_points(), device=device)
    points = centre[:, :, None] + (box[:, :, None] * nodes) @ frame.transpose(2, 3)
    bone, skin, owned = _measured(bodies, points, NEAR)
    occupancy = torch.stack([torch.sigmoid(-SHARPNESS * torch.maximum(bone, owned)),
                             torch.sigmoid(-SHARPNESS * torch.maximum(skin, owned))], 2)  # fmt: skip
    carrier = bodies.parent
    carried = torch.einsum("nkji,nkj->nki", frame[rows, carrier], bodies.position - centre[rows, carrier])
    attach = carried / box[rows, carrier]
    axis = torch.einsum("nkji,nkj->nki", frame, bodies.axis)
    pose = torch.cat([attach, direction, (distance / 8.0).log()[..., None], (spread / 3.0).log(),
                      tensor_of(axis, torch), bodies.range], 2)  # fmt: skip
    pose[:, 0] = 0.0
    pose[:, 0, :3] = (centre[:, 0] - MIDDLE) / REACH
    pose[:, 0, 7:10] = (spread[:, 0] / 3.0).log()
    alive = bodies.alive
    pose = pose * alive[..., None]
    lattice = torch.stack([bone, skin], 2).clamp(-TRUNCATION, TRUNCATION)
    mask = alive[..., None, None]
    return Examples(alive, torch.where(alive, carrier, 0), centre, pose, occupancy * mask, lattice * mask)


def seen(batch: Examples) -> tuple[Tensor, Tensor]:
    """What the encoder sees of a batch: (n, 8, 4608) and (n, 8, SEEN)."""
    carrier = functional.one_hot(batch.parent, MAX_PARTS).float()
    centre = (batch.centre - MIDDLE) / REACH
    alive = batch.alive[..., None].float()
    pose = torch.cat([alive, carrier * alive, batch.pose, centre * alive], 2)
    return batch.occupancy.flatten(2) - 0.2 * alive, pose


def _frames(direction: Tensor) -> Tensor:
    frame = frames_along(direction, torch).clone()
    frame[:, 0] = torch.as_tensor(torso_frame(), device=direction.device)
    return frame


def _moments(bodies: Bodies) -> tuple[Tensor, Tensor]:
    """Covariance (n, 8, 3, 3) and centre (n, 8, 3) of every bone as far as it is its own, by a coarse sum."""
    axes = [torch.linspace(-1 + 1 / m, 1 - 1 / m, m, device=bodies.alive.device) for m in PASS]
    nodes = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    wide = torch.maximum(bodies.taper, torch.ones_like(bodies.taper))[..., None]
    room = 3.0
    reach = torch.cat([bodies.half[..., :2] * wide, bodies.half[..., 2:] + 0.5 * bodies.length[..., None]], 2) + room
    middle = bodies.start + 0.5 * bodies.length[..., None] * bodies.frame[..., 2]
    points = middle[:, :, None] + (reach[:, :, None] * nodes) @ bodies.frame.transpose(2, 3)
    bone, _, owned = _measured(bodies, points, NEAR // 2)
    weight = torch.sigmoid(-SHARPNESS * torch.maximum(bone, owned))
    total = weight.sum(2).clamp(min=1e-3)
    centre = torch.einsum("nkm,nkmi->nki", weight, points) / total[..., None]
    away = points - centre[:, :, None]
    covariance = (weight[..., None] * away).transpose(2, 3) @ away / total[..., None, None]
    return covariance, centre


def _projected(covariance: Tensor, frame: Tensor) -> Tensor:
    """Standard deviations along the columns of the frames, (n, 8, 3)."""
    return torch.einsum("nkij,nkia,nkja->nka", covariance, frame, frame).clamp(min=0.25).sqrt()


def _depth(bodies: Bodies) -> Tensor:
    depth = torch.zeros_like(bodies.parent)
    for k in range(1, MAX_PARTS):
        depth[:, k] = torch.gather(depth, 1, bodies.parent[:, k : k + 1])[:, 0] + 1
    return depth


def _measured(bodies: Bodies, points: Tensor, near: int) -> tuple[Tensor, Tensor, Tensor]:
    """Distances (n, 8, m) of points (n, 8, m, 3) to their own bone and skin, and to where a linked bone is nearer.

    The last is about a signed distance, positive where the voxel belongs to a neighbour; it is measured at the `near`
    points nearest to each hinge and -1000 elsewhere.
    """
    part, carrier = _where(bodies)
    bone = torch.full(points.shape[:3], FAR, device=points.device)
    skin = bone.clone()
    owned = torch.full_like(bone, -FAR)
    alive = bodies.alive.nonzero(as_tuple=True)
    for chunk in zip(*(i.split(CHUNK) for i in alive), strict=True):
        bone[chunk], skin[chunk] = field(bodies.pick(*chunk), points[chunk])
    for own, other in ((part, carrier), (carrier, part)):
        hinge = bodies.position[part][:, None]
        close = (points[own] - hinge).square().sum(2).topk(near, dim=1, largest=False).indices
        rivals = []
        for rows in torch.arange(len(close), device=close.device).split(4 * CHUNK):
            at = points[own][rows].gather(1, close[rows, :, None].expand(-1, -1, 3))
            rivals.append(field(bodies.pick(*(i[rows] for i in other)), at)[0])
        rival = torch.cat(rivals)
        edge = torch.full((len(close), points.shape[2]), -FAR, device=points.device)
        edge.scatter_(1, close, 0.6 * (bone[own].gather(1, close) - rival))
        flat = owned.view(-1, owned.shape[2])
        index = (own[0] * MAX_PARTS + own[1])[:, None].expand_as(edge)
        flat.scatter_reduce_(0, index, edge, "amax")
    return bone, skin, owned


def _where(bodies: Bodies) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Body and place of every part but the torsos, and of the parts that carry them."""
    body, place = bodies.alive.nonzero(as_tuple=True)
    hinged = place > 0
    body, place = body[hinged], place[hinged]
    return (body, place), (body, bodies.parent[body, place])
