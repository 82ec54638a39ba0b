"""Reading a JSON document field by field: nothing is defaulted or ignored, and every complaint is one short line."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_SIDE = 4096  # numbers along a side of an array: a bundle is read on a small computer
MOST_SHOWN = 80  # characters of a wrong value that a complaint repeats


class BundleError(ValueError):
    """A policy bundle is unusable; the message names the field, the value and the bound."""


def read_json(path: Path) -> Any:
    """The document of a file.

    Raises:
        BundleError: It is no JSON, or has a number that is not finite.
        FileNotFoundError: There is none.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except BundleError as error:
        raise BundleError(f"{path}: {error}") from None
    except (ValueError, RecursionError, NotADirectoryError, IsADirectoryError) as error:
        raise BundleError(f"{path} is not a JSON file: {shown(error)}.") from None


def shown(value: Any) -> str:
    """A wrong value as a complaint repeats it: in one line, cut where it is long."""
    try:
        text = str(value) if isinstance(value, Exception) else repr(value)
    except (ValueError, RecursionError):  # Python writes no whole number of more than 4300 digits
        text = f"a {type(value).__name__} that is too long to show"
    text = " ".join(text.split())
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def same_names(what: str, found: set[str], expected: set[str]) -> None:
    """Refuse a set of names that is not the expected one."""
    missing, unknown = sorted(expected - found), sorted(found - expected)
    if missing or unknown:
        raise BundleError(f"{what} disagree: missing {shown(missing)}, unknown {shown(unknown)}.")


def record(what: str, document: Any, fields: tuple[str, ...]) -> dict[str, Any]:
    """An object with exactly these fields."""
    if not isinstance(document, dict):
        raise BundleError(f"{what} must be a JSON object, got {shown(document)}.")
    same_names(what, set(document), set(fields))
    return document


def text(what: str, value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise BundleError(f"{what} must be text, got {shown(value)}.")
    return value


def number(what: str, value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise BundleError(f"{what} must be a finite number, got {shown(value)}.")
    return float(value)


def numbers(what: str, value: Any, count: int) -> list[float]:
    """A list of `count` finite numbers."""
    if not isinstance(value, list) or len(value) != count:
        raise BundleError(f"{what} must be a list of {count} numbers, got {shown(value)}.")
    return [number(what, item) for item in value]


def array(what: str, value: Any, axes: int) -> Array:
    """A list of finite numbers (axes = 1), or a rectangular list of such lists (axes = 2)."""
    rows = value if axes == 2 else [value]
    if not isinstance(rows, list) or not rows or not all(isinstance(row, list) for row in rows):
        raise BundleError(f"{what} must be {'a matrix' if axes == 2 else 'a list of numbers'}.")
    width = len(rows[0])
    if not 0 < width <= MOST_SIDE or len(rows) > MOST_SIDE or any(len(row) != width for row in rows):
        raise BundleError(f"{what} must be rectangular with 1 to {MOST_SIDE} numbers a side.")
    found = np.array([[number(what, item) for item in row] for row in rows])
    return found if axes == 2 else found[0]


def _refuse_constant(text: str) -> float:
    raise BundleError(f"every number must be finite, got {text}.")
