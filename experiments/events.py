"""Curves for TensorBoard: the only importer of tensorboardX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol


class Events(Protocol):
    """Where curves are written to."""

    def __call__(self, step: int, values: Mapping[str, float]) -> None:
        """Write one point of each named curve."""
        ...


@contextmanager
def event_file(folder: Path, step: int) -> Iterator[Events]:
    """Open an event file of its own for what follows after a step; `tensorboard --logdir` of the folder reads them all.

    Args:
        folder: of the event files; it is made.
        step: the last that is done. What an interrupted run had written beyond it is hidden from the reader.

    Raises:
        OSError: if the folder cannot be written.
    """
    from tensorboardX import SummaryWriter

    folder.mkdir(parents=True, exist_ok=True)
    # File names hold the second of their making; with the step no second start can write over the first.
    writer = SummaryWriter(str(folder), purge_step=step + 1, filename_suffix=f".{step}", flush_secs=30)

    def write(step: int, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            writer.add_scalar(name, value, step)

    try:
        yield write
    finally:
        writer.close()
