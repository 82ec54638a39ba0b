"""The design type: every invariant is refused by name, and a file gives back what was saved or says what is wrong."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import ellipsoid, painted
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from decoder.design import DEPTH_LIMIT, DEPTH_UNIT, GRID, DesignError, Joint, VoxelDesign, quantised

Y = (0.0, 1.0, 0.0)


def two_bones(**change: Any) -> VoxelDesign:
    joint: dict[str, Any] = {"position": (0.32, 0.32, 0.32), "axis": Y, "range": (-1, 1), "parent": 1, "child": 2}
    bones = [ellipsoid((25, 32, 32), (8, 5, 5)), ellipsoid((39, 32, 32), (8, 5, 5))]
    return painted(bones, (Joint(**(joint | change)),))


@given(
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1),
    low=st.floats(-3, -0.01),
    high=st.floats(0.01, 3),
    confidence=st.floats(0, 1),
)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_saved_design_comes_back_whole(
    tmp_path: Path, axis: tuple[float, float, float], low: float, high: float, confidence: float
) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    design = two_bones(axis=unit, range=(low, high), confidence=confidence)
    design.save(tmp_path / "d.npz")
    copy = VoxelDesign.load(tmp_path / "d.npz")
    assert copy.key == design.key
    np.testing.assert_array_equal(copy.material, design.material)
    np.testing.assert_array_equal(copy.joints[0].axis, design.joints[0].axis)
    assert copy.joints[0].confidence == confidence


def test_the_key_changes_with_everything_that_matters() -> None:
    base = two_bones()
    keys = {base.key, two_bones(range=(-1, 0.9)).key, two_bones(axis=(1, 0, 0)).key, two_bones(confidence=0.5).key}
    keys.add(VoxelDesign(base.material, base.segment, 0.011, base.joints).key)
    material = base.material.copy()
    material[10, 10, 10] = 1
    keys.add(VoxelDesign(material, base.segment, base.pitch, base.joints).key)
    assert len(keys) == 6
    assert two_bones().key == base.key


def test_a_design_cannot_be_changed_from_outside() -> None:
    material = two_bones().material.copy()
    design = VoxelDesign(material, two_bones().segment, 0.01, two_bones().joints)
    material[:] = 0
    assert design.material.any()
    with pytest.raises(ValueError, match="read-only"):
        design.material[0, 0, 0] = 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axis": (0, 2, 0)}, "unit vector"),
        ({"axis": (0, np.nan, 1)}, "finite"),
        ({"axis": (0, 1)}, "shape"),
        ({"axis": "up"}, "not a list of numbers"),
        ({"range": (0.5, 1)}, "hold 0"),
        ({"range": (1, -1)}, "low < high"),
        ({"range": (-9, 1)}, "within"),
        ({"position": (0.9, 0.3, 0.3)}, "outside the body"),
        ({"child": 1}, "itself"),
        ({"child": 7}, "has segments [1, 2]"),
        ({"confidence": 2.0}, "confidence"),
    ],
)
def test_a_bad_joint_is_refused_by_name(change: dict[str, Any], words: str) -> None:
    with pytest.raises(DesignError) as caught:
        two_bones(**change)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def broken(kind: str) -> VoxelDesign:
    base = two_bones()
    material, segment, pitch, joints = base.material.copy(), base.segment.copy(), 0.01, base.joints
    if kind == "shape":
        material = material[:60]
    elif kind == "dtype":
        return VoxelDesign(material.astype(float), segment, pitch, joints)  # type: ignore[arg-type]
    elif kind == "empty":
        material[:], segment[:] = 0, 0
    elif kind == "soft only":
        material[material == 2], segment[:] = 1, 0
    elif kind == "unknown material":
        material[5, 5, 5] = 9
    elif kind == "bone without id":
        segment[material == 2] = 0
    elif kind == "id in the void":
        segment[5, 5, 5] = 1
    elif kind == "negative id":
        segment[5, 5, 5] = -1
    elif kind == "border":
        material[0, 5, 5] = 1
    elif kind == "huge":
        material[:], segment[:] = 2, 1
    elif kind == "orphan tissue":
        material[5, 5, 5], segment[5, 5, 5] = 1, 9
    elif kind == "pitch":
        pitch = -1.0
    elif kind == "loop":
        joints = (*joints, joints[0])
    return VoxelDesign(material, segment, pitch, joints)


@pytest.mark.parametrize(
    ("kind", "words"),
    {
        "shape": "expected (64, 64, 64)",
        "dtype": "whole numbers",
        "empty": "no rigid voxel",
        "soft only": "no rigid voxel",
        "unknown material": "material holds 9",
        "bone without id": "segment 0",
        "id in the void": "empty voxel",
        "negative id": "-1",
        "border": "border",
        "huge": "border",
        "orphan tissue": "[9]",
        "pitch": "pitch is -1",
        "loop": "closes a loop",
    }.items(),
)
def test_a_broken_grid_is_refused_by_name(kind: str, words: str) -> None:
    with pytest.raises(DesignError) as caught:
        broken(kind)
    assert words in str(caught.value)


def stored(tmp_path: Path) -> dict[str, Any]:
    two_bones().save(tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as archive:
        return dict(archive)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": np.array("other")}, "format"),
        ({"version": np.array(99)}, "version"),
        ({"material": None}, "lacks material"),
        ({"pitch": np.array([0.1, 0.2])}, "one finite number"),
        ({"pitch": np.array(np.nan)}, "one finite number"),
        ({"axis": np.zeros((2, 3))}, "shape"),
        ({"axis": np.array([["a", "b", "c"]])}, "numbers"),
        ({"link": np.array([[1.5, 2.0]])}, "numbers"),
        ({"position": np.full((1, 3), np.inf)}, "finite"),
    ],
)
def test_a_foreign_archive_is_refused(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    arrays = {k: v for k, v in (stored(tmp_path) | change).items() if v is not None}
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(DesignError) as caught:
        VoxelDesign.load(tmp_path / "bad.npz")
    assert words in str(caught.value)
    assert "bad.npz" in str(caught.value)


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "sprung",))

    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([Trap()], dtype=object), allow_pickle=True)
    two_bones().save(tmp_path / "trap.npz")
    with zipfile.ZipFile(tmp_path / "trap.npz") as source, zipfile.ZipFile(tmp_path / "t2.npz", "w") as target:
        for item in source.namelist():
            target.writestr(item, buffer.getvalue() if item == "pitch.npy" else source.read(item))
    with pytest.raises(DesignError):
        VoxelDesign.load(tmp_path / "t2.npz")
    (tmp_path / "plain.npz").write_bytes(pickle.dumps(Trap()))
    with pytest.raises(DesignError):
        VoxelDesign.load(tmp_path / "plain.npz")
    assert not (tmp_path / "sprung").exists()


@given(cut=st.integers(0, 4000), flip=st.integers(0, 4000), value=st.integers(1, 255))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_never_ends_in_anything_but_a_design_error(tmp_path: Path, cut: int, flip: int, value: int) -> None:
    two_bones().save(tmp_path / "d.npz")
    data = bytearray((tmp_path / "d.npz").read_bytes())
    data[flip % len(data)] ^= value
    if cut < len(data) and cut % 2:
        data = data[:cut]
    (tmp_path / "d.npz").write_bytes(bytes(data))
    refusal = ""
    try:
        design = VoxelDesign.load(tmp_path / "d.npz")
    except DesignError as error:
        refusal = str(error)
    else:
        assert design.material.shape == (GRID,) * 3  # The damage hit a byte that carries no meaning.
    assert "\n" not in refusal


def with_depth(**change: Any) -> VoxelDesign:
    """`two_bones` with the depths of their voxels' centres, bare of soft tissue."""
    base = two_bones()
    inside = np.where(base.material == 2, 1.7, -2.3)
    fields = {"material": base.material, "segment": base.segment, "pitch": base.pitch, "joints": base.joints}
    return VoxelDesign(**(fields | {"depth": quantised(inside, inside)} | change))


def test_depth_is_kept_and_is_part_of_the_key(tmp_path: Path) -> None:
    design = with_depth()
    design.save(tmp_path / "d.npz")
    copy = VoxelDesign.load(tmp_path / "d.npz")
    assert copy.depth is not None
    assert copy.depth.dtype == np.int8
    np.testing.assert_array_equal(copy.depth, design.depth)
    assert copy.key == design.key
    deeper = design.depth.copy()
    deeper[0, 32, 32, 32] -= 1
    assert len({design.key, with_depth(depth=deeper).key, two_bones().key}) == 3
    with pytest.raises(ValueError, match="read-only"):
        design.depth[0, 0, 0, 0] = 1


def test_a_design_without_depth_keeps_its_key_and_its_file(hinge: VoxelDesign, tmp_path: Path) -> None:
    assert hinge.key == "1d8d7576cf45a1ce"
    hinge.save(tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz") as archive:
        assert "depth" not in archive.files
    assert VoxelDesign.load(tmp_path / "d.npz").depth is None


@pytest.mark.parametrize(
    ("change", "words"),
    {
        "bone": "disagree at 1 voxels of bone and 0 of body",
        "body": "disagree at 0 voxels of bone and 1 of body",
        "shape": "expected (2, 64, 64, 64)",
        "dtype": "depth holds float64",
        "range": "[-128, 127]",
    }.items(),
)
def test_a_depth_that_breaks_its_law_is_refused_by_name(change: str, words: str) -> None:
    depth: Any = with_depth().depth.astype(np.int16)
    if change == "bone":
        depth[0, 25, 32, 32] = 0
    elif change == "body":
        depth[1, 5, 5, 5] = 1
    elif change == "shape":
        depth = depth[0]
    elif change == "dtype":
        depth = depth.astype(float)
    elif change == "range":
        depth[0, 25, 32, 32] = 200
    with pytest.raises(DesignError) as caught:
        with_depth(depth=depth)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@given(depth=hnp.arrays(np.float64, (3, 4, 5), elements=st.floats(-50, 50) | st.sampled_from([0.0, 1e-9, -1e-9])))
def test_quantised_depth_keeps_the_sign_and_is_within_a_step(depth: np.ndarray) -> None:
    steps = quantised(depth, -depth)
    assert steps.dtype == np.int8
    np.testing.assert_array_equal(steps[0] > 0, depth > 0)
    near = np.abs(depth) <= DEPTH_LIMIT / DEPTH_UNIT
    assert np.abs(steps[0] / DEPTH_UNIT - depth)[near].max(initial=0) <= 1 / DEPTH_UNIT
    np.testing.assert_array_equal(np.abs(steps[0][~near]), DEPTH_LIMIT)
    np.testing.assert_array_equal(steps[0][depth != 0], -steps[1][depth != 0])  # Inside and outside alike.


def test_quantised_refuses_what_is_not_a_number() -> None:
    with pytest.raises(DesignError, match="depth is not a number at 1 voxels"):
        quantised(np.array([1.0, np.nan]), np.ones(2))
