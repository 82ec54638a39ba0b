"""How a command judges bodies: by which rules and with which parts, as its options or its configuration say."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.output import CATALOGUES, BadInput, Catalogues, Solvers, add_solver_option, say

if TYPE_CHECKING:
    from evo.judge import Judge


def add_pipeline_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose solvers and components."""
    add_solver_option(parser)
    parser.add_argument(
        "--catalogue", choices=CATALOGUES, default="paper",
        help="which components: the paper's, or auto: those that each robot's own gait asks for, which takes some ten "
        "seconds a body; `bodyplan doctor` lists what it chooses from (paper)",
    )  # fmt: skip
    parser.add_argument(
        "--parts", type=Path, metavar="DIR",
        help="with --catalogue auto: choose from the motors, batteries, controllers and wires in this folder's TOML "
        "files too, written like those in mfg/components; one of the same kind and name takes the shipped one's place",
    )  # fmt: skip


def judge_of(solver: Solvers, catalogue: Catalogues, parts: Path | str | None, *, deployed: bool = False) -> Judge:
    """The judge that options or a configuration ask for.

    Args:
        solver: rules of the pipeline.
        catalogue: "paper", or "auto" for parts sized to each body.
        parts: folder of component files to choose from beside those that ship, or None.
        deployed: whether the robot gets a policy bundle, so that only motors count that `hardware` can drive.

    Raises:
        BadInput: if there are parts to choose from and nothing is chosen.
        ComponentError: if a file of the folder is no part.
        OSError: if it cannot be read.
    """
    from evo.judge import Judge

    if catalogue == "paper":
        if parts is not None:
            raise BadInput(f"--parts {parts}: there is nothing to choose from them but with --catalogue auto")
        return Judge(solver)
    from mfg.library import read_library

    return Judge(solver, library=read_library(parts), drivers="only" if deployed else "prefer")


def tell_round(number: int, rounds: int, parts: str) -> None:
    """Say what the sizing of parts is at; a round takes seconds."""
    say(f"sizing parts, round {number} of at most {rounds}: a gait for the robot with {parts}")
