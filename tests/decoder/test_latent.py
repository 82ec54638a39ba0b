"""Which decoder a name means, and what tells one from another."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from decoder import weights as files
from decoder.genome import GenomeDecoder
from decoder.latent import DECODERS, DEFAULT_DECODER, decoder_digest, make_decoder
from decoder.weights import Weights, WeightsError, save_weights


@dataclass(frozen=True, eq=False)
class Learned:
    """Stands in for the learned decoder: a record of weights and a pitch."""

    weights: Weights
    pitch: float = 0.01


def shapes(about: Mapping[str, str]) -> dict[str, tuple[int, ...]]:
    return {"w": (int(about["width"]),)}


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> None:
    """The smallest architecture there can be."""
    monkeypatch.setitem(sys.modules, "decoder.vae", SimpleNamespace(VaeDecoder=Learned))
    monkeypatch.setitem(sys.modules, "decoder.networks", SimpleNamespace(shapes=shapes))


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "own.safetensors"
    save_weights(path, {"w": np.ones(3)}, {"width": "3"})
    return path


def test_the_default_is_one_of_those_on_offer() -> None:
    assert DEFAULT_DECODER in DECODERS
    assert isinstance(make_decoder("genome"), GenomeDecoder)


def test_a_file_of_weights_is_a_decoder(network: None, own: Path) -> None:
    decoder = make_decoder(str(own))
    assert isinstance(decoder, Learned)
    assert decoder.weights.arrays["w"].tolist() == [1.0, 1.0, 1.0]


def test_vae_means_the_weights_that_ship(network: None, own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "SHIPPED", own.resolve())
    monkeypatch.setattr(files, "DIGEST", own.with_suffix(".sha256"))
    monkeypatch.setattr("decoder.latent.SHIPPED", own.resolve())
    with pytest.raises(WeightsError, match=r"own\.sha256 is missing"):
        make_decoder("vae")
    own.with_suffix(".sha256").write_text("0" * 64)
    with pytest.raises(WeightsError, match=r"own\.sha256 records 0000"):
        make_decoder("vae")
    own.with_suffix(".sha256").write_text(f"{hashlib.sha256(own.read_bytes()).hexdigest()}  {own.name}\n")
    assert isinstance(make_decoder("vae"), Learned)


def test_weights_of_another_architecture_are_refused(network: None, tmp_path: Path) -> None:
    path = tmp_path / "wide.safetensors"
    save_weights(path, {"w": np.ones(3)}, {"width": "4"})
    with pytest.raises(WeightsError, match=r"array 'w' has shape \(3,\), expected \(4,\)"):
        make_decoder(str(path))


def test_the_digest_tells_weights_and_numbers_apart(network: None, own: Path) -> None:
    first = decoder_digest(make_decoder(str(own)))
    moved = own.with_name("moved.safetensors")
    moved.write_bytes(own.read_bytes())
    assert decoder_digest(make_decoder(str(moved))) == first
    save_weights(own, {"w": np.array([1.0, 1.0, 1.001])}, {"width": "3"})
    other = make_decoder(str(own))
    assert isinstance(other, Learned)
    assert decoder_digest(other) != first
    assert decoder_digest(Learned(other.weights, 0.02)) != decoder_digest(other)
    assert len({decoder_digest(GenomeDecoder()), decoder_digest(GenomeDecoder(gap=2.6)), first}) == 3
