"""TOML files checked against typed records: one clear line for the first thing that is wrong."""

from __future__ import annotations

import difflib
import math
import tomllib
import typing
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import msgspec
from msgspec import Meta, Struct

from experiments.output import BadInput
from experiments.toml_text import toml_value

S = TypeVar("S", bound=Struct)


def read_document(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        BadInput: if it is none.
        OSError: if it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise BadInput(f"{path} is not a text file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{path} is not a TOML file: {error}") from None


def checked(document: dict[str, Any], record: type[S], name: str) -> S:
    """Turn a document into its record.

    Args:
        document: tables and values.
        record: what it must hold.
        name: of the file, for messages.

    Raises:
        BadInput: naming the key, its value, what is allowed and, for a typo, what was probably meant.
    """
    _refuse(document, record, name, "")
    return msgspec.convert(document, record)


def _refuse(document: dict[str, Any], record: type[Struct], name: str, prefix: str) -> None:
    """Find the first thing that is wrong, in the order of the file."""
    hints = typing.get_type_hints(record, include_extras=True)
    for key, value in document.items():
        full = prefix + key
        if key not in hints:
            raise BadInput(f"{name}: unknown key {full}{remedy(key, list(hints), nouns=True)}")
        hint = hints[key]
        if isinstance(hint, type) and issubclass(hint, Struct):
            if not isinstance(value, dict):
                raise BadInput(f"{name}: {full} = {shown(value)}; it must be a table: write [{full}]")
            _refuse(value, hint, name, full + ".")
            continue
        finite = not isinstance(value, float) or math.isfinite(value)
        try:
            msgspec.convert(value, hint)
        except msgspec.ValidationError:
            finite = False
        if not finite:
            raise BadInput(
                f"{name}: {full} = {shown(value)}; it must be {_allowed(hint)}{remedy(value, choices(hint))}"
            )
    for field in msgspec.structs.fields(record):
        if field.required and field.name not in document:
            raise BadInput(f"{name}: {prefix}{field.name} is missing; it must be {_allowed(hints[field.name])}")


def _allowed(hint: Any) -> str:
    """What a key takes, in words."""
    if hint is bool:
        return "true | false"
    if get_origin(hint) is Literal:
        return " | ".join(f'"{choice}"' for choice in get_args(hint))
    plain = [part for part in get_args(hint) if part is not type(None)]
    if get_origin(hint) is not Annotated:  # X | None
        return _allowed(plain[0])
    base, meta = plain
    if base is str:
        return str(meta.description or "a text that is not empty")
    low = f"({meta.gt:g}" if meta.gt is not None else f"[{meta.ge:g}"
    noun = "a whole number" if base is int else "a number"
    return f"{noun} in {low}, {meta.le if base is int else format(meta.le, 'g')}]"


def choices(hint: Any) -> list[str]:
    """The names that a key takes."""
    if get_origin(hint) is Literal:
        return [str(choice) for choice in get_args(hint)]
    return next((list(meta.examples or ()) for meta in get_args(hint) if isinstance(meta, Meta)), [])


def remedy(value: object, known: list[str], nouns: bool = False) -> str:
    """The end of a message: what was probably meant."""
    close = difflib.get_close_matches(str(value), known, n=1)
    if close:
        return f"; did you mean {close[0]}?" if nouns else f'; did you mean "{close[0]}"?'
    return f"; known here are {', '.join(known)}" if nouns else ""


def shown(value: object) -> str:
    """A value as one would write it in the file, cut short."""
    if value is None:
        return "not set"
    try:
        text = toml_value(value)
    except TypeError:
        text = "a table" if isinstance(value, dict) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."
