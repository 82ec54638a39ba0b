"""Worker processes that may crash or hang: one task is lost, never the run.

Why not `concurrent.futures.ProcessPoolExecutor`: when one of its workers is killed the whole pool is broken and every
pending future fails with it, and a running task cannot be stopped, so a solver in an endless loop holds its worker for
ever. Here the parent gives every worker one task at a time over its own pipe, so it always knows which task a dead or
late worker had, kills that worker, starts another and marks only that task.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import math
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import TracebackType
from typing import Any, Generic, TypeVar

from mfg.outcome import Failure, Reason, Stage

Task = TypeVar("Task")
Result = TypeVar("Result")

# Set in a worker's environment before it imports numpy: two maths threads per worker on as many cores as workers make
# every worker slower, and sums would depend on their number.
_ONE_THREAD = {
    name: "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
                 "NUMEXPR_NUM_THREADS")
}  # fmt: skip

_SPAWN = multiprocessing.get_context("spawn")
_GRACE = 2.0  # how long a worker may take to leave by itself before it is killed [s]
_START = 300.0  # how long a worker may take to import what it runs; some seconds, but for a machine that swaps [s]
_STARTS = 4  # workers lost in a row at their start, before the trouble is taken to be a lasting one


@dataclass(slots=True)
class _Worker(Generic[Task]):
    process: SpawnProcess
    pipe: Connection
    ready: bool = False
    task: Task | None = None
    started: float = 0.0  # when the task was given, or the worker started [s], monotonic clock


class Pool(Generic[Task, Result]):
    """Run `work` on tasks, in this process or in spawned ones; any order out, each result with its task.

    An answer must depend on its task alone, then it does not depend on the number of workers. `work` and the tasks
    are pickled to the workers, so `work` is a module-level function or a dataclass with `__call__`.

    Args:
        work: what to do with one task.
        workers: number of processes; 0 works in this process, where a crash or a hang cannot be caught.
        timeout: how long one task may take [s]; not enforced with 0 workers.

    Raises:
        ValueError: if an argument is out of its bounds.
    """

    def __init__(self, work: Callable[[Task], Result], workers: int, timeout: float) -> None:
        """Start nothing yet: workers start when there is work."""
        if workers < 0:
            raise ValueError(f"workers is {workers}; it must be at least 0")
        if not timeout > 0:
            raise ValueError(f"timeout is {timeout}; it must be above 0 s")
        self._work = work
        self._count = workers
        self._timeout = timeout
        self._workers: list[_Worker[Task]] = []
        self._lost_starts = 0  # since a worker last got ready

    def __enter__(self) -> Pool[Task, Result]:
        """Enter a context that leaves no process behind."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop every worker, kill those that are busy."""
        self.close()

    def close(self) -> None:
        """Stop every worker; busy ones are killed. The pool can be used again afterwards."""
        atexit.unregister(self.close)
        workers, self._workers = self._workers, []
        for worker in workers:
            worker.pipe.close()
            if worker.task is not None or not worker.ready:
                worker.process.kill()
        for worker in workers:
            worker.process.join(_GRACE)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.process.close()

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Result | Failure, float]]:
        """Yield (task, result, seconds of wall time) as they finish.

        A task whose work raised, whose worker died or that ran out of time yields a `Failure(Stage.WORKER, ...)` that
        says so. Stopping the iteration early kills what is still running.

        Raises:
            ChildProcessError: if workers die or hang at their start, time after time: then no task can ever run.
            OSError: if a process cannot be made.
        """
        if self._count == 0:
            for task in tasks:
                started = time.monotonic()
                result = _attempt(self._work, task)
                yield task, result, time.monotonic() - started
            return
        waiting = deque(tasks)
        try:
            yield from self._supervise(waiting)
        finally:
            for worker in self._workers:
                if worker.task is not None:
                    self._discard(worker)

    def _supervise(self, waiting: deque[Task]) -> Iterator[tuple[Task, Result | Failure, float]]:
        while waiting or any(worker.task is not None for worker in self._workers):
            busy = sum(worker.task is not None for worker in self._workers)
            while len(self._workers) < min(self._count, busy + len(waiting)):
                self._workers.append(self._start())
            for worker in self._workers:
                if waiting and worker.ready and worker.task is None and worker.process.is_alive():
                    self._give(worker, waiting.popleft())
            for worker in self._await():
                task = worker.task
                outcome = self._collect(worker)
                if outcome is not None and task is not None:
                    yield task, outcome[0], time.monotonic() - worker.started

    def _start(self) -> _Worker[Task]:
        if not self._workers:
            # At the end of the program multiprocessing waits for workers after a SIGTERM that they do not hear.
            atexit.unregister(self.close)
            atexit.register(self.close)
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_serve, args=(self._work, theirs), daemon=True)
        with _one_thread(), _without_signals():
            process.start()
        theirs.close()
        return _Worker(process, ours, started=time.monotonic())

    def _give(self, worker: _Worker[Task], task: Task) -> None:
        worker.task, worker.started = task, time.monotonic()
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it died idle: its sentinel says so next.
            worker.pipe.send(task)

    def _await(self) -> list[_Worker[Task]]:
        """Sleep until a worker answers, dies or runs out of time; those workers."""
        handles: dict[Any, _Worker[Task]] = {}
        deadlines = [self._deadline(worker) for worker in self._workers]
        for worker in self._workers:
            handles[worker.pipe] = worker
            handles[worker.process.sentinel] = worker
        nearest = min(deadlines, default=math.inf)
        patience = max(0.0, nearest - time.monotonic()) if math.isfinite(nearest) else None
        woken = {id(handles[handle]) for handle in wait(list(handles), patience)}
        now = time.monotonic()
        return [
            worker for worker in list(self._workers)
            if id(worker) in woken or now >= self._deadline(worker)
        ]  # fmt: skip

    def _deadline(self, worker: _Worker[Task]) -> float:
        """When a worker must have answered; never for an idle one."""
        if worker.task is not None:
            return worker.started + self._timeout
        return math.inf if worker.ready else worker.started + _START

    def _collect(self, worker: _Worker[Task]) -> tuple[Result | Failure] | None:
        """What a woken worker has to say about its task, if anything; lost workers leave the pool."""
        hung_up = not worker.process.is_alive()
        try:
            message = worker.pipe.recv() if worker.pipe.poll() else None
        except (EOFError, OSError):
            message, hung_up = None, True
        if message is not None:
            if not worker.ready:
                worker.ready = True
                self._lost_starts = 0
                return None
            worker.task = None
            return (message[0],)
        if hung_up:
            worker.process.join(_GRACE)
            code = worker.process.exitcode
            self._discard(worker)
            if not worker.ready:
                self._give_up_after(f"ended with {_exit(code)}")
                return None
            return (_lost(Reason.CRASHED, f"the worker process ended with {_exit(code)}"),)
        if time.monotonic() >= self._deadline(worker):
            self._discard(worker)
            if not worker.ready:
                self._give_up_after(f"was not ready after {_START:g} s")
                return None
            return (_lost(Reason.TIMED_OUT, f"stopped after {self._timeout:g} s"),)
        return None

    def _give_up_after(self, what: str) -> None:
        """Count a worker that was lost at its start; the next one may have more luck, but not for ever."""
        self._lost_starts += 1
        if self._lost_starts >= _STARTS:
            lost, self._lost_starts = self._lost_starts, 0
            raise ChildProcessError(
                f"{lost} worker processes in a row were lost before they could take a task, the last one {what}; "
                "use fewer workers if memory is short, or none (0) to see the trouble itself"
            )

    def _discard(self, worker: _Worker[Task]) -> None:
        self._workers = [other for other in self._workers if other is not worker]
        worker.pipe.close()
        worker.process.kill()
        worker.process.join()
        worker.process.close()


def _attempt(work: Callable[[Task], Result], task: Task) -> Result | Failure:
    """The boundary where one design's exception becomes its failure; nothing above or below swallows any."""
    try:
        return work(task)
    except Exception as error:  # noqa: BLE001 - this is the worker boundary.
        frame = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(str(error).split())[:300]
        where = f"{os.path.basename(frame.filename)}:{frame.lineno}"
        return _lost(Reason.CRASHED, f"{type(error).__name__}: {text} ({where})")


def _serve(work: Callable[[Task], Result], pipe: Connection) -> None:
    """Answer tasks until the parent hangs up."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_leave_with, args=(parent.sentinel,), daemon=True).start()
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send("ready")
        pipe.send((_attempt(work, pipe.recv()),))
        # Libraries are in by now and stay: no collection of garbage need look through them again.
        gc.collect()
        gc.freeze()
        while True:
            pipe.send((_attempt(work, pipe.recv()),))


def _leave_with(parent: int) -> None:
    """Leave when the parent is gone, even from the middle of a task: a killed run leaves no orphans."""
    wait([parent])
    os._exit(1)


def _lost(reason: Reason, detail: str) -> Failure:
    return Failure(Stage.WORKER, reason, detail)


def _exit(code: int | None) -> str:
    if code is not None and code < 0:
        return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Set what a child inherits, and leave this process as it was."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _without_signals() -> Iterator[None]:
    """Block polite requests to stop in what a child inherits, for its whole life.

    A terminal sends Ctrl-C, and a batch system SIGTERM, to every process of a run. The parent alone decides; it stops
    workers by hanging up or by SIGKILL, and when it is gone they leave by themselves.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # the first process would start it, and that lets the signals through again.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
