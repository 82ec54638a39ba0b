"""Where a training from scratch begins: the best linear encoder and decoder, in closed form, in place of noise."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decoder import networks
from decoder.examples import examples, seen
from decoder.genome import LATENT_DIM
from decoder.networks import LATTICES, SEEN, WIDTH
from decoder.parts import MAX_PARTS, POSE, TOLERANCES, TRUNCATION
from decoder.synthetic import generator, sample_bodies

LEAST, BATCH = 256, 64
FORMS = WIDTH - SEEN - 18  # components of the lattices that a token begins with; its pose has the rest
_LARGEST_FORM = 2.0
_WIDTH_OF_POSTERIOR = 0.12  # at first, in standard deviations of a latent
_SURE = 4.0  # log odds that a choice begins with


@lru_cache(maxsize=1)
def linear_start(seed: int, bodies: int) -> dict[str, NDArray[np.float32]]:
    """Weights whose layers do nothing yet and whose linear maps are those of principal components.

    A token starts as principal components of its part's lattices beside its pose; the latent as the 512 principal
    components of the eight tokens together, each with variance 1; what is said of a part is the least-squares fit to
    the tokens that come back. Measured on so many bodies, 256 at least.
    """
    arrays = {n: torch.tensor(a) for n, a in networks.initial(np.random.default_rng(seed)).items()}
    batches = [
        examples(sample_bodies(BATCH, generator(seed, 2**42 + i))) for i in range(max(bodies // BATCH, LEAST // BATCH))
    ]
    looks = [seen(batch) for batch in batches]
    alive, lattices, pose = (torch.cat(each) for each in zip(*looks, strict=True))
    wanted = torch.cat([batch.distance.flatten(1) for batch in batches]) / TRUNCATION
    torch.manual_seed(0)  # svd_lowrank takes its randomness from nowhere else.
    _, size, forms = torch.svd_lowrank(lattices - lattices.mean(0), FORMS, niter=3)
    size = size / math.sqrt(len(lattices))
    # About in tenths of a nat: components of the lattices in proportion to their size, the pose by its tolerances.
    weight = _LARGEST_FORM / size[0]
    arrays["seen.lattices"] = torch.zeros(LATTICES, WIDTH)
    arrays["seen.lattices"][:, :FORMS] = forms * weight
    arrays["seen.pose"] = torch.zeros(SEEN, WIDTH)
    arrays["seen.pose"][:, FORMS : FORMS + SEEN] = torch.diag(_importance())
    arrays["seen.place"] = torch.zeros(MAX_PARTS, WIDTH)
    tokens = pose @ arrays["seen.pose"]
    tokens[alive] += lattices @ arrays["seen.lattices"]
    flat = tokens.flatten(1)
    middle = flat.mean(0)
    values, vectors = torch.linalg.eigh((flat - middle).T @ (flat - middle) / len(flat))
    scale, axes = values[-LATENT_DIM:].clamp(min=1e-6).sqrt(), vectors[:, -LATENT_DIM:]
    into = torch.zeros(MAX_PARTS * WIDTH, 2 * LATENT_DIM)
    into[:, :LATENT_DIM] = axes / scale.clamp(min=0.02)
    arrays["latent.in"] = into
    arrays["latent.in_bias"] = -(middle @ into)
    arrays["latent.in_bias"][LATENT_DIM:] = 2 * math.log(_WIDTH_OF_POSTERIOR)
    arrays["latent.out"] = (axes * scale).T.contiguous()
    arrays["said.place"] = middle.reshape(MAX_PARTS, WIDTH)
    said = ((flat - middle) @ axes @ axes.T + middle).reshape(-1, MAX_PARTS, WIDTH)
    choices = torch.cat([torch.where(alive, _SURE, -_SURE)[..., None],
                         _SURE * pose[..., 1 : 1 + MAX_PARTS], pose[..., 1 + MAX_PARTS : -3]], 2)  # fmt: skip
    fit = _least_squares(said.flatten(0, 1), choices.flatten(0, 1))
    arrays["said.pose"], arrays["said.pose_bias"] = fit[:-1], fit[-1].expand(MAX_PARTS, -1).clone()
    fit = _least_squares(said[alive], wanted)
    arrays["said.lattices"], arrays["said.lattices_bias"] = fit[:-1], fit[-1].expand(MAX_PARTS, -1).clone()
    for name in arrays:
        if name.endswith((".mix", ".down")):
            arrays[name] = torch.zeros_like(arrays[name])
    return {name: array.contiguous().numpy() for name, array in arrays.items()}


def _importance() -> Tensor:
    """Of what is seen of a part: tenths of a tolerance per unit."""
    pose = torch.zeros(POSE)
    for _, part, tolerance in TOLERANCES:
        pose[part] = 0.1 / tolerance
    return torch.cat([torch.ones(1 + MAX_PARTS), pose, torch.full((3,), 0.3)])


def _least_squares(x: Tensor, y: Tensor) -> Tensor:
    """Ridge fit of y (m, q) by x (m, p) and a constant: (p + 1, q), the constant last."""
    x = torch.cat([x, torch.ones(len(x), 1)], 1).double()
    square = x.T @ x / len(x)
    square.diagonal().add_(1e-4)
    return torch.linalg.solve(square, x.T @ y.double() / len(x)).float()
