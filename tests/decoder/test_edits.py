"""Changes to a body do what they say and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import ellipsoid, painted
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from decoder.design import DesignError, Joint, Material, VoxelDesign
from decoder.edits import APART, cleft, grown, scaled, without_crumbs
from decoder.latent import make_decoder, sample_latents

HINGE = (Joint(np.array([0.32, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-0.5, 0.5]), 1, 2),)


def pair(gap: float = 3.0, soft: bool = False) -> VoxelDesign:
    """Two ellipsoids side by side along x, `gap` voxels apart."""
    bones = [ellipsoid((32 + s * (9 + gap / 2), 32, 32), (9, 6, 6)) for s in (-1, 1)]
    around = ellipsoid((23 - gap / 2, 32, 32), (11, 8, 8)) if soft else None
    return painted(bones, HINGE, around)


def bone(design: VoxelDesign, segment: int) -> np.ndarray:
    return (design.material == Material.RIGID) & (design.segment == segment)


@pytest.fixture(scope="module")
def decoded() -> list[VoxelDesign]:
    return make_decoder("genome").decode(sample_latents(4, np.random.default_rng(1)))


def test_a_scaled_body_has_the_same_voxels_and_longer_lengths() -> None:
    before = pair()
    after = scaled(before, 1.5)
    np.testing.assert_array_equal(after.material, before.material)
    assert after.pitch == 1.5 * before.pitch
    np.testing.assert_allclose(after.joints[0].position, 1.5 * before.joints[0].position)
    np.testing.assert_allclose(after.bounds, 1.5 * before.bounds)
    np.testing.assert_array_equal(after.joints[0].range, before.joints[0].range)
    with pytest.raises(ValueError, match="factor must be above 0"):
        scaled(before, 0.0)


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("voxels", [1.0, 2.0, 3.0])
def test_growth_without_neighbours_is_a_dilation_by_a_ball(voxels: float, soft: bool) -> None:
    before = pair(gap=14.0, soft=soft)
    after = grown(before, 1, voxels)
    own = bone(before, 1)
    np.testing.assert_array_equal(bone(after, 1), ndimage.distance_transform_edt(~own) <= voxels)
    np.testing.assert_array_equal(bone(after, 2), bone(before, 2))
    if soft:
        body = before.material > 0
        mine = body & ~bone(before, 2)
        np.testing.assert_array_equal(
            (after.material > 0) & ~bone(after, 2), ndimage.distance_transform_edt(~mine) <= voxels
        )
    else:
        assert (after.material == Material.SOFT).sum() == 0


@settings(max_examples=25, deadline=None)
@given(
    which=st.integers(0, 3), pick=st.integers(0, 100), voxels=st.sampled_from([0.5, 1.0, 2.0, 3.0]), local=st.booleans()
)
def test_only_the_named_bone_grows_and_keeps_its_distance(
    decoded: list[VoxelDesign], which: int, pick: int, voxels: float, local: bool
) -> None:
    before = decoded[which]
    segment = before.segments[pick % len(before.segments)]
    joint = before.joints[pick % len(before.joints)]
    after = grown(before, segment, voxels, joint.position if local else None, 0.08 if local else np.inf)
    new = (after.material == Material.RIGID) & (before.material != Material.RIGID)
    assert (after.segment[new] == segment).all()
    for other in before.segments:
        if other == segment:
            assert (bone(after, other) | ~bone(before, other)).all()  # nothing is lost
        else:
            np.testing.assert_array_equal(bone(after, other), bone(before, other))
    others = (before.material == Material.RIGID) & (before.segment != segment)
    assert (ndimage.distance_transform_edt(~others)[new] >= APART).all()
    assert ((after.material > 0) | (before.material == 0)).all()
    if local:
        centres = (np.argwhere(new) + 0.5) * before.pitch
        assert (np.linalg.norm(centres - joint.position, axis=1) <= 0.08).all()
    assert after.joints == before.joints


def test_growth_ends_at_the_border_of_the_grid_and_needs_a_segment() -> None:
    tall = painted([ellipsoid((32, 32, 20), (8, 8, 18)), ellipsoid((32, 32, 50), (8, 8, 11))], HINGE)
    after = grown(tall, 1, 3.0)
    assert bone(after, 1).sum() > bone(tall, 1).sum()
    assert not after.material[:, :, 0].any()
    with pytest.raises(ValueError, match="no segment 7 to grow"):
        grown(tall, 7, 1.0)


def test_a_cleft_parts_what_touches_and_leaves_the_rest() -> None:
    before = pair(gap=-2.0)
    after = cleft(before, 1, 2)
    near = ndimage.binary_dilation(bone(after, 1), np.ones((3, 3, 3))) & bone(after, 2)
    assert not near.any()
    changed = before.material != after.material
    assert changed.any()
    assert (after.material[changed] == Material.SOFT).all()
    with pytest.raises(DesignError):  # a segment that is all contact cannot be parted
        cleft(painted([ellipsoid((32, 32, 32), (9, 9, 9)), ellipsoid((41, 32, 32), (1.2, 1.2, 1.2))], HINGE), 1, 2)


def test_crumbs_become_soft() -> None:
    bones = ellipsoid((23, 32, 32), (8, 6, 6)) | ellipsoid((23, 50, 32), (2, 2, 2))
    before = painted([bones, ellipsoid((42, 32, 32), (8, 6, 6))], HINGE)
    after = without_crumbs(before)
    assert ndimage.label(bone(after, 1))[1] == 1
    assert (after.material[ellipsoid((23, 50, 32), (2, 2, 2))] == Material.SOFT).all()
    assert without_crumbs(after).key == after.key
