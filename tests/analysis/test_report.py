from __future__ import annotations

import base64
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from analysis.records import RecordsError
from analysis.report import write_report

VOID = {"meta", "img", "br"}
WINNER = {"design": "0" * 15 + "1", "generation": 0, "candidate": 1, "distance_m": 2.5, "seconds": 10.0,
          "body_length_m": 0.5, "speed_m_s": 0.26, "s_mfg": 3.2, "mass_kg": 4.0, "fell": False,
          "cost_of_transport": None}  # fmt: skip
BLUEPRINT = {"design": "0" * 15 + "1", "notes": ["root <moved>"], "joints": [{}, {}], "robot": {"mass": 4.0},
             "scores": {"motor": 0.5, "electronics": 0.9, "cable": None, "total": 3.2},
             "parts": [{"material": "rigid"}, {"material": "soft"}],
             "bodies": [{"plate": 0}, {"plate": 1}]}  # fmt: skip
DRY = {"ticks": 500, "overruns": 0, "tracking_rms_rad": 0.05, "speed_m_s": 0.2, "state": "off", "latched": None}
GUARD = {"guard": "torque", "joint": "joint_1", "value": 20.0, "bound": 19.9}
BOM = "kind,item,quantity,unit,mass_g,note\nmotor,J60-6,2,pcs,960.0,x\nscrew,M4,12,pcs,,y\n"


class Checker(HTMLParser):
    """Tags that open and close, and every address that the page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag, attributes):
        assert tag not in ("script", "link", "iframe", "object")
        if tag not in VOID:
            self.open.append(tag)
        self.loads += [value for name, value in attributes if name in ("src", "href", "poster", "srcset")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(path: Path) -> str:
    """Check that the page is whole and loads nothing from outside; its text."""
    html = path.read_text("utf-8")
    checker = Checker()
    checker.feed(html)
    assert checker.open == []
    assert all(address.startswith("data:") for address in checker.loads)
    assert not re.search(r"url\(|@import|https?://", html)
    return " ".join(" ".join(checker.text).split())


def picture() -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.zeros((9, 12, 3), np.uint8)).save(file, "PNG")
    return file.getvalue()


FILES: dict[str, bytes] = {
    "result.json": json.dumps({"kind": "evolve", "winner": WINNER, "seconds": 12.0}).encode(),
    "best/blueprint/blueprint.json": json.dumps(BLUEPRINT).encode(),
    "best/blueprint/blueprint.png": picture(),
    "best/blueprint/bom.csv": BOM.encode(),
    "best/walk.png": picture(),
    "best/walk.mp4": b"film",
    "best/dry_run.json": json.dumps(DRY).encode(),
}


def fill(folder: Path, without: str = "") -> None:
    for name, data in FILES.items():
        if name != without:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)


def test_a_full_run_is_told(run_folder):
    folder = run_folder()
    fill(folder)
    path = write_report(folder)
    assert path == folder / "report.html"
    text = read(path)
    for said in ("5.0 × its own length", "2.50 m", "3.20 of 5", "J60-6", "960 g", "control periods 500",
                 "16 of 24 designs can be built: 66.7 %", "No rigid body is large enough", "joint_2 <is> & bad",
                 "root <moved>", "bodyplan deploy best/bundle --bus virtual --dry-run", "numpy 9.9.9",
                 "on 2 plates"):  # fmt: skip
        assert said in text, said
    assert "not finished" not in text
    html = path.read_text("utf-8")
    assert base64.b64encode(FILES["best/walk.png"]).decode() in html
    assert base64.b64encode(b"film").decode() in html


@pytest.mark.parametrize("missing", FILES)
def test_any_file_may_be_missing(run_folder, missing):
    folder = run_folder("sketch")  # the quickest page with all that is optional
    fill(folder, without=missing)
    text = read(write_report(folder))
    assert "How to repeat it" in text
    assert "nan" not in text.lower().replace("nanopi", "")


@pytest.mark.parametrize("damaged", [name for name in FILES if name.endswith((".json", ".csv"))])
def test_a_damaged_file_is_no_end(run_folder, damaged):
    folder = run_folder("sketch")
    fill(folder)
    for data in (b"{", b"[]", b"\xff\xfe", b""):
        (folder / damaged).write_bytes(data)
        assert "How to repeat it" in read(write_report(folder))


def test_an_unfinished_run_says_so(run_folder):
    folder = run_folder()
    text = read(write_report(folder))
    assert "This run is not finished: 24 of 24 bodies" in text
    assert "it has no winner yet" in text


def test_a_run_without_a_winner_says_what_to_try(run_folder):
    folder = run_folder()
    (folder / "result.json").write_text(json.dumps({"kind": "evolve", "winner": None}))
    assert "Try more generations" in read(write_report(folder))


def test_a_run_that_has_just_begun(run_folder):
    text = read(write_report(run_folder(n=0)))
    assert "No design has been evaluated yet" in text


def test_a_guard_that_stopped_the_dry_run_is_named(run_folder):
    folder = run_folder()
    fill(folder)
    (folder / "best/dry_run.json").write_text(json.dumps({**DRY, "latched": GUARD}))
    text = read(write_report(folder))
    assert "The guard 'torque' stopped it at joint joint_1: 20.0 is beyond 19.9." in text


def test_a_study(run_folder):
    folder = run_folder("study", n=200)
    (folder / "study.json").write_text(json.dumps({"n": 200, "seconds": 9.0}))
    (folder / "sheet.png").write_bytes(picture())
    text = read(write_report(folder))
    assert "200 random bodies" in text
    assert "67.0 % can be built" in text
    assert "random labels do as well with probability" in text
    assert "Left out, because too few or because they say nothing about the design: worker (16)" in text
    assert "winner" not in text.lower()


@pytest.mark.parametrize("failure", [None, {"stage": "motor", "reason": "no_overlap", "detail": "joint_1"}])
def test_a_sketch(run_folder, failure):
    folder = run_folder("sketch")
    if failure is None:
        fill(folder)
    winner = None if failure else WINNER
    (folder / "result.json").write_text(json.dumps({"kind": "sketch", "winner": winner, "failure": failure}))
    text = read(write_report(folder))
    assert ("This body cannot be built." in text) == (failure is not None)
    assert ("its own length" in text) == (failure is None)
    assert "What passes" not in text


def test_the_same_run_gives_the_same_page(run_folder):
    folder = run_folder("sketch")
    fill(folder)
    first = write_report(folder).read_bytes()
    assert write_report(folder).read_bytes() == first


@pytest.mark.parametrize("prepare", [lambda _: None, Path.mkdir, lambda path: path.write_text("x")])
def test_what_is_no_run_is_refused_by_name(tmp_path, prepare):
    prepare(tmp_path / "given")
    with pytest.raises(RecordsError, match="given"):
        write_report(tmp_path / "given")
