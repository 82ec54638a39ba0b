"""`bodyplan replay`: would the program, given the same replies, still send the same frames?"""

from __future__ import annotations

import argparse
from pathlib import Path

from experiments.output import DONE, INFEASIBLE, BadInput, emit

HELP = "play a deploy log back: frames -> first divergence between logged and recomputed action"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("log", metavar="LOG", type=Path, help="frame log that `deploy --log` wrote")
    parser.add_argument("--bundle", type=Path, help="act by this policy bundle instead of the logged one")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Play the log back; exit status 1 if the program diverges from it."""
    from hardware.bundle import load_bundle
    from hardware.log import LogError, play_back, read_log

    try:
        log = read_log(args.log)
    except LogError as error:
        raise BadInput(str(error)) from None
    bundle = log.bundle if args.bundle is None else load_bundle(args.bundle)
    if [joint.can_id for joint in bundle.joints] != [joint.can_id for joint in log.bundle.joints]:
        raise BadInput(f"{args.bundle} is for other motors than {args.log}; give a bundle of the same robot")
    compared, divergence = play_back(log, bundle)
    found = None if divergence is None else divergence.as_json(bundle)
    if args.json:
        emit({"ticks": len(log.ticks), "frames": len(log.frames), "agree": compared, "divergence": found})
    elif found is None:
        print(f"{compared} of {len(log.frames)} frames over {len(log.ticks)} periods recomputed, no divergence")
    else:
        print(f"divergence in period {found['tick']} at {found['time']:.6f} s, joint {found['joint']}")
        print(f"  logged     {found['logged']}")
        print(f"  recomputed {found['recomputed']}")
    return DONE if found is None else INFEASIBLE
