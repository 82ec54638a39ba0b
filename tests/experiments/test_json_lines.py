"""Rows outlive a kill at any byte, and what is added after it is whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.json_lines import appending, read_rows

ROWS = [{"a": 1}, {"b": "ä\n"}, {"c": [1.5, None]}]


def test_rows_outlive_a_cut_at_any_byte(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    assert read_rows(path) == []
    with appending(path) as add:
        for k, row in enumerate(ROWS):
            add(row)
            assert read_rows(path) == ROWS[: k + 1]  # at once, not at the end
    whole = path.read_bytes()
    for cut in range(len(whole)):
        path.write_bytes(whole[:cut])
        kept = whole[:cut].count(b"\n")
        assert read_rows(path) == ROWS[:kept]
        with appending(path) as add:
            add(ROWS[0])
        assert read_rows(path) == [*ROWS[:kept], ROWS[0]]


def test_a_file_of_something_else_is_told(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text("not JSON\n")
    with pytest.raises(ValueError, match="Expecting value"):
        read_rows(path)
