"""A run folder: one writer at a time, what it holds, and going on with it after Ctrl-C or a crash."""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import VERSION, BadInput, say

if TYPE_CHECKING:
    from msgspec import Struct

    from evo.record import Record
    from experiments.config import Config, Evolve, Study

CONFIG, CHECKPOINT, REPORT = "config.toml", "checkpoint", "report.html"
RESULT, STUDY_RESULT = "result.json", "study.json"
RUN_FILES = {"evolve": "run.sqlite", "study": "study.sqlite"}  # a sketch has none
DEPENDENCIES = ("numpy", "scipy", "cma", "mujoco", "manifold3d", "scikit-image")  # whose versions can change a result


def check_folder(config: Config, folder: Path) -> None:
    """Refuse a folder that another run was written to.

    Raises:
        BadInput: if what is there is of another kind or configuration, or cannot be told; it names the difference.
        OSError: if a file cannot be read.
    """
    from experiments.config import differences

    then = _held(folder)
    if then is None:
        return
    if then.kind != config.kind:
        raise BadInput(f'{folder} holds a run of kind "{then.kind}", this one is "{config.kind}"; choose another --out')
    changes = differences(then, config)
    if changes:
        raise BadInput(
            f"{folder} was made with another configuration: {'; '.join(changes)}; "
            f"resume with {folder / CONFIG}, or choose another --out"
        )
    run_file, result = RUN_FILES.get(config.kind), _result_in(folder)
    if run_file is not None and result is not None and not (folder / run_file).exists():
        raise BadInput(f"{folder} holds {result} but not the {run_file} it came from; choose another --out")


def _held(folder: Path) -> Config | None:
    """The configuration of the run in a folder; None if there is no run."""
    import tomllib

    from evo.record import Record, RecordError
    from experiments.config import load_config, parse_config

    for name in RUN_FILES.values():
        path = folder / name
        if path.exists():
            with Record(path, 1) as record:
                meta = record.meta()
            if "config" not in meta:
                raise RecordError(f"{path}: this run file does not say how it was made; choose another --out")
            return parse_config(tomllib.loads(meta["config"]), f"{path}, meta")
    if (folder / CONFIG).exists():
        try:
            return _as_of_then(load_config(folder / CONFIG), folder / CONFIG)
        except BadInput as error:
            raise BadInput(f"{folder} may hold another run, choose another --out: {error}") from None
    result = _result_in(folder)
    if result is not None:
        raise BadInput(f"{folder} holds {result} of another run, but no {CONFIG}; choose another --out")
    return None


def _as_of_then(config: Config, path: Path) -> Config:
    """A configuration that was kept; one of a policy that names no solver is from when there was no choice: paper."""
    import tomllib

    from experiments.config import parse_config

    said = tomllib.loads(path.read_text(encoding="utf-8"))
    if config.kind == "policy" and "solver" not in said:
        return parse_config(said | {"solver": "paper"}, str(path))
    return config


def _result_in(folder: Path) -> str | None:
    return next((name for name in (RESULT, STUDY_RESULT) if (folder / name).exists()), None)


def keep_config(config: Struct, folder: Path) -> None:
    """Write the configuration into a folder that was checked; one that is there already says the same and stays."""
    from experiments.config import to_toml

    path = folder / CONFIG
    if not path.exists():
        partial = path.with_name(path.name + ".partial")
        partial.write_text(to_toml(config), encoding="utf-8")
        os.replace(partial, path)


def finished(kind: str, folder: Path) -> dict[str, Any] | None:
    """The result of a run of that kind that is complete; a damaged result is none, and the run makes it again."""
    if not (folder / REPORT).exists() or not (folder / RESULT).exists():
        return None
    try:
        result = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    except ValueError:
        return None
    if not isinstance(result, dict) or result.get("kind") != kind or "winner" not in result:
        return None
    say(f"{folder} is finished; its report is {folder / REPORT}")
    return result | {"out": str(folder)}  # it may have been moved.


@contextlib.contextmanager
def opened(config: Evolve | Study, path: Path, popsize: int, resume: bool) -> Iterator[Record]:
    """The run file, made or found.

    Args:
        config: the experiment; it is written beside the file.
        path: of the run file, in an existing folder.
        popsize: candidates per generation.
        resume: go on if a run is there already.

    Raises:
        BadInput: if a run is there and `resume` is not set, or it was made with another configuration or other parts.
        OSError: if a file cannot be read or written.
    """
    from evo.record import Record
    from experiments.config import config_hash, to_toml

    folder = path.parent
    check_folder(config, folder)
    if path.exists():
        if not resume:
            raise BadInput(f"{folder} holds a run already; go on with it by --resume, or choose another --out")
        _check_past(path, config)
    else:
        if resume:
            say(f"{folder} holds no run yet: starting it")
        meta = {
            "config": to_toml(config), "config_hash": config_hash(config), "seed": str(config.seed),
            "popsize": str(popsize), "decoder": config.decoder, "versions": json.dumps(versions()),
            "ingredients": json.dumps(ingredients(config)),
        }  # fmt: skip
        keep_config(config, folder)  # not before the ingredients: a decoder without weights leaves nothing behind.
        Record.create(path, popsize, meta).close()
    with Record(path, popsize) as record:
        yield record


def _check_past(path: Path, config: Evolve | Study) -> None:
    """Refuse to go on with other numbers in the program; tell of other versions, which differ in details at most."""
    from evo.record import Record

    with Record(path, 1) as record:
        meta = record.meta()
    before, now = json.loads(meta.get("ingredients", "{}")), ingredients(config)
    other = [name for name in now if before.get(name) != now[name]]
    if other:
        raise BadInput(
            f"{path.parent} was made by a program with another {' and another '.join(other)}, so the rest would not "
            "fit what is there; choose another --out"
        )
    before, now = json.loads(meta.get("versions", "{}")), versions()
    other = [f"{name} was {before.get(name)} and is now {now[name]}" for name in now if before.get(name) != now[name]]
    if other:
        say(f"note: {'; '.join(other)}: the rest of this run may differ from what it would have been")


def ingredients(config: Evolve | Study) -> dict[str, str]:
    """Digests of the numbers that results follow from but no configuration names, so that none changes within a run."""
    from decoder.latent import decoder_digest, make_decoder
    from experiments.judging import judge_of
    from mfg.pipeline import RULES

    judge = judge_of(config.solver, config.catalogue, config.parts)
    parts = {
        "set of solvers": RULES[judge.rules],
        "catalogue of components": judge.catalogue if judge.library is None else (judge.catalogue, judge.library),
    }
    digests = {name: hashlib.sha256(repr(part).encode()).hexdigest()[:16] for name, part in parts.items()}
    return {"decoder": decoder_digest(make_decoder(config.decoder)), **digests}


def versions() -> dict[str, str]:
    """Of this program and of what its results depend on."""
    import platform
    from importlib.metadata import version

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
