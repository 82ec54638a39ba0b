from __future__ import annotations

import sqlite3

import numpy as np
import pandas as pd
import pytest

from analysis.records import (
    COLUMNS,
    RecordsError,
    by_reason,
    frame,
    latents,
    read_meta,
    read_records,
    with_repairs,
    write_csv,
)

CONTRACT = (
    "id", "generation", "candidate", "design", "latent", "stage", "reason", "speed", "s_motor", "s_elec", "s_cable",
    "s_elec_inst", "s_body_inst", "s_mfg", "fitness", "seconds",
)  # fmt: skip


def test_the_schema_is_the_same_for_a_full_a_bare_and_an_empty_file(run_folder, tmp_path):
    full = read_records(run_folder() / "run.sqlite")
    with sqlite3.connect(tmp_path / "bare.sqlite") as connection:
        connection.execute(f"CREATE TABLE evaluations ({', '.join(CONTRACT)})")
        connection.execute(
            f"INSERT INTO evaluations VALUES ({', '.join('?' * len(CONTRACT))})",
            [0, 0, 0, "k", b"\0" * 8, None, None, 0.5, *[0.1] * 5, 0.5, 0.2, 1.0],
        )
    connection.close()
    bare, empty = read_records(tmp_path / "bare.sqlite"), frame([])
    for other in (bare, empty):
        assert list(other.columns) == list(full.columns) == list(COLUMNS)
        assert (other.dtypes == full.dtypes).all()
    assert set(CONTRACT) <= set(COLUMNS)
    assert bare["speed"][0] == 0.5
    assert np.isnan(bare["mass"][0])


def test_values_come_back_as_written(run_folder):
    records = read_records(run_folder() / "run.sqlite")
    assert list(records["id"]) == list(range(24))
    assert list(records["outcome"][:6]) == ["passed", "passed", "motor", "passed", "passed", "electronics"]
    assert records["fitness"].isna().sum() == 8
    assert latents(records).shape == (24, 16)
    assert latents(records).dtype == np.float32
    expected = np.random.default_rng(0).standard_normal(16).astype("<f4")
    np.testing.assert_array_equal(latents(records)[0], expected)


def test_latents_of_nothing_and_of_different_lengths():
    assert latents(frame([])).shape == (0, 0)
    with pytest.raises(ValueError, match=r"\[1, 2\]"):
        latents(frame([{"latent": np.zeros(1)}, {"latent": np.zeros(2)}]))


def test_meta(run_folder):
    assert read_meta(run_folder() / "run.sqlite")["seed"] == "3"


def test_reading_leaves_the_file_alone(run_folder):
    path = run_folder() / "run.sqlite"
    before = path.read_bytes()
    read_records(path)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir() if "sqlite" in p.name] == ["run.sqlite"]


@pytest.mark.parametrize("data", [None, b"", b"no database" * 99, b"SQLite format 3\0" + b"x" * 4000])
def test_what_is_no_run_file_is_one_line(tmp_path, data):
    path = tmp_path / "given.sqlite"
    if data is not None:
        path.write_bytes(data)
    for read in (read_records, read_meta):
        with pytest.raises(RecordsError, match=r"given\.sqlite") as caught:
            read(path)
        assert "\n" not in str(caught.value)


def test_csv_holds_every_row_without_latents(run_folder, tmp_path):
    records = read_records(run_folder() / "run.sqlite")
    write_csv(records, tmp_path / "t.csv")
    back = pd.read_csv(tmp_path / "t.csv")
    assert len(back) == 24
    assert "latent" not in back
    assert list(back["design"]) == list(records["design"])
    np.testing.assert_allclose(back["s_mfg"], records["s_mfg"], rtol=1e-5)


def test_failures_by_reason(run_folder):
    records = read_records(run_folder() / "run.sqlite")
    groups = dict(by_reason(records[records["outcome"] != "passed"]))
    assert sorted(groups) == sorted(
        [("motor", "no_overlap"), ("electronics", "no_room"), ("print", "too_large"), ("worker", "timed_out")]
    )
    assert sum(len(group) for group in groups.values()) == 8


def test_repairs_are_joined_by_id_and_a_file_without_any_is_told(run_folder, tmp_path):
    path = run_folder() / "run.sqlite"
    with pytest.raises(RecordsError, match="holds no repairs"):
        with_repairs(read_records(path), path)
    records = read_records(path)
    failed = list(records["id"][records["outcome"] != "passed"])
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE repairs (id INTEGER PRIMARY KEY, stage TEXT, changes TEXT)")
        rows = [(failed[1], "wire", "[]"), (failed[0], None, '["a, b", "c"]')]
        connection.executemany("INSERT INTO repairs VALUES (?, ?, ?)", rows)
    connection.close()
    joined = with_repairs(records, path).set_index("id")
    assert tuple(joined.loc[failed[0], ["repaired", "changes"]]) == ("passed", "a, b; c")
    assert tuple(joined.loc[failed[1], ["repaired", "changes"]]) == ("wire", "")
    others = joined.drop(failed[:2])
    assert (others["repaired"] == others["outcome"]).all()
    assert (others["changes"] == "").all()
    assert "repaired" not in records.columns
