"""The latent space: its size, its priors, and the decoders that read it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from decoder.design import VoxelDesign
from decoder.genome import LATENT_DIM, GenomeDecoder
from decoder.weights import SHIPPED, SUFFIX, load_weights

__all__ = [
    "DECODERS", "DEFAULT_DECODER", "LATENT_DIM", "PRIORS", "Decoder", "Prior", "decoder_digest", "make_decoder",
    "sample_latents",
]  # fmt: skip

Prior = Literal["normal", "uniform"]
PRIORS: tuple[str, ...] = get_args(Prior)
DECODERS: tuple[str, ...] = ("vae", "genome")
DEFAULT_DECODER = "vae"
_UNIT_VARIANCE = float(np.sqrt(3.0))  # half-width of the uniform law whose variance is 1


class Decoder(Protocol):
    """Whatever turns latents into bodies."""

    def decode(self, latents: NDArray[np.floating]) -> list[VoxelDesign]:
        """Decode latents (n, 512) into n designs, each a function of its own row only."""
        ...


def make_decoder(name: str) -> Decoder:
    """Build a decoder with its default hyper-parameters.

    Args:
        name: "vae" is the learned decoder with the weights that ship, a file ending in .safetensors the same with
            those; "genome" is the procedural one.

    Raises:
        WeightsError: if the weights cannot be used.
        ValueError: if there is no such decoder.
        OSError: if the file cannot be read.
    """
    if name == "genome":
        return GenomeDecoder()
    if name == "vae" or name.endswith(SUFFIX):
        weights = load_weights(SHIPPED if name == "vae" else Path(name), _architecture)
        from decoder.vae import VaeDecoder

        return VaeDecoder(weights)
    raise ValueError(f"decoder is {name!r}; available: {', '.join(DECODERS)}, or a file ending in {SUFFIX}")


def decoder_digest(decoder: Decoder) -> str:
    """16 hex digits over everything that a decoder makes bodies from: its numbers, and the digest of its weights."""
    return hashlib.sha256(repr(decoder).encode()).hexdigest()[:16]


def sample_latents(n: int, rng: np.random.Generator, prior: str = "normal") -> NDArray[np.float32]:
    """Draw n latents, (n, 512) f4, every coordinate independent with mean 0 and variance 1.

    Args:
        n: how many, 0 or more.
        rng: the only source of randomness.
        prior: "normal" is N(0, 1); "uniform" is U(-sqrt 3, sqrt 3). Whoever draws records it beside the seed.

    Raises:
        ValueError: if n is negative or there is no such prior.
    """
    if n < 0:
        raise ValueError(f"number of latents is {n}; it must be 0 or more")
    if prior == "normal":
        return rng.standard_normal((n, LATENT_DIM), dtype=np.float32)
    if prior == "uniform":
        return rng.uniform(-_UNIT_VARIANCE, _UNIT_VARIANCE, (n, LATENT_DIM)).astype(np.float32)
    raise ValueError(f"prior is {prior!r}; available: {', '.join(PRIORS)}")


def _architecture(about: Mapping[str, str]) -> dict[str, tuple[int, ...]]:
    """The shape of every array of the network that weights say they are for."""
    from decoder.networks import shapes

    return shapes(about)
