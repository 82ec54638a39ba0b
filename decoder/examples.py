"""Synthetic bodies as the learned decoder reads and writes them: poses and lattices of their parts, in torch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from decoder.formulas import Bodies, bone_and_skin, bone_only
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

PASS = (8, 8, 12)  # nodes of the first, coarse look at a bone
FAR = 1e3
NEAR = 400  # nodes around a hinge where the neighbour's claim is measured
CHUNK = 32  # parts measured at once on a CPU: their arrays stay in the processor's cache


@dataclass(frozen=True, eq=False)
class Examples:
    """A batch of n bodies of p parts together, parts in canonical order. Lattices are those of existing parts only.

    Attributes:
        alive: which parts exist, (n, 8).
        parent: index of the carrying part, (n, 8); 0 for the torso and for unused parts.
        centre: centre of each bone in the grid [voxels], (n, 8, 3).
        pose: see `decoder.parts`, (n, 8, 18); 0 for unused parts.
        occupancy: smoothed bone and body as a voxel design shows them, (p, 2, 2304); what the encoder sees.
        distance: truncated signed distances of the part's own bone and skin [voxels], (p, 2, 2304).
    """

    alive: Tensor
    parent: Tensor
    centre: Tensor
    pose: Tensor
    occupancy: Tensor
    distance: Tensor


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
    alive = bodies.alive
    rows = torch.arange(n, device=device)[:, None]
    spread, centre = spread[rows, order], centre[rows, order]
    offset = centre - bodies.position
    distance = offset.norm(dim=2).clamp(min=1.0)
    direction = offset / distance[..., None]
    frame = _frames(direction)
    spread = _projected(spread, frame)
    box = box_of(spread)
    parts = _Parts(bodies)
    nodes = torch.tensor(lattice_points(), device=device).T
    bone, skin, owned = parts.measured(centre[alive], frame[alive] * box[alive][:, None], nodes, NEAR)
    occupancy = torch.stack([torch.sigmoid(-SHARPNESS * torch.maximum(bone, owned)),
                             torch.sigmoid(-SHARPNESS * torch.maximum(skin, owned))], 1)  # fmt: skip
    carrier = bodies.parent
    carried = torch.einsum("nkji,nkj->nki", frame[rows, carrier], bodies.position - centre[rows, carrier])
    attach = carried / box[rows, carrier]
    axis = torch.einsum("nkji,nkj->nki", frame, bodies.axis)
    pose = torch.cat([attach, direction, (distance / 8.0).log()[..., None], (spread / 3.0).log(),
                      tensor_of(axis, torch), bodies.range], 2)  # fmt: skip
    pose[:, 0] = 0.0
    pose[:, 0, :3] = (centre[:, 0] - MIDDLE) / REACH
    pose[:, 0, 7:10] = (spread[:, 0] / 3.0).log()
    pose = pose * alive[..., None]
    lattice = torch.stack([bone, skin], 1).clamp_(-TRUNCATION, TRUNCATION)
    return Examples(alive, torch.where(alive, carrier, 0), centre, pose, occupancy, lattice)


def seen(batch: Examples) -> tuple[Tensor, Tensor, Tensor]:
    """What the encoder sees of a batch: which parts exist (n, 8), their lattices (p, 4608), and (n, 8, SEEN)."""
    carrier = functional.one_hot(batch.parent, MAX_PARTS).float()
    centre = (batch.centre - MIDDLE) / REACH
    alive = batch.alive[..., None].float()
    pose = torch.cat([alive, carrier * alive, batch.pose, centre * alive], 2)
    return batch.alive, batch.occupancy.flatten(1) - 0.2, pose


def _frames(direction: Tensor) -> Tensor:
    frame = frames_along(direction, torch).clone()
    frame[:, 0] = torch.as_tensor(torso_frame(), device=direction.device)
    return frame


def _moments(bodies: Bodies) -> tuple[Tensor, Tensor]:
    """Covariance (n, 8, 3, 3) and centre (n, 8, 3) of every bone as far as it is its own, by a coarse sum."""
    axes = [torch.linspace(-1 + 1 / m, 1 - 1 / m, m, device=bodies.alive.device) for m in PASS]
    nodes = torch.stack(torch.meshgrid(*axes, indexing="ij")).reshape(3, -1)
    all_parts = _Parts(bodies)
    parts = all_parts.parts
    wide = torch.maximum(parts.taper, torch.ones_like(parts.taper))[..., None]
    room = 3.0
    reach = torch.cat([parts.half[..., :2] * wide, parts.half[..., 2:] + 0.5 * parts.length[..., None]], 1) + room
    middle = parts.start + 0.5 * parts.length[..., None] * parts.frame[..., 2]
    axes_of_boxes = parts.frame * reach[:, None]
    bone, _, owned = all_parts.measured(middle, axes_of_boxes, nodes, NEAR // 2)
    weight = torch.sigmoid(-SHARPNESS * torch.maximum(bone, owned))
    weight = weight / weight.sum(1, keepdim=True).clamp(min=1e-3)
    mean = weight @ nodes.T
    square = torch.einsum("pm,im,jm->pij", weight, nodes, nodes) - mean[:, :, None] * mean[:, None]
    covariance = torch.zeros(*bodies.alive.shape, 3, 3, device=mean.device)
    centre = torch.zeros(*bodies.alive.shape, 3, device=mean.device)
    covariance[bodies.alive] = axes_of_boxes @ square @ axes_of_boxes.mT
    centre[bodies.alive] = middle + (axes_of_boxes @ mean[..., None])[..., 0]
    return covariance, centre


def _projected(covariance: Tensor, frame: Tensor) -> Tensor:
    """Standard deviations along the columns of the frames, (n, 8, 3)."""
    return torch.einsum("nkij,nkia,nkja->nka", covariance, frame, frame).clamp(min=0.25).sqrt()


def _depth(bodies: Bodies) -> Tensor:
    depth = torch.zeros_like(bodies.parent)
    for k in range(1, MAX_PARTS):
        depth[:, k] = torch.gather(depth, 1, bodies.parent[:, k : k + 1])[:, 0] + 1
    return depth


class _Parts:
    """The existing parts of a batch in one row, who carries whom among them, and what is measured at their nodes."""

    def __init__(self, bodies: Bodies) -> None:
        body, place = bodies.alive.nonzero(as_tuple=True)
        self.parts = bodies.pick(body, place)
        number = bodies.alive.flatten().cumsum(0).view_as(bodies.alive) - 1
        self.hinged = place.nonzero()[:, 0]
        self.carrier = number[body, bodies.parent[body, place]][self.hinged]

    def measured(self, origin: Tensor, axes: Tensor, nodes: Tensor, near: int) -> tuple[Tensor, Tensor, Tensor]:
        """Distances (p, m) to a part's own bone and skin, and to where a linked bone is nearer.

        The last is about a signed distance, positive where the voxel belongs to a neighbour; it is measured at the
        `near` nodes nearest to each hinge and -1000 elsewhere.

        Args:
            origin: where coordinates (0, 0, 0) of each part lie in the grid, (p, 3).
            axes: columns are the steps of a node's coordinates, (p, 3, 3).
            nodes: coordinates, (3, m).
            near: how many nodes around a hinge.
        """
        chunk = CHUNK if origin.device.type == "cpu" else len(origin)
        own = [bone_and_skin(self.parts.pick(i), *_local(self.parts.pick(i), origin[i], axes[i], nodes))
               for i in torch.arange(len(origin), device=origin.device).split(chunk)]  # fmt: skip
        bone, skin = (torch.cat(each) for each in zip(*own, strict=True))
        owned = torch.full_like(bone, -FAR)
        for mine, other in ((self.hinged, self.carrier), (self.carrier, self.hinged)):
            hinge = self.parts.position[self.hinged]
            close, edge = [], []
            for rows in torch.arange(len(mine), device=mine.device).split(chunk):
                i = mine[rows]
                x, y, z = _placed(axes[i], origin[i] - hinge[rows], nodes)
                nearest = (x * x + y * y + z * z).topk(near, dim=1, largest=False, sorted=False).indices
                at = nodes[:, nearest].transpose(0, 1)
                rival = self.parts.pick(other[rows])
                distance = bone_only(rival, *_local(rival, origin[i], axes[i], at))
                close.append(nearest)
                edge.append(0.6 * (bone[i].gather(1, nearest) - distance))
            index = torch.cat(close) + (mine * bone.shape[1])[:, None]
            owned.view(-1).scatter_reduce_(0, index.flatten(), torch.cat(edge).flatten(), "amax")
        return bone, skin, owned


def _local(parts: Bodies, origin: Tensor, axes: Tensor, nodes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Coordinates of nodes in the frames of parts, from the near ends of their core lines, (p, m) each."""
    return _placed(parts.frame.mT @ axes, (parts.frame.mT @ (origin - parts.start)[..., None])[..., 0], nodes)


def _placed(axes: Tensor, origin: Tensor, nodes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Coordinates (p, m) of nodes, (3, m) of all or (p, 3, m), by `origin` (p, 3) and the columns of `axes`.

    Row by row: for so few numbers in a row a product of matrices takes longer.
    """
    u, v, w = nodes.unbind(-2)
    x, y, z = (
        torch.addcmul(origin[:, i, None], u, axes[:, i, 0, None])
        .addcmul_(v, axes[:, i, 1, None])
        .addcmul_(w, axes[:, i, 2, None])
        for i in range(3)
    )
    return x, y, z
