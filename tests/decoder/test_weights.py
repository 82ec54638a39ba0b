"""Weights: what is written reads back, the same bytes every time; anything else is refused with one clear line."""

from __future__ import annotations

import hashlib
import io
import json
import os
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import save

from decoder import weights as module
from decoder.weights import Weights, WeightsError, load_weights, save_weights

ABOUT = {"width": "3", "note": "for tests, β"}
ARRAYS = {
    "b": np.linspace(-2, 2, 6, dtype=np.float32).reshape(2, 3),
    "a": np.array([0.5, 65504.0], np.float64),
    "scalar": np.array(3),
}
ENTRY = json.dumps({"version": "1", "width": "3"})


def expected(about: Mapping[str, str]) -> dict[str, tuple[int, ...]]:
    return {"a": (2,), "b": (2, int(about["width"])), "scalar": ()}


def raw(header: object, body: bytes = b"") -> bytes:
    """A safetensors file by hand."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + body


def tensor(dtype: str, shape: list[int], start: int, end: int) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "data_offsets": [start, end]}


def archive() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as zipped:
        zipped.writestr("data.pkl", b"\x80\x04N.")
    return file.getvalue()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "w.safetensors"
    save_weights(path, ARRAYS, ABOUT)
    return path


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    save_weights(path, ARRAYS, ABOUT)
    return path


def refusal(path: Path, **how: Any) -> str:
    with pytest.raises(WeightsError) as caught:
        load_weights(path, **how)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 400
    assert str(path) in text
    return text


def test_what_is_written_reads_back(file: Path) -> None:
    weights = load_weights(file, expected)
    assert weights.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert dict(weights.about) == ABOUT
    assert list(weights.arrays) == ["a", "b", "scalar"]
    for name, array in weights.arrays.items():
        assert array.dtype == np.float32
        assert array.flags.c_contiguous
        np.testing.assert_array_equal(array, ARRAYS[name].astype(np.float16).astype(np.float32))


def test_weights_cannot_be_altered(file: Path) -> None:
    weights = load_weights(file)
    with pytest.raises(ValueError, match="read-only"):
        weights.arrays["b"][0, 0] = 1.0
    with pytest.raises(TypeError):
        weights.arrays["c"] = np.zeros(1, np.float32)  # type: ignore[index]
    given = np.zeros(2, np.float32)
    made = Weights({"a": given}, "")
    given[0] = 1.0
    assert not made.arrays["a"].any()


def test_single_precision_files_are_read_too(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    path.write_bytes(save({"a": np.array([1e-9, 1e9], np.float32)}, {module._ENTRY: ENTRY}))
    np.testing.assert_array_equal(load_weights(path).arrays["a"], np.array([1e-9, 1e9], np.float32))


def test_the_same_weights_give_the_same_bytes(file: Path, tmp_path: Path) -> None:
    backwards = {name: np.array(ARRAYS[name], order="F") for name in reversed(ARRAYS)}
    digest = save_weights(tmp_path / "again", backwards, dict(reversed(ABOUT.items())))
    assert (tmp_path / "again").read_bytes() == file.read_bytes()
    assert digest == load_weights(file).sha256
    code = (
        "import numpy as np; from pathlib import Path; from decoder.weights import save_weights;"
        f"print(save_weights(Path({str(tmp_path / 'other')!r}), {{'x': np.ones(3), 'y': np.ones(2)}},"
        "{'k%d' % k: 'v' for k in range(20)}))"
    )
    digests = {
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                       cwd=Path(module.__file__).parent.parent).stdout
        for _ in range(3)
    }  # fmt: skip
    assert len(digests) == 1


def test_a_failed_write_leaves_what_was_there(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = file.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space"):
        save_weights(file, {"a": np.zeros(2)}, {})
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("arrays", "about", "words"),
    [
        ({}, {}, "no array"),
        ({"a": np.array([1.0, np.nan])}, {}, "'a' holds a number that is not finite"),
        ({"a": np.array([7e4])}, {}, "'a' holds a number that is too large for 16 bits"),
        ({"a": np.array(["x"])}, {}, "must hold numbers"),
        ({"__metadata__": np.zeros(1)}, {}, "taken"),
        ({"a": np.zeros(1)}, {"version": "2"}, "taken"),
        ({"a": np.zeros(1)}, {"steps": 3}, "texts"),
    ],
)
def test_weights_that_cannot_be_written_are_refused(
    tmp_path: Path, arrays: dict[str, Any], about: dict[str, Any], words: str
) -> None:
    with pytest.raises(WeightsError, match=words):
        save_weights(tmp_path / "w", arrays, about)
    assert not list(tmp_path.iterdir())


GOOD_META = {module._ENTRY: ENTRY}
BROKEN: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "the file is empty"),
    "short": (b"\x01\x00", "not a readable safetensors file"),
    "text": (b"this is no file of weights, it is a text\n" * 9, "not a readable safetensors file"),
    "pointer to large file storage": (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "not a readable"),
    "pickle": (b"\x80\x04\x95\x10\x00\x00\x00\x00\x00\x00\x00\x8c\x02os\x94.", "not a readable safetensors file"),
    "zip": (archive(), "not a readable safetensors file"),
    "header of 2^63 bytes": (struct.pack("<Q", 2**63) + b"{}", "not a readable safetensors file"),
    "header of 90 MB that is not there": (struct.pack("<Q", 90_000_000) + b"{}", "not a readable safetensors file"),
    "header is not JSON": (raw(b"{nonsense"), "not a readable safetensors file"),
    "header is a list": (raw(b"[1, 2]"), "not a readable safetensors file"),
    "array of 2^60 numbers": (raw({"a": tensor("F16", [2**60], 0, 2**61)}), "not a readable safetensors file"),
    "sizes that overflow": (raw({"a": tensor("F16", [2**62, 2**62], 0, 4)}, b"0000"), "not a readable safetensors"),
    "vast shape of no number": (raw({"a": tensor("F16", [0, 2**62, 2**62], 0, 0)}), "not a readable safetensors"),
    "arrays that share bytes": (
        raw({"a": tensor("F16", [2], 0, 4), "b": tensor("F16", [2], 2, 6)}, b"000000"), "not a readable safetensors",
    ),
    "bytes left over": (raw({"a": tensor("F16", [1], 0, 2)}, b"0000"), "not a readable safetensors file"),
    "unknown type": (raw({"a": tensor("F13", [1], 0, 2)}, b"00"), "not a readable safetensors file"),
    "no array": (save({}, GOOD_META), "there is no array"),
    "foreign": (save({"a": np.zeros(2, np.float16)}), "not of this program"),
    "foreign, with metadata": (save({"a": np.zeros(2, np.float16)}, {"format": "pt"}), "not of this program"),
    "whole numbers": (save({"a": np.zeros(2, np.int32)}, GOOD_META), "numbers of type I32; weights are F16 or F32"),
    "version of tomorrow": (
        save({"a": np.zeros(2, np.float16)}, {module._ENTRY: '{"version": "2"}'}), "format version is '2', this",
    ),
    "no version": (save({"a": np.zeros(2, np.float16)}, {module._ENTRY: "{}"}), "format version is 'none'"),
    "metadata is no object": (save({"a": np.zeros(2, np.float16)}, {module._ENTRY: "[]"}), "JSON object of texts"),
    "metadata holds a number": (
        save({"a": np.zeros(2, np.float16)}, {module._ENTRY: '{"version": 1}'}), "JSON object of texts",
    ),
    "metadata is deep": (
        save({"a": np.zeros(2, np.float16)}, {module._ENTRY: "[" * 99_999}), "JSON object of texts",
    ),
    "not a number": (save({"a": np.array([np.nan], np.float16)}, GOOD_META), "'a' holds a number that is not finite"),
    "infinite": (save({"a": np.array([-np.inf], np.float32)}, GOOD_META), "'a' holds a number that is not finite"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_a_file_that_does_not_hold_weights_is_one_clear_line(tmp_path: Path, kind: str) -> None:
    data, words = BROKEN[kind]
    path = tmp_path / "bad.safetensors"
    path.write_bytes(data)
    tracemalloc.start()
    try:
        assert words in refusal(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6  # Nothing that was only announced was made.
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("arrays", "about", "words"),
    [
        ({"a": (2,), "b": (2, 3)}, ABOUT, "array 'scalar' is missing; this architecture has 3 arrays"),
        ({"a": (2,), "b": (2, 3), "c": (1,), "scalar": ()}, ABOUT, "array 'c' has no place in this architecture"),
        ({"a": (2,), "b": (3, 2), "scalar": ()}, ABOUT, "array 'b' has shape (3, 2), expected (2, 3)"),
        ({"a": (2,), "b": (2, 3), "scalar": ()}, {}, "says of its architecture cannot be used ('width')"),
        ({"a": (2,), "b": (2, 3), "scalar": ()}, {"width": "wide"}, "says of its architecture cannot be used (inv"),
    ],
)
def test_another_architecture_is_refused(
    tmp_path: Path, arrays: dict[str, tuple[int, ...]], about: dict[str, str], words: str
) -> None:
    path = tmp_path / "other.safetensors"
    save_weights(path, {name: np.zeros(shape) for name, shape in arrays.items()}, about)
    assert words in refusal(path, expected=expected)


def test_a_file_that_is_no_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe.safetensors")
    assert "not a regular file" in refusal(tmp_path / "pipe.safetensors")
    with pytest.raises(FileNotFoundError):
        load_weights(tmp_path / "none.safetensors")
    with pytest.raises(IsADirectoryError):
        load_weights(tmp_path)
    monkeypatch.setattr(module, "MOST_BYTES", 10)
    (tmp_path / "large.safetensors").write_bytes(b"x" * 11)
    assert "at most 10 are read" in refusal(tmp_path / "large.safetensors")


@pytest.fixture
def shipped(file: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """These weights in the place of those that ship."""
    monkeypatch.setattr(module, "SHIPPED", file.resolve())
    monkeypatch.setattr(module, "DIGEST", file.with_suffix(".sha256"))
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    file.with_suffix(".sha256").write_text(f"{digest}  {file.name}\n")
    return file


def test_the_file_that_ships_must_have_the_digest_that_is_recorded(shipped: Path) -> None:
    assert load_weights(shipped).about == ABOUT
    save_weights(shipped, {"a": np.zeros(2)}, {})
    assert "w.sha256 records" in refusal(shipped)
    shipped.with_suffix(".sha256").write_bytes(b"")
    assert "records nothing" in refusal(shipped)
    shipped.with_suffix(".sha256").unlink()
    with pytest.raises(WeightsError, match=r"w\.sha256 is missing; install bodyplan again"):
        load_weights(shipped)
    shipped.unlink()
    with pytest.raises(WeightsError, match=r"w\.safetensors is missing; install bodyplan again"):
        load_weights(shipped)


def test_another_file_needs_no_recorded_digest(shipped: Path, tmp_path: Path) -> None:
    save_weights(tmp_path / "own.safetensors", {"a": np.zeros(2)}, {})
    assert load_weights(tmp_path / "own.safetensors").arrays["a"].shape == (2,)


@given(data=st.data())
def test_altered_bytes_are_refused_or_are_weights(data: st.DataObject, good: Path) -> None:
    original = good.read_bytes()
    changed = bytearray(original)
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    length = data.draw(st.integers(0, len(changed)) | st.just(len(changed)))
    path = good.with_name("fuzzed.safetensors")
    path.write_bytes(bytes(changed[:length]) + data.draw(st.binary(max_size=9)))
    try:
        weights = load_weights(path, expected)
    except WeightsError as error:
        assert "\n" not in str(error)  # noqa: PT017 - both outcomes are right
    else:
        assert {name: array.shape for name, array in weights.arrays.items()} == expected(weights.about)
        assert all(np.isfinite(array).all() for array in weights.arrays.values())


@given(st.integers(0, 2**64 - 1) | st.integers(0, 300), st.binary(max_size=300))
def test_no_bytes_do_harm(size: int, rest: bytes) -> None:
    with pytest.raises(WeightsError):
        module._parse(struct.pack("<Q", size) + rest)


@given(st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=9) | st.sampled_from(["F16", "F32", "I8", "BOOL"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(["a", "__metadata__", "dtype", "shape", "data_offsets", module._ENTRY]), inner, max_size=4),
    max_leaves=8,
))  # fmt: skip
def test_no_header_does_harm(header: object) -> None:
    try:
        about, arrays = module._parse(raw(header, b"\0\0\0\0"))
    except WeightsError:
        return
    raise AssertionError(f"{header} was taken for weights: {about}, {arrays}")
