"""The archive of a design: named arrays in a versioned .npz, written and read without pickle."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

FORMAT = "bodyplan-design"
VERSION = 1  # Goes up when an array changes meaning or becomes required; an optional one may come without that.
REQUIRED = ("format", "version", "material", "segment", "pitch", "position", "axis", "range", "link", "confidence")
OPTIONAL = ("depth",)
# What numpy and zipfile raise on bytes that are no archive, or one that was cut or altered.
_DAMAGED = (
    ValueError, TypeError, SyntaxError, KeyError, EOFError, OSError, OverflowError, MemoryError, RuntimeError,
    NotImplementedError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


class DesignError(ValueError):
    """A design that breaks an invariant of the type, or a file that does not hold a design."""


def write_arrays(path: Path | str | BinaryIO, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays with format and version before them, to a path or an open binary file."""
    named: dict[str, Any] = {"format": np.array(FORMAT), "version": np.array(VERSION), **arrays}
    np.savez_compressed(path, **named)


def read_arrays(path: Path | str) -> dict[str, NDArray[Any]]:
    """Every required array of an archive and those optional ones that it holds, by name.

    Raises:
        DesignError: if the file is truncated, foreign, pickled, of another version or lacks an array.
        OSError: if it cannot be read at all.
    """
    with open(path, "rb") as file:  # Opened here: numpy forgets to close a file that it cannot read.
        try:
            with np.load(file, allow_pickle=False) as archive:
                if not isinstance(archive, np.lib.npyio.NpzFile):
                    raise DesignError("this is a single array")
                stored = {name: archive[name] for name in (*REQUIRED, *OPTIONAL) if name in archive.files}
        except _DAMAGED as error:
            raise DesignError(f"{path}: not a readable design archive ({_first_line(error)})") from error
    missing = [name for name in REQUIRED if name not in stored]
    if missing:
        raise DesignError(f"{path}: not a design archive, it lacks {', '.join(missing)}")
    if str(stored["format"]) != FORMAT:
        raise DesignError(f"{path}: format is {str(stored['format'])!r}, expected {FORMAT!r}")
    if stored["version"].size != 1 or stored["version"].dtype.kind not in "iu" or int(stored["version"]) != VERSION:
        raise DesignError(f"{path}: version is {stored['version']}, this program reads version {VERSION}")
    return stored


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]
