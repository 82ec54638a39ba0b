"""The procedural decoder: deterministic, independent of the batch, smooth, diverse, and always within the grid."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.design import DEPTH_UNIT, GRID, Material, VoxelDesign
from decoder.genome import GenomeDecoder
from decoder.latent import LATENT_DIM, PRIORS, make_decoder, sample_latents

DECODER = GenomeDecoder()


@pytest.fixture(scope="module")
def latents() -> NDArray[np.float32]:
    return sample_latents(48, np.random.default_rng(0))


@pytest.fixture(scope="module")
def designs(latents: NDArray[np.float32]) -> list[VoxelDesign]:
    return DECODER.decode(latents)


def test_a_body_depends_on_its_own_latent_only(latents: NDArray[np.float32], designs: list[VoxelDesign]) -> None:
    for k in (0, 7, 31):
        assert DECODER.decode(latents[k : k + 1])[0].key == designs[k].key
    assert [d.key for d in GenomeDecoder().decode(latents[:4])] == [d.key for d in designs[:4]]
    assert len({d.key for d in designs}) == len(designs)


def test_bodies_keep_a_margin_of_two_voxels(designs: list[VoxelDesign]) -> None:
    for design in designs:
        filled = np.argwhere(design.material > 0)
        assert filled.min() >= 2
        assert filled.max() <= GRID - 3


def test_joints_lie_at_both_of_their_bones(designs: list[VoxelDesign]) -> None:
    for design in designs:
        assert len(design.joints) == len(design.segments) - 1
        for joint in design.joints:
            assert joint.confidence == 1.0
            for segment in (joint.parent, joint.child):
                bone = (np.argwhere((design.segment == segment) & (design.material == 2)) + 0.5) * design.pitch
                assert np.linalg.norm(bone - joint.position, axis=1).min() < 0.035


def test_samples_are_diverse(designs: list[VoxelDesign]) -> None:
    assert len({len(d.joints) for d in designs}) >= 4
    trees = {tuple(sorted((j.parent, j.child) for j in d.joints)) for d in designs}
    assert len(trees) >= 8
    volume = np.array([(d.material == Material.RIGID).sum() for d in designs])
    assert volume.std() > 0.15 * volume.mean()


def test_small_steps_change_little_and_free_form_directions_change_shape_only(latents: NDArray[np.float32]) -> None:
    rng = np.random.default_rng(1)
    changes = []
    for z in latents[:10]:
        step = rng.standard_normal(LATENT_DIM).astype(np.float32)
        near = z + 0.01 * step
        a, b = DECODER.decode(np.stack([z, near]))
        changes.append((a.material != b.material).sum() / (a.material > 0).sum())
    assert np.median(changes) < 0.03
    # A direction that no gene sees: the last rows of Q are displacements of the surfaces.
    residual = rng.standard_normal(250) @ DECODER.map[-250:]
    a, b = DECODER.decode(np.stack([latents[0], latents[0] + residual]).astype(np.float32))
    assert [(j.parent, j.child) for j in a.joints] == [(j.parent, j.child) for j in b.joints]
    assert (a.material != b.material).any()


def test_the_map_is_orthonormal() -> None:
    np.testing.assert_allclose(DECODER.map @ DECODER.map.T, np.eye(LATENT_DIM), atol=1e-10)


@pytest.mark.parametrize(
    ("latents", "words"),
    [(np.zeros((2, 5)), r"\(2, 5\)"), (np.zeros(LATENT_DIM), "512"), (np.full((1, LATENT_DIM), np.nan), "finite")],
)
def test_bad_latents_are_refused(latents: NDArray[np.float64], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DECODER.decode(latents)


@pytest.mark.parametrize("prior", PRIORS)
def test_priors_are_white(prior: str) -> None:
    z = sample_latents(400, np.random.default_rng(2), prior)
    assert z.dtype == np.float32
    assert abs(float(z.mean())) < 0.01
    assert float(z.std()) == pytest.approx(1.0, abs=0.01)


def test_unknown_names_list_what_there_is() -> None:
    with pytest.raises(ValueError, match=r"available: vae, genome, or a file ending in \.safetensors"):
        make_decoder("oracle")
    with pytest.raises(ValueError, match="normal"):
        sample_latents(1, np.random.default_rng(0), "cauchy")
    with pytest.raises(ValueError, match="0 or more"):
        sample_latents(-1, np.random.default_rng(0))


def test_a_signed_design_is_the_same_body_with_its_depth(latents: np.ndarray, designs: list[VoxelDesign]) -> None:
    for plain, signed in zip(designs[:6], GenomeDecoder(signed=True).decode(latents[:6]), strict=True):
        np.testing.assert_array_equal(plain.material, signed.material)
        np.testing.assert_array_equal(plain.segment, signed.segment)
        assert plain.depth is None
        assert signed.depth is not None
        assert (signed.depth[1] >= signed.depth[0]).all()  # A body holds its bones.
        depth = signed.depth / DEPTH_UNIT
        slope = np.linalg.norm(np.gradient(depth[0]), axis=0)[np.abs(depth[0]) < 1.5]
        assert np.median(slope) == pytest.approx(1.0, abs=0.15)  # About metric near the surface.
