from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import ellipsoid, painted

from decoder.design import Joint
from evo.evaluation import Candidate, Evaluation
from evo.judge import DEFAULT_JUDGE
from experiments import study
from mfg.outcome import Failure, Reason, Scores, Stage

Command = Callable[..., Any]
KEYS = {"n", "seed", "decoder", "solver", "counts", "pass_rate", "pass_rate_95", "lda", "seconds"}
LDA_KEYS = {"classes", "balanced_accuracy", "balanced_accuracy_95", "chance", "permutation_p"}
COUNTS = {"skeleton", "motor", "electronics", "wire", "print", "worker", "passed"}


class Fake:
    """Stands in for the solvers; stops the study or breaks where a test wants that."""

    calls = 0
    stop_at = 0
    broken = -1

    def __init__(self, *_: object) -> None:
        pass

    def __call__(self, candidate: Candidate) -> Evaluation:
        Fake.calls += 1
        if Fake.calls == Fake.stop_at:
            raise KeyboardInterrupt
        if candidate.index == Fake.broken:
            raise ZeroDivisionError("planted")
        key = f"{candidate.latent[0]:.6f}"
        if candidate.latent[0] < -0.3:
            stage, reason = (Stage.MOTOR, Reason.NO_OVERLAP) if candidate.index % 2 else (Stage.WIRE, Reason.NO_ROUTE)
            return Evaluation(candidate, key, Scores(0.5), Failure(stage, reason, "planted"))
        return Evaluation(candidate, key, Scores(0.5, 0.6, 0.7, 0.8, 0.9))


class Mending(Fake):
    """The same, and every other body that failed at its motor is mended."""

    def __call__(self, candidate: Candidate) -> Evaluation:
        found = super().__call__(candidate)
        if found.passed:
            return found
        assert found.failure is not None
        helped = found.failure.stage is Stage.MOTOR and candidate.index % 4 == 1
        mended = Evaluation(
            candidate, "mended" if helped else found.design, found.scores, None if helped else found.failure,
            stages={"repair": 0.5}, changes=("segment 1 thicker (+3% bone)", "then scaled") if helped else (),
        )  # fmt: skip
        return replace(found, repaired=mended)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, bodyplan: Command) -> Command:
    """`bodyplan study` in this process, with everything dear replaced."""
    monkeypatch.setattr(study, "Score", Fake)
    monkeypatch.setattr(study, "_draw_examples", lambda *_: None)
    for name, value in (("calls", 0), ("stop_at", 0), ("broken", -1)):
        monkeypatch.setattr(Fake, name, value)
    return lambda *words, out=tmp_path / "s": bodyplan(
        "study", "-n", 90, "--decoder", "genome", "--workers", 0, "--out", out, *words
    )


def rows(folder: Path) -> list[Any]:
    with sqlite3.connect(folder / "study.sqlite") as connection:
        names = [row[1] for row in connection.execute("PRAGMA table_info(evaluations)") if row[1] != "seconds"]
        found = connection.execute(f"SELECT {', '.join(names)} FROM evaluations ORDER BY id").fetchall()
    connection.close()
    return found


def test_the_number_of_workers_changes_nothing(
    bodyplan: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "_draw_examples", lambda *_: None)  # the answers are what counts here, not pictures.
    results = []
    for workers in (0, 2):
        said = bodyplan(
            "study", "-n", 6, "--seed", 1, "--decoder", "genome", "--workers", workers, "--out",
            tmp_path / str(workers), "--json",
        )  # fmt: skip
        assert said.status == 0
        result = json.loads(said.out)
        assert json.loads((tmp_path / str(workers) / "study.json").read_text()) == result
        results.append({name: value for name, value in result.items() if name != "seconds"})
    assert rows(tmp_path / "0") == rows(tmp_path / "2")
    assert results[0] == results[1]


def test_a_study_leaves_what_the_contract_says(quick: Command, tmp_path: Path) -> None:
    said = quick("--seed", 5, "--json")
    assert said.status == 0
    result = json.loads(said.out)
    assert set(result) >= KEYS
    assert set(result["lda"]) >= LDA_KEYS
    assert set(result["counts"]) == COUNTS
    assert (result["n"], result["seed"], result["decoder"], result["solver"]) == (90, 5, "genome", "search")
    assert sum(result["counts"].values()) == 90
    assert result["pass_rate"] == result["counts"]["passed"] / 90
    low, high = result["pass_rate_95"]
    assert low < result["pass_rate"] < high
    assert result["lda"]["classes"] == ["motor", "wire"]
    assert result["lda"]["chance"] == 0.5
    assert 0 < result["lda"]["permutation_p"] <= 1
    names = {path.name for path in (tmp_path / "s").iterdir()}
    assert names >= {"config.toml", "study.sqlite", "study.json", "records.csv", "pass_through.csv", "report.html",
                     "pass_through.png", "scores.png", "failures.png"}  # fmt: skip
    assert (tmp_path / "s" / "pass_through.csv").read_text().splitlines()[-1].startswith("all,90,")


def test_repaired_bodies_are_counted_apart_and_told(
    quick: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plain = json.loads(quick("--json", out=tmp_path / "plain").out)
    monkeypatch.setattr(study, "Score", Mending)
    said = quick("--repair", "--json")
    assert said.status == 0, said.err
    result = json.loads(said.out)
    assert plain["repaired"] is None
    assert result["counts"] == plain["counts"]
    assert rows(tmp_path / "s") == rows(tmp_path / "plain")
    mended = result["repaired"]
    assert set(mended["counts"]) == COUNTS
    assert sum(mended["counts"].values()) == 90
    helped = mended["counts"]["passed"] - plain["counts"]["passed"]
    assert helped > 0
    assert mended["counts"]["motor"] == plain["counts"]["motor"] - helped
    assert mended["counts"]["wire"] == plain["counts"]["wire"]
    assert mended["pass_rate"] == mended["counts"]["passed"] / 90
    low, high = mended["pass_rate_95"]
    assert low < mended["pass_rate"] < high
    with (tmp_path / "s" / "records.csv").open() as file:
        table = list(csv.DictReader(file))
    changed = [row for row in table if row["changes"]]
    assert len(changed) == helped
    assert {(row["outcome"], row["repaired"]) for row in changed} == {("motor", "passed")}
    assert {row["changes"] for row in changed} == {"segment 1 thicker (+3% bone); then scaled"}
    assert all(row["repaired"] == row["outcome"] for row in table if not row["changes"])
    lines = (tmp_path / "s" / "pass_through.csv").read_text().splitlines()
    assert lines[0] == "stage,reached,failed,remaining,failed_after_repair"
    assert [line.split(",")[-1] for line in lines if line.startswith(("motor", "all"))] == [
        str(mended["counts"]["motor"]), str(90 - mended["counts"]["passed"]),
    ]  # fmt: skip
    report = (tmp_path / "s" / "report.html").read_text("utf-8")
    assert f"Changed as little as helps, {mended['counts']['passed']} of them can be built" in report
    assert "Changed as little" not in (tmp_path / "plain" / "report.html").read_text("utf-8")
    told = quick("--repair", out=tmp_path / "told").out
    assert f"{mended['counts']['passed']} of 90 bodies can be built once changed as little as helps" in told
    assert f"{mended['counts']['motor']} after repair" in told


def test_an_interrupted_study_says_all_that_its_continuation_needs(
    quick: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(study, "Score", Mending)
    assert quick("--repair", out=tmp_path / "undisturbed").status == 0
    Fake.calls, Fake.stop_at = 0, 30
    said = quick("--repair", "--solver", "paper", "--catalogue", "auto")
    assert said.status == 3
    assert "--prior normal --solver paper --catalogue auto --repair --out" in said.err
    Fake.stop_at = 0
    assert quick("--repair", "--resume").status == 2  # other rules than those it was begun with
    assert quick("--repair", "--solver", "paper", "--catalogue", "auto", "--resume").status == 0
    both = (tmp_path / name for name in ("undisturbed", "s"))
    assert len({tuple(repairs(folder)) for folder in both}) == 1


def repairs(folder: Path) -> list[Any]:
    with sqlite3.connect(folder / "study.sqlite") as connection:
        found = connection.execute("SELECT id, design, stage, reason, changes FROM repairs ORDER BY id").fetchall()
    connection.close()
    return found


def test_a_body_is_mended_by_the_rules_of_the_study() -> None:
    joint = Joint(np.array([0.32, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-0.6, 0.6]), 1, 2)
    thin = painted([ellipsoid((21, 32, 32), (12, 11, 10)), ellipsoid((45, 32, 32), (11, 2.2, 2.2))], (joint,))
    judged: list[str] = []

    class Counting:
        def score(self, design: Any) -> Any:
            judged.append(design.key)
            return DEFAULT_JUDGE.score(design)

    class One:
        def decode(self, _: Any) -> list[Any]:
            return [thin]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "decoder_of", lambda _: One())
        candidate = Candidate(0, 0, np.zeros(512, np.float32))
        found = study.Score("genome", Counting(), repair=True)(candidate)  # type: ignore[arg-type]
        plain = study.Score("genome", DEFAULT_JUDGE)(candidate)
    assert found.failure == plain.failure is not None
    assert plain.repaired is None
    assert found.repaired is not None
    assert found.repaired.passed
    assert found.repaired.changes
    assert found.repaired.design != thin.key
    assert judged.count(thin.key) == 1


def test_for_people_it_ends_with_the_table(quick: Command) -> None:
    said = quick()
    assert said.status == 0
    assert "of 90 bodies can be built" in said.out
    assert "motor" in said.out
    assert "report.html" in said.out


@pytest.mark.parametrize("moment", [1, 40])
def test_an_interrupted_study_goes_on_where_it_was(quick: Command, tmp_path: Path, moment: int) -> None:
    assert quick(out=tmp_path / "undisturbed").status == 0
    Fake.calls, Fake.stop_at = 0, moment
    said = quick()
    assert said.status == 3
    assert f"-n 90 --seed 0 --decoder genome --prior normal --out {tmp_path / 's'} --resume" in said.err
    assert len(rows(tmp_path / "s")) == moment - 1
    Fake.calls, Fake.stop_at = 0, 0
    assert quick("--resume").status == 0
    assert Fake.calls == 90 - (moment - 1)
    assert rows(tmp_path / "s") == rows(tmp_path / "undisturbed")


def test_a_design_that_breaks_its_worker_is_one_failure(quick: Command) -> None:
    Fake.broken = 7
    result = json.loads(quick("--json").out)
    assert result["counts"]["worker"] == 1
    assert result["lda"]["left_out"]["worker"] == 1


def test_a_study_is_never_overwritten(quick: Command, tmp_path: Path) -> None:
    assert quick().status == 0
    before = rows(tmp_path / "s")
    said = quick()
    assert said.status == 2
    assert "go on with it by --resume, or choose another --out" in said.err
    said = quick("--seed", 9, "--resume")
    assert said.status == 2
    assert "seed was 0 and is now 9" in said.err
    assert rows(tmp_path / "s") == before


def test_a_configuration_file_gives_the_same_study(quick: Command, bodyplan: Command, tmp_path: Path) -> None:
    assert quick().status == 0
    said = bodyplan("run", tmp_path / "s" / "config.toml", "--out", tmp_path / "again", "--workers", 0)
    assert said.status == 0
    assert rows(tmp_path / "again") == rows(tmp_path / "s")


def test_the_first_bodies_do_not_depend_on_how_many_are_drawn(
    quick: Command, bodyplan: Command, tmp_path: Path
) -> None:
    assert quick().status == 0
    assert bodyplan("study", "-n", 20, "--decoder", "genome", "--workers", 0, "--out", tmp_path / "few").status == 0
    assert rows(tmp_path / "few") == rows(tmp_path / "s")[:20]


def test_pictures_of_designs_that_passed_and_failed(tmp_path: Path) -> None:
    from experiments.config import Study

    config = Study("study", n=3, seed=1, decoder="genome")
    latents = study._latents(config)
    scorer = study.Score("genome", DEFAULT_JUDGE)
    evaluations = [scorer(Candidate(0, k, latents[k])) for k in range(2)]
    study._draw_examples(config, evaluations, tmp_path / "sheet.png", 0)
    assert (tmp_path / "sheet.png").read_bytes().startswith(b"\x89PNG")
    study._draw_examples(config, [], tmp_path / "none.png", 0)
    assert not (tmp_path / "none.png").exists()


def test_the_sheet_shows_the_range_of_scores_and_every_class() -> None:
    def built(index: int, score: float) -> Evaluation:
        return Evaluation(Candidate(0, index, None), "k", Scores(score))  # type: ignore[arg-type]

    def failed(index: int, stage: Stage) -> Evaluation:
        failure = Failure(stage, Reason.NO_ROOM, "planted")
        return Evaluation(Candidate(0, index, None), "k", Scores(), failure)  # type: ignore[arg-type]

    evaluations = [built(k, k / 50) for k in range(50)]
    evaluations += [failed(50 + k, stage) for stage in Stage for k in range(3)]
    shown = study._examples(evaluations)
    scores = [e.scores.total for e in shown if e.passed]
    assert len(scores) == study.PASSED_SHOWN
    assert scores == sorted(scores, reverse=True)
    assert (scores[0], scores[-1]) == (49 / 50, 0.0)
    stages = [e.failure.stage for e in shown if e.failure is not None]
    assert set(stages) == set(Stage) - {Stage.WORKER}
    assert study._examples([]) == []


def test_report_command(quick: Command, bodyplan: Command, tmp_path: Path) -> None:
    assert quick().status == 0
    (tmp_path / "s" / "report.html").unlink()
    said = bodyplan("report", tmp_path / "s", "--json")
    assert said.status == 0
    assert json.loads(said.out)["report"] == str(tmp_path / "s" / "report.html")
    assert "can be built" in (tmp_path / "s" / "report.html").read_text("utf-8")
