"""Results as one line of JSON each: a program that is killed loses none but the one it was writing."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from experiments.output import BadInput

Row = dict[str, Any]


def read_rows(path: Path) -> list[Row]:
    """The rows of a file, none if it is not there; a last line without an end, cut short by a kill, is left out.

    Raises:
        BadInput: if a whole line is not JSON.
        OSError: if the file cannot be read.
    """
    if not path.exists():
        return []
    data = path.read_bytes()
    try:
        return [json.loads(line) for line in data[: data.rfind(b"\n") + 1].splitlines()]
    except ValueError as error:
        raise BadInput(f"{path} has a damaged line: {error}; take it out, or choose another file") from None


@contextlib.contextmanager
def appending(path: Path) -> Iterator[Callable[[Row], None]]:
    """What adds a row to a file, each in the file before it returns; a line that was cut short makes way.

    Raises:
        OSError: if the file cannot be written.
    """
    with path.open("ab+") as file:
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)

        def add(row: Row) -> None:
            file.write(json.dumps(row, allow_nan=False).encode() + b"\n")
            file.flush()

        yield add
