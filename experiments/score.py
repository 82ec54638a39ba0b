"""`bodyplan score`: the verdict and the five scores of any number of designs, without writing anything."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.build import read_design
from experiments.judging import add_pipeline_options, judge_of, tell_round
from experiments.output import DONE, INFEASIBLE, emit, say

if TYPE_CHECKING:
    from mfg.pipeline import Outcome

HELP = "verdict and five scores of designs, no export"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("designs", type=Path, nargs="+", metavar="DESIGN", help="designs: .npz, or MagicaVoxel .vox")
    add_pipeline_options(parser)
    parser.add_argument(
        "--json", action="store_true", help="print one JSON document: an object, or a list of them for several designs"
    )


def main(args: argparse.Namespace) -> int:
    """Score designs in the order given; status 1 if any of them cannot be built."""
    judge = judge_of(args.solver, args.catalogue, args.parts)
    width = max(len(str(path)) for path in args.designs)
    verdicts: list[dict[str, Any]] = []
    for path in args.designs:
        outcome = judge.score(read_design(path), tell_round)
        verdicts.append({"file": str(path), **outcome.to_json(None)})
        if not args.json:
            print(f"{path!s:{width}}  {_line(outcome)}")
            for note in outcome.blueprint.notes if outcome.ok else ():
                print(f"  note: {note}")
        elif not outcome.ok:
            say(f"bodyplan: {path} cannot be built: {outcome.failure}")
    if args.json:
        emit(verdicts if len(verdicts) > 1 else verdicts[0])
    passed = sum(v["ok"] for v in verdicts)
    if not args.json and len(verdicts) > 1:
        print(f"{passed} of {len(verdicts)} can be built")
    return DONE if passed == len(verdicts) else INFEASIBLE


def _line(outcome: Outcome) -> str:
    if not outcome.ok:
        return f"cannot be built: {outcome.failure}"
    names = ("motor", "electronics", "cable", "electronics install", "body install")
    scores = "  ".join(f"{name} {value:.2f}" for name, value in zip(names, outcome.scores.values(), strict=True))
    return f"can be built, {outcome.scores.total:.2f} of 5: {scores}"
