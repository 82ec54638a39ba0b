from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from evo.cma_es import CmaEs
from evo.evaluation import Evaluation
from evo.finals import finals, winners
from evo.loop import CHECKPOINT_FILE, Checkpoint, ResumeError, evolve
from evo.pool import Pool
from evo.record import Record

ROOT = Path(__file__).parents[2]
Dump = Callable[[Path], list[tuple[object, ...]]]
DIM, POPSIZE, GENERATIONS = 8, 6, 5


def fresh(seed: int = 3) -> CmaEs:
    return CmaEs(DIM, POPSIZE, np.random.default_rng(seed))


def opened(folder: Path) -> Record:
    path = folder / "run.sqlite"
    return Record(path, POPSIZE) if path.exists() else Record.create(path, POPSIZE, {})


def run(folder: Path, work: Callable, workers: int = 0, stop_after: int | None = None, seed: int = 3) -> int:
    """One session with a run; returns how many candidates it worked out."""
    count = 0
    with opened(folder) as record, Pool(work, workers, 30.0) as pool:
        for count, _ in enumerate(evolve(fresh(seed), record, pool, GENERATIONS, folder), start=1):
            if count == stop_after:
                break
    return count


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, fakes: ModuleType) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    assert run(folder, fakes.answer) == POPSIZE * GENERATIONS
    with opened(folder) as record, Pool(fakes.twin, 0, 30.0) as pool:
        list(finals(record, pool, 2))
    return folder


def test_all_that_can_happen_to_a_candidate_happens_in_this_run(undisturbed: Path) -> None:
    with opened(undisturbed) as record:
        found = record.evaluations()
        assert {None if e.failure is None else str(e.failure.stage) for e in found} == {
            None, "worker", "electronics", "skeleton",
        }  # fmt: skip
        assert len({e.candidate.latent.tobytes() for e in found}) == len(found)
        assert winners(record)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_rows_do_not_depend_on_the_number_of_workers(
    undisturbed: Path, tmp_path: Path, fakes: ModuleType, dump: Dump, workers: int
) -> None:
    run(tmp_path, fakes.answer, workers)
    with opened(tmp_path) as record, Pool(fakes.twin, workers, 30.0) as pool:
        list(finals(record, pool, 2))
    assert dump(tmp_path / "run.sqlite") == dump(undisturbed / "run.sqlite")
    assert Checkpoint.load(tmp_path) == Checkpoint.load(undisturbed)


@pytest.mark.parametrize("stop_after", [1, POPSIZE - 1, POPSIZE, POPSIZE + 1, 3 * POPSIZE + 2])
def test_a_stopped_run_goes_on_where_it_was(
    undisturbed: Path, tmp_path: Path, fakes: ModuleType, dump: Dump, stop_after: int
) -> None:
    assert run(tmp_path, fakes.answer, stop_after=stop_after) == stop_after
    assert run(tmp_path, fakes.answer) == POPSIZE * GENERATIONS - stop_after
    assert run(tmp_path, fakes.answer) == 0
    with opened(tmp_path) as record, Pool(fakes.twin, 0, 30.0) as pool:
        first = next(finals(record, pool, 2))
        assert first is not None
        list(finals(record, pool, 2))
        assert list(finals(record, pool, 2)) == []
    assert dump(tmp_path / "run.sqlite") == dump(undisturbed / "run.sqlite")


def test_kill_9_at_any_moment_loses_nothing(undisturbed: Path, tmp_path: Path, fakes: ModuleType, dump: Dump) -> None:
    script = tmp_path / "session.py"
    code = f"""
    import sys
    sys.path[:0] = [{str(ROOT)!r}, {str(Path(str(fakes.__file__)).parent)!r}]
    from pathlib import Path
    import numpy as np
    import evo_fakes
    from evo.cma_es import CmaEs
    from evo.finals import finals
    from evo.loop import evolve
    from evo.pool import Pool
    from evo.record import Record

    if __name__ == "__main__":
        folder = Path({str(tmp_path)!r})
        path = folder / "run.sqlite"
        record = Record(path, {POPSIZE}) if path.exists() else Record.create(path, {POPSIZE}, {{}})
        optimiser = CmaEs({DIM}, {POPSIZE}, np.random.default_rng(3))
        with record, Pool(evo_fakes.slow_answer, int(sys.argv[1]), 30.0) as pool:
            print("working", flush=True)
            for _ in evolve(optimiser, record, pool, {GENERATIONS}, folder):
                pass
            with Pool(evo_fakes.twin, 0, 30.0) as last:
                list(finals(record, last, 2))
    """
    script.write_text(textwrap.dedent(code))
    moment = random.Random(11)
    kills, status, rows = 0, None, 0
    for session in range(60):
        process = subprocess.Popen([sys.executable, str(script), str(session % 3)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        if kills < 3:
            time.sleep(moment.uniform(0.0, 0.08))
            os.kill(process.pid, signal.SIGKILL)
        status = process.wait()
        process.stdout.close()
        kills += status == -signal.SIGKILL
        with sqlite3.connect(tmp_path / "run.sqlite") as connection:
            before, rows = rows, connection.execute("SELECT count(*) FROM evaluations").fetchone()[0]
        connection.close()
        assert rows >= before
        if status == 0:
            break
    assert status == 0
    assert kills >= 2
    assert dump(tmp_path / "run.sqlite") == dump(undisturbed / "run.sqlite")
    assert Checkpoint.load(tmp_path) == Checkpoint.load(undisturbed)


def test_the_run_of_another_seed_is_not_continued(tmp_path: Path, fakes: ModuleType) -> None:
    run(tmp_path, fakes.answer, stop_after=2)
    with pytest.raises(ResumeError, match="another latent"):
        run(tmp_path, fakes.answer, seed=4)


def test_missing_rows_are_noticed(tmp_path: Path, fakes: ModuleType) -> None:
    run(tmp_path, fakes.answer, stop_after=2 * POPSIZE + 1)
    _edit(tmp_path, "DELETE FROM evaluations WHERE id = 3")
    with pytest.raises(ResumeError, match="lacks 1 rows of generation 0"):
        run(tmp_path, fakes.answer)


def test_a_changed_row_is_noticed(tmp_path: Path, fakes: ModuleType) -> None:
    run(tmp_path, fakes.answer, stop_after=POPSIZE + 1)
    (tmp_path / CHECKPOINT_FILE).unlink()
    run(tmp_path, fakes.answer, stop_after=POPSIZE + 1)
    with opened(tmp_path) as record:
        best = min((e for e in record.evaluations(0) if e.fitness is not None), key=lambda e: e.rank_key)
    _edit(tmp_path, f"UPDATE evaluations SET fitness = -9 WHERE id = {best.candidate.index}")
    with pytest.raises(ResumeError, match=r"another latent|state is"):
        run(tmp_path, fakes.answer)


def test_a_checkpoint_of_another_optimiser_is_noticed(tmp_path: Path, fakes: ModuleType) -> None:
    run(tmp_path, fakes.answer)
    Checkpoint(GENERATIONS, "0123456789abcdef").save(tmp_path)
    with pytest.raises(ResumeError, match="state is"):
        run(tmp_path, fakes.answer)


@pytest.mark.parametrize("text", ["", "{", '{"generations": 1}', '{"generations": "x", "optimiser": ""}', "[]"])
def test_a_damaged_checkpoint_says_what_to_do(tmp_path: Path, text: str) -> None:
    (tmp_path / CHECKPOINT_FILE).write_text(text)
    with pytest.raises(ResumeError, match="damaged; delete it"):
        Checkpoint.load(tmp_path)


def test_a_used_optimiser_is_refused(tmp_path: Path, fakes: ModuleType) -> None:
    optimiser = fresh()
    optimiser.ask()
    optimiser.tell(range(POPSIZE))
    with opened(tmp_path) as record, Pool(fakes.answer, 0, 30.0) as pool, pytest.raises(ValueError, match="fresh"):
        next(evolve(optimiser, record, pool, 1, tmp_path))


def test_told_orders_put_every_failure_behind_every_success(
    tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[list[int]] = []
    tell = CmaEs.tell
    monkeypatch.setattr(CmaEs, "tell", lambda self, order: (told.append(list(order)), tell(self, order)))
    run(tmp_path, fakes.answer)
    with opened(tmp_path) as record:
        for generation, order in enumerate(told):
            ranked: list[Evaluation] = [record.evaluations(generation)[i] for i in order]
            fitness = [e.fitness for e in ranked]
            scored = [f for f in fitness if f is not None]
            assert scored == sorted(scored, reverse=True)
            assert fitness == scored + [None] * (len(fitness) - len(scored))


def _edit(folder: Path, statement: str) -> None:
    with sqlite3.connect(folder / "run.sqlite") as connection:
        connection.execute(statement)
    connection.close()
