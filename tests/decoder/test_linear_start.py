"""The linear start: what a network that does nothing but two linear maps gets right."""

from __future__ import annotations

import numpy as np
import torch

from decoder import networks
from decoder.examples import examples, seen
from decoder.linear_start import linear_start
from decoder.parts import POSE, TRUNCATION
from decoder.synthetic import generator, sample_bodies


def test_it_brings_bodies_back_that_it_has_not_seen():
    with torch.no_grad():
        arrays = linear_start(3, 1024)
        assert {name: array.shape for name, array in arrays.items()} == networks.shapes({})
        w = {name: torch.tensor(array) for name, array in arrays.items()}
        batch = examples(sample_bodies(32, generator(4, 0)))
        mean, spread = networks.encode(w, *seen(batch), torch)
        said, tokens = networks.decode(w, mean, torch)
        distance = TRUNCATION * networks.distances(w, tokens, batch.alive, torch)
    assert torch.equal(said[..., 0] > 0, batch.alive)
    assert (said[..., -POSE:] - batch.pose)[batch.alive].square().mean().sqrt() < 0.1
    truth = batch.distance.flatten(1)
    assert (distance - truth).square().mean() < 0.4 * (truth - truth.mean(0)).square().mean()
    assert 0.3 < float(mean.square().mean()) < 3.0
    assert np.exp(0.5 * float(spread.mean())) < 0.2
    assert float(networks.velocity(w, mean, mean[:, :1], torch).abs().max()) == 0.0
