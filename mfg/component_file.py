"""One part in a TOML file, checked field by field.

A file holds one part: `kind` (one of `KINDS`), the fields of its type in `mfg.catalogue` in SI units, if wanted
`mesh = "file.stl"` beside it for its looks, and a table `[sources]` from a source (or "assumed: why") to the numbers
that it covers; every number must be covered once. Whatever is wrong is one line: file, field, value, what is allowed.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any

from mfg.catalogue import Battery, Computer, Device, Filament, Motor, Printer, ScrewPattern, Wire
from mfg.component_looks import LooksError, read_looks

Part = Motor | Computer | Battery | Wire | Filament | Printer | Device
LONGEST_TEXT = 120  # of a name or a source [characters]
LARGEST_FILE = 100_000  # [bytes]
ROLES = ("rigid", "soft")
DRIVERS = ("j60", "none")  # wire formats that `hardware` speaks, and that it speaks none of a motor's
KINDS: dict[str, type[Part]] = {
    "motor": Motor, "controller": Computer, "battery": Battery, "wire": Wire, "filament": Filament,
    "printer": Printer, "encoder": Device,
}  # fmt: skip
WITH_LOOKS = (Motor, Computer, Battery)

# Least and greatest value of every number, wherever it stands; beyond these it is a slip of the unit or the pen.
BOUNDS: dict[str, tuple[float, float]] = {
    "diameter": (0.001, 0.2), "length": (0.005, 0.3), "mass": (1e-4, 10.0),
    "peak_torque": (0.05, 200.0), "continuous_torque": (0.02, 200.0), "max_speed": (0.5, 200.0),
    "voltage": (3.0, 60.0), "voltage_range": (3.0, 70.0), "torque_constant": (0.005, 20.0), "armature": (1e-7, 1.0),
    "friction": (0.0, 10.0), "stiffness": (1.0, 1023.0), "damping": (0.0, 51.0), "latency": (0.0, 0.1),
    "size": (0.001, 0.5), "max_joints": (1, 64), "capacity": (0.05, 50.0), "max_current": (0.1, 500.0),
    "mass_per_metre": (0.001, 1.0), "bend_radius": (0.001, 0.2), "density": (100.0, 10_000.0),
    "youngs_modulus": (1e5, 1e12), "walls": (1, 20), "infill": (0.0, 1.0), "volume": (0.05, 2.0),
    "nozzle": (1e-4, 2e-3), "line_width": (1e-4, 4e-3), "layer_height": (2e-5, 2e-3), "interlock_depth": (0.0, 0.02),
    "count": (2, 24), "circle_radius": (0.003, 0.1), "hole_diameter": (0.001, 0.02), "head_diameter": (0.001, 0.04),
}  # fmt: skip
WHOLE = {"max_joints", "walls", "count"}
LISTS = {"size": 3, "volume": 3, "voltage_range": 2}
CHOICES = {"driver": DRIVERS}
OURS = ("kind", "role", "mesh", "sources")  # what a file says beyond the fields of its type


class ComponentError(ValueError):
    """A file that is no part; the message is one line with file, field, value and what is allowed."""


def read_part(path: Path | str) -> tuple[str, Part]:
    """Read one file: the kind of part ("rigid filament" and "soft filament" are two) and the part.

    Raises:
        ComponentError: as said above.
        OSError: if it cannot be read.
    """
    path = Path(path)
    if path.stat().st_size > LARGEST_FILE:
        raise ComponentError(f"{path}: is {path.stat().st_size} bytes long, a part takes at most {LARGEST_FILE}")
    try:
        document = tomllib.loads(path.read_bytes().decode("utf-8"))
    except (ValueError, RecursionError) as error:  # a ValueError also where an integer has too many digits
        raise ComponentError(f"{path}: not readable as TOML ({str(error).splitlines()[0][:120]})") from None
    kind = document.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ComponentError(f"{path}: kind is {_shown(kind, quoted=True)}, it must be {_one_of(kind, KINDS)}")
    return _Reader(path, kind).read(document)


def part_text(kind: str, part: Part, sources: Mapping[str, Iterable[str]]) -> str:
    """A file that reads back as this part, but for its `source` and `looks`; the inverse of `read_part`.

    Args:
        kind: as `read_part` gives it.
        part: to be written.
        sources: the numbers that each source covers.
    """
    role, _, name = kind.rpartition(" ")
    lines = [f'kind = "{name}"'] + ([f'role = "{role}"'] if role else [])
    tables: list[str] = []
    for f in fields(part):
        value = getattr(part, f.name)
        if value is None or f.name == "looks" or (f.name == "source" and not isinstance(part, Device)):
            continue
        if isinstance(value, ScrewPattern):
            tables += ["", f"[{f.name}]", *(f"{g.name} = {_toml(getattr(value, g.name))}" for g in fields(value))]
        elif f.name == "devices":
            for device in value:
                tables += ["", "[[devices]]", *(f"{g.name} = {_toml(getattr(device, g.name))}" for g in fields(device))]
        elif f.name != "source":
            lines.append(f"{f.name} = {_toml(value)}")
    tables += ["", "[sources]", *(f"{_toml(source)} = {_toml(list(names))}" for source, names in sources.items())]
    return "\n".join([*lines, *tables]) + "\n"


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reads the fields of one file; `where` is the table within it, e.g. "body_screws."."""

    path: Path
    kind: str

    def read(self, document: dict[str, Any]) -> tuple[str, Part]:
        made = KINDS[self.kind]
        own = set(OURS) - (set() if made is Filament else {"role"}) - (set() if made in WITH_LOOKS else {"mesh"})
        body = {name: value for name, value in document.items() if name not in own}
        names = [f.name for f in fields(made) if f.name not in ("source", "looks")]
        values = self._fields(made, body, names, "", sorted(own))
        values["source"] = self._sources(document.get("sources"), [n for n in body if not isinstance(body[n], str)])
        group = self.kind
        if made is Filament:
            role = document.get("role")
            if role not in ROLES:
                raise self._error("role", role, f"it must be {_one_of(role, ROLES)}")
            group = f"{role} filament"
        part = made(**values)
        self._coherent(part)
        if "mesh" in document:
            part = self._with_looks(part, document["mesh"])
        return group, part

    def _fields(
        self, made: type, body: dict[str, Any], names: list[str], where: str, also: Iterable[str] = ()
    ) -> dict[str, Any]:
        for name in body:
            if name not in names:
                raise ComponentError(f"{self.path}: {where}{_shown(name)} is no field of a {self.kind}, "
                                     f"expected {_one_of(name, [*names, *also])}")  # fmt: skip
        defaults = {f.name for f in fields(made) if f.default is not MISSING}
        missing = [name for name in names if name not in body and name not in defaults]
        if missing:
            raise ComponentError(f"{self.path}: {where}{missing[0]} is missing, a {self.kind} must state it")
        return {name: self._value(where, name, value) for name, value in body.items()}

    def _value(self, where: str, name: str, value: Any) -> Any:
        if name in LISTS:
            if not isinstance(value, list) or len(value) != LISTS[name]:
                raise self._error(where + name, value, f"it must be a list of {LISTS[name]} numbers")
            return tuple(self._number(f"{where}{name}[{k}]", name, v) for k, v in enumerate(value))
        if name in BOUNDS:
            return self._number(where + name, name, value)
        if name in ("body_screws", "output_screws"):
            return ScrewPattern(**self._table(ScrewPattern, name, value))
        if name == "devices":
            if not isinstance(value, list) or not value:
                raise self._error(name, value, "it must be a list of tables [[devices]]")
            return tuple(Device(**self._table(Device, f"devices[{k}]", item)) for k, item in enumerate(value))
        if not isinstance(value, str) or not value.strip() or len(value) > LONGEST_TEXT or not value.isprintable():
            raise self._error(where + name, value, f"it must be a text of 1 to {LONGEST_TEXT} printable characters")
        if name in CHOICES and value not in CHOICES[name]:
            raise self._error(where + name, value, f"it must be {_one_of(value, CHOICES[name])}")
        if name == "colour" and not (len(value) == 7 and value[0] == "#" and set(value[1:]) <= _HEX):
            raise self._error(where + name, value, 'it must be a colour such as "#3E7CB1"')
        return value

    def _table(self, made: type, name: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self._error(name, value, "it must be a table")
        return self._fields(made, value, [f.name for f in fields(made)], f"{name}.")

    def _number(self, label: str, name: str, value: Any) -> float:
        low, high = BOUNDS[name]
        whole = name in WHOLE
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
            raise self._error(label, value, f"it must be a {'whole ' if whole else ''}number")
        if not low <= value <= high:  # NaN too
            milli = not whole and 1000 * low <= value <= 1000 * high
            meant = f" in SI units (did you mean {value / 1000:g}?)" if milli else ""
            raise self._error(label, value, f"it must lie in [{low:g}, {high:g}]{meant}")
        return value if whole else float(value)

    def _sources(self, table: Any, numbers: list[str]) -> str:
        """Check that every number has one source; return them as one line."""
        if not isinstance(table, dict):
            raise ComponentError(f'{self.path}: a table [sources] must say where the numbers come from, or "assumed"')
        covered: dict[str, str] = {}
        for source, names in table.items():
            self._value("sources.", "source", source)
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise self._error(f"sources.{source!r}", names, "it must be a list of the numbers it covers")
            for name in names:
                if name in covered:
                    raise self._error(f"sources.{source!r}", name, f"{covered[name]!r} covers it already")
                if name not in numbers and name != "devices":
                    known = f"expected {_one_of(name, numbers)}"
                    raise self._error(f"sources.{source!r}", name, f"the file states no such number, {known}")
                covered[name] = source
        bare = [name for name in numbers if name not in covered and name != "devices"]  # devices have their own source
        if bare:
            raise ComponentError(f'{self.path}: no source covers {bare[0]}; name one, or "assumed", in [sources]')
        return "; ".join(f"{source} ({', '.join(names)})" for source, names in table.items())

    def _coherent(self, part: Part) -> None:
        """Refuse numbers that are each possible and together not."""
        if isinstance(part, Motor):
            if part.continuous_torque > part.peak_torque:
                raise self._error("continuous_torque", part.continuous_torque,
                                  f"it must not exceed peak_torque = {part.peak_torque:g}")  # fmt: skip
            low, high = part.voltage_range or (part.voltage, part.voltage)
            if not low <= part.voltage <= high:
                raise self._error("voltage_range", [low, high], f"it must hold voltage = {part.voltage:g}")
            for name, pattern in (("body_screws", part.body_screws), ("output_screws", part.output_screws)):
                reach = pattern.circle_radius + pattern.head_diameter / 2
                if reach > part.diameter / 2:
                    raise self._error(f"{name}.circle_radius", pattern.circle_radius,
                                      f"with screw heads it must fit the radius of {part.diameter / 2:g}")  # fmt: skip
                if pattern.head_diameter < pattern.hole_diameter:
                    raise self._error(f"{name}.head_diameter", pattern.head_diameter,
                                      f"it must be at least hole_diameter = {pattern.hole_diameter:g}")  # fmt: skip
        if isinstance(part, Computer):
            for k, device in enumerate(part.devices):
                if any(a > b for a, b in zip(sorted(device.size), sorted(part.size), strict=True)):
                    raise self._error(f"devices[{k}].size", list(device.size),
                                      f"it must fit the box of {list(part.size)}")  # fmt: skip
        if isinstance(part, Printer) and not part.nozzle / 2 <= part.line_width <= 2 * part.nozzle:
            raise self._error(
                "line_width", part.line_width, f"it must lie within a factor 2 of nozzle = {part.nozzle:g}"
            )

    def _with_looks(self, part: Part, mesh: Any) -> Part:
        if not isinstance(mesh, str) or Path(mesh).name != mesh or not mesh.lower().endswith(".stl"):
            raise self._error("mesh", mesh, "it must be the name of an .stl file beside this one")
        if isinstance(part, Motor):
            room = (part.diameter, part.diameter, part.length)
        elif isinstance(part, Computer | Battery):
            room = part.size
        else:
            raise self._error("mesh", mesh, f"a {self.kind} has no looks")
        try:
            return replace(part, looks=read_looks(self.path.with_name(mesh), room, round_=isinstance(part, Motor)))
        except LooksError as error:
            raise self._error("mesh", mesh, str(error)) from None

    def _error(self, field: str, value: Any, allowed: str) -> ComponentError:
        return ComponentError(f"{self.path}: {field} is {_shown(value, quoted=True)}, {allowed}")


_HEX = set("0123456789abcdefABCDEF")


def _shown(value: Any, *, quoted: bool = False) -> str:
    """A value from a file as one short line, whatever it is."""
    try:
        text = value if isinstance(value, str) and value.isprintable() and not quoted else repr(value)
    except ValueError:
        return "a number with too many digits"  # Python does not print such
    return text if len(text) <= 60 else text[:57] + "..."


def _one_of(value: Any, known: Iterable[str]) -> str:
    names = list(known)
    near = difflib.get_close_matches(str(value), names, 1, 0.6)
    hint = f" (did you mean {near[0]}?)" if near else ""
    return f"one of {', '.join(names)}{hint}"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is no number of a part")
    return repr(value)
