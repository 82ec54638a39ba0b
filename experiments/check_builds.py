"""Check the files of many builds by foreign eyes: every STL and 3MF read back, every clearance by exact booleans.

    python -m experiments.check_builds -n 50 --seed 0 --out builds.jsonl --slice 3

Random designs are drawn until n of them pass the solvers; then each is written, read back and measured, and the first
K are sliced whole. One line of JSON per design is kept as it goes, so that the same command goes on where an earlier
one was stopped. Status 1 if anything is wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from experiments.json_lines import Row, appending, read_rows
from experiments.output import DONE, INFEASIBLE, BadInput, add_decoder_option, add_solver_option, progress, say

if TYPE_CHECKING:
    from decoder.latent import Decoder
    from mfg.slicer import SliceReport

MOST_DRAWN = 20  # designs drawn for one that passes, before the script gives up
SCORES = ("motor", "electronics", "cable", "electronics_install", "body_install")


def main(argv: list[str] | None = None) -> int:
    """Run the check; status 1 on any violation."""
    parser = argparse.ArgumentParser(prog="python -m experiments.check_builds", description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=50, help="designs that must pass (50)")
    parser.add_argument("--seed", type=int, default=0, help="of the random designs (0)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="keep one line of JSON per design, and go on from it")
    parser.add_argument("--slice", type=int, default=0, metavar="K", help="slice the first K robots whole (0)")
    add_decoder_option(parser)
    add_solver_option(parser)
    args = parser.parse_args(argv)
    try:
        rows = checked_rows(args.n, args.seed, args.decoder, args.solver, args.slice, args.out)
    except BadInput as error:
        parser.error(str(error))
    print(summary(rows))
    wrong = [f"{row['design']} (draw {row['draw']}): {problem}" for row in rows for problem in row["problems"]]
    for problem in wrong:
        print(f"WRONG {problem}")
    return INFEASIBLE if wrong or sum(row["built"] for row in rows) < args.n else DONE


def checked_rows(n: int, seed: int, decoder: str, solver: str, sliced: int, out: Path | None) -> list[Row]:
    """One row for every design drawn until n are built; those in the file `out` are not drawn again.

    Raises:
        BadInput: if the file holds rows of other settings.
        OSError: if it cannot be read or written.
    """
    from decoder.latent import make_decoder

    settings = {"decoder": decoder, "solver": solver, "seed": seed}
    rows = [] if out is None else earlier_rows(out, settings)
    latents = make_decoder(decoder)
    _say_what_is_missing(sliced > 0)
    built = sum(row["built"] for row in rows)
    with contextlib.ExitStack() as stack:
        add = None if out is None else stack.enter_context(appending(out))
        for _ in progress(range(n - built), n - built, "builds"):
            for row in _until_built(latents, settings, len(rows), built < sliced, MOST_DRAWN * n):
                rows.append(row)
                if add is not None:
                    add(row)
            if not rows[-1]["built"]:
                say(f"only {built} of {len(rows)} designs were built; gave up")
                break
            built += 1
    return rows


def earlier_rows(path: Path, settings: Mapping[str, Any]) -> list[Row]:
    """The rows of an earlier run, none if there was none.

    Raises:
        BadInput: if they are not rows of this program or of other settings.
    """
    try:
        rows = read_rows(path)
        found = [{key: row[key] for key in settings} | {"draw": row["draw"]} for row in rows]
    except (ValueError, KeyError, TypeError):
        raise BadInput(f"{path} holds something else than rows of this program; name another file") from None
    for draw, row in enumerate(found):
        if row != {**settings, "draw": draw}:
            raise BadInput(f"{path} holds rows of {row}, not {dict(settings)}; name another file")
    return rows


def _until_built(decoder: Decoder, settings: Row, first: int, sliced: bool, most: int) -> Iterator[Row]:
    for draw in range(first, most):
        row = _row(decoder, settings, draw, sliced)
        yield row
        if row["built"]:
            return


def _row(decoder: Decoder, settings: Row, draw: int, sliced: bool) -> Row:
    """Draw one design, build it, and check what was written."""
    import numpy as np

    from decoder.latent import sample_latents
    from experiments.foreign_check import checked
    from mfg.outcome import Failure
    from mfg.pipeline import RULES, Outcome, score
    from mfg.splitting import pieces

    # One stream per design: the sample does not depend on how many were refused.
    design = decoder.decode(sample_latents(1, np.random.default_rng([settings["seed"], draw])))[0]
    row: Row = {**settings, "draw": draw, "design": design.key, "built": False, "late": False, "failure": None,
                "problems": []}  # fmt: skip
    fast = score(design, rules=settings["solver"])
    start = time.process_time()
    finished = fast.failure or RULES[settings["solver"]][-1].solve(fast.blueprint)
    if isinstance(finished, Failure):
        return row | {"late": fast.ok, "failure": {"stage": finished.stage, "reason": finished.reason,
                                                   "detail": finished.detail}}  # fmt: skip
    row |= {"built": True, "finish_s": round(time.process_time() - start, 3)}
    with tempfile.TemporaryDirectory() as folder:
        problems, shared = checked(Outcome(finished, None, {}), Path(folder) / "robot")
        report, trouble = _sliced(Path(folder) / "robot") if sliced else (None, "")
    pairs = zip(SCORES, fast.scores.values(), finished.scores.values(), strict=True)
    return row | {
        "bodies": len(finished.bodies), "parts": len(finished.parts), "objects": len(pieces(finished)),
        "lids": len(finished.lids), "mass_kg": round(sum(m.mass for m in finished.masses), 3),
        "volume_cm3": round(1e6 * sum(part.solid.volume for part in finished.parts), 1),
        "shared_mm3": float(f"{1e9 * shared:.2g}"),
        "score_differences": {name: abs((a or 0.0) - (b or 0.0)) for name, a, b in pairs},
        "slice": report and report.to_json(), "notes": list(finished.notes),
        "problems": [*problems, *([trouble] if trouble else [])],
    }  # fmt: skip


def _sliced(folder: Path) -> tuple[SliceReport | None, str]:
    from mfg.slicer import SliceError, find_slicer, slice_blueprint

    if find_slicer() is None:
        return None, ""
    try:
        return slice_blueprint(folder), ""
    except SliceError as error:
        return None, str(error)


def _say_what_is_missing(slices: bool) -> None:
    from mfg.slicer import find_slicer

    if shutil.which("admesh") is None:
        say("no admesh here: STL files are read back by trimesh only")
    if find_slicer() is None:
        say(f"no PrusaSlicer here: 3MF files are read back by trimesh only{', and nothing is sliced' * slices}")


def summary(rows: list[Row]) -> str:
    """A table of what was seen, failures by reason."""
    built, late = [row for row in rows if row["built"]], [row for row in rows if row["late"]]
    wrong = [row for row in rows if row["problems"]]
    sliced = [row["slice"] for row in built if row["slice"]]
    lines = [f"{len(built)} robots built of {len(rows)} designs, {len(wrong)} of them with something wrong"]
    refused = Counter(f"{row['failure']['stage']}: {row['failure']['reason']}" for row in rows if row["failure"])
    lines += [f"  {count:5}  {why}" for why, count in refused.most_common()]
    lines += [f"  refused by exact solids only: {row['design']}: {row['failure']['detail']}" for row in late]
    if built:
        share = len(built) / (len(built) + len(late))
        largest = {name: max(row["score_differences"][name] for row in built) for name in SCORES}
        table = (
            ("printed objects, parts, lids", *(sum(row[k] for row in built) for k in ("objects", "parts", "lids"))),
            ("shared by all pairs, median and most [mm3]", median(row["shared_mm3"] for row in built),
             max(row["shared_mm3"] for row in built)),
            ("mass, median [kg]", median(row["mass_kg"] for row in built)),
            ("finish, median [CPU s]", median(row["finish_s"] for row in built)),
            ("exact verdict agrees with the fast one", f"{100 * share:.1f} %"),
            ("largest difference of a score", *(f"{name} {value:.3f}" for name, value in largest.items())),
            ("sliced whole, warnings", len(sliced), sum(len(report["warnings"]) for report in sliced)),
        )  # fmt: skip
        lines += [f"  {name}: {', '.join(str(value) for value in values)}" for name, *values in table]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
