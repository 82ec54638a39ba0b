"""Surfaces from a design's own depth: near the true body, without the voxels' steps, and apart at boundaries."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import CENTRES
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from decoder.design import VoxelDesign, quantised
from decoder.genome import GenomeDecoder
from decoder.latent import sample_latents
from mfg.fields import Field
from mfg.picture import design_shapes
from mfg.pipeline import build, score, virtual
from mfg.solids import from_field, surface
from mfg.voxel_fields import bone_field, measured_field, opened_min, smooth_field, whole_field

PITCH = 0.01
SEED = 11


def capsule_depth(a: NDArray[np.float64], b: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Depth of voxel centres in a capsule from a to b [voxels]."""
    along = b - a
    t = np.clip(((CENTRES - a) @ along) / max(float(along @ along), 1e-12), 0, 1)
    return radius - np.linalg.norm(CENTRES - a - t[..., None] * along, axis=-1)


def fields_of(depth: NDArray[np.float64]) -> tuple[Field, Field]:
    """The same body from its depth and from its labels."""
    return measured_field(depth > 0, quantised(depth, depth)[0], PITCH, 0.8), smooth_field(depth > 0, PITCH, 0.8)


@given(
    shift=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    length=st.sampled_from([0.0, 9.0]),
    way=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda w: np.linalg.norm(w) > 0.1),
)
@settings(max_examples=20, deadline=None)
def test_the_volume_is_the_true_one(
    shift: tuple[float, float, float], length: float, way: tuple[float, float, float]
) -> None:
    a = 32 + np.array(shift)
    b = a + length * np.array(way) / np.linalg.norm(way)
    measured, _ = fields_of(capsule_depth(a, b, 5.0))
    true = np.pi * 0.05**2 * (length * PITCH + 4 / 3 * 0.05)
    assert from_field(measured).volume == pytest.approx(true, rel=0.02)
    assert measured.volume() == pytest.approx(true, rel=0.02)


def test_depth_is_much_nearer_to_the_true_surface_than_labels() -> None:
    rng = np.random.default_rng(0)
    error, tilt, volume = np.zeros((3, 8, 2))
    for k in range(8):
        centre = 32 + rng.uniform(-0.5, 0.5, 3)
        for m, field in enumerate(fields_of(capsule_depth(centre, centre, 5.0))):
            vertices, triangles = surface(field)
            error[k, m] = np.std(np.linalg.norm(vertices - centre * PITCH, axis=1))
            corner = vertices[triangles]
            normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
            outward = corner.mean(axis=1) - centre * PITCH
            size = np.linalg.norm(normal, axis=1)
            cosine = (normal * outward).sum(1) / np.maximum(size * np.linalg.norm(outward, axis=1), 1e-30)
            tilt[k, m] = np.average(np.arccos(np.clip(cosine, -1, 1)), weights=size)
            volume[k, m] = abs(from_field(field).volume / (4 / 3 * np.pi * 0.05**3) - 1)
    assert error[:, 0].mean() < 0.2 * error[:, 1].mean()
    assert error[:, 0].max() < 0.02 * PITCH
    assert tilt[:, 0].mean() < 0.4 * tilt[:, 1].mean()
    assert volume[:, 0].mean() < 0.7 * volume[:, 1].mean()


def test_depth_is_metric_far_inside_where_the_stored_one_ends() -> None:
    depth = np.minimum(capsule_depth(np.full(3, 32.0), np.full(3, 32.0), 14.0), 4.0)
    measured, _ = fields_of(depth)
    assert measured.values.max() == pytest.approx(0.14, abs=0.01)
    inside = measured.values[measured.values > 0]
    np.testing.assert_allclose(
        inside,
        0.14 - np.linalg.norm(measured.points()[measured.values > 0] - 0.32, axis=-1),
        atol=0.01,
    )


def test_parts_of_one_solid_meet_half_way_and_squarely() -> None:
    depth = capsule_depth(np.array([20.0, 32, 32]), np.array([44.0, 32, 32]), 6.0)
    left = (depth > 0) & (CENTRES[..., 0] < 32)
    stored = quantised(depth, depth)[0]
    fields = [measured_field(m, stored, PITCH, 0.8) for m in (left, (depth > 0) & ~left)]
    for field, side in zip(fields, (1, -1), strict=True):
        on_axis = np.array([[0.32 + d, 0.32, 0.32] for d in (-0.02, 0.0, 0.02)])
        np.testing.assert_allclose(field.sample(on_axis), side * np.array([0.02, 0.0, -0.02]), atol=1.5e-3)
        rim = 0.06 * np.array([[0, np.cos(t), np.sin(t)] for t in np.linspace(0, 6, 20)])
        np.testing.assert_allclose(field.sample(0.32 + rim - [side * 0.01, 0, 0]), 0.0, atol=5e-4)
    overlap = from_field(fields[0]).overlap(from_field(fields[1]))
    assert overlap < 1e-3 * fields[0].volume()


def test_opening_rounds_edges_trims_wedges_and_spares_the_rest() -> None:
    x, y = (a.astype(np.float32) for a in np.meshgrid(*[np.arange(-20, 21) * 0.25] * 2, indexing="ij"))
    x, y = (np.repeat(a[..., None], 5, axis=2) for a in (x, y))
    square = opened_min(x, y, 2.0)  # The quadrant x > 0, y > 0.
    assert (square <= np.minimum(x, y)).all()
    corner = (np.minimum(x, y) > 0) & (np.maximum(x, y) < 2)  # There, the surface is the arc that the ball leaves.
    np.testing.assert_allclose(square[corner], 2 - np.hypot(x - 2, y - 2)[corner], atol=1e-5)
    far = (np.maximum(x, y) > 4) | (np.minimum(x, y) > 2)
    np.testing.assert_array_equal(square[far], np.minimum(x, y)[far])
    turn = np.radians(15)
    other = np.float32(np.sin(turn)) * x - np.float32(np.cos(turn)) * y  # A wedge of 15 degrees, its edge at 0.
    wedge = opened_min(y, other, 0.3)
    tip = 0.3 / np.tan(turn / 2) - 0.3  # No ball reaches nearer to the edge.
    inside = (y > 0) & (other > 0)
    assert not (wedge[inside & (np.hypot(x, y) < 0.8 * tip)] > 0).any()
    assert (wedge[inside & (x > 1.5 * tip)] > 0).all()
    np.testing.assert_array_equal(opened_min(y, other, 0.0), np.minimum(y, other))


@pytest.mark.parametrize("stride", [1, 2])
def test_opening_an_edge_depends_on_nothing_far_from_it(stride: int) -> None:
    rng = np.random.default_rng(stride)
    for _ in range(20):
        # Two planes that meet in the middle, and noise where one of them is too deep or too far out for any edge.
        x, y, z = (np.arange(-20, 21, dtype=np.float32)[(..., *[None] * k)] / 4 for k in (2, 1, 0))
        a = np.broadcast_to(x + 0 * y + 0 * z, (41, 41, 41)).astype(np.float32)
        b = (rng.uniform(-0.5, 0.5) * x + y + 0.2 * z).astype(np.float32)
        far = (a > 4) | (a < -3)
        noisy = np.where(far, a + np.abs(rng.normal(size=a.shape)) * np.sign(a), a).astype(np.float32)
        plain, other = opened_min(a, b, 1.0, stride), opened_min(noisy, b, 1.0, stride)
        assert (plain < np.minimum(a, b)).any()
        np.testing.assert_array_equal(plain[~far], other[~far])
        np.testing.assert_array_equal(other[far], np.minimum(noisy, b)[far])


@pytest.fixture(scope="module")
def pairs() -> list[tuple[VoxelDesign, VoxelDesign]]:
    """Bodies without and with their depth."""
    latents = sample_latents(12, np.random.default_rng(SEED))
    return list(zip(GenomeDecoder().decode(latents), GenomeDecoder(signed=True).decode(latents), strict=True))


def test_without_depth_fields_come_from_labels(pairs: list[tuple[VoxelDesign, VoxelDesign]]) -> None:
    design = pairs[0][0]
    for segment in design.segments:
        bone = (design.segment == segment) & (design.material == 2)
        soft = (design.segment == segment) & (design.material == 1)
        for field, mask in (
            (bone_field(design, segment, 0.8), bone),
            (whole_field(design, segment, soft, 0.8, 1.0), soft | bone),
        ):
            np.testing.assert_array_equal(field.values, smooth_field(mask, design.pitch, 0.8).values)


def test_depth_changes_surfaces_but_hardly_a_verdict(pairs: list[tuple[VoxelDesign, VoxelDesign]]) -> None:
    outcomes = [(score(plain), score(signed)) for plain, signed in pairs]
    assert sum(a.ok == b.ok for a, b in outcomes) >= len(outcomes) - 1
    for a, b in outcomes:
        if a.ok and b.ok:
            volumes = [sum((x.skin or x.bone).volume() for x in o.blueprint.bodies) for o in (a, b)]
            assert volumes[1] == pytest.approx(volumes[0], rel=0.1)
            assert b.scores.total == pytest.approx(a.scores.total, abs=0.5)


def test_bodies_from_depth_keep_the_laws_of_skins(pairs: list[tuple[VoxelDesign, VoxelDesign]]) -> None:
    for _, design in pairs[:4]:
        bodies = virtual(design).blueprint.bodies
        bones = [from_field(b.bone) for b in bodies]
        outer = [from_field(b.skin or b.bone) for b in bodies]
        for i, a in enumerate(outer):
            assert (bones[i] - a).volume < 2e-3 * bones[i].volume
            for j in range(i):
                assert a.overlap(outer[j]) < 1e-9


def test_score_and_build_agree_on_a_body_with_depth(pairs: list[tuple[VoxelDesign, VoxelDesign]]) -> None:
    design = next(signed for _, signed in pairs if score(signed).ok)
    built, scored = build(design), score(design)
    assert built.ok, built.failure
    assert scored.scores.total == pytest.approx(built.scores.total, abs=0.05)


def test_pictures_show_the_surface_of_the_depth(pairs: list[tuple[VoxelDesign, VoxelDesign]]) -> None:
    plain, signed = (design_shapes(design) for design in pairs[0])
    assert [s.colour for s in plain] == [s.colour for s in signed]
    assert plain[0].vertices.shape != signed[0].vertices.shape


def test_a_thin_sheet_survives() -> None:
    depth = 0.9 - np.abs(CENTRES[..., 2] - 32.0) + 0 * CENTRES[..., 0]
    depth = np.minimum(depth, 10 - np.linalg.norm(CENTRES[..., :2] - 32, axis=-1))
    measured, _ = fields_of(depth)
    assert len(from_field(measured).components()) == 1
    assert measured.volume() == pytest.approx(np.pi * 0.1**2 * 0.018, rel=0.25)
