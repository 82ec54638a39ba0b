"""The shipped parts are sound and sourced; a file that is wrong is refused in one line that says where and what."""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfg.catalogue import Motor
from mfg.component_file import BOUNDS, KINDS, LISTS, WHOLE, ComponentError, part_text, read_part
from mfg.component_looks import TOLERANCE
from mfg.library import SHIPPED
from mfg.mounts import housing, mount_of
from mfg.parts import PAPER
from mfg.stl import MM_PER_M, stl_bytes

FILES = sorted(SHIPPED.glob("*.toml"))
MOTOR = (SHIPPED / "motor_j60_6.toml").read_text()


def edited(tmp_path: Path, change: str, to: str, text: str = MOTOR) -> Path:
    """A motor's file with one passage replaced."""
    assert change in text
    path = tmp_path / "motor.toml"
    path.write_text(text.replace(change, to, 1))
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ComponentError) as caught:
        read_part(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_a_shipped_part_survives_being_written_and_read(path: Path, tmp_path: Path):
    kind, part = read_part(path)
    copy = tmp_path / "copy.toml"
    copy.write_text(part_text(kind, part, tomllib.loads(path.read_text())["sources"]))
    assert read_part(copy) == (kind, part)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_every_number_of_a_shipped_part_has_its_source(path: Path):
    _, part = read_part(path)
    document = tomllib.loads(path.read_text())
    for name, value in document.items():
        if name not in ("kind", "role", "sources", "devices") and not isinstance(value, str):
            assert re.search(rf"\b{name}\b", part.source), name


def test_every_number_has_bounds_that_hold_it():
    for f in {f.name: f for kind in KINDS.values() for f in fields(kind)}.values():
        known = f.name in BOUNDS or f.type in ("str", "str | None") or f.name in (
            "devices", "body_screws", "output_screws", "looks")  # fmt: skip
        assert known, f.name
    assert set(LISTS) | WHOLE <= set(BOUNDS)
    assert all(low < high for low, high in BOUNDS.values())


@pytest.mark.parametrize(
    ("change", "to", "said"),
    [
        ("mass = 0.480", "mas = 0.480", "mas is no field of a motor.*did you mean mass"),
        ("mass = 0.480", "", "mass is missing"),
        ("mass = 0.480", 'mass = "0.480"', "mass is '0.480', it must be a number"),
        ("mass = 0.480", "mass = true", "mass is True, it must be a number"),
        ("mass = 0.480", "mass = nan", r"mass is nan, it must lie in \[0.0001, 10\]"),
        ("mass = 0.480", "mass = inf", r"mass is inf, it must lie in \[0.0001, 10\]$"),
        ("mass = 0.480", "mass = 480", r"mass is 480, it must lie in \[0.0001, 10\] in SI units .did you mean 0.48\?"),
        ("mass = 0.480", "mass = 9" + 400 * "9", "mass is 9"),
        ("mass = 0.480", "mass = " + 5000 * "9", "not readable as TOML"),
        ("mass = 0.480", "mass = 0x" + 5000 * "f", "mass is a number with too many digits, it must lie in"),
        ("mass = 0.480", "mass = [0x" + 5000 * "f" + "]", "mass is a number with too many digits, it must be a number"),
        ("mass = 0.480", '"a\\nb" = 1', r"'a\\nb' is no field"),
        ("mass = 0.480", "mass = 2020-01-01", "mass is datetime.date.*must be a number"),
        ("mass = 0.480", "mass = " + 3000 * "[" + 3000 * "]", "."),
        ("mass = 0.480", "mass = [0.48]", "mass is .*must be a number"),
        ("count = 6", "count = 6000", r"body_screws.count is 6000, it must lie in \[2, 24\]$"),
        ("diameter = 0.0765", "diameter = 76.5", "diameter is 76.5, .*did you mean 0.0765"),
        ("count = 6", "count = 6.0", "body_screws.count is 6.0, it must be a whole number"),
        ("circle_radius = 0.030", "circle_radius = 0.037", "body_screws.circle_radius is 0.037, with screw heads"),
        ("head_diameter = 0.0075", "head_diameter = 0.003", "body_screws.head_diameter is 0.003"),
        ("head_diameter", "haed_diameter", "body_screws.haed_diameter is no field.*did you mean head_diameter"),
        ("[18.0, 36.0]", "[18.0]", "voltage_range is .*list of 2 numbers"),
        ("[18.0, 36.0]", "[25.0, 36.0]", "voltage_range is .*must hold voltage = 24"),
        ("[18.0, 36.0]", "[18.0, -1.0]", r"voltage_range\[1\] is -1.0, it must lie in"),
        ("continuous_torque = 6.646666666666667", "continuous_torque = 30", "continuous_torque is 30.0.*peak_torque"),
        ('driver = "j60"', 'driver = "j61"', "driver is 'j61', it must be one of j60, none .did you mean j60"),
        ('kind = "motor"', 'kind = "mottor"', "kind is 'mottor', .*did you mean motor"),
        ('kind = "motor"', "", "kind is None, it must be one of motor"),
        ('name = "J60-6"', 'name = ""', "name is '', it must be a text"),
        ('name = "J60-6"', 'name = "a\\nb"', "name is .*printable"),
        ('["friction", "latency"]', '["friction"]', "no source covers latency"),
        ('["friction", "latency"]', '["friction", "latency", "mas"]', "the file states no such number.*mass"),
        ('["friction", "latency"]', '["friction", "latency", "mass"]', "covers it already"),
        ("[sources]", "[source]", "source is no field of a motor.*did you mean sources"),
        ("mass = 0.480", 'mass = 0.480\nmesh = "../motor.stl"', "mesh is .*beside this one"),
        ("mass = 0.480", 'mass = 0.480\nmesh = "none.stl"', "mesh is 'none.stl', it cannot be read"),
        ("mass = 0.480", "mass = ", "not readable as TOML"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_one_line(change: str, to: str, said: str, tmp_path: Path):
    assert re.search(said, refusal(edited(tmp_path, change, to)))


@given(data=st.binary(max_size=300))
def test_garbage_is_refused(data: bytes, tmp_path_factory: pytest.TempPathFactory):
    path = tmp_path_factory.mktemp("garbage") / "part.toml"
    path.write_bytes(data)
    refusal(path)


LINES = st.integers(0, len(MOTOR.splitlines()) - 1)
VALUES = st.one_of(st.floats(), st.integers(-(10**400), 10**400), st.text(max_size=20), st.booleans(),
                   st.lists(st.floats(), max_size=4))  # fmt: skip


@given(line=LINES, value=VALUES)
def test_a_field_of_any_value_is_read_within_bounds_or_refused(line, value, tmp_path_factory):
    lines = MOTOR.splitlines()
    if " = " not in lines[line]:
        return
    shown = str(value).lower() if isinstance(value, bool) else repr(value)
    lines[line] = f"{lines[line].split(' = ')[0]} = {shown}"
    path = tmp_path_factory.mktemp("mutated") / "part.toml"
    path.write_text("\n".join(lines))
    try:
        _, part = read_part(path)
    except ComponentError:
        refusal(path)
        return
    assert isinstance(part, Motor)
    for name in (f.name for f in fields(part) if f.name in BOUNDS and f.name not in LISTS):
        low, high = BOUNDS[name]
        assert math.isfinite(getattr(part, name))
        assert low <= getattr(part, name) <= high


def stl_text(vertices: np.ndarray, triangles: np.ndarray) -> bytes:
    lines = ["solid looks"]
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x!r} {y!r} {z!r}" for x, y, z in vertices[triangle].tolist()]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid"]).encode()


@pytest.mark.parametrize("text", [False, True])
def test_looks_are_read_from_binary_and_text_stl(text: bool, tmp_path: Path):
    body = housing(mount_of(PAPER.motor))
    millimetres = body.vertices * MM_PER_M
    data = stl_text(millimetres, body.triangles) if text else stl_bytes(millimetres, body.triangles, "motor")
    (tmp_path / "motor.stl").write_bytes(data)
    _, part = read_part(edited(tmp_path, "mass = 0.480", 'mass = 0.480\nmesh = "motor.stl"'))
    assert isinstance(part, Motor)
    assert part.looks is not None
    assert len(part.looks.triangles) == len(body.triangles)
    np.testing.assert_allclose(part.looks.vertices[part.looks.triangles].sum(), body.vertices[body.triangles].sum(),
                               atol=1e-4)  # fmt: skip
    assert replace(part, looks=None) == part  # looks never count: the same motor with the same mount


@pytest.mark.parametrize(
    ("scale", "shift", "said"),
    [
        (1.0, 0.0, None),
        (1.0, 0.9 * TOLERANCE, None),
        (1.0, 1.2 * TOLERANCE, "leaves the cylinder of 76.5 x 63.0 mm about its origin by 1.2 mm"),
        (1.05, 0.0, "leaves the cylinder"),
        (0.001, 0.0, "fills 0 % of the part's extent.*in mm"),
    ],
)
def test_looks_must_fit_their_part(scale: float, shift: float, said: str | None, tmp_path: Path):
    body = housing(mount_of(PAPER.motor))
    vertices = (body.vertices * scale + [0.0, 0.0, shift]) * MM_PER_M
    (tmp_path / "motor.stl").write_bytes(stl_bytes(vertices, body.triangles, "motor"))
    path = edited(tmp_path, "mass = 0.480", 'mass = 0.480\nmesh = "motor.stl"')
    if said is None:
        read_part(path)
    else:
        assert re.search(said, refusal(path))


@pytest.mark.parametrize("data", [b"", b"solid\nvertex 1 2", b"solid\nvertex a b c", b"\0" * 90, b"solid\nend"])
def test_looks_that_are_no_stl_are_refused(data: bytes, tmp_path: Path):
    (tmp_path / "motor.stl").write_bytes(data)
    assert "STL" in refusal(edited(tmp_path, "mass = 0.480", 'mass = 0.480\nmesh = "motor.stl"'))
