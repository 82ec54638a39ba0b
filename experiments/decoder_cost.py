"""What a decoder takes: seconds per body, memory of a fresh process, and whether its bytes depend on the batch."""

from __future__ import annotations

import hashlib
import io
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from decoder.evaluation import Cost
from decoder.latent import make_decoder, sample_latents
from experiments.bench import machine
from experiments.measuring import clock, peak

if TYPE_CHECKING:
    from decoder.design import VoxelDesign
    from decoder.latent import Decoder
    from decoder.reconstruction import Codec

SEED = 0
BATCHES = (1, 3, 32)
REPEATS = 5  # of each timed batch
ROOT = Path(__file__).resolve().parent.parent


def measure_cost(codec: Codec, name: str, size: int = 32) -> Cost:
    """Time a codec on this machine and check its bytes.

    Args:
        codec: what is measured.
        name: what `make_decoder` knows it by, so that a fresh process can load it.
        size: bodies in a large batch.
    """
    latents = sample_latents(size, np.random.default_rng(SEED))
    designs = codec.decode(latents)  # Warms up, too.
    single = [clock(lambda z=z: codec.decode(z[None])) for z in latents]  # type: ignore[misc]
    batched = [clock(lambda: codec.decode(latents)) / size for _ in range(REPEATS)]
    encoding = [clock(lambda: codec.encode(designs)) / size for _ in range(REPEATS)]
    return Cost(
        machine=machine(),
        single=statistics.median(single),
        batched=statistics.median(batched),
        encoding=statistics.median(encoding),
        repeats=size,
        peak=peak_of_fresh_process(name, size),
        same_bytes=same_bytes(codec, size),
    )


def same_bytes(decoder: Decoder, size: int = 32) -> bool:
    """Whether the same latents give the same saved designs in batches of 1, 3 and 32."""
    latents = sample_latents(size, np.random.default_rng(SEED))
    found = set()
    for batch in BATCHES:
        pieces = [latents[start : start + batch] for start in range(0, size, batch)]
        found.add(b"".join(_digest(design) for piece in pieces for design in decoder.decode(piece)))
    return len(found) == 1


def peak_of_fresh_process(name: str, size: int = 32) -> float:
    """Peak memory of a process that only loads a decoder and decodes one batch [MiB]."""
    if Path(name).suffix:
        name = str(Path(name).resolve())
    code = f"from experiments.decoder_cost import decode_once; print(decode_once({name!r}, {size}))"
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    child = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.PIPE, text=True,
        check=True,
    )  # fmt: skip
    return float(child.stdout)


def decode_once(name: str, size: int) -> float:
    """Decode one batch and return the peak memory of this process so far [MiB]."""
    make_decoder(name).decode(sample_latents(size, np.random.default_rng(SEED)))
    return peak()


def _digest(design: VoxelDesign) -> bytes:
    file = io.BytesIO()
    design.save(file)
    return hashlib.sha256(file.getvalue()).digest()
