"""The assembly guide as a file: sound HTML, whole pictures, every name, the same bytes."""

from __future__ import annotations

import base64
import hashlib
import io
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hardware.j60 import BITRATE, Code
from mfg.addresses import can_address
from mfg.assembly import assembly_steps, part_names
from mfg.export import blueprint_files, write_blueprint
from mfg.guide import NAME, guide_html
from mfg.guide_prose import BRING_UP, FIRST_RUN, HOMING
from mfg.guide_text import BEARING, HEAD_RATIO, cut_length, holding_torque, setup_rows, tightening_torque
from mfg.manifest import changed_files
from mfg.pipeline import Outcome
from mfg.plate import arrange
from mfg.splitting import pieces
from mfg.wiring_diagram import bus_ends

VOID = {"meta", "img", "br"}
ROOT = Path(__file__).parents[2]


class Page(HTMLParser):
    """Tags must balance; text, attributes and pictures are kept."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.names: set[str] = set()
        self.text = ""
        self.pictures: list[str] = []
        self.links: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        given = dict(attrs)
        assert len(given) == len(attrs), (tag, attrs)
        for key in ("src", "href"):
            if key in given:
                (self.pictures if str(given[key]).startswith("data:") else self.links).append(str(given[key]))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def guide_of(outcome: Outcome, **changes: object) -> bytes:
    blueprint = replace(outcome.blueprint, **changes)  # type: ignore[arg-type]
    points = [piece.points for piece in pieces(blueprint)]
    return guide_html(blueprint, arrange(points, blueprint.catalogue.printer.volume), "layer 0.3 mm <&>")


@pytest.fixture(scope="module")
def html(built: Outcome) -> str:
    return guide_of(built).decode()


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_the_page_is_sound_and_stands_alone(page: Page, html: str) -> None:
    assert page.open == []
    assert page.links == []
    assert not page.names & {"script", "link", "iframe", "object"}
    assert html.count("http") == html.count('xmlns="http://www.w3.org/2000/svg"')
    assert "url(" not in html
    assert "<!DOCTYPE html>" in html
    assert "size: A4" in html
    assert len(html.encode()) < 4_000_000


def test_every_picture_decodes_and_shows_something(page: Page, built: Outcome) -> None:
    joints, printed, lids = len(built.blueprint.seats), len(pieces(built.blueprint)), len(built.blueprint.lids)
    # cover, parts on plates, all apart, a motor and a join per joint, two boxes with their lids, each joint turned
    assert len(page.pictures) == 1 + printed + 1 + 2 * joints + 2 + lids + joints
    for uri in page.pictures:
        head, data = uri.split(",", 1)
        assert head == "data:image/png;base64"
        image = Image.open(io.BytesIO(base64.b64decode(data, validate=True)))
        image.load()
        grey = np.asarray(image.convert("L"))
        assert 0.02 < (grey < 235).mean() < 0.98


def test_every_part_motor_id_and_cable_is_named(page: Page, built: Outcome) -> None:
    blueprint = built.blueprint
    for name in part_names(blueprint):
        if not name.endswith(("_motor", "_screws")):
            assert name in page.text, name
    for k, seat in enumerate(blueprint.seats):
        bus, address = can_address(k)
        assert f"motor of {blueprint.hinges[seat.hinge].name}" in page.text
        assert f"{bus} id {address}" in page.text
    for wire in blueprint.wires:
        assert f"{wire.name}: cut {1e3 * cut_length(wire.length):.0f} mm" in page.text
        assert wire.length + 0.12 <= cut_length(wire.length) < wire.length + 0.1301
    assert blueprint.design.key in page.text
    assert f"{sum(m.mass for m in blueprint.masses):.2f} kg" in page.text
    for text in ("120 Ω", "18 V", "--dry-run", "--set-home", "layer 0.3 mm <&>"):
        assert text in page.text


def test_the_guide_is_the_same_in_another_process(built: Outcome, html: str, tmp_path: Path) -> None:
    assert guide_of(built).decode() == html
    built.design.save(tmp_path / "design.npz")
    code = (
        "import sys, hashlib; from decoder.design import VoxelDesign; from mfg.pipeline import build\n"
        "from mfg.export import blueprint_files\n"
        "files = blueprint_files(build(VoxelDesign.load(sys.argv[1])).blueprint, guide=True)\n"
        "print(hashlib.sha256(files['guide.html']).hexdigest())"
    )
    run = [sys.executable, "-c", code, str(tmp_path / "design.npz")]
    there = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    here = blueprint_files(built.blueprint, guide=True)[NAME]
    assert there == hashlib.sha256(here).hexdigest()


def test_odd_names_are_text_and_nothing_else(built: Outcome) -> None:
    odd = "<script>\"x\" & 'y'</script> ü"
    bodies = tuple(replace(body, name=f"{odd}{k}") for k, body in enumerate(built.blueprint.bodies))
    parts = tuple(replace(part, name=f"{odd} {part.name}") for part in built.blueprint.parts)
    lids = tuple(replace(lid, part=f"{odd} {lid.part}") for lid in built.blueprint.lids)
    battery = replace(built.blueprint.catalogue.battery, name=odd)
    catalogue = replace(built.blueprint.catalogue, battery=battery)
    page = Page(guide_of(built, bodies=bodies, parts=parts, lids=lids, catalogue=catalogue, notes=(odd,)).decode())
    assert page.open == []
    assert "script" not in page.names
    assert page.text.count(odd) > 10


def test_trouble_is_told_with_advice(built: Outcome, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = tuple(
        replace(step, trouble="the bone of torso stands in the way by 1.00 cm3")
        if step.kind in ("join", "motor", "box", "body_screws") else step
        for step in assembly_steps(built.blueprint)
    )  # fmt: skip
    monkeypatch.setattr("mfg.guide.assembly_steps", lambda _: steps)
    text = Page(guide_of(built).decode()).text
    assert text.count("stands in the way by 1.00 cm3") == sum(bool(step.trouble) for step in steps)


def test_the_folder_holds_it_with_its_hash_only_if_asked(built: Outcome, tmp_path: Path) -> None:
    folder = write_blueprint(built, tmp_path / "robot", guide=True)
    assert (folder / NAME).is_file()
    assert changed_files(folder) == []
    (folder / NAME).write_bytes(b"other")
    assert changed_files(folder) == [NAME]
    assert not (write_blueprint(built, folder) / NAME).exists()


def test_the_frames_are_those_of_the_motors_driver(built: Outcome) -> None:
    for k, row in enumerate(setup_rows(built.blueprint)):
        bus, address = can_address(k)
        assert row[1:3] == [bus, str(address)]
        give, store, read = (command.removeprefix(f"cansend {bus} ") for command in row[3:])
        assert give == f"{Code.SET_ID << 5 | 1:03X}#{address:02X}"
        assert store == f"{Code.SAVE_CONFIG << 5 | address:03X}#"
        assert read == f"{Code.CONFIG << 5 | address:03X}#"
    assert f"bitrate {BITRATE} " in BRING_UP


def test_every_command_in_the_guide_is_one_of_ours() -> None:
    from experiments.cli import main

    commands = [command for _, command in (*HOMING, *FIRST_RUN) if command]
    assert any("--dry-run" in c for c in commands)
    for command in commands:
        words = command.replace("BUNDLE", "/nonexistent/bundle").replace("first.log", "/nonexistent/first.log").split()
        assert words[0] == "bodyplan"
        assert main(words[1:]) == 2  # Understood, and the folder is missing; argparse would end the process.


def test_torques_press_the_plastic_and_hold_the_motor(built: Outcome) -> None:
    motor = built.blueprint.catalogue.motor
    for pattern in (motor.body_screws, motor.output_screws):
        ring = np.pi / 4 * ((HEAD_RATIO * 4e-3) ** 2 - pattern.hole_diameter**2)
        force = tightening_torque(pattern) / (0.2 * 4e-3)
        assert force / ring == pytest.approx(BEARING)
        assert 0.3 < tightening_torque(pattern) < 1.5  # what M4 in aluminium bears
        assert holding_torque(pattern) > motor.peak_torque


def test_the_resistor_sits_at_the_longest_cable_of_each_bus(built: Outcome) -> None:
    ends = bus_ends(built.blueprint)
    lengths = {wire.seat: wire.length for wire in built.blueprint.wires}
    for bus, end in ends.items():
        assert lengths[end] == max(v for k, v in lengths.items() if can_address(k)[0] == bus)
