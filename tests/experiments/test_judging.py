"""`--catalogue auto` and `--parts` mean the same wherever designs are judged; what is wrong with parts is one line."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import pytest
from gaits_in_brief import QUADRUPED, TINY

import evo.sizing as sizing
from decoder.design import VoxelDesign
from evo.sizing import sized
from experiments import doctor, study
from experiments.judging import judge_of
from mfg.component_file import part_text
from mfg.library import read_library
from mfg.parts import PAPER


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(sizing, "sized", lambda *args, **kwargs: sized(*args, **kwargs, budget=TINY))


@pytest.fixture
def shelf(tmp_path):
    """A folder with a motor of one's own: like the paper's, lighter, by another name."""
    folder = tmp_path / "shelf"
    folder.mkdir()
    motor = replace(PAPER.motor, name="my motor", mass=0.41, voltage_range=(18.0, 36.0))
    numbers = [name for name in motor.__slots__ if name not in ("name", "source", "driver", "looks")]
    (folder / "mine.toml").write_text(part_text("motor", motor, {"assumed: my own scales": numbers}))
    return folder


def test_what_was_chosen_is_in_the_verdict_the_manifest_and_the_bill(bodyplan, quick, tmp_path):
    scored = bodyplan("score", QUADRUPED, "--catalogue", "auto", "--json")
    assert scored.status == 0, scored.err
    parts = json.loads(scored.out)["catalogue"]
    assert parts["name"] == "auto"
    assert "sizing parts, round 1 of at most 6: a gait for the robot with J60-6" in scored.err
    built = bodyplan("build", QUADRUPED, "--catalogue", "auto", "--out", tmp_path / "robot", "--no-guide", "--json")
    assert built.status == 0, built.err
    verdict = json.loads(built.out)
    assert verdict["catalogue"] == parts
    manifest = json.loads((tmp_path / "robot" / "blueprint.json").read_text())
    stated = manifest["catalogue"]
    assert [stated[kind]["name"] for kind in ("motor", "battery", "computer", "wire")] == list(parts.values())[1:]
    assert any(note.startswith("parts chosen in ") for note in manifest["notes"])
    assert manifest["notes"] == verdict["notes"]
    bill = {row["kind"]: row["item"] for row in rows(tmp_path / "robot" / "bom.csv")}
    assert (bill["motor"], bill["battery"], bill["cable"]) == (parts["motor"], parts["battery"], parts["wire"])


def test_a_folder_of_parts_is_chosen_from_too(bodyplan, quick, shelf):
    said = bodyplan("score", QUADRUPED, "--catalogue", "auto", "--parts", shelf, "--json")
    assert said.status == 0, said.err
    assert json.loads(said.out)["catalogue"]["motor"] == "my motor"


def test_simulate_takes_the_robot_with_its_own_parts(bodyplan, quick):
    said = bodyplan("simulate", QUADRUPED, "--catalogue", "auto", "--seconds", 2, "--json")
    assert said.status == 0, said.err
    assert "sizing parts" in said.err
    refused = bodyplan("simulate", QUADRUPED, "--catalogue", "auto", "--virtual")
    assert refused.status == 2
    assert refused.err.count("\n") == 1
    assert "leave --catalogue auto out" in refused.err


def test_a_design_that_no_parts_mend_is_status_1_with_its_own_reason(bodyplan, hinge, tmp_path):
    VoxelDesign(hinge.material, hinge.segment, hinge.pitch, ()).save(tmp_path / "still.npz")
    auto, paper = (bodyplan("score", tmp_path / "still.npz", "--json", *more) for more in (("--catalogue", "auto"), ()))
    assert (auto.status, paper.status) == (1, 1)
    assert auto.err == paper.err
    assert json.loads(auto.out)["failure"] == json.loads(paper.out)["failure"]


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("command", ["score", "build", "study", "simulate"])
@pytest.mark.parametrize(
    ("content", "words", "message"),
    [
        (None, ("--catalogue", "auto"), "no such folder of parts"),
        ("", ("--catalogue", "auto"), "holds no .toml file"),
        ('kind = "moter"', ("--catalogue", "auto"), "kind is 'moter', it must be one of motor, controller"),
        ('kind = "motor"\nmass = 4800.0\n', ("--catalogue", "auto"), "part.toml: name is missing"),
        ("kind = ", ("--catalogue", "auto"), "part.toml: not readable as TOML"),
        ('kind = "motor"', (), "there is nothing to choose from them but with --catalogue auto"),
    ],
    ids=["no folder", "empty", "kind", "missing", "no toml", "paper"],
)  # fmt: skip
def test_what_is_wrong_with_parts_is_one_line(bodyplan, hinge_file, tmp_path, command, content, words, message):
    folder = tmp_path / "parts"
    if content is not None:
        folder.mkdir()
    if content:
        (folder / "part.toml").write_text(content)
    out = () if command in ("score", "simulate") else ("--out", tmp_path / "out")
    design = () if command == "study" else (hinge_file,)
    said = bodyplan(command, *design, *out, *words, "--parts", folder)
    assert said.status == 2, said
    assert said.err.count("\n") == 1
    assert message in said.err
    assert str(folder) in said.err
    assert not (tmp_path / "out").exists()


def test_parts_belong_to_what_a_run_was_made_of(tmp_path, shelf):
    from experiments.config import Study
    from experiments.run_folder import ingredients

    auto = Study("study", n=1, decoder="genome", catalogue="auto")
    mine = Study("study", n=1, decoder="genome", catalogue="auto", parts=str(shelf))
    digests = [ingredients(config)["catalogue of components"] for config in (auto, mine)]
    assert digests[0] != digests[1]
    text = (shelf / "mine.toml").read_text()
    (shelf / "mine.toml").write_text(text.replace("0.41", "0.42"))
    assert ingredients(mine)["catalogue of components"] not in digests
    (shelf / "mine.toml").write_text(text)
    assert ingredients(mine)["catalogue of components"] == digests[1]
    assert judge_of("paper", "auto", shelf).library != judge_of("paper", "auto", None).library


def test_a_study_with_sized_parts_is_the_same_with_any_number_of_workers(bodyplan, tmp_path, monkeypatch):
    monkeypatch.setattr(study, "_draw_examples", lambda *_: None)
    found = []
    for workers in (0, 1):
        said = bodyplan("study", "-n", 2, "--solver", "search", "--catalogue", "auto", "--workers", workers,
                        "--out", tmp_path / str(workers), "--json")  # fmt: skip
        assert said.status == 0, said.err
        result = json.loads(said.out)
        assert result.pop("seconds") > 0
        table = rows(tmp_path / str(workers) / "records.csv")
        found.append((result, [{k: v for k, v in row.items() if k != "seconds"} for row in table]))
    assert found[0] == found[1]
    assert found[0][0]["catalogue"] == "auto"


def test_doctor_lists_all_that_can_be_chosen(bodyplan, monkeypatch):
    monkeypatch.setattr(doctor, "REQUIRED", (("numpy", "numpy"),))
    library = read_library()
    listed = json.loads(bodyplan("doctor", "--json").out)["parts"]
    for kind, parts in (("motor", library.motors), ("battery", library.batteries), ("controller", library.controllers),
                        ("wire", library.wires)):  # fmt: skip
        assert [text.split(":")[0] for text in listed[kind]] == [part.name for part in parts]
    shown = bodyplan("doctor").out
    assert all(text in shown for texts in listed.values() for text in texts)
    assert "--catalogue auto" in shown
