"""Clocks and memory for the benchmarks."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ParamSpec, TypeVar

from experiments.output import progress

MIB = 2**20
TIMEOUT = 300.0  # of one task [s]

Given = ParamSpec("Given")
Result = TypeVar("Result")
Task = TypeVar("Task")


def clock(action: Callable[[], object], now: Callable[[], float] = time.perf_counter) -> float:
    """Seconds that an action takes, of wall time or by another clock."""
    started = now()
    action()
    return now() - started


def timed(action: Callable[Given, Result], *given: Given.args, **named: Given.kwargs) -> tuple[float, Result]:
    """Seconds of wall time that a call takes, and what it returns."""
    started = time.perf_counter()
    result = action(*given, **named)
    return time.perf_counter() - started, result


def throughput(work: Callable[[Task], object], tasks: Sequence[Task], workers: int, what: str) -> float:
    """Tasks per second of wall time on so many worker processes; the first two warm them up and do not count."""
    from evo.pool import Pool

    with Pool[Task, object](work, workers, TIMEOUT) as pool:
        list(pool.run(tasks[:2]))
        seconds = clock(lambda: list(progress(pool.run(tasks[2:]), len(tasks) - 2, what)))
    return (len(tasks) - 2) / seconds


def peak() -> float:
    """Peak resident memory of this process [MiB]."""
    status = Path("/proc/self/status")
    if status.exists():  # Linux lets a child inherit its parent's peak in getrusage, but not here.
        return next(int(t.split()[1]) for t in status.read_text().splitlines() if t.startswith("VmHWM")) * 1024 / MIB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB
