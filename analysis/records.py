"""Run files as data frames: the only importer of pandas."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.passthrough import PASSED

SCORES = ("s_motor", "s_elec", "s_cable", "s_elec_inst", "s_body_inst")  # in the order of `mfg.outcome.Scores`
_INTEGERS = ("id", "generation", "candidate")
_TEXTS = ("design", "stage", "reason", "detail")
_NUMBERS = ("task", "speed", "distance", "episode", "body_length", "mass", *SCORES, "s_mfg", "fitness", "seconds")
COLUMNS = (*_INTEGERS, *_TEXTS, *_NUMBERS, "latent", "outcome")


class RecordsError(OSError):
    """A run file cannot be read; the message names it and what is wrong."""


def read_records(path: Path, table: str = "evaluations") -> pd.DataFrame:
    """Read a table of a run file while its run may still be writing.

    Args:
        path: of the SQLite file.
        table: "evaluations" or "finals".

    Returns:
        One row per evaluation by id, always with `COLUMNS`; what a file lacks is missing in every row. `outcome` is the
        failure class or "passed"; `latent` holds vectors (d,) f4.

    Raises:
        RecordsError: if it is not a run file or cannot be read.
    """
    with _reading(path) as connection:
        try:
            cursor = connection.execute(f'SELECT * FROM "{table}" ORDER BY id')
            names = [column[0] for column in cursor.description]
            rows = [dict(zip(names, row, strict=True)) for row in cursor]
        except sqlite3.DatabaseError as error:
            raise RecordsError(f"{path}: not a run file ({error})") from None
    return frame(rows)


def read_meta(path: Path) -> dict[str, str]:
    """What the run file says about its run: configuration, seed, versions.

    Raises:
        RecordsError: if it is not a run file or cannot be read.
    """
    with _reading(path) as connection:
        try:
            return dict(connection.execute("SELECT key, value FROM meta").fetchall())
        except sqlite3.DatabaseError as error:
            raise RecordsError(f"{path}: not a run file ({error})") from None


def with_repairs(records: pd.DataFrame, path: Path) -> pd.DataFrame:
    """The evaluations of a study with what came of repairs, from the same run file.

    Returns:
        Two more columns: `repaired`, the outcome where changes to the body counted, and `changes`, those changes in
        words; a body that was not changed keeps its outcome and has none.

    Raises:
        RecordsError: if it is not a run file, holds no repairs or cannot be read.
    """
    with _reading(path) as connection:
        try:
            rows = connection.execute("SELECT id, stage, changes FROM repairs").fetchall()
        except sqlite3.DatabaseError as error:
            raise RecordsError(f"{path}: holds no repairs ({error})") from None
    found = {index: (stage or PASSED, "; ".join(json.loads(changes))) for index, stage, changes in rows}
    pairs = [found.get(index, (outcome, "")) for index, outcome in zip(records["id"], records["outcome"], strict=True)]
    return records.assign(repaired=[pair[0] for pair in pairs], changes=[pair[1] for pair in pairs])


def frame(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Make the data frame of evaluations given as mappings of column names to values."""
    rows = list(rows)
    columns: dict[str, pd.Series] = {}
    for name in _INTEGERS:
        columns[name] = pd.Series([int(row.get(name) or 0) for row in rows], dtype="int64")
    for name in _TEXTS:
        columns[name] = pd.Series([row.get(name) for row in rows], dtype="object")
    for name in _NUMBERS:
        columns[name] = pd.Series([np.nan if row.get(name) is None else row[name] for row in rows], dtype="float64")
    columns["latent"] = pd.Series([_vector(row.get("latent")) for row in rows], dtype="object")
    columns["outcome"] = pd.Series([row.get("stage") or PASSED for row in rows], dtype="object")
    return pd.DataFrame(columns, columns=list(COLUMNS))


def latents(records: pd.DataFrame) -> NDArray[np.float32]:
    """The latents of all rows, (n, d).

    Raises:
        ValueError: if their lengths differ.
    """
    vectors = list(records["latent"])
    lengths = {len(vector) for vector in vectors}
    if len(lengths) > 1:
        raise ValueError(f"latents of different lengths in one file: {sorted(lengths)}")
    return np.stack(vectors) if vectors else np.zeros((0, 0), np.float32)


def by_reason(failed: pd.DataFrame) -> Iterator[tuple[tuple[str, str], pd.DataFrame]]:
    """Failures grouped by (stage, reason), in alphabetical order."""
    for (stage, reason), group in failed.groupby([failed["stage"], failed["reason"].fillna("")], sort=True):
        yield (str(stage), str(reason)), group


def write_csv(records: pd.DataFrame, path: Path) -> None:
    """Write the table without latents, which stay in the run file.

    Raises:
        OSError: if it cannot be written.
    """
    columns = [name for name in records.columns if name != "latent" and not records[name].isna().all()]
    records[columns].to_csv(path, index=False, float_format="%.6g", lineterminator="\n")


def _vector(value: bytes | NDArray[np.float32] | None) -> NDArray[np.float32]:
    if isinstance(value, bytes):
        return np.frombuffer(value, "<f4").astype(np.float32)
    return np.zeros(0, np.float32) if value is None else np.asarray(value, np.float32)


def _reading(path: Path) -> closing[sqlite3.Connection]:
    """Open a file that must exist, and never write to it."""
    if not path.is_file():
        raise RecordsError(f"{path}: there is no run file here")
    try:
        return closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True))
    except sqlite3.DatabaseError as error:
        raise RecordsError(f"{path}: {error}") from None
