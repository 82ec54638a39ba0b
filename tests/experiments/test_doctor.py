"""`bodyplan doctor`: it looks at everything that is declared, and says what is broken."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest

from experiments import doctor

ROOT = Path(doctor.__file__).parent.parent


@pytest.fixture
def light(monkeypatch):
    """Importing every dependency takes seconds; two stand for all."""
    monkeypatch.setattr(doctor, "REQUIRED", (("numpy", "numpy"), ("tqdm", "tqdm")))


def test_doctor_looks_at_every_declared_dependency_and_no_other():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    assert [name for name, _ in doctor.REQUIRED] == [re.split(r"[<>=!~ ]", line)[0] for line in declared]


def test_every_dependency_works_here(bodyplan):
    said = bodyplan("doctor", "--json")
    assert (said.status, said.err) == (0, "")
    report = json.loads(said.out)
    assert report["ok"] is True
    assert report["dependencies"]["mujoco"]["text"].startswith("4.0")
    assert set(report["optional"]) == {"GPU", "GL", "ffmpeg", "slicer", "browser", "CAN", "serial"}


def test_the_table_has_a_line_for_each_finding(bodyplan, light):
    said = bodyplan("doctor")
    assert said.status == 0
    for name in ("python", "cores", "memory", "numpy", "tqdm", "GPU", "GL", "slicer", "CAN"):
        assert re.search(rf"^ +(yes|no)  {name} ", said.out, re.MULTILINE), name
    assert "Everything bodyplan needs is here." in said.out


def stub(folder, name, text):
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\n{text}\n")
    (folder / name).chmod(0o755)


@pytest.mark.parametrize(
    ("programs", "ok", "said"),
    [
        ({}, False, "no PrusaSlicer; build --slice needs it: apt install"),
        ({"orca-slicer": ""}, True, "opens print_bambu.3mf; no PrusaSlicer"),
        ({"prusa-slicer": "echo PrusaSlicer-9.8.7+x based on Slic3r"}, True, "PrusaSlicer 9.8.7 at "),
        ({"prusa-slicer": "exit 1"}, False, "is not PrusaSlicer"),
    ],
)
def test_doctor_says_which_slicer_there_is_and_how_to_get_the_one_that_slices(
    programs, ok, said, tmp_path, monkeypatch
):
    for name, text in programs.items():
        stub(tmp_path / "bin", name, text)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}")
    finding = doctor._slicer()
    assert finding.ok is ok
    assert said in finding.text


def test_a_missing_dependency_is_named_with_its_remedy(bodyplan, monkeypatch):
    monkeypatch.setattr(doctor, "REQUIRED", (("numpy", "numpy"), ("surely-not-there", "surely_not_there")))
    said = bodyplan("doctor", "--json")
    assert said.status == 2
    assert said.err.count("\n") == 1
    assert "surely-not-there" in said.err
    assert "make install" in said.err
    report = json.loads(said.out)
    assert report["ok"] is False
    assert "pip install surely-not-there" in report["dependencies"]["surely-not-there"]["text"]
