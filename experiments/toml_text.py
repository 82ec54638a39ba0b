"""Configurations as TOML text: Python reads that format and does not write it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import Struct


def flat(config: Struct) -> Iterator[tuple[str, Any]]:
    """Every value under its dotted key, in order."""

    def walk(table: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
        for key, value in table.items():
            if isinstance(value, dict):
                yield from walk(value, f"{prefix}{key}.")
            else:
                yield prefix + key, value

    return walk({k: v for k, v in msgspec.to_builtins(config).items() if v is not None}, "")


def toml_table(table: dict[str, Any], name: str) -> Iterator[str]:
    """Values of a table first, then its tables; no value is None in TOML, so those are left out."""
    if name:
        yield f"\n[{name}]\n"
    for key, value in table.items():
        if value is not None and not isinstance(value, dict):
            yield f"{key} = {toml_value(value)}\n"
    for key, value in table.items():
        if isinstance(value, dict):
            yield from toml_table(value, f"{name}.{key}" if name else key)


def toml_value(value: object) -> str:
    """Write one value.

    Raises:
        TypeError: if TOML has no form for it.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda found: f"\\u{ord(found[0]):04x}", escaped) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    raise TypeError(f"{type(value).__name__} has no place in a configuration")
