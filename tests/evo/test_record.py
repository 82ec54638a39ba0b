from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from evo.evaluation import Candidate, Evaluation, Walk
from evo.record import Record, RecordError, gait_from_json, gait_to_json
from mfg.outcome import Failure, Reason, Scores, Stage
from sim.actor import Gait

numbers = st.floats(allow_nan=False, allow_infinity=False)
shares = st.none() | st.floats(0, 1)


@st.composite
def gaits(draw: st.DrawFn) -> Gait:
    n = draw(st.integers(1, 4))
    return Gait(draw(st.floats(0, 9)), *(np.array(draw(st.lists(numbers, min_size=n, max_size=n))) for _ in range(3)))


@st.composite
def evaluations(draw: st.DrawFn) -> Evaluation:
    latent = np.array(draw(st.lists(st.floats(width=32), min_size=1, max_size=5)), np.float32)
    candidate = Candidate(draw(st.integers(0, 99)), draw(st.integers(0, 15)), latent)
    scores = Scores(*(draw(shares) for _ in range(5)))
    if draw(st.booleans()):
        stage, reason = draw(st.sampled_from(Stage)), draw(st.sampled_from(Reason))
        failure = Failure(stage, reason, draw(st.text(st.characters(codec="utf-8"))))
        return Evaluation(candidate, draw(st.none() | st.just("a1b2")), scores, failure)
    walk = Walk(draw(gaits()), *(draw(numbers) for _ in range(7)))
    return Evaluation(candidate, "a1b2", scores, None, walk, draw(st.none() | numbers), {"decode": 0.5})


def create(path: Path) -> Record:
    return Record.create(path, 16, {"seed": "0", "config": "kind = 'evolve'"})


def fields(evaluation: Evaluation) -> tuple[object, ...]:
    walk = evaluation.walk
    moved = None if walk is None else (gait_to_json(walk.gait), *(getattr(walk, n) for n in Walk.__slots__[1:]))
    candidate = evaluation.candidate
    return (
        candidate.generation, candidate.index, candidate.latent.tobytes(), evaluation.design, evaluation.scores,
        evaluation.failure, moved, evaluation.fitness, evaluation.rank_key,
    )  # fmt: skip


@given(evaluations())
def test_an_evaluation_comes_back_bit_for_bit(evaluation: Evaluation) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evo.record.Path.is_file", lambda _: True)
        patch.setattr("evo.record._connect", _memory)
        record = Record(Path(":memory:"), 16)
    record.add(evaluation, 1.25)
    assert [fields(e) for e in record.evaluations()] == [fields(evaluation)]
    record.close()


def _memory(path: Path) -> sqlite3.Connection:
    from evo.record import _SCHEMA

    connection = sqlite3.connect(":memory:")
    connection.executescript(_SCHEMA)
    return connection


@given(gaits())
def test_a_gait_survives_its_json(gait: Gait) -> None:
    back = gait_from_json(gait_to_json(gait))
    assert back.frequency == gait.frequency
    for name in ("amplitude", "phase", "offset"):
        assert_array_equal(getattr(back, name), getattr(gait, name))


def test_the_table_has_the_columns_that_scripts_rely_on(tmp_path: Path) -> None:
    latent = np.arange(512, dtype=np.float32)
    failure = Failure(Stage.MOTOR, Reason.NO_OVERLAP, "too thin")
    with create(tmp_path / "run.sqlite") as record:
        record.add(Evaluation(Candidate(2, 3, latent), "k", Scores(0.5, 0.25), failure), 1.5)
    connection = sqlite3.connect(tmp_path / "run.sqlite")
    row = connection.execute(
        "SELECT id, generation, candidate, design, latent, stage, reason, speed, s_motor, s_elec, s_cable, s_elec_inst,"
        " s_body_inst, s_mfg, fitness, seconds FROM evaluations"
    ).fetchone()
    connection.close()
    assert row == (
        35, 2, 3, "k", latent.astype("<f4").tobytes(), "motor", "no_overlap", None, 0.5, 0.25, None, None, None, 0.75,
        None, 1.5,
    )  # fmt: skip


def test_ids_do_not_depend_on_the_order_of_arrival(tmp_path: Path) -> None:
    found = []
    for name, order in (("a", (0, 1, 2)), ("b", (2, 0, 1))):
        with create(tmp_path / name) as record:
            for index in order:
                record.add(Evaluation(Candidate(1, index, np.full(2, index, np.float32)), "k"), 0.0)
            found.append([(e.candidate.index, e.candidate.latent[0]) for e in record.evaluations(1)])
    assert found[0] == found[1] == [(0, 0.0), (1, 1.0), (2, 2.0)]


def test_a_candidate_is_recorded_once_and_within_its_generation(tmp_path: Path) -> None:
    with create(tmp_path / "run.sqlite") as record:
        record.add(Evaluation(Candidate(0, 1, np.zeros(2, np.float32)), "k"), 0.0)
        with pytest.raises(sqlite3.IntegrityError):
            record.add(Evaluation(Candidate(0, 1, np.zeros(2, np.float32)), "k"), 0.0)
        with pytest.raises(ValueError, match="index is 16"):
            record.add(Evaluation(Candidate(0, 16, np.zeros(2, np.float32)), "k"), 0.0)
        assert record.count() == 1
        assert record.evaluations(1) == []


def test_others_may_read_while_the_run_writes(tmp_path: Path) -> None:
    path = tmp_path / "run.sqlite"
    with create(path) as record:
        record.add(Evaluation(Candidate(0, 0, np.zeros(2, np.float32)), "k"), 0.0)
        reader = sqlite3.connect(path)
        cursor = reader.execute("SELECT count(*) FROM evaluations")
        record.add(Evaluation(Candidate(0, 1, np.zeros(2, np.float32)), "k"), 0.0)
        assert cursor.fetchone() == (1,)
        cursor.close()
        assert reader.execute("SELECT count(*) FROM evaluations").fetchone() == (2,)
        reader.close()


def test_what_is_no_run_file_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no run file here"):
        Record(tmp_path / "missing.sqlite", 4)
    (tmp_path / "text.sqlite").write_text("this is not a database, but it is long enough to look like one" * 20)
    with pytest.raises(RecordError, match="not a database"):
        Record(tmp_path / "text.sqlite", 4)
    sqlite3.connect(tmp_path / "old.sqlite").execute("PRAGMA user_version = 99").connection.close()
    with pytest.raises(RecordError, match="version 99"):
        Record(tmp_path / "old.sqlite", 4)
    create(tmp_path / "run.sqlite").close()
    with pytest.raises(RecordError, match="here already"):
        create(tmp_path / "run.sqlite")
    with pytest.raises(RecordError, match="unable to open"):
        create(tmp_path / "no" / "run.sqlite")


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path: Path) -> None:
    latent = np.zeros(4096, np.float32)
    path = tmp_path / "run.sqlite"
    with create(path) as record:
        record.add(Evaluation(Candidate(0, 0, latent), "k"), 0.0)
        pages = record._connection.execute("PRAGMA page_count").fetchone()[0]
        record._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(RecordError, match="full; check that the disk has room"):
            record.add(Evaluation(Candidate(0, 1, latent), "k"), 0.0)
        count = record.count()
    assert Record(path, 16).count() == count == 1


def test_meta_comes_back(tmp_path: Path) -> None:
    with create(tmp_path / "run.sqlite") as record:
        assert record.meta() == {"seed": "0", "config": "kind = 'evolve'"}


def test_a_repaired_body_is_kept_beside_its_own_verdict(tmp_path: Path) -> None:
    latent = np.arange(4, dtype=np.float32)
    failure = Failure(Stage.MOTOR, Reason.NO_OVERLAP, "too thin")
    changes = ('segment 1 "thicker"; by 1', "größer")
    mended = Evaluation(Candidate(0, 3, latent), "new", Scores(0.5), stages={"repair": 2.5}, changes=changes)
    with create(tmp_path / "run.sqlite") as record:
        record.add(Evaluation(Candidate(0, 3, latent), "old", Scores(0.25), failure, repaired=mended), 4.0)
        record.add(Evaluation(Candidate(0, 4, latent), "whole", Scores(0.75)), 1.0)
        plain, repaired = record.evaluations(), record.evaluations(table="repairs")
    assert [(e.candidate.index, e.design, e.failure, e.changes) for e in plain] == [
        (3, "old", failure, ()), (4, "whole", None, ()),
    ]  # fmt: skip
    assert [fields(e) for e in repaired] == [fields(mended)]
    assert repaired[0].changes == changes


def test_a_verdict_and_its_repair_are_kept_together_or_not_at_all(tmp_path: Path) -> None:
    latent = np.zeros(2, np.float32)
    failure = Failure(Stage.WIRE, Reason.NO_ROUTE, "x")
    lost = Evaluation(Candidate(0, 1, latent), "k", failure=failure, repaired=Evaluation(Candidate(0, 1, latent), "m"))
    with create(tmp_path / "run.sqlite") as record:
        record._connection.execute("DROP TABLE repairs")
        with pytest.raises(RecordError):
            record.add(lost, 0.0)
        assert record.count() == 0
