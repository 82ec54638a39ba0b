"""MagicaVoxel files: what is written comes back, and no damage ends in anything but one clear line."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from decoder.design import DesignError
from decoder.vox import VoxModel, read_vox, write_vox

QUIET = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@given(index=hnp.arrays(np.uint8, hnp.array_shapes(min_dims=3, max_dims=3, max_side=7)))
@QUIET
def test_a_model_comes_back(tmp_path: Path, index: np.ndarray) -> None:
    palette = {1: (10, 20, 30, 255), 255: (1, 2, 3, 4)}
    write_vox(tmp_path / "m.vox", VoxModel(index, palette))
    model = read_vox(tmp_path / "m.vox")
    np.testing.assert_array_equal(model.index, index)
    assert model.palette[1] == palette[1]
    assert model.palette[255] == palette[255]


def good(tmp_path: Path) -> bytes:
    index = np.zeros((5, 4, 3), np.uint8)
    index[1:4, 1:3, 1] = 1
    write_vox(tmp_path / "m.vox", VoxModel(index))
    return (tmp_path / "m.vox").read_bytes()


@given(cut=st.integers(0, 1200), flips=st.lists(st.tuples(st.integers(0, 1200), st.integers(1, 255)), max_size=4))
@QUIET
def test_damage_never_ends_in_anything_but_a_design_error(
    tmp_path: Path, cut: int, flips: list[tuple[int, int]]
) -> None:
    data = bytearray(good(tmp_path))
    for position, value in flips:
        data[position % len(data)] ^= value
    (tmp_path / "m.vox").write_bytes(bytes(data[:cut]) if cut % 2 else bytes(data))
    refusal = ""
    try:
        read_vox(tmp_path / "m.vox")
    except DesignError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert not refusal or "m.vox" in refusal


def chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<II", len(content), 0) + content


def file(*chunks: bytes) -> bytes:
    body = b"".join(chunks)
    return b"VOX " + struct.pack("<I", 150) + b"MAIN" + struct.pack("<II", 0, len(body)) + body


SIZE, POINTS = chunk(b"SIZE", struct.pack("<3I", 3, 3, 3)), chunk(b"XYZI", struct.pack("<I4B", 1, 1, 1, 1, 1))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a MagicaVoxel file"),
        (b"GIF89a..", "not a MagicaVoxel file"),
        (b"VOX " + struct.pack("<I", 150), "before its MAIN"),
        (file(SIZE, POINTS)[:-3], "announces"),
        (file(), "0 models"),
        (file(SIZE, POINTS, SIZE, POINTS), "2 models"),
        (file(chunk(b"SIZE", b"abc"), POINTS), "expected 12"),
        (file(chunk(b"SIZE", struct.pack("<3I", 0, 3, 3)), POINTS), "1 to 256"),
        (file(chunk(b"SIZE", struct.pack("<3I", 3, 3, 2**31)), POINTS), "1 to 256"),
        (file(SIZE, chunk(b"XYZI", struct.pack("<I", 2**31))), "announces 2147483648 voxels"),
        (file(SIZE, chunk(b"XYZI", struct.pack("<I4B", 1, 9, 1, 1, 1))), "outside the model"),
        (file(SIZE, b"XYZI" + struct.pack("<II", 2**32 - 1, 0)), "announces 4294967295 bytes"),
    ],
)
def test_each_malformed_file_is_named(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "bad.vox").write_bytes(data)
    with pytest.raises(DesignError) as caught:
        read_vox(tmp_path / "bad.vox")
    assert words in str(caught.value)


def test_scene_graph_chunks_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "scene.vox").write_bytes(file(SIZE, POINTS, chunk(b"nTRN", b"x" * 40), chunk(b"MATL", b"y" * 9)))
    assert read_vox(tmp_path / "scene.vox").index.sum() == 1


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DesignError, match="1 to 256"):
        write_vox(tmp_path / "m.vox", VoxModel(np.zeros((300, 2, 2), np.uint8)))
