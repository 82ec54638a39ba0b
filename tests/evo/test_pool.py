from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from evo.pool import Pool
from mfg.outcome import Failure, Reason, Stage

ROOT = Path(__file__).parents[2]

# Workers are spawned, so what they run must be importable there: a module written for the test.
WORK = """
import os, signal, time

def double(task):
    return 2 * task

def picky(task):
    if task == 3:
        raise ValueError("no threes\\nplease")
    return 2 * task

def mean(task):
    if task == 1:
        os._exit(7)
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 4:
        time.sleep(3600)
    if task == 5:
        time.sleep(0.3)
    return 2 * task

def environment(task):
    return os.environ["OMP_NUM_THREADS"], os.getpid()

def leaves_a_note(task):
    with open(task, "w") as note:
        note.write(str(os.getpid()))
    time.sleep(3600)

def asks_itself_to_stop(task):
    os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), signal.SIGINT)
    return 2 * task

def unpicklable(task):
    return (lambda: 0) if task == 1 else task
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    folder = tmp_path_factory.mktemp("work")
    (folder / "pool_work.py").write_text(WORK)
    sys.path.insert(0, str(folder))  # spawned children are handed the parent's sys.path.
    import pool_work

    yield pool_work
    sys.path.remove(str(folder))


def collect(pool: Pool[Any, Any], tasks: Iterable[Any]) -> dict[Any, Any]:
    with pool:
        return {task: result for task, result, _ in pool.run(tasks)}


@pytest.mark.parametrize("workers", [1, 2])
def test_answers_do_not_depend_on_the_number_of_workers(work: ModuleType, workers: int) -> None:
    tasks = range(6)
    alone = collect(Pool(work.picky, 0, 10.0), tasks)
    assert [alone[task] for task in (0, 1, 2, 4, 5)] == [0, 2, 4, 8, 10]
    assert isinstance(alone[3], Failure)
    assert alone[3].stage is Stage.WORKER
    assert alone[3].reason is Reason.CRASHED
    assert "ValueError: no threes please (pool_work.py:" in alone[3].detail
    assert collect(Pool(work.picky, workers, 10.0), tasks) == alone


@pytest.mark.parametrize("workers", [1, 2])
def test_a_crash_and_a_hang_cost_their_own_task_only(work: ModuleType, workers: int) -> None:
    results = collect(Pool(work.mean, workers, 1.0), range(8))
    assert {task: value for task, value in results.items() if not isinstance(value, Failure)} == {
        0: 0, 3: 6, 5: 10, 6: 12, 7: 14,
    }  # fmt: skip
    assert results[1] == Failure(Stage.WORKER, Reason.CRASHED, "the worker process ended with exit code 7")
    assert results[2] == Failure(Stage.WORKER, Reason.CRASHED, "the worker process ended with signal SIGKILL")
    assert results[4] == Failure(Stage.WORKER, Reason.TIMED_OUT, "stopped after 1 s")


def test_a_result_that_cannot_travel_costs_its_own_task_only(work: ModuleType) -> None:
    results = collect(Pool(work.unpicklable, 1, 10.0), range(3))
    assert results[0] == 0
    assert results[2] == 2
    assert results[1].reason is Reason.CRASHED


def test_workers_compute_on_one_thread_and_the_parent_keeps_its_environment(
    work: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    threads, pid = collect(Pool(work.environment, 1, 10.0), [0])[0]
    assert threads == "1"
    assert pid != os.getpid()
    assert os.environ["OMP_NUM_THREADS"] == "5"
    assert "MKL_NUM_THREADS" not in os.environ


def test_a_pool_runs_batch_after_batch_on_the_same_workers(work: ModuleType) -> None:
    with Pool(work.environment, 1, 10.0) as pool:
        ((_, first, _),) = pool.run([0])
        ((_, second, seconds),) = pool.run([0])
        assert first == second
        assert seconds > 0
        assert list(pool.run([])) == []


def test_workers_leave_it_to_the_parent_to_stop(work: ModuleType) -> None:
    with Pool(work.asks_itself_to_stop, 1, 60.0) as pool:
        assert [result for _, result, _ in pool.run([1, 2])] == [2, 4]


FLAKY = """
import os, time
from pathlib import Path

starts = Path({folder!r}, "starts")
if os.getpid() != {parent}:
    with starts.open("a") as note:
        note.write("x")
    if len(starts.read_text()) <= {times}:
        {trouble}

def double(task):
    return 2 * task
"""


@pytest.fixture
def flaky(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, int], ModuleType]:
    """Make work whose import in a worker goes wrong some times."""

    def make(trouble: str, times: int) -> ModuleType:
        (tmp_path / "flaky.py").write_text(
            FLAKY.format(folder=str(tmp_path), parent=os.getpid(), trouble=trouble, times=times)
        )
        return importlib.import_module("flaky")

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "flaky", raising=False)
    return make


def test_a_worker_that_dies_at_its_start_is_started_again(
    flaky: Callable[[str, int], ModuleType], tmp_path: Path
) -> None:
    module = flaky("os._exit(5)", 3)
    assert collect(Pool(module.double, 1, 60.0), range(3)) == {0: 0, 1: 2, 2: 4}
    assert (tmp_path / "starts").read_text() == "xxxx"


def test_workers_that_always_die_at_their_start_are_one_error(flaky: Callable[[str, int], ModuleType]) -> None:
    module = flaky("os._exit(5)", 99)
    with pytest.raises(ChildProcessError, match=r"4 worker processes in a row were lost .* ended with exit code 5"):
        collect(Pool(module.double, 2, 60.0), range(3))


def test_a_worker_that_hangs_at_its_start_is_started_again(
    flaky: Callable[[str, int], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("evo.pool._START", 8.0)  # well above what the import takes on a busy machine.
    module = flaky("time.sleep(3600)", 1)
    assert collect(Pool(module.double, 1, 60.0), range(3)) == {0: 0, 1: 2, 2: 4}
    assert (tmp_path / "starts").read_text() == "xx"


def test_a_program_that_forgets_to_close_its_pool_ends_all_the_same(work: ModuleType) -> None:
    code = f"""
    import sys
    sys.path.insert(0, {str(Path(str(work.__file__)).parent)!r})
    import pool_work
    from evo.pool import Pool
    if __name__ == "__main__":
        pool = Pool(pool_work.double, 1, 3600.0)
        print([result for _, result, _ in pool.run([1])])
    """
    command = [sys.executable, "-c", textwrap.dedent(code)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (0, "[2]\n"), done.stderr


def test_stopping_early_leaves_no_process(work: ModuleType, tmp_path: Path) -> None:
    notes = [str(tmp_path / "a"), str(tmp_path / "b")]
    with Pool(work.leaves_a_note, 2, 0.9) as pool:
        next(pool.run([*notes, *notes]))  # the first one runs out of time; the rest is not awaited.
    pids = [int(Path(note).read_text()) for note in notes if Path(note).exists()]
    assert pids
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_killing_the_parent_takes_hung_workers_with_it(work: ModuleType, tmp_path: Path) -> None:
    note = tmp_path / "note"
    code = f"""
    import sys
    sys.path.insert(0, {str(Path(str(work.__file__)).parent)!r})
    import pool_work
    from evo.pool import Pool
    if __name__ == "__main__":
        list(Pool(pool_work.leaves_a_note, 1, 3600.0).run([{str(note)!r}]))
    """
    script = tmp_path / "parent.py"
    script.write_text(textwrap.dedent(code))
    parent = subprocess.Popen([sys.executable, str(script)], env={**os.environ, "PYTHONPATH": str(ROOT)})
    pid = int(_await(lambda: note.exists() and note.read_text()))
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    assert _await(lambda: not _alive(pid))


def test_work_that_cannot_be_imported_in_a_worker_is_an_error_not_a_failure(
    work: ModuleType, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def local(task: object) -> object:
        return task

    local.__module__, local.__qualname__ = "pool_work", "vanished"
    work.vanished = local
    with pytest.raises(ChildProcessError, match="before they could take a task"):
        collect(Pool(local, 1, 10.0), [0])
    assert "vanished" in capfd.readouterr().err


@pytest.mark.parametrize(("workers", "timeout", "match"), [(-1, 1.0, "workers is -1"), (1, 0.0, "timeout is 0")])
def test_arguments_are_checked(work: ModuleType, workers: int, timeout: float, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Pool(work.double, workers, timeout)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    return not (stat.exists() and stat.read_text().rpartition(")")[2].split()[0] == "Z")


def _await(condition: Callable[[], Any]) -> Any:
    for _ in range(600):
        value = condition()
        if value:
            return value
        time.sleep(0.05)
    raise AssertionError("waited 30 s in vain")
