"""The bodies that the learned decoder learns from: drawn without end, in batches, on the CPU or on a GPU."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decoder.compose import Window, centres, compose, window_of
from decoder.design import DEFAULT_PITCH, Joint, VoxelDesign
from decoder.formulas import LIMIT, Bodies, boxes, field
from decoder.growth import grown
from decoder.room import shortfalls

_CANDIDATES, _LEAST_CANDIDATES = 3, 12  # bodies drawn for each that is taken, and for a call


def sample_bodies(n: int, rng: torch.Generator) -> Bodies:
    """Draw n bodies on the generator's device, as `decoder.growth` grows them.

    Of several times as many the first n are taken that are not cramped: their hinges leave room for motors, and bones
    without a common hinge keep apart.
    """
    drawn = grown(max(_CANDIDATES * n, _LEAST_CANDIDATES), rng)
    hinges, bones = shortfalls(drawn)
    cramped = torch.maximum(hinges, bones).amax(dim=(1, 2))
    return drawn.pick(torch.sort(cramped, stable=True).indices[:n])


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
    low, high = boxes(bodies, 2 * LIMIT + 1)
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
