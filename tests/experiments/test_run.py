from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decoder.genome import GenomeDecoder
from decoder.weights import Weights, load_weights, save_weights
from evo.evaluation import Candidate, Evaluation, Walk
from evo.judge import Judge
from experiments import best, run, run_folder
from mfg.outcome import Failure, Reason, Scores, Stage
from mfg.parts import PAPER
from mfg.pipeline import RULES
from sim.actor import Gait

CONFIG = """
kind = "evolve"
seed = 4
decoder = "genome"
[search]
generations = 3
popsize = 4
[finals]
heat = 2
"""
GAIT = Gait(1.0, np.ones(2), np.zeros(2), np.zeros(2))
DRY = {"ticks": 500, "overruns": 0, "tracking_rms_rad": 0.01, "speed_m_s": 0.1, "state": "off", "latched": None}
BEHAVIOUR = {"seconds": 10.0, "distance_m": 1.5, "speed_m_s": 0.15, "body_length_m": 0.5, "fell": False}
Command = Callable[..., Any]


class Fake:
    """Stands in for an evaluation in full; stops the run where a test wants that."""

    stop: Callable[[int], object] = staticmethod(lambda _: None)
    calls = 0
    distance = 1.5
    lame = 0  # so many finalists do not walk when they are exported

    def __init__(self, *fields: object) -> None:
        self.fields = fields

    def __call__(self, task: Candidate | Evaluation) -> Evaluation:
        candidate = task if isinstance(task, Candidate) else task.candidate
        Fake.calls += 1
        Fake.stop(Fake.calls)
        value = float(candidate.latent[:8].mean())
        if value < -0.5:
            return Evaluation(candidate, "none", failure=Failure(Stage.MOTOR, Reason.NO_OVERLAP, "planted"))
        walk = Walk(GAIT, value, value, 0.0, Fake.distance, 10.0, 0.5, 3.0)
        return Evaluation(candidate, f"{value:.6f}", Scores(0.5), None, walk, value)


def write_best(folder: Path, *_: object, must_walk: bool) -> best.Best | best.Lame:
    folder.mkdir()
    Fake.lame -= 1
    if must_walk and Fake.lame >= 0:
        return best.Lame("planted")
    (folder / "robot").write_text("to print")
    return best.Best(BEHAVIOUR, DRY)


@pytest.fixture
def experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bodyplan: Command) -> Command:
    """`bodyplan run` with everything dear replaced, in this process."""
    monkeypatch.setattr("evo.evaluate.Evaluate", Fake)
    monkeypatch.setattr("evo.evaluate.EvaluateTwin", Fake)
    monkeypatch.setattr("evo.evaluate.decode", lambda *_: None)
    monkeypatch.setattr("evo.judge.Judge.build", lambda *_: None)
    monkeypatch.setattr(best, "write_best", write_best)
    monkeypatch.setattr(Fake, "lame", 0)
    monkeypatch.setattr(run, "_write_report", lambda folder: (folder / "report.html").write_text("<html>"))
    monkeypatch.setattr(Fake, "stop", staticmethod(lambda _: None))
    monkeypatch.setattr(Fake, "calls", 0)
    (tmp_path / "small.toml").write_text(CONFIG)

    def call(*words: object, config: Path | None = None, out: Path | None = None) -> Any:
        return bodyplan(
            "run", config or tmp_path / "small.toml", "--out", out or tmp_path / "out", "--workers", 0, *words
        )

    return call


def stop_at(monkeypatch: pytest.MonkeyPatch, moment: int, action: Callable[[], object]) -> None:
    monkeypatch.setattr(Fake, "stop", staticmethod(lambda call: action() if call == moment else None))


def interrupt() -> None:
    raise KeyboardInterrupt


def rows(folder: Path) -> list[Any]:
    with sqlite3.connect(folder / "run.sqlite") as connection:
        names = [row[1] for row in connection.execute("PRAGMA table_info(evaluations)") if row[1] != "seconds"]
        found = [
            connection.execute(f"SELECT {', '.join(names)} FROM {table} ORDER BY id").fetchall()
            for table in ("evaluations", "finals")
        ]
    connection.close()
    return found


def test_a_run_leaves_what_the_contract_says(experiment: Command, tmp_path: Path) -> None:
    said = experiment("--json")
    assert said.status == 0
    result = json.loads(said.out)
    assert result["evaluations"] == 12
    assert result["winner"]["dry_run"] == DRY
    folder = tmp_path / "out"
    names = {path.name for path in folder.iterdir()}
    assert {"config.toml", "run.sqlite", "checkpoint", "best", "report.html", "result.json"} <= names
    assert len(rows(folder)[0]) == 12
    assert len(rows(folder)[1]) == 2
    assert "3.0 body lengths" in said.err
    assert json.loads((folder / "result.json").read_text()) == result


def test_the_resolved_configuration_repeats_the_run(experiment: Command, tmp_path: Path) -> None:
    assert experiment().status == 0
    assert experiment(config=tmp_path / "out" / "config.toml", out=tmp_path / "again").status == 0
    assert rows(tmp_path / "out") == rows(tmp_path / "again")


def test_a_run_is_never_overwritten(experiment: Command, tmp_path: Path) -> None:
    assert experiment().status == 0
    before = rows(tmp_path / "out")
    said = experiment()
    assert said.status == 2
    assert "holds a run already; go on with it by --resume, or choose another --out" in said.err
    assert rows(tmp_path / "out") == before


def test_resuming_a_finished_run_says_so_and_computes_nothing(experiment: Command) -> None:
    first = experiment("--json")
    calls = Fake.calls
    second = experiment("--json", "--resume")
    assert second.status == 0
    assert "is finished" in second.err
    assert json.loads(second.out) == json.loads(first.out)
    assert Fake.calls == calls


def test_resuming_nothing_starts(experiment: Command) -> None:
    said = experiment("--resume")
    assert said.status == 0
    assert "holds no run yet: starting it" in said.err


@pytest.mark.parametrize("action", [interrupt, lambda: os.kill(os.getpid(), signal.SIGTERM)], ids=["ctrl-c", "sigterm"])
@pytest.mark.parametrize("moment", [1, 4, 7, 13])
def test_an_interrupted_run_says_how_to_go_on_and_does(
    experiment: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, action: Callable[[], object], moment: int
) -> None:
    assert experiment(out=tmp_path / "undisturbed").status == 0
    monkeypatch.setattr(Fake, "calls", 0)
    stop_at(monkeypatch, moment, action)
    said = experiment()
    assert said.status == 3
    assert f"bodyplan run {tmp_path / 'small.toml'} --out {tmp_path / 'out'} --resume" in said.err
    assert "Traceback" not in said.err
    assert len(rows(tmp_path / "out")[0]) == min(moment - 1, 12)
    assert experiment("--resume").status == 0
    assert rows(tmp_path / "out") == rows(tmp_path / "undisturbed")


def test_another_configuration_is_refused_by_name(experiment: Command, tmp_path: Path) -> None:
    assert experiment().status == 0
    (tmp_path / "small.toml").write_text(CONFIG.replace("seed = 4", "seed = 5").replace("heat = 2", "heat = 3"))
    said = experiment("--resume")
    assert said.status == 2
    assert "seed was 4 and is now 5; finals.heat was 2 and is now 3" in said.err
    assert said.err.count("\n") == 1


def test_the_number_of_workers_may_change(experiment: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stop_at(monkeypatch, 3, interrupt)
    assert experiment().status == 3
    (tmp_path / "small.toml").write_text("workers = 5\n" + CONFIG)
    assert experiment("--resume").status == 0


def test_other_versions_are_told(experiment: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    stop_at(monkeypatch, 3, interrupt)
    assert experiment().status == 3
    monkeypatch.setattr(run_folder, "versions", lambda: {"numpy": "0.1"})
    said = experiment("--resume")
    assert said.status == 0
    assert "and is now 0.1: the rest of this run may differ" in said.err


@pytest.mark.parametrize("what", ["components", "solvers", "decoder"])
def test_a_run_does_not_go_on_with_other_numbers_in_the_program(
    experiment: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    stop_at(monkeypatch, 3, interrupt)
    assert experiment().status == 3
    before = rows(tmp_path / "out")
    with monkeypatch.context() as changed:
        if what == "components":
            heavier = replace(PAPER, motor=replace(PAPER.motor, mass=0.481))
            changed.setattr("experiments.judging.judge_of", lambda *_, **__: Judge(catalogue=heavier))
        elif what == "solvers":
            changed.setattr("mfg.pipeline.RULES", {rules: solvers[:-1] for rules, solvers in RULES.items()})
        else:
            changed.setattr("decoder.latent.make_decoder", lambda _: GenomeDecoder(gap=2.6))
        said = experiment("--resume")
    assert said.status == 2
    assert f"was made by a program with another {'catalogue of ' * (what == 'components')}" in said.err
    assert what in said.err
    assert said.err.count("\n") == 1
    assert rows(tmp_path / "out") == before
    assert experiment("--resume").status == 0


@dataclass(frozen=True)
class Learned:
    """Stands in for the learned decoder, of which only the digest of its weights counts here."""

    weights: Weights


def test_a_run_does_not_go_on_with_other_weights(
    experiment: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("decoder.latent.make_decoder", lambda name: Learned(load_weights(Path(name))))
    config, file = tmp_path / "learned.toml", tmp_path / "own.safetensors"
    config.write_text(CONFIG.replace('"genome"', '"own.safetensors"'))
    assert "own.safetensors: No such file" in experiment(config=config).err
    save_weights(file, {"w": np.zeros(3)}, {})
    stop_at(monkeypatch, 3, interrupt)
    assert experiment(config=config).status == 3  # What failed before left nothing in the way.
    kept = file.read_bytes()
    save_weights(file, {"w": np.ones(3)}, {})
    said = experiment("--resume", config=config)
    assert said.status == 2
    assert "was made by a program with another decoder" in said.err
    file.write_bytes(kept)
    assert experiment("--resume", config=config).status == 0


def test_finalists_whose_exported_model_does_not_walk_are_passed_over(
    experiment: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = json.loads(experiment("--json").out)
    monkeypatch.setattr(Fake, "lame", 1)
    said = experiment("--json", out=tmp_path / "second")
    second = json.loads(said.out)
    assert first["passed_over"] == []
    assert [(lame["design"], lame["reason"]) for lame in second["passed_over"]] == [
        (first["winner"]["design"], "planted")
    ]
    assert f"{first['winner']['design']} is passed over: planted" in said.err
    assert said.status == 0
    assert second["winner"]["design"] != first["winner"]["design"]
    assert second["winner"]["fitness"] <= first["winner"]["fitness"]
    monkeypatch.setattr(Fake, "lame", 2)
    said = experiment("--json", out=tmp_path / "third")
    assert said.status == 1
    assert json.loads(said.out)["winner"] is None
    assert not (tmp_path / "third" / "best").exists()


def test_the_time_of_all_sessions_counts(experiment: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stop_at(monkeypatch, 3, interrupt)
    assert experiment().status == 3
    with sqlite3.connect(tmp_path / "out" / "run.sqlite") as connection:
        (spent,) = connection.execute("SELECT value FROM meta WHERE key = 'seconds'").fetchone()
        assert 0 < float(spent) < 3600
        connection.execute("UPDATE meta SET value = '5000.0' WHERE key = 'seconds'")
    connection.close()
    result = json.loads(experiment("--resume", "--json").out)
    assert 5000 <= result["seconds"] < 8600


@pytest.mark.parametrize("text", ["", "{", "[]", '{"kind": "evolve"}', '{"kind": "study", "winner": null}', "\xff"])
def test_a_damaged_result_is_made_again(experiment: Command, tmp_path: Path, text: str) -> None:
    first = json.loads(experiment("--json").out)
    calls = Fake.calls
    (tmp_path / "out" / "result.json").write_bytes(text.encode("latin-1"))
    shutil.rmtree(tmp_path / "out" / "best")  # what stands in for its writer here does not replace it.
    said = experiment("--json", "--resume")
    assert said.status == 0
    assert Fake.calls == calls
    assert json.loads(said.out)["winner"] == first["winner"]
    assert json.loads((tmp_path / "out" / "result.json").read_text())["winner"] == first["winner"]


def test_two_processes_do_not_write_one_run(experiment: Command, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with (tmp_path / "out" / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        said = experiment()
        assert said.status == 2
        assert "is being written by another process" in said.err
    assert experiment().status == 0


def test_without_a_winner_the_status_says_so(experiment: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fake, "distance", 0.1)
    said = experiment("--json")
    assert said.status == 1
    assert json.loads(said.out)["winner"] is None
    assert "none: no candidate could be built and walks" in said.err


def broken_file(folder: Path) -> None:
    (folder / "out").mkdir()
    (folder / "out" / "run.sqlite").write_bytes(b"SQLite format 3\0" + b"x" * 4000)


def foreign_file(folder: Path) -> None:
    (folder / "out").mkdir()
    sqlite3.connect(folder / "out" / "run.sqlite").execute("CREATE TABLE t (x)").connection.close()


@pytest.mark.parametrize(
    ("prepare", "words", "message"),
    [
        (lambda folder: (folder / "out").write_text("in the way"), [], "is a file"),
        (broken_file, ["--resume"], "run.sqlite: "),
        (foreign_file, ["--resume"], "this run file has version 0, this program reads version 1"),
        (lambda folder: (folder / "small.toml").write_text("kind = 'evolve'\nsed = 3"), [], "did you mean seed?"),
        (lambda folder: (folder / "small.toml").unlink(), [], "No such file"),
        (lambda _: None, ["--workers", "-1"], "-1 is out of bounds"),
        (lambda _: None, ["--workers", "two"], "'two' is not a whole number"),
        (lambda _: None, ["--out", "/proc/no/such"], "/proc/no"),
        (lambda _: None, ["--resum"], "did you mean --resume?"),
    ],
)
def test_bad_input_is_status_2_and_one_line(
    experiment: Command, tmp_path: Path, prepare: Callable[[Path], object], words: list[str], message: str
) -> None:
    prepare(tmp_path)
    said = experiment(*words)
    assert said.status == 2
    assert message in said.err
    assert said.err.count("\n") == 1


def test_a_full_disk_is_one_line_and_can_be_resumed(
    experiment: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from evo import record

    connect = record._connect

    def small_disk(path: Path) -> sqlite3.Connection:
        connection = connect(path)
        connection.execute("PRAGMA max_page_count = 14")
        return connection

    with monkeypatch.context() as full:
        full.setattr(record, "_connect", small_disk)
        said = experiment()
    assert said.status == 2
    assert "full; check that the disk has room" in said.err
    assert "Traceback" not in said.err
    kept = len(rows(tmp_path / "out")[0])
    assert 0 < kept < 12
    assert experiment("--resume").status == 0
    assert len(rows(tmp_path / "out")[0]) == 12
