"""What ships is enough and holds the paper's parts; a user's folder adds to it, and nothing is silently left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mfg.component_file import ComponentError
from mfg.library import SHIPPED, read_library
from mfg.parts import PAPER

MOTOR = (SHIPPED / "motor_j60_6.toml").read_text()


def test_the_shipped_library_has_enough_of_every_kind():
    library = read_library()
    assert len(library.motors) >= 3
    assert len(library.controllers) >= 2
    assert len(library.batteries) >= 3
    assert len(library.wires) >= 2
    assert len(library.printers) >= 2
    assert len(library.rigid) + len(library.soft) >= 4
    assert min(len(library.rigid), len(library.soft), len(library.encoders)) >= 1
    assert [m.mass for m in library.motors] == sorted(m.mass for m in library.motors)


def test_the_shipped_parts_hold_the_papers_as_they_are():
    library = read_library()
    motor = next(m for m in library.motors if m.name == PAPER.motor.name)
    assert replace(motor, source=PAPER.motor.source, voltage_range=None) == PAPER.motor
    battery = next(b for b in library.batteries if b.name == PAPER.battery.name)
    assert replace(battery, source=PAPER.battery.source, max_current=None) == PAPER.battery
    wire = next(w for w in library.wires if w.name == PAPER.wire.name)
    assert replace(wire, source=PAPER.wire.source, max_current=None) == PAPER.wire
    for group, part in (
        (library.controllers, PAPER.computer), (library.printers, PAPER.printer), (library.rigid, PAPER.rigid),
        (library.soft, PAPER.soft), (library.encoders, PAPER.joint_encoder),
    ):  # fmt: skip
        assert any(replace(p, source=part.source) == part for p in group), part.name  # type: ignore[type-var]


def test_a_user_adds_a_part_and_replaces_one_by_name(tmp_path: Path):
    assert "mass = 0.480" in MOTOR
    (tmp_path / "motor.toml").write_text(MOTOR.replace("mass = 0.480", "mass = 0.470"))
    (tmp_path / "other.toml").write_text(MOTOR.replace('name = "J60-6"', 'name = "Mine"'))
    library, shipped = read_library(tmp_path), read_library()
    assert {m.name for m in library.motors} == {m.name for m in shipped.motors} | {"Mine"}
    assert next(m for m in library.motors if m.name == "J60-6").mass == 0.470
    assert library.batteries == shipped.batteries


def test_two_files_of_one_part_and_folders_without_any_are_refused(tmp_path: Path):
    with pytest.raises(ComponentError, match="no such folder"):
        read_library(tmp_path / "none")
    with pytest.raises(ComponentError, match=r"holds no \.toml file"):
        read_library(tmp_path)
    for name in "ab":
        (tmp_path / f"{name}.toml").write_text(MOTOR)
    with pytest.raises(ComponentError, match=r"b\.toml: name is 'J60-6', a\.toml holds a motor of that name"):
        read_library(tmp_path)
