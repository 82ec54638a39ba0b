"""How commands speak: results to stdout, everything else to stderr, bad input as one clear line."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

T = TypeVar("T")

VERSION = "0.1.0"

DONE = 0  # exit status: it worked
INFEASIBLE = 1  # exit status: the design cannot be built, and the reason was printed
BAD_INPUT = 2  # exit status: bad input or configuration
INTERRUPTED = 3  # exit status: stopped by the user, and it can be resumed
DEFECT = 70  # exit status: the program itself is at fault

# What the options of the same name accept; a test keeps them equal to what the library offers.
DECODERS = ("vae", "genome")
DEFAULT_DECODER = "vae"
WEIGHTS_SUFFIX = ".safetensors"  # a file of weights for the learned decoder stands where its name does
Priors = Literal["normal", "uniform"]
Solvers = Literal["paper", "search"]
Catalogues = Literal["paper", "auto"]
PRIORS, SOLVERS, CATALOGUES = get_args(Priors), get_args(Solvers), get_args(Catalogues)
DEFAULT_SOLVER: Solvers = "search"

MOST_BODIES = 1_000_000  # in one sample or study: latents of that many fill 2 GB
SEED_BOUND = 2**63  # seeds are stored as signed 64-bit integers in run files


class BadInput(ValueError):
    """What the user gave cannot be used; the message is one line that says why and what to do."""


def say(text: str) -> None:
    """Tell the person at the terminal something (stderr), above a progress bar if there is one."""
    bars = sys.modules.get("tqdm")
    if bars is None:
        print(text, file=sys.stderr, flush=True)
    else:
        bars.tqdm.write(text, file=sys.stderr)


def emit(value: Any) -> None:
    """Print one JSON document (stdout).

    Raises:
        ValueError: if a number is not finite; JSON has no word for it.
    """
    print(json.dumps(value, indent=2, allow_nan=False), flush=True)


def progress(iterable: Iterable[T], total: int | None, label: str) -> Iterator[T]:
    """Pass items through while a bar on stderr shows how far, how fast and how long still."""
    from tqdm import tqdm

    live = sys.stderr.isatty()
    # In a log file a bar is a stream of lines: none for short work, then one every ten seconds.
    pause = 0.1 if live else 10.0
    yield from tqdm(
        iterable, total=total, desc=label, file=sys.stderr, dynamic_ncols=live, mininterval=pause,
        delay=0.0 if live else pause,
    )  # fmt: skip


def make_folder(path: Path | str) -> Path:
    """Make an output folder, with its parents.

    Raises:
        BadInput: if a file is in the way.
        OSError: if it cannot be made or written to.
    """
    folder = Path(path)
    for part in (folder, *folder.parents):
        if part.is_dir():
            break
        if part.exists() or part.is_symlink():
            raise BadInput(f"{part} is a file, so no folder {folder} can be made there; choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def add_decoder_option(parser: argparse.ArgumentParser) -> None:
    """Let the user choose what turns latents into bodies."""
    parser.add_argument(
        "--decoder", type=decoder, default=DEFAULT_DECODER, metavar="|".join((*DECODERS, "FILE")),
        help=f"what turns latents into bodies; a file ends in {WEIGHTS_SUFFIX} ({DEFAULT_DECODER})",
    )  # fmt: skip


def add_solver_option(parser: argparse.ArgumentParser) -> None:
    """Let the user choose the rules by which a design becomes a robot."""
    parser.add_argument(
        "--solver", choices=SOLVERS, default=DEFAULT_SOLVER,
        help=f"by which rules: the paper's, or a search for more ways to build the same body ({DEFAULT_SOLVER})",
    )  # fmt: skip


def decoder(text: str) -> str:
    """Read a command-line decoder: a name, or a file of weights, whose path a run must find from anywhere."""
    if text in DECODERS:
        return text
    if not text.endswith(WEIGHTS_SUFFIX) or not text.isprintable():
        raise argparse.ArgumentTypeError(
            f"{text!r} is no decoder; known are {', '.join(DECODERS)}, and files ending in {WEIGHTS_SUFFIX}"
        )
    return os.path.abspath(text)


def count(text: str) -> int:
    """Read a command-line number of bodies: a whole number of at least 1."""
    return _whole(text, 1, MOST_BODIES)


def seed(text: str) -> int:
    """Read a command-line seed: a whole number of at least 0."""
    return _whole(text, 0, SEED_BOUND - 1)


def _whole(text: str, least: int, greatest: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not least <= value <= greatest:
        raise argparse.ArgumentTypeError(f"{value} is out of bounds; it must lie in [{least}, {greatest}]")
    return value
