"""`bodyplan sample`: reproducible designs, one file each, and a picture of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from decoder.design import VoxelDesign
from decoder.genome import GenomeDecoder
from decoder.latent import LATENT_DIM, decoder_digest, sample_latents
from experiments import sample

GENOME = ("--decoder", "genome")


@pytest.fixture
def small(monkeypatch):
    """Pictures are slow; a stamp is enough to see that there is one per body."""
    monkeypatch.setattr(sample, "PICTURE", (48, 36))


@pytest.fixture
def unseen(monkeypatch):
    """Where nobody looks, a grey card stands for the picture."""
    monkeypatch.setattr("mfg.picture.picture_of_design", lambda *_: np.full((36, 48, 3), 128, np.uint8))


def test_a_sample_is_what_its_json_says(bodyplan, tmp_path, small):
    said = bodyplan("sample", "-n", "3", "--seed", "5", *GENOME, "--out", tmp_path / "s", "--json")
    assert said.status == 0
    report = json.loads(said.out)
    assert report == json.loads((tmp_path / "s" / "sample.json").read_text("utf-8"))
    assert (report["n"], report["seed"], report["decoder"], report["prior"]) == (3, 5, "genome", "normal")
    for body in report["bodies"]:
        design = VoxelDesign.load(tmp_path / "s" / body["file"])
        assert (design.key, len(design.joints), len(design.segments)) == (
            body["design"], body["joints"], body["segments"],
        )  # fmt: skip
    latents = np.load(tmp_path / "s" / "latents.npy")
    np.testing.assert_array_equal(latents, sample_latents(3, np.random.default_rng(5)))
    assert latents.shape == (3, LATENT_DIM)
    with Image.open(tmp_path / "s" / "sheet.png") as sheet:
        assert sheet.width >= 3 * 48


def test_the_sheet_says_of_how_many_segments_and_joints_a_body_is(bodyplan, tmp_path, unseen, monkeypatch):
    said = {}
    monkeypatch.setattr("mfg.picture.contact_sheet", lambda images, labels, _: said.update(labels=labels) or images[0])
    bodyplan("sample", "-n", "2", *GENOME, "--out", tmp_path)
    bodies = json.loads((tmp_path / "sample.json").read_text("utf-8"))["bodies"]
    for k, (body, label) in enumerate(zip(bodies, said["labels"], strict=True)):
        assert label.startswith(f"body_{k}   {body['segments']} segments, {body['joints']} joint")


def test_bodies_do_not_depend_on_how_many_are_decoded_together(bodyplan, tmp_path, unseen, monkeypatch):
    bodyplan("sample", "-n", "5", *GENOME, "--out", tmp_path / "a")
    monkeypatch.setattr(sample, "BATCH", 2)
    bodyplan("sample", "-n", "5", *GENOME, "--out", tmp_path / "b")
    assert keys(tmp_path / "a") == keys(tmp_path / "b")
    digests = [json.loads((tmp_path / name / "sample.json").read_text("utf-8"))["decoder_digest"] for name in "ab"]
    assert digests[0] == digests[1] == decoder_digest(GenomeDecoder())


def keys(folder: Path) -> list[str]:
    return [VoxelDesign.load(file).key for file in sorted(folder.glob("body_*.npz"))]


def test_the_same_seed_draws_the_same_bodies_and_a_larger_sample_begins_with_a_smaller_one(bodyplan, tmp_path, unseen):
    for name, n, seed in (("a", 2, 1), ("b", 3, 1), ("c", 2, 2)):
        assert bodyplan("sample", "-n", n, "--seed", seed, *GENOME, "--out", tmp_path / name).status == 0
    assert keys(tmp_path / "a") == keys(tmp_path / "b")[:2]
    assert keys(tmp_path / "a") != keys(tmp_path / "c")


def test_the_prior_is_recorded_and_used(bodyplan, tmp_path, unseen):
    bodyplan("sample", "-n", "1", "--prior", "uniform", *GENOME, "--out", tmp_path)
    assert json.loads((tmp_path / "sample.json").read_text("utf-8"))["prior"] == "uniform"
    assert np.abs(np.load(tmp_path / "latents.npy")).max() <= np.sqrt(3)


def test_names_sort_in_the_order_of_drawing(bodyplan, tmp_path, unseen, monkeypatch):
    monkeypatch.setattr(sample, "MOST_PICTURES", 1)
    said = bodyplan("sample", "-n", "11", *GENOME, "--out", tmp_path)
    assert sorted(p.name for p in tmp_path.glob("body_*.npz"))[-1] == "body_10.npz"
    assert "the contact sheet shows the first 1" in said.err


def test_bodies_of_an_earlier_sample_are_kept_and_pointed_out(bodyplan, tmp_path, unseen):
    bodyplan("sample", "-n", "2", *GENOME, "--out", tmp_path)
    assert "also holds 1 bodies" in bodyplan("sample", "-n", "1", *GENOME, "--out", tmp_path).err
    assert len(keys(tmp_path)) == 2
