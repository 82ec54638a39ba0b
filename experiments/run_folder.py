"""A run folder: one writer at a time, what it holds, and going on with it after Ctrl-C or a crash."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import BadInput, say

if TYPE_CHECKING:
    from evo.record import Record
    from experiments.config import Evolve, Study

CONFIG, CHECKPOINT, REPORT = "config.toml", "checkpoint", "report.html"
DEPENDENCIES = ("numpy", "scipy", "cma", "mujoco", "manifold3d", "scikit-image")  # whose versions can change a result


@contextlib.contextmanager
def opened(config: Evolve | Study, path: Path, popsize: int, resume: bool) -> Iterator[Record]:
    """The run file, made or found.

    Args:
        config: the experiment; it is written beside the file.
        path: of the run file, in an existing folder.
        popsize: candidates per generation.
        resume: go on if a run is there already.

    Raises:
        BadInput: if a run is there and `resume` is not set, or it was made with another configuration.
        OSError: if a file cannot be read or written.
    """
    from evo.record import Record
    from experiments.config import config_hash, to_toml

    folder = path.parent
    if path.exists():
        if not resume:
            raise BadInput(f"{folder} holds a run already; go on with it by --resume, or choose another --out")
        _check_past(path, config, popsize)
    else:
        if resume:
            say(f"{folder} holds no run yet: starting it")
        (folder / CONFIG).write_text(to_toml(config), encoding="utf-8")
        Record.create(
            path, popsize,
            {"config": to_toml(config), "config_hash": config_hash(config), "seed": str(config.seed),
             "popsize": str(popsize), "decoder": config.decoder, "versions": json.dumps(versions())},
        ).close()  # fmt: skip
    with Record(path, popsize) as record:
        yield record


def _check_past(path: Path, config: Evolve | Study, popsize: int) -> None:
    import tomllib

    from evo.record import Record
    from experiments.config import differences, parse_config

    with Record(path, popsize) as record:
        meta = record.meta()
    then = parse_config(tomllib.loads(meta["config"]), f"{path}, meta")
    changes = differences(then, config)
    if changes:
        raise BadInput(
            f"{path.parent} was made with another configuration: {'; '.join(changes)}; "
            f"resume with {path.parent / CONFIG}, or choose another --out"
        )
    before, now = json.loads(meta["versions"]), versions()
    other = [f"{name} was {before.get(name)} and is now {now[name]}" for name in now if before.get(name) != now[name]]
    if other:
        say(f"note: {'; '.join(other)}: the rest of this run may differ from what it would have been")


def versions() -> dict[str, str]:
    """Of this program and of what its results depend on."""
    import platform
    from importlib.metadata import version

    from experiments.cli import VERSION

    return {"bodyplan": VERSION, "python": platform.python_version(), **{name: version(name) for name in DEPENDENCIES}}


def write_json(path: Path, value: dict[str, Any]) -> None:
    """Write a file that is whole or not there.

    Raises:
        ValueError: if a number is not finite.
        OSError: if it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(value, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, path)


def worker_count(text: str) -> int:
    """Read a command-line number of worker processes."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not 0 <= value <= 1024:
        raise argparse.ArgumentTypeError(f"{value} is out of bounds; it must lie in [0, 1024]")
    return value


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep a second process from writing the same run; a killed one leaves no lock behind."""
    import fcntl

    with (folder / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BadInput(
                f"{folder} is being written by another process; wait for it or choose another --out"
            ) from None
        yield


@contextlib.contextmanager
def terminable() -> Iterator[None]:
    """Treat a cluster's polite request to stop like Ctrl-C."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
