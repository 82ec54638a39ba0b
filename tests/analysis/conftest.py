"""Run folders as the commands leave them, written by hand, because analysis knows files only."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

COLUMNS = (
    "id", "generation", "candidate", "design", "latent", "stage", "reason", "detail", "speed", "distance", "episode",
    "body_length", "mass", "s_motor", "s_elec", "s_cable", "s_elec_inst", "s_body_inst", "s_mfg", "fitness", "seconds",
)  # fmt: skip
FAILURES = (("motor", "no_overlap"), ("electronics", "no_room"), ("print", "too_large"), ("worker", "timed_out"))
CONFIG = """
kind = "{kind}"
n = {n}
seed = 3
[search]
generations = {generations}
popsize = 8
[fitness]
mode = "speed"
"""


def rows(n: int) -> list[dict[str, object]]:
    """Every third row fails, in turn at every stage of FAILURES."""
    rng = np.random.default_rng(0)
    found: list[dict[str, object]] = []
    for k in range(n):
        failed = k % 3 == 2
        stage, reason = FAILURES[(k // 3) % len(FAILURES)] if failed else (None, None)
        found.append({
            "id": k, "generation": k // 8, "candidate": k % 8, "design": f"{k:016x}", "stage": stage, "reason": reason,
            "latent": rng.standard_normal(16).astype("<f4").tobytes(), "s_motor": 0.5, "seconds": 0.25,
            "detail": f"joint_{k} <is> & bad" if failed else None, "s_mfg": 0.5 if failed else 3.0 + k / (4 * n),
            "fitness": None if failed else k / n, "speed": None if failed else 0.1,
        })  # fmt: skip
    return found


def write_run_file(path: Path, found: list[dict[str, object]], columns: tuple[str, ...] = COLUMNS) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT)")
        versions = json.dumps({"bodyplan": "0.1.0", "numpy": "9.9.9"})
        connection.executemany(
            "INSERT INTO meta VALUES (?, ?)",
            [("seed", "3"), ("decoder", "genome"), ("config_hash", "00ff"), ("versions", versions)],
        )
        for table in ("evaluations", "finals"):
            connection.execute(f"CREATE TABLE {table} ({', '.join(columns)})")
        marks = ", ".join("?" * len(columns))
        values = [[row.get(name) for name in columns] for row in found]
        connection.executemany(f"INSERT INTO evaluations VALUES ({marks})", values)
    connection.close()


@pytest.fixture
def run_folder(tmp_path: Path) -> Callable[..., Path]:
    def make(kind: str = "evolve", n: int = 24) -> Path:
        folder = tmp_path / kind
        folder.mkdir()
        (folder / "config.toml").write_text(CONFIG.format(kind=kind, n=n, generations=n // 8))
        if kind != "sketch":
            write_run_file(folder / {"evolve": "run.sqlite", "study": "study.sqlite"}[kind], rows(n))
        return folder

    return make
