"""Sketches: the palette means what the table says, hinges go where they are painted, the rest is inferred."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from decoder.design import DesignError, Material
from decoder.sketch import HINGE, SOFT_NEAREST, from_palette, load_design
from decoder.vox import VoxModel, write_vox

EXAMPLES = Path(__file__).parents[2] / "experiments" / "examples"


def limb() -> np.ndarray:
    """Two stout bars in line along x, 12 voxels each."""
    index = np.zeros((24, 8, 8), np.uint8)
    index[:12], index[12:] = 1, 2
    return index


def test_the_sketch_is_centred_and_keeps_every_voxel() -> None:
    design = from_palette(limb())
    assert (design.material == Material.RIGID).sum() == limb().size
    np.testing.assert_allclose(design.bounds.mean(axis=0), 0.32, atol=0.006)


def test_a_painted_hinge_is_the_joint() -> None:
    index = limb()
    index[12, 4, 1:7] = HINGE
    design = from_palette(index)
    (joint,) = design.joints
    np.testing.assert_allclose(joint.axis, (0, 0, 1), atol=1e-9)
    assert joint.confidence == 1.0
    assert (joint.parent, joint.child) == (1, 2)
    middle = np.add([20, 28, 28], [12.5, 4.5, 4.0]) * 0.01
    np.testing.assert_allclose(joint.position, middle, atol=1e-9)
    assert (design.material == Material.RIGID).sum() == index.size  # The marker became bone.


def test_touching_bones_without_a_hinge_get_one() -> None:
    (joint,) = from_palette(limb()).joints
    assert joint.confidence < 1.0
    np.testing.assert_allclose(joint.position, (0.32, 0.32, 0.32), atol=0.006)
    assert abs(joint.axis[0]) < 1e-6  # Never along the bones themselves.


def test_a_long_contact_is_a_hinge_along_its_length() -> None:
    index = np.zeros((16, 20, 4), np.uint8)
    index[:8], index[8:] = 1, 2
    (joint,) = from_palette(index).joints
    np.testing.assert_allclose(np.abs(joint.axis), (0, 1, 0), atol=1e-6)
    assert joint.confidence == pytest.approx(0.7)


def test_a_bend_turns_about_its_normal() -> None:
    index = np.zeros((16, 8, 16), np.uint8)
    index[:, :, :8] = 1
    index[8:, :, 8:] = 2
    index[:8, :, 8:] = 0
    (joint,) = from_palette(index).joints
    assert joint.confidence == pytest.approx(0.5)
    np.testing.assert_allclose(np.abs(joint.axis), (0, 1, 0), atol=1e-6)


def test_inferred_hinges_never_close_a_loop() -> None:
    index = np.zeros((16, 16, 8), np.uint8)
    index[:8, :8], index[8:, :8], index[:8, 8:], index[8:, 8:] = 1, 2, 3, 4
    assert len(from_palette(index).joints) == 3


def test_soft_tissue_keeps_its_owner() -> None:
    index = np.pad(limb(), 2)
    index[0], index[-1] = 101, SOFT_NEAREST
    design = from_palette(index)
    soft = design.material == Material.SOFT
    assert set(np.unique(design.segment[soft])) == {0, 1}


@pytest.mark.parametrize(
    ("paint", "words"),
    [
        (lambda i: i * 0, "empty"),
        (lambda i: np.full_like(i, SOFT_NEAREST), "no bone"),
        (lambda i: np.where(i == 2, 77, i).astype(np.uint8), "index 77 has no meaning"),
        (lambda i: np.pad(i, ((0, 40), (0, 0), (0, 0)), mode="edge"), "at most 62"),
        (lambda i: _marked(i, [(12, 4, 4)]), "single voxel"),
        (lambda i: _marked(i, [(x, y, z) for x in (11, 12) for y in (3, 4) for z in (3, 4)]), "blob"),
        (lambda i: _marked(np.minimum(i, 1), [(12, 4, 3), (12, 4, 4), (12, 4, 5)]), "only one"),
        (lambda i: _marked(np.pad(i, ((0, 0), (0, 12), (0, 0))), [(12, 16, 3), (12, 16, 4)]), "within 4 voxels"),
    ],
)
def test_what_cannot_be_understood_is_said(paint, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(DesignError) as caught:
        from_palette(paint(limb()))
    assert words in str(caught.value)


def _marked(index: np.ndarray, voxels: list[tuple[int, int, int]]) -> np.ndarray:
    marked = index.copy()
    for voxel in voxels:
        marked[voxel] = HINGE
    return marked


def test_files_are_read_by_suffix(tmp_path: Path) -> None:
    write_vox(tmp_path / "limb.VOX", VoxModel(limb()))
    design = load_design(tmp_path / "limb.VOX")
    design.save(tmp_path / "limb.npz")
    assert load_design(tmp_path / "limb.npz").key == design.key
    with pytest.raises(DesignError, match=r"limb\.txt.*\.npz or \.vox"):
        load_design(tmp_path / "limb.txt")


@pytest.mark.parametrize(
    ("name", "parents", "axes"),
    [
        ("quadruped", [1, 1, 1, 1], [90, 90, 90, 90]),
        ("tripod", [1, 1, 1], [-30, 30, 90]),  # each square to its leg
        ("crawler", [1, 1, 2, 3], [90, 90, 90, 90]),
        ("inchworm", [1, 2, 3], [90, 90, 90]),
    ],
)
def test_the_example_is_what_the_painter_paints(name: str, parents: list[int], axes: list[int]) -> None:
    design = load_design(EXAMPLES / f"{name}.vox")
    assert len(design.segments) == len(parents) + 1
    assert [joint.parent for joint in design.joints] == parents
    found = [np.degrees(np.arctan2(joint.axis[1], joint.axis[0])) for joint in design.joints]
    np.testing.assert_allclose(found, axes, atol=4)  # five voxels draw a slanting line no straighter
    assert all(joint.confidence == 1.0 and abs(joint.axis[2]) < 1e-9 for joint in design.joints)


def test_every_example_is_painted_by_the_painter(tmp_path: Path) -> None:
    painter = runpy.run_path(str(EXAMPLES / "paint.py"))
    assert {path.stem for path in EXAMPLES.glob("*.vox")} == {paint.__name__ for paint in painter["SKETCHES"]}
    for paint in painter["SKETCHES"]:
        write_vox(tmp_path / "again.vox", paint())
        assert (tmp_path / "again.vox").read_bytes() == (EXAMPLES / f"{paint.__name__}.vox").read_bytes()
