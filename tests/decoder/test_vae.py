"""The learned decoder with untrained weights: the laws that hold whatever it has learned."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import ellipsoid, painted
from hypothesis import given, settings
from hypothesis import strategies as st

from decoder.design import Material
from decoder.genome import LATENT_DIM, GenomeDecoder
from decoder.kinematics import touch
from decoder.networks import carried, carried_back, initial
from decoder.vae import VaeDecoder
from decoder.weights import Weights, WeightsError
from mfg.skeleton import SkeletonSolver, contacts


@pytest.fixture(scope="module")
def decoder() -> VaeDecoder:
    arrays = initial(np.random.default_rng(3))
    x = np.linspace(-1, 1, 12)[:, None, None] ** 2 + np.linspace(-1, 1, 12)[:, None] ** 2 + np.linspace(-1, 1, 16) ** 2
    ball = (np.sqrt(x) - 0.6) * 2
    arrays["flow.out"] = 0.02 * np.random.default_rng(4).standard_normal(arrays["flow.out"].shape).astype(np.float32)
    arrays["said.lattices_bias"] = np.tile(np.stack([ball, ball - 0.4]).ravel(), (8, 1)).astype(np.float32)
    return VaeDecoder(Weights(arrays, "", {}))


def latents(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, LATENT_DIM)).astype(np.float32)


def test_the_same_latent_gives_the_same_bytes_in_any_batch(decoder: VaeDecoder):
    z = latents(5)
    together = [d.key for d in decoder.decode(z)]
    assert together == [decoder.decode(z[k : k + 1])[0].key for k in range(5)]
    assert together[::-1] == [d.key for d in decoder.decode(z[::-1])]


def test_the_flow_is_inverted(decoder: VaeDecoder):
    z = latents(3, 8)
    x = carried(decoder.weights.arrays, z)
    assert np.abs(x - z).mean() > 0.1
    assert np.abs(carried_back(decoder.weights.arrays, x) - z).max() < 1e-4


def test_linked_bones_touch_and_others_do_not(decoder: VaeDecoder):
    """Whatever the network says: parts are pushed together at their hinge, and bones that share none are cut apart."""
    joints, apart = 0, 0
    for design in decoder.decode(latents(12, 2)):
        labels = np.where(design.material == Material.RIGID, design.segment, 0)
        linked = {frozenset((j.parent, j.child)) for j in design.joints}
        joints += len(linked)
        apart += sum(not touch(design, j.parent, j.child) for j in design.joints)
        faces = {frozenset(pair): count for pair, count in contacts(labels).items()}
        assert all(count < SkeletonSolver().contact_faces for pair, count in faces.items() if pair not in linked)
    assert joints > 12
    assert apart <= 1  # where others crowd in between


def test_joints_link_parts_into_one_tree(decoder: VaeDecoder):
    for design in decoder.decode(latents(6, 1)):
        assert len(design.joints) <= len(design.segments) - 1
        for joint in design.joints:
            assert joint.parent < joint.child
            assert 0.0 <= joint.confidence <= 1.0


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([0.0, 1e-3, 1.0, 10.0, 1e6, 1e30]))
def test_any_finite_latent_is_a_legal_design(decoder: VaeDecoder, seed: int, scale: float):
    z = latents(1, seed) * np.float32(scale)
    assert len(decoder.decode(z)) == 1


def test_encoding_takes_designs_of_other_origin(decoder: VaeDecoder):
    designs = [
        *GenomeDecoder().decode(latents(2, 4)),
        painted([ellipsoid((24, 32, 32), (8, 5, 5)), ellipsoid((44, 32, 32), (8, 5, 5))], ()),
    ]
    z = decoder.encode(designs)
    assert z.shape == (3, LATENT_DIM)
    assert z.dtype == np.float32
    assert np.isfinite(z).all()
    assert decoder.encode([]).shape == (0, LATENT_DIM)


@pytest.mark.parametrize("bad", [np.zeros(LATENT_DIM), np.zeros((2, 5)), np.full((1, LATENT_DIM), np.nan)])
def test_latents_of_another_shape_are_refused(decoder: VaeDecoder, bad: np.ndarray):
    with pytest.raises(ValueError, match="latents"):
        decoder.decode(bad)


def test_weights_of_another_architecture_are_refused():
    with pytest.raises(WeightsError, match=r"seen\.lattices"):
        VaeDecoder(Weights({"a": np.zeros(3)}, "", {}))
