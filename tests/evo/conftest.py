"""Stand-ins for the evaluation of a body: quick, deterministic, and failing in every way."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from gaits_in_brief import QUADRUPED

from decoder.design import VoxelDesign
from decoder.sketch import load_design

# Spawned workers import what they run, so it is a module in a file. A candidate's answer follows from its latent.
FAKES = """
import os, time
import numpy as np
from evo.evaluation import Candidate, Evaluation, Walk
from evo.fitness import FitnessRule
from mfg.outcome import Failure, Reason, Scores, Stage
from sim.actor import Gait


def answer(candidate):
    z = candidate.latent.astype(float)
    rng = np.random.default_rng(candidate.seed(5, 1))
    kind = int(abs(z[0]) * 1e4) % 10
    key = candidate.latent.tobytes().hex()[:16]
    if kind == 0:
        raise ArithmeticError("planted")
    scores = Scores(*(float(v) for v in rng.random(5)))
    if kind == 1:
        return Evaluation(candidate, key, Scores(0.25), Failure(Stage.ELECTRONICS, Reason.NO_ROOM, "planted"))
    if kind == 2:
        return Evaluation(candidate, key, Scores(), Failure(Stage.SKELETON, Reason.NO_JOINT, "planted"))
    gait = Gait(1.5, rng.random(3), rng.random(3), rng.random(3))
    speed = float(np.exp(-np.square(z - 1).mean()))
    walk = Walk(gait, speed, speed * 1.1, 0.3, 10 * speed, 10.0, 4.0, 3.5)
    fitness = FitnessRule().fitness(speed, scores)
    return Evaluation(candidate, key, scores, None, walk, fitness, {"decode": 0.01, "gait": 0.02})


def slow_answer(candidate):
    time.sleep(0.004)
    return answer(candidate)


def twin(evaluation):
    z = evaluation.candidate.latent.astype(float)
    w = evaluation.walk
    if int(abs(z[1]) * 1e4) % 3 == 0:
        failure = Failure(Stage.PRINT, Reason.TOO_LARGE, "planted")
        return Evaluation(evaluation.candidate, evaluation.design, evaluation.scores, failure)
    far = 5.0 if int(abs(z[2]) * 1e4) % 3 == 0 else 1.0
    walk = Walk(w.gait, w.task, w.speed, w.heading, far, 10.0, 4.0, 3.5)
    return Evaluation(evaluation.candidate, evaluation.design, evaluation.scores, None, walk, evaluation.fitness)
"""


@pytest.fixture(scope="session")
def fakes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    folder = tmp_path_factory.mktemp("fakes")
    (folder / "evo_fakes.py").write_text(FAKES)
    sys.path.insert(0, str(folder))
    import evo_fakes

    yield evo_fakes
    sys.path.remove(str(folder))


@pytest.fixture(scope="session")
def quadruped() -> VoxelDesign:
    return load_design(QUADRUPED)


@pytest.fixture
def dump() -> Callable[[Path], list[tuple[object, ...]]]:
    """Every byte of both tables but wall time."""

    def read(path: Path) -> list[tuple[object, ...]]:
        import sqlite3

        with sqlite3.connect(path) as connection:
            found: list[tuple[object, ...]] = []
            for table in ("evaluations", "finals"):
                names = [row[1] for row in connection.execute(f"PRAGMA table_info({table})") if row[1] != "seconds"]
                found += connection.execute(f"SELECT {', '.join(names)} FROM {table} ORDER BY id").fetchall()
        connection.close()
        return found

    return read
