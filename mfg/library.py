"""All parts there are to choose from: the shipped ones in mfg/components, and a user's own folder of such files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from mfg.catalogue import Battery, Computer, Device, Filament, Motor, Printer, Wire
from mfg.component_file import ComponentError, Part, read_part

SHIPPED = Path(__file__).parent / "components"

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Library:
    """All parts there are to choose from; each kind in the order of mass, then name.

    Attributes:
        motors, controllers, batteries, wires, printers, encoders: the parts.
        rigid, soft: filaments by role.
    """

    motors: tuple[Motor, ...] = ()
    controllers: tuple[Computer, ...] = ()
    batteries: tuple[Battery, ...] = ()
    wires: tuple[Wire, ...] = ()
    printers: tuple[Printer, ...] = ()
    encoders: tuple[Device, ...] = ()
    rigid: tuple[Filament, ...] = ()
    soft: tuple[Filament, ...] = ()

    def only(self, motors: Iterable[Motor]) -> Library:
        """The same library with these motors only."""
        return replace(self, motors=tuple(motors))


def read_library(folder: Path | str | None = None) -> Library:
    """The shipped parts, and a user's: one of the same kind and name takes the shipped one's place.

    Args:
        folder: with the user's TOML files, or None.

    Raises:
        ComponentError: if a file is no part, two files of the folder name the same part, or there is no such folder.
        OSError: if a file cannot be read.
    """
    found = dict(_shipped())
    if folder is not None:
        folder = Path(folder)
        if not folder.is_dir():
            raise ComponentError(f"{folder}: no such folder of parts")
        paths = sorted(folder.glob("*.toml"))
        if not paths:
            raise ComponentError(f"{folder}: holds no .toml file, expected one per part")
        found |= _read_all(paths)
    groups: dict[str, list[Part]] = {}
    for (group, _), part in found.items():
        groups.setdefault(group, []).append(part)
    ordered = {group: tuple(sorted(parts, key=_order)) for group, parts in groups.items()}
    return Library(
        motors=_of(ordered.get("motor"), Motor), controllers=_of(ordered.get("controller"), Computer),
        batteries=_of(ordered.get("battery"), Battery), wires=_of(ordered.get("wire"), Wire),
        printers=_of(ordered.get("printer"), Printer), encoders=_of(ordered.get("encoder"), Device),
        rigid=_of(ordered.get("rigid filament"), Filament), soft=_of(ordered.get("soft filament"), Filament),
    )  # fmt: skip


@lru_cache(maxsize=1)
def _shipped() -> Mapping[tuple[str, str], Part]:
    return _read_all(sorted(SHIPPED.glob("*.toml")))


def _read_all(paths: Iterable[Path]) -> dict[tuple[str, str], Part]:
    found: dict[tuple[str, str], Part] = {}
    files: dict[tuple[str, str], Path] = {}
    for path in paths:
        group, part = read_part(path)
        key = group, part.name
        if key in found:
            raise ComponentError(
                f"{path}: name is {part.name!r}, {files[key].name} holds a {group} of that name already"
            )
        found[key], files[key] = part, path
    return found


def _of(parts: Iterable[Part] | None, kind: type[_T]) -> tuple[_T, ...]:
    return tuple(part for part in parts or () if isinstance(part, kind))


def _order(part: Part) -> tuple[float, str]:
    mass: Callable[[Any], float] = lambda p: float(getattr(p, "mass", getattr(p, "mass_per_metre", 0.0)))  # noqa: E731
    return mass(part), part.name
