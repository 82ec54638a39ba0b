"""`bodyplan report`: one HTML file about a run, finished or not."""

from __future__ import annotations

import argparse
from pathlib import Path

from experiments.output import DONE, emit

HELP = "one self-contained HTML file about a run"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of an evolution, a study or a sketch")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Write RUN/report.html."""
    from analysis.report import write_report

    path = write_report(args.run)
    if args.json:
        emit({"run": str(args.run), "report": str(path), "bytes": path.stat().st_size})
    else:
        print(path)
    return DONE
