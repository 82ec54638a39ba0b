"""The bodies that the learned decoder learns from: drawn without end, in batches, on the CPU or on a GPU."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decoder.compose import Window, centres, compose, window_of
from decoder.design import DEFAULT_PITCH, Joint, VoxelDesign
from decoder.formulas import LIMIT, Bodies, field
from decoder.growth import grown
from decoder.trees import MAX_PARTS

HINGES_APART = 9.0  # at least, for a motor at each [voxels]
BONES_APART = 1.5  # bones without a common hinge, at least [voxels]
_CANDIDATES, _LEAST_CANDIDATES = 3, 12  # bodies drawn for each that is taken, and for a call
_BALLS = 5  # that stand for a bone


def sample_bodies(n: int, rng: torch.Generator) -> Bodies:
    """Draw n bodies on the generator's device, as `decoder.growth` grows them.

    Of several times as many the first n are taken that are not cramped: their hinges leave room for motors, and bones
    without a common hinge keep apart.
    """
    drawn = grown(max(_CANDIDATES * n, _LEAST_CANDIDATES), rng)
    return drawn.pick(torch.sort(_cramped(drawn), stable=True).indices[:n])


def _cramped(bodies: Bodies) -> Tensor:
    """By how much hinges or bones are too near each other, (n,) [voxels]; 0 for a body with room."""
    alive, parent = bodies.alive, bodies.parent
    hinged = alive.clone()
    hinged[:, 0] = False
    apart = torch.cdist(bodies.position, bodies.position)
    near_hinges = (HINGES_APART - apart).masked_fill(~_pairs(hinged), 0.0)
    # Bones as a few balls each; those of the torso, which is flat and has no core line, lie side by side.
    along = torch.linspace(0.0, 1.0, _BALLS, device=alive.device)
    centre = bodies.start[:, :, None] + (along * bodies.length[..., None])[..., None] * bodies.frame[:, :, None, :, 2]
    thick = bodies.half[..., :2].mean(2)[..., None] * (1 + (bodies.taper[..., None] - 1) * along)
    y, z, x = bodies.half[:, 0].unbind(1)
    thick[:, 0] = (0.5 * (torch.minimum(x, y) + z))[:, None]
    row = (2 * along - 1) * (x - thick[:, 0, 0]).clamp(min=0)[:, None]
    centre[:, 0] = bodies.start[:, 0, None] + row[..., None] * bodies.frame[:, 0, None, :, 2]
    gap = (
        torch.cdist(centre.flatten(1, 2), centre.flatten(1, 2))
        - thick.flatten(1)[:, :, None]
        - thick.flatten(1)[:, None]
    )
    count = len(alive)
    gap = gap.view(count, MAX_PARTS, _BALLS, MAX_PARTS, _BALLS).amin(dim=(2, 4))
    place = torch.arange(MAX_PARTS, device=alive.device)
    carries = parent[:, None, :] == place[:, None]  # (n, carrier, carried)
    strangers = _pairs(alive) & ~carries & ~carries.mT
    near_bones = (BONES_APART - gap).masked_fill(~strangers, 0.0)
    return torch.maximum(near_hinges, near_bones).clamp(min=0).amax(dim=(1, 2))


def _pairs(of: Tensor) -> Tensor:
    """Which pairs of different parts are both chosen, (n, 8, 8) from (n, 8)."""
    return of[:, :, None] & of[:, None] & ~torch.eye(MAX_PARTS, dtype=torch.bool, device=of.device)


def generator(seed: int, index: int, device: str = "cpu") -> torch.Generator:
    """The random stream number `index` of a seed."""
    rng = torch.Generator(device)
    rng.manual_seed(int(np.random.SeedSequence([seed, index]).generate_state(1, np.uint64)[0] >> 1))
    return rng


def sample_designs(n: int, seed: int) -> list[VoxelDesign]:
    """Draw n voxel designs; number k depends on the seed and on k only."""
    return [_design(sample_bodies(1, generator(seed, k))) for k in range(n)]


def _design(bodies: Bodies) -> VoxelDesign:
    count = int(bodies.alive[0].sum())
    wide = torch.cat([(bodies.half[..., :2] * bodies.taper.clamp(min=1.0)[..., None]), bodies.half[..., 2:]], 2)
    reach = torch.einsum("nkij,nkj->nki", bodies.frame.abs(), wide) + (bodies.thickness + 2 * LIMIT + 1)[..., None]
    end = bodies.start + bodies.length[..., None] * bodies.frame[..., 2]
    low, high = torch.minimum(bodies.start, end) - reach, torch.maximum(bodies.start, end) + reach
    windows = []
    for k in range(count):
        first, size = window_of(low[0, k].numpy(), high[0, k].numpy())
        points = torch.from_numpy(centres(first, size).reshape(-1, 3))
        bone, skin = field(bodies.pick(torch.tensor([0]), torch.tensor([k])), points[None])
        windows.append(Window(first, bone[0].numpy().reshape(size), skin[0].numpy().reshape(size)))
    parent = bodies.parent[0].tolist()
    material, segment, depth = compose(windows, {(min(parent[k], k), max(parent[k], k)) for k in range(1, count)})
    joints = [
        Joint(bodies.position[0, k].double().numpy() * DEFAULT_PITCH, _unit(bodies.axis[0, k]),
              bodies.range[0, k].double().numpy(), parent[k] + 1, k + 1)
        for k in range(1, count)
    ]  # fmt: skip
    return VoxelDesign(material, segment, DEFAULT_PITCH, tuple(joints), depth)


def _unit(vector: Tensor) -> NDArray[np.float64]:
    exact = vector.double().numpy()
    return np.asarray(exact / np.linalg.norm(exact))
