"""One folder holds one run: whatever else is told to write there is refused, and what is there stays as it is."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from experiments import run_folder
from experiments.config import Evolve, Sketch, Study, load_config
from experiments.run_folder import RUN_FILES, finished, keep_config, opened

Command = Callable[..., Any]
CONFIGS = {
    "evolve": 'kind = "evolve"\nseed = 4\ndecoder = "genome"\n[search]\ngenerations = 1\npopsize = 4\n',
    "study": 'kind = "study"\nseed = 4\ndecoder = "genome"\nn = 3\n',
    "sketch": 'kind = "sketch"\nseed = 4\ndesign = "hinge.npz"\n',
}


@pytest.fixture
def configs(hinge_file: Path) -> dict[str, Path]:
    """Configuration files by kind, beside the design that the sketch is of."""
    for kind, text in CONFIGS.items():
        (hinge_file.parent / f"{kind}.toml").write_text(text)
    return {kind: hinge_file.parent / f"{kind}.toml" for kind in CONFIGS}


def begin(path: Path, folder: Path) -> None:
    """What a run leaves that was stopped early; of a sketch one that is finished."""
    config = load_config(path)
    folder.mkdir()
    if isinstance(config, Evolve | Study):
        with opened(config, folder / RUN_FILES[config.kind], 4, resume=False):
            pass
        return
    keep_config(config, folder)
    (folder / "result.json").write_text('{"kind": "sketch", "winner": null}')
    (folder / "report.html").write_text("<html>")


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"}


@pytest.mark.parametrize("words", [[], ["--resume"]], ids=["anew", "resumed"])
@pytest.mark.parametrize(("there", "now"), list(itertools.permutations(CONFIGS, 2)))
def test_a_run_of_another_kind_is_refused_and_nothing_is_touched(
    bodyplan: Command, configs: dict[str, Path], tmp_path: Path, there: str, now: str, words: list[str]
) -> None:
    folder = tmp_path / "out"
    begin(configs[there], folder)
    before = content(folder)
    said = bodyplan("run", configs[now], "--out", folder, *words)
    assert said.status == 2
    assert f'holds a run of kind "{there}", this one is "{now}"; choose another --out' in said.err
    assert said.err.count("\n") == 1
    assert content(folder) == before


@pytest.mark.parametrize("words", [[], ["--resume"]], ids=["anew", "resumed"])
@pytest.mark.parametrize("kind", CONFIGS)
def test_a_run_of_another_configuration_is_refused_and_nothing_is_touched(
    bodyplan: Command, configs: dict[str, Path], tmp_path: Path, kind: str, words: list[str]
) -> None:
    folder = tmp_path / "out"
    begin(configs[kind], folder)
    before = content(folder)
    configs[kind].write_text(CONFIGS[kind].replace("seed = 4", "seed = 5"))
    said = bodyplan("run", configs[kind], "--out", folder, *words)
    assert said.status == 2
    assert "was made with another configuration: seed was 4 and is now 5" in said.err
    assert said.err.count("\n") == 1
    assert content(folder) == before


@pytest.mark.parametrize("kind", CONFIGS)
@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("config.toml", "colour = 3", "may hold another run, choose another --out: "),
        ("config.toml", "not toml", "may hold another run, choose another --out: "),
        ("result.json", "{}", "holds result.json of another run, but no config.toml"),
        ("study.json", "{}", "holds study.json of another run, but no config.toml"),
        ("study.sqlite", "not a database, but long enough to be taken for one" * 20, "study.sqlite: "),
    ],
)
def test_files_of_unknown_origin_are_not_written_over(
    bodyplan: Command, configs: dict[str, Path], tmp_path: Path, kind: str, name: str, text: str, message: str
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / name).write_text(text)
    said = bodyplan("run", configs[kind], "--out", folder, "--resume")
    assert said.status == 2
    assert message in said.err
    assert said.err.count("\n") == 1
    assert content(folder) == {name: text.encode()}


@pytest.mark.parametrize(("kind", "result"), [("evolve", "result.json"), ("study", "study.json")])
def test_a_result_whose_run_file_is_gone_is_not_passed_off_as_that_of_a_new_run(
    bodyplan: Command, configs: dict[str, Path], tmp_path: Path, kind: str, result: str
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    keep_config(load_config(configs[kind]), folder)
    (folder / result).write_text(json.dumps({"kind": kind, "winner": None}))
    (folder / "report.html").write_text("<html>")
    said = bodyplan("run", configs[kind], "--out", folder, "--resume")
    assert said.status == 2
    assert f"holds {result} but not the {RUN_FILES[kind]} it came from" in said.err
    assert not (folder / RUN_FILES[kind]).exists()


def test_a_configuration_beside_its_own_run_keeps_its_comments(configs: dict[str, Path], tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    text = "# mine\n" + CONFIGS["evolve"]
    (folder / "config.toml").write_text(text)
    config = load_config(folder / "config.toml")
    assert isinstance(config, Evolve)
    with opened(config, folder / "run.sqlite", 4, resume=False):
        pass
    assert (folder / "config.toml").read_text() == text


def test_only_a_whole_result_of_the_kind_counts_as_finished(tmp_path: Path) -> None:
    result = {"kind": "evolve", "winner": {"design": "k"}, "out": "where it was once"}
    (tmp_path / "result.json").write_text(json.dumps(result))
    assert finished("evolve", tmp_path) is None  # the report comes last.
    (tmp_path / "report.html").write_text("<html>")
    assert finished("evolve", tmp_path) == {**result, "out": str(tmp_path)}
    assert finished("sketch", tmp_path) is None
    for text in (b"", b"{", b"[]", b"\xff\xfe", b'{"kind": "evolve"}'):
        (tmp_path / "result.json").write_bytes(text)
        assert finished("evolve", tmp_path) is None


def test_the_configuration_of_a_sketch_leads_to_the_same_design(configs: dict[str, Path], tmp_path: Path) -> None:
    config = load_config(configs["sketch"])
    assert isinstance(config, Sketch)
    folder = tmp_path / "out"
    folder.mkdir()
    keep_config(config, folder)
    assert load_config(folder / "config.toml") == config
    run_folder.check_folder(config, folder)
