"""The run file: SQLite in WAL mode, one writer, one row per evaluation, committed before the optimiser is told.

Everything in `evaluations` follows from the configuration alone, but for `seconds`, which is wall time: two runs of one
configuration, or an undisturbed run and one that was killed and resumed, agree in every other byte. Wall time by stage
is in the table `timings`, for the same reason, and that of all sessions together is in `meta`, under "seconds".
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np

from evo.evaluation import Candidate, Evaluation, Walk
from mfg.outcome import Failure, Reason, Scores, Stage
from sim.actor import Gait

VERSION = 1
Table = Literal["evaluations", "finals", "repairs"]

_SCORES = ("s_motor", "s_elec", "s_cable", "s_elec_inst", "s_body_inst")  # in the order of `Scores`
_WALK = ("task", "speed", "heading", "distance", "episode", "body_length", "mass")  # numbers of a `Walk`

# `finals` holds the best candidates again, built and measured as twins, and `repairs` those that failed, as far as a
# change of the body helps: the same columns, the same ids.
_COLUMNS = """
    id INTEGER PRIMARY KEY,    -- generation * popsize + candidate
    generation INTEGER NOT NULL,
    candidate INTEGER NOT NULL,
    design TEXT,               -- key of the design; null where its worker was lost
    latent BLOB NOT NULL,      -- float32, little endian
    stage TEXT,                -- where it failed; null if it can be built
    reason TEXT,
    detail TEXT,
    task REAL,                 -- task fitness [m/s], before manufacturability
    speed REAL,                -- along the best heading [m/s]
    heading REAL,              -- [rad]
    distance REAL,             -- [m]
    episode REAL,              -- simulated [s]
    body_length REAL,          -- [m]
    mass REAL,                 -- [kg]
    gait TEXT,                 -- JSON: frequency [Hz], amplitude, phase, offset [rad]
    s_motor REAL, s_elec REAL, s_cable REAL, s_elec_inst REAL, s_body_inst REAL,
    s_mfg REAL NOT NULL,
    fitness REAL,              -- null where there is none
    seconds REAL NOT NULL      -- wall time, the one column that differs between equal runs
"""
_NAMES = (
    "id", "generation", "candidate", "design", "latent", "stage", "reason", "detail", *_WALK, "gait", *_SCORES, "s_mfg",
    "fitness", "seconds",
)  # fmt: skip
_SCHEMA = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE evaluations ({_COLUMNS});
CREATE TABLE finals ({_COLUMNS});
CREATE TABLE repairs ({_COLUMNS}, changes TEXT NOT NULL);  -- JSON: a list of texts
CREATE TABLE timings (
    id INTEGER NOT NULL, round TEXT NOT NULL, stage TEXT NOT NULL, seconds REAL NOT NULL,
    PRIMARY KEY (id, round, stage)
) WITHOUT ROWID;
PRAGMA user_version = {VERSION};
"""


class RecordError(OSError):
    """The run file cannot be read or written; the message names it and the way out."""


class Record:
    """An open run file.

    Args:
        path: of an existing run file.
        popsize: candidates per generation; ids are generation * popsize + index.

    Raises:
        RecordError: if it is not a run file of this version, or cannot be opened.
    """

    def __init__(self, path: Path, popsize: int) -> None:
        """Open it."""
        if not path.is_file():
            raise RecordError(f"{path}: there is no run file here")
        self._path = path
        self._popsize = popsize
        self._connection = _connect(path)
        self._opened = time.monotonic()
        with _storage(path):
            version = self._connection.execute("PRAGMA user_version").fetchone()[0]
        if version != VERSION:
            raise RecordError(f"{path}: this run file has version {version}, this program reads version {VERSION}")
        self._before = float(self.meta().get("seconds", 0.0))

    @classmethod
    def create(cls, path: Path, popsize: int, meta: Mapping[str, str]) -> Record:
        """Make a run file; it appears complete or not at all.

        Raises:
            RecordError: if it exists, or the folder cannot be written.
        """
        if path.exists():
            raise RecordError(f"{path}: a run file is here already")
        partial = path.with_name(path.name + ".partial")
        with _storage(path):
            partial.unlink(missing_ok=True)
            connection = sqlite3.connect(partial)
            connection.executescript(_SCHEMA)
            with connection:
                connection.executemany("INSERT INTO meta VALUES (?, ?)", sorted(meta.items()))
            connection.close()
            partial.rename(path)
        return cls(path, popsize)

    def __enter__(self) -> Record:
        """Enter a context that closes the file."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Close the file; what was added is safe already."""
        self._connection.close()

    def meta(self) -> dict[str, str]:
        """What was written at creation, and "seconds" as of the last row."""
        with _storage(self._path):
            return dict(self._connection.execute("SELECT key, value FROM meta").fetchall())

    def seconds(self) -> float:
        """Wall time since the file was opened, and of every session before as far as its last row [s]."""
        return self._before + time.monotonic() - self._opened

    def add(self, evaluation: Evaluation, seconds: float, table: Table = "evaluations") -> None:
        """Commit one evaluation, and with it that of the repaired body.

        Args:
            evaluation: what to keep.
            seconds: wall time it took.
            table: "finals" for the measurement on the built twin.

        Raises:
            ValueError: if the candidate's index is not below popsize.
            RecordError: if it cannot be written, because the disk is full for example.
        """
        identity = self._id(evaluation.candidate)
        with _storage(self._path), self._connection:
            self._insert(table, evaluation, identity, seconds)
            if evaluation.repaired is not None:
                self._insert("repairs", evaluation.repaired, identity, sum(evaluation.repaired.stages.values()))
            # With every row, so that a killed session counts too.
            self._connection.execute("INSERT OR REPLACE INTO meta VALUES ('seconds', ?)", (repr(self.seconds()),))

    def evaluations(self, generation: int | None = None, table: Table = "evaluations") -> list[Evaluation]:
        """Everything recorded, or one generation of it, by id; wall times are not read back."""
        where, values = ("", ()) if generation is None else (" WHERE generation = ?", (generation,))
        with _storage(self._path):
            names = _names(table)
            rows = self._connection.execute(f"SELECT {', '.join(names)} FROM {table}{where} ORDER BY id", values)
            return [_evaluation(dict(zip(names, row, strict=True))) for row in rows]

    def count(self, table: Table = "evaluations") -> int:
        """How many rows there are."""
        with _storage(self._path):
            return int(self._connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0])

    def _insert(self, table: Table, evaluation: Evaluation, identity: int, seconds: float) -> None:
        row, names = _row(evaluation, identity, seconds), _names(table)
        stages = [(identity, table, stage, time) for stage, time in evaluation.stages.items()]
        marks = ", ".join("?" * len(names))
        self._connection.execute(f"INSERT INTO {table} VALUES ({marks})", [row[name] for name in names])
        self._connection.executemany("INSERT INTO timings VALUES (?, ?, ?, ?)", stages)

    def _id(self, candidate: Candidate) -> int:
        if not 0 <= candidate.index < self._popsize:
            raise ValueError(f"candidate index is {candidate.index}; this run has {self._popsize} per generation")
        return candidate.generation * self._popsize + candidate.index


def _names(table: Table) -> tuple[str, ...]:
    return (*_NAMES, "changes") if table == "repairs" else _NAMES


def _connect(path: Path) -> sqlite3.Connection:
    with _storage(path):
        connection = sqlite3.connect(path)
        connection.execute("PRAGMA journal_mode = WAL")  # others may read while we write.
        connection.execute("PRAGMA synchronous = FULL")  # a commit survives a power cut; it costs little beside a walk.
        return connection


@contextmanager
def _storage(path: Path) -> Iterator[None]:
    """Say in one line what SQLite has to say about a disk; defects of ours keep their own error."""
    try:
        yield
    except (sqlite3.IntegrityError, sqlite3.ProgrammingError):
        raise
    except sqlite3.DatabaseError as error:
        raise RecordError(f"{path}: {error}; check that the disk has room and the folder can be written") from error


def _row(evaluation: Evaluation, identity: int, seconds: float) -> dict[str, Any]:
    candidate, failure, walk = evaluation.candidate, evaluation.failure, evaluation.walk
    row: dict[str, Any] = {
        "id": identity,
        "generation": candidate.generation,
        "candidate": candidate.index,
        "design": evaluation.design,
        "latent": np.ascontiguousarray(candidate.latent, "<f4").tobytes(),
        "stage": None if failure is None else str(failure.stage),
        "reason": None if failure is None else str(failure.reason),
        "detail": None if failure is None else failure.detail,
        "s_mfg": evaluation.scores.total,
        "fitness": evaluation.fitness,
        "seconds": seconds,
        "changes": json.dumps(evaluation.changes, ensure_ascii=False),
        **dict(zip(_SCORES, evaluation.scores.values(), strict=True)),
        "gait": None if walk is None else gait_to_json(walk.gait),
        **{name: None if walk is None else getattr(walk, name) for name in _WALK},
    }
    return row


def _evaluation(row: Mapping[str, Any]) -> Evaluation:
    failure = None
    if row["stage"] is not None:
        failure = Failure(Stage(row["stage"]), Reason(row["reason"]), row["detail"])
    walk = None
    if row["gait"] is not None:
        walk = Walk(gait_from_json(row["gait"]), **{name: row[name] for name in _WALK})
    latent = np.frombuffer(row["latent"], "<f4").astype(np.float32)
    scores = {f.name: row[column] for f, column in zip(fields(Scores), _SCORES, strict=True)}
    return Evaluation(
        Candidate(row["generation"], row["candidate"], latent), row["design"], Scores(**scores), failure, walk,
        row["fitness"], changes=tuple(json.loads(row.get("changes", "[]"))),
    )  # fmt: skip


def gait_to_json(gait: Gait) -> str:
    """Write a gait at full precision."""
    arrays = {name: getattr(gait, name).tolist() for name in ("amplitude", "phase", "offset")}
    return json.dumps({"frequency": gait.frequency, **arrays}, allow_nan=False)


def gait_from_json(text: str) -> Gait:
    """Read what `gait_to_json` wrote."""
    return Gait(**json.loads(text))
