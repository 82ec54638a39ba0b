"""Parts other than the paper's go through the pipeline and are what the folder names; the paper's say what they did."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gaits_in_brief import QUADRUPED

from decoder.sketch import load_design
from mfg.component_looks import Looks
from mfg.description import describe
from mfg.export import blueprint_files
from mfg.library import read_library
from mfg.manifest import component_json, read_description
from mfg.mounts import mount_of
from mfg.parts import PAPER
from mfg.picture import MOTOR, blueprint_shapes
from mfg.pipeline import Outcome, build

LIBRARY = read_library()
# Of the paper's catalogue in the manifest, before parts had fields with defaults.
PAPER_DIGEST = "9bd6f3886d60c561a3e33da50987917fb783f8a236abdd16eb12cc1827bdcb56"


@pytest.fixture(scope="module")
def built() -> Outcome:
    motor = next(m for m in LIBRARY.motors if m.name == "CyberGear")
    battery = next(b for b in LIBRARY.batteries if b.name == "6S LiPo 1300 mAh")
    box = next(c for c in LIBRARY.controllers if c.name == "flat controller box")
    auto = replace(PAPER, name="auto", motor=motor, battery=battery, computer=box, wire=LIBRARY.wires[0])
    outcome = build(load_design(QUADRUPED), auto)
    assert outcome.ok, str(outcome.failure)
    return outcome


def test_the_papers_catalogue_is_written_as_ever():
    text = json.dumps(component_json(PAPER), indent=1, ensure_ascii=False)
    assert hashlib.sha256(text.encode()).hexdigest() == PAPER_DIGEST


def test_manifest_and_bill_of_materials_name_the_chosen_parts(built: Outcome, tmp_path: Path):
    catalogue = built.blueprint.catalogue
    files = blueprint_files(built.blueprint)
    document = json.loads(files["blueprint.json"])
    assert document["catalogue"]["name"] == "auto"
    for kind in ("motor", "battery", "computer", "wire", "rigid", "soft", "printer"):
        assert document["catalogue"][kind]["name"] == getattr(catalogue, kind).name
    assert document["catalogue"]["motor"]["driver"] == "none"  # so that nobody takes it for one that can be driven
    assert document["catalogue"]["computer"]["max_joints"] == 30
    assert {joint["motor"] for joint in document["joints"]} == {catalogue.motor.name}
    items = {row["item"]: row for row in csv.DictReader(io.StringIO(files["bom.csv"].decode()))}
    for part in (catalogue.motor, catalogue.battery, catalogue.wire, catalogue.rigid, *catalogue.computer.devices):
        assert part.name in items
    assert items["CyberGear"]["quantity"] == "4"
    assert float(items["CyberGear"]["mass_g"]) == pytest.approx(4 * 317)
    (tmp_path / "blueprint.json").write_bytes(files["blueprint.json"])
    read, told = read_description(tmp_path), describe(built.blueprint)
    assert [joint.motor for joint in read.joints] == [joint.motor for joint in told.joints]


def test_every_shipped_motor_has_a_sound_mount():
    for motor in LIBRARY.motors:
        mount = mount_of(motor)
        assert mount.holder_radius > mount.cavity_radius > mount.housing_radius > 0
        assert motor.output_screws.circle_radius + motor.output_screws.head_diameter / 2 < mount.connector_radius


def test_looks_show_in_pictures_and_change_nothing_else(built: Outcome):
    plain = built.blueprint
    corner = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]])
    looks = Looks(corner, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    catalogue = replace(plain.catalogue, motor=replace(plain.catalogue.motor, looks=looks))
    seen = replace(plain, catalogue=catalogue)
    assert component_json(catalogue) == component_json(plain.catalogue)
    motors = [[s for s in blueprint_shapes(b) if s.colour == MOTOR] for b in (plain, seen)]
    assert len(motors[0]) == len(motors[1]) == len(plain.seats)
    assert {len(s.triangles) for s in motors[1]} == {4}
    assert {len(s.triangles) for s in motors[0]} != {4}
    for shape, seat in zip(motors[1], plain.seats, strict=True):
        np.testing.assert_allclose(shape.vertices[0], seat.T_design_motor[:3, 3])
