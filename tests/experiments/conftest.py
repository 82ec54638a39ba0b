"""The command line as a fixture: call it, get status, stdout and stderr."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest

from experiments.cli import main


class Said(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture
def bodyplan(capfd: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    def call(*words: object) -> Said:
        capfd.readouterr()
        try:
            status = main([str(word) for word in words])
        except SystemExit as leave:  # argparse leaves this way
            status = int(leave.code or 0)
        return Said(status, *capfd.readouterr())

    return call
