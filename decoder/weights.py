"""Weights of the learned decoder: safetensors files, written and checked. The only importer of safetensors.

A file holds named arrays of half-precision numbers and one metadata entry, `bodyplan-weights`: a JSON object of texts
with the version of this format among them. One entry, because safetensors writes several in an order that differs from
run to run, and the same weights must give the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

VERSION = "1"
SUFFIX = ".safetensors"
SHIPPED = Path(__file__).resolve().parent / "weights" / f"vae{SUFFIX}"
DIGEST = SHIPPED.with_suffix(".sha256")  # as sha256sum writes it: 64 hex digits, then the name
MOST_BYTES = 512 * 2**20  # of a file; what ships has less than a tenth of that
_ENTRY = "bodyplan-weights"
_TYPES = ("F16", "F32")  # of the numbers in a file that can be read, in the words of safetensors
_HEADER_SIZE = struct.Struct("<Q")
# What safetensors and numpy raise on bytes that are no such file, or one that was cut or altered.
_DAMAGED = (SafetensorError, ValueError, TypeError, KeyError, OverflowError, MemoryError, RuntimeError)
Shapes = Mapping[str, tuple[int, ...]]


class WeightsError(ValueError):
    """A file that does not hold weights this program can use, or weights that cannot be written."""


@dataclass(frozen=True, eq=False)
class Weights:
    """Trained numbers and what they are; two with the same digest are the same.

    Attributes:
        arrays: by name, f4 whatever the file holds, every number finite, read-only.
        sha256: of the file, 64 hex digits; empty for weights that come from no file.
        about: what whoever wrote them said: architecture, training, figures.

    Raises:
        WeightsError: if there is no array, or one holds something else than finite numbers.
    """

    arrays: Mapping[str, NDArray[np.float32]] = field(repr=False)
    sha256: str
    about: Mapping[str, str] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        """Freeze copies of the arrays."""
        if not self.arrays:
            raise WeightsError("there is no array among these weights")
        frozen = {name: _frozen(value, name, np.dtype(np.float32)) for name, value in sorted(self.arrays.items())}
        object.__setattr__(self, "arrays", MappingProxyType(frozen))
        object.__setattr__(self, "about", MappingProxyType(dict(self.about)))


def load_weights(path: Path = SHIPPED, expected: Callable[[Mapping[str, str]], Shapes] | None = None) -> Weights:
    """Read weights that `save_weights` wrote; no code runs, and nothing is taken on trust.

    Args:
        path: of the file. The one that ships must have the digest that is recorded beside it.
        expected: from what the file says about itself to the shape of every array of that architecture.

    Raises:
        WeightsError: if the file is empty, truncated, altered, foreign, of another version or another architecture, or
            holds a number that is not finite; and if the file that ships is missing.
        OSError: if it cannot be read at all.
    """
    path = Path(path)
    shipped = path.resolve() == SHIPPED
    if shipped and not (path.exists() and DIGEST.exists()):
        missing = DIGEST if path.exists() else path
        raise WeightsError(f"{missing} is missing; install bodyplan again, or use the decoder genome")
    data = _read(path)
    digest = hashlib.sha256(data).hexdigest()
    try:
        if shipped:
            _check_digest(digest)
        about, arrays = _parse(data)
        if expected is not None:
            _check_shapes({name: array.shape for name, array in arrays.items()}, about, expected)
        return Weights(arrays, digest, about)
    except WeightsError as error:
        raise WeightsError(f"{path}: {error}") from None


def save_weights(path: Path, arrays: Mapping[str, ArrayLike], about: Mapping[str, str]) -> str:
    """Write weights as half-precision numbers, whole or not at all; the same weights give the same bytes.

    Args:
        path: of the file, which is replaced.
        arrays: by name, one or more.
        about: texts that describe them; `version` is taken.

    Returns:
        The SHA-256 of the file, 64 hex digits.

    Raises:
        WeightsError: if there is no array, a number is not finite or too large for half precision, or a name is taken.
        OSError: if it cannot be written.
    """
    if not arrays:
        raise WeightsError("there is no array among these weights")
    if "version" in about or "__metadata__" in arrays:
        raise WeightsError("the names 'version' of a text and '__metadata__' of an array are taken; choose others")
    if not all(isinstance(text, str) for entry in about.items() for text in entry):
        raise WeightsError("what is said about weights must be texts under names")
    halves = {name: _frozen(value, name, np.dtype("<f2")) for name, value in sorted(arrays.items())}
    data = save(halves, {_ENTRY: json.dumps({**about, "version": VERSION}, sort_keys=True)})
    path = Path(path)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(data)
    os.replace(partial, path)
    return hashlib.sha256(data).hexdigest()


def _frozen(value: ArrayLike, name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
    given = np.asarray(value)
    if given.dtype.kind not in "fiu":
        raise WeightsError(f"array {name[:80]!r} holds {given.dtype}; it must hold numbers")
    with np.errstate(over="ignore", invalid="ignore"):
        array = np.array(given, dtype, order="C")
    if not np.isfinite(array).all():
        why = f"too large for {8 * dtype.itemsize} bits" if np.isfinite(given).all() else "not finite"
        raise WeightsError(f"array {name[:80]!r} holds a number that is {why}")
    array.setflags(write=False)
    return array


def _read(path: Path) -> bytes:
    status = path.stat()
    if not stat.S_ISDIR(status.st_mode):  # For a folder, reading says it better.
        if not stat.S_ISREG(status.st_mode):
            raise WeightsError(f"{path} is not a regular file")
        if status.st_size > MOST_BYTES:
            raise WeightsError(f"{path}: weights of {status.st_size} bytes; at most {MOST_BYTES} are read")
    return path.read_bytes()


def _check_digest(digest: str) -> None:
    words = DIGEST.read_bytes().decode("ascii", "replace").split()
    recorded = words[0].lower() if words else "nothing"
    if digest != recorded:
        raise WeightsError(
            f"the SHA-256 is {digest[:16]}..., but {DIGEST.name} records {recorded[:16]}...; "
            "the file was altered: install bodyplan again"
        )


def _parse(data: bytes) -> tuple[dict[str, str], dict[str, NDArray[Any]]]:
    """What the file says about itself, and its arrays as they are stored."""
    if not data:
        raise WeightsError("the file is empty")
    try:
        # safetensors checks that the header fits the bytes that are there before anything of that size is made.
        arrays = load(data)
        header = json.loads(data[_HEADER_SIZE.size : _HEADER_SIZE.size + _HEADER_SIZE.unpack_from(data)[0]])
    except _DAMAGED as error:
        raise WeightsError(f"not a readable safetensors file ({_first_line(error)})") from None
    other = sorted({tensor["dtype"] for name, tensor in header.items() if name != "__metadata__"} - set(_TYPES))
    if other:
        raise WeightsError(f"the file holds numbers of type {other[0]}; weights are {' or '.join(_TYPES)}")
    return _about((header.get("__metadata__") or {}).get(_ENTRY)), arrays


def _about(entry: str | None) -> dict[str, str]:
    if entry is None:
        raise WeightsError(f"a safetensors file, but not of this program: it lacks the metadata {_ENTRY!r}")
    try:
        about = json.loads(entry)
    except (ValueError, RecursionError):
        about = None
    if not isinstance(about, dict) or not all(isinstance(text, str) for text in about.values()):
        raise WeightsError(f"the metadata {_ENTRY!r} is not a JSON object of texts")
    version = about.pop("version", "none")
    if version != VERSION:
        raise WeightsError(f"format version is {version[:20]!r}, this program reads version {VERSION}")
    return about


def _check_shapes(
    found: Shapes, about: Mapping[str, str], expected: Callable[[Mapping[str, str]], Shapes]
) -> None:  # fmt: skip
    try:
        wanted = expected(about)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise WeightsError(f"what the file says of its architecture cannot be used ({_first_line(error)})") from None
    for name in sorted(wanted.keys() | found.keys()):
        if name not in found:
            raise WeightsError(f"array {name[:80]!r} is missing; this architecture has {len(wanted)} arrays")
        if name not in wanted:
            raise WeightsError(f"array {name[:80]!r} has no place in this architecture")
        if tuple(found[name]) != tuple(wanted[name]):
            raise WeightsError(f"array {name[:80]!r} has shape {tuple(found[name])}, expected {tuple(wanted[name])}")


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]
