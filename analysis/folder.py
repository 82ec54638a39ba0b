"""A run folder as a report needs it: every file is optional but the one that says what the run was."""

from __future__ import annotations

import csv
import io
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.records import RecordsError, frame, read_meta, read_records

if TYPE_CHECKING:
    import pandas as pd

RUN_FILES = {"evolve": "run.sqlite", "study": "study.sqlite"}
RESULT, STUDY, CONFIG = "result.json", "study.json", "config.toml"


@dataclass(frozen=True, eq=False)
class RunFolder:
    """What is in a run folder.

    Attributes:
        path: of the folder.
        kind: "evolve", "study" or "sketch".
        records: all evaluations.
        finals: twins that were measured; empty where there is no such table.
        meta: what the run file says about the run.
        config: the configuration, as text and parsed.
        result: what the run ended with; empty while it is unfinished.
        problems: files that could not be used, in words.
    """

    path: Path
    kind: str
    records: pd.DataFrame
    finals: pd.DataFrame
    meta: Mapping[str, str]
    config: Mapping[str, Any]
    config_text: str
    result: Mapping[str, Any]
    problems: tuple[str, ...]

    def bytes(self, *names: str, limit: int = 12_000_000) -> bytes | None:
        """A file of the folder; None if it is missing or larger than `limit`."""
        path = self.path.joinpath(*names)
        if not path.is_file() or path.stat().st_size > limit:
            return None
        return path.read_bytes()

    def json(self, *names: str) -> dict[str, Any]:
        """A JSON object of the folder; empty if it is missing or damaged."""
        return _json(self.path.joinpath(*names))[0]

    def csv(self, *names: str) -> list[dict[str, str]]:
        """Rows of a CSV file; none if it is missing."""
        data = self.bytes(*names)
        if data is None:
            return []
        return list(csv.DictReader(io.StringIO(data.decode("utf-8", "replace")), restval=""))

    def has(self, *names: str) -> bool:
        """Whether the folder holds this."""
        return self.path.joinpath(*names).exists()


def read_folder(path: Path) -> RunFolder:
    """Read what a report is made of.

    Raises:
        RecordsError: if it is no run folder, or its run file cannot be read.
    """
    if not path.is_dir():
        raise RecordsError(f"{path} is {'a file, not' if path.exists() else 'not there; give'} the folder of a run")
    result, damage = _json(path / RESULT)
    problems = [damage] if damage else []
    config_text, config = _config(path / CONFIG)
    for kind, name in RUN_FILES.items():
        if (path / name).exists():
            if kind == "study":
                result, damage = _json(path / STUDY)
                problems = [damage] if damage else []
            records, meta = read_records(path / name), read_meta(path / name)
            finals = read_records(path / name, "finals") if kind == "evolve" else frame([])
            text = config_text or meta.get("config", "")
            return RunFolder(
                path, kind, records, finals, meta, config or _toml(text), text, result, tuple(problems)
            )  # fmt: skip
    if result.get("kind") == "sketch" or config.get("kind") == "sketch":
        return RunFolder(
            path, "sketch", frame([]), frame([]), {}, config, config_text, result, tuple(problems)
        )  # fmt: skip
    wanted = ", ".join([*RUN_FILES.values(), RESULT])
    raise RecordsError(f"{path} is not the folder of a run: it holds none of {wanted}")


def _json(path: Path) -> tuple[dict[str, Any], str]:
    """An object and what is wrong with its file, if anything."""
    if not path.is_file():
        return {}, ""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return {}, f"{path.name} is damaged and was left out"
    return (found, "") if isinstance(found, dict) else ({}, f"{path.name} holds no object and was left out")


def _config(path: Path) -> tuple[str, dict[str, Any]]:
    if not path.is_file():
        return "", {}
    text = path.read_text(encoding="utf-8", errors="replace")
    return text, _toml(text)


def _toml(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return {}
