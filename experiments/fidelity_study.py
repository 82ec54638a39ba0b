"""What each way to model the soft skin costs, and how it changes which gait is faster.

    python -m experiments.fidelity_study -n 10 --seed 0 --out runs/fidelity

Random bodies of the decoder that pass `bodyplan score` by the chosen rules walk by the same random open-loop gaits at
every fidelity. All levels start from the pose in which the fitted model lies still. The reference is flex-fine. Contact
makes walking chaotic, so every level is run a second time from a start that is a micrometre higher: how well a level
agrees with itself is the most that it can agree with another.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import DONE, add_decoder_option, add_solver_option, count, make_folder, progress, say, seed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from experiments.output import Solvers
    from mfg.blueprint import Blueprint
    from sim.model import Model

LEVELS = (
    "constant",
    "compliant",
    "hull",
    "sprung",
    "flex",
    "flex-fine",
)  # the first is the default, `compliant` with one contact
REFERENCE = LEVELS[-1]
SHIFT = 1e-6  # of the second start [m]
DRAWS = 2000  # of the bootstrap over bodies
RESULT, TABLE = "fidelity.json", "fidelity.md"
WHAT = {
    "constant": "hull, one contact time of 20 ms (default)",
    "compliant": "hull, contact fitted to the skin",
    "hull": "full hull, fitted contact, 1 ms",
    "sprung": "hull on three damped slides",
    "flex": "1 x 1 x 1 trilinear blocks at the ends of limbs",
    "flex-fine": "2 x 2 x 2 trilinear blocks, core held",
}


@dataclass(frozen=True, slots=True)
class Walks:
    """One body at one fidelity.

    Attributes:
        level: of the ladder.
        speeds: of the gaits along their best headings [m/s]; None where the physics exploded.
        again: the same from a start that is a micrometre higher.
        steps_per_s: physics steps per CPU-second.
        real_time: simulated seconds per CPU-second.
        dofs: of the model.
        compile_ms: from description to model [ms].
    """

    level: str
    speeds: list[float | None]
    again: list[float | None]
    steps_per_s: float
    real_time: float
    dofs: int
    compile_ms: float


def study_parser(name: str, story: str, gaits: int) -> argparse.ArgumentParser:
    """The command line of a study of random bodies that walk by random gaits, so many a body by default."""
    parser = argparse.ArgumentParser(prog=f"python -m experiments.{name}", description=story.splitlines()[0])
    parser.add_argument("-n", type=count, default=10, help="bodies that pass (10)")
    parser.add_argument("--seed", type=seed, default=0, help="of bodies and gaits (0)")
    parser.add_argument("--gaits", type=count, default=gaits, help=f"per body ({gaits})")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each gait that are measured (3)")
    parser.add_argument("--workers", type=count, default=2, help="processes (2)")
    parser.add_argument("--out", type=Path, required=True, help="folder for the table and all speeds")
    add_decoder_option(parser)
    add_solver_option(parser)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Run the study, print its table and write it with all speeds."""
    parser = study_parser("fidelity_study", __doc__, gaits=16)
    args = parser.parse_args(argv)
    folder = make_folder(args.out)
    for library in ("OMP", "OPENBLAS"):  # before the workers import them
        os.environ[f"{library}_NUM_THREADS"] = "1"
    began = time.time()
    tasks = [
        (args.decoder, args.solver, args.seed, index, args.gaits, args.seconds)
        for index in progress(passing(args.decoder, args.solver, args.seed, args.n), args.n, "bodies that pass")
    ]
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        found = list(progress(pool.imap(study, tasks), args.n, "walking"))
    result = summary(found)
    table = markdown(result, args)
    say(f"took {time.time() - began:.0f} s")
    print(table)
    from experiments.bench import machine
    from experiments.run_folder import write_json

    bodies = [
        {"index": task[3], "levels": [asdict(w) for w in walks]} for task, walks in zip(tasks, found, strict=True)
    ]
    write_json(folder / RESULT, {
        "machine": machine(), "seed": args.seed, "decoder": args.decoder, "solver": args.solver, "gaits": args.gaits,
        "seconds": args.seconds, "levels": result, "bodies": bodies,
    })  # fmt: skip
    (folder / TABLE).write_text(table, encoding="utf-8")
    return DONE


def study(task: tuple[str, Solvers, int, int, int, float]) -> list[Walks]:
    """Let the body of (decoder, rules, seed, index) walk by so many gaits for so long, at every level."""
    import numpy as np

    from sim.gaits import decode, random_points
    from sim.model import drive_of
    from sim.rollout import measure, roll_out, settle

    name, rules, seed, index, gaits, seconds = task
    blueprint = body_of(name, rules, seed, index)
    assert blueprint is not None  # it passed before
    found: list[Walks] = []
    pose: NDArray[np.float64] | None = None
    for level in ("compliant", *(level for level in LEVELS if level != "compliant")):
        model, compiled = _model(blueprint, level)
        if pose is not None:
            model.qpos0[:7] = pose  # where a robot is put before it is let down
        start = settle(model)
        pose = start[1:8].copy() if pose is None else pose
        drive = drive_of(model)
        chosen = [decode(drive, p) for p in random_points(drive, gaits, np.random.default_rng([seed, index, 1]))]
        runs = []
        for shift in (0.0, SHIFT):
            moved = start.copy()
            moved[3] += shift
            runs.append(roll_out(model, chosen, seconds, moved))
        speeds, again = ([None if b is None else b.speed for b in measure(model, run, 1.0)] for run in runs)
        rate = float(np.mean([run.steps_per_s for run in runs]))
        found.append(Walks(level, speeds, again, rate, rate * model.opt.timestep, model.nv, 1e3 * compiled))
    return sorted(found, key=lambda walks: LEVELS.index(walks.level))


def summary(bodies: Sequence[Sequence[Walks]]) -> list[dict[str, Any]]:
    """One row per level, over all bodies; correlations are means over bodies with bootstrap intervals of 95 %."""
    import numpy as np

    reference = [next(w for w in body if w.level == REFERENCE) for body in bodies]
    rows = []
    for k, level in enumerate(LEVELS):
        walks = [body[k] for body in bodies]
        itself = [spearman(w.speeds, w.again) for w in walks]
        pairs = [_both(w.speeds, r.again if level == REFERENCE else r.speeds)
                 for w, r in zip(walks, reference, strict=True)]  # fmt: skip
        rows.append({
            "level": level, "what": WHAT[level], "dofs": float(np.mean([w.dofs for w in walks])),
            "compile_ms": float(np.median([w.compile_ms for w in walks])),
            "steps_per_s": float(np.mean([w.steps_per_s for w in walks])),
            "real_time": float(np.mean([w.real_time for w in walks])),
            "rank": mean_interval([spearman(a, b) for a, b in pairs]), "rank_with_itself": mean_interval(itself),
            "rank_of_bodies": spearman(*([max(v, default=None) for v in side] for side in zip(*pairs, strict=True))),
            "speed_ratio": float(np.median([np.mean(a) / np.mean(b) for a, b in pairs if a])),
            "error_mm_s": 1e3 * float(np.mean([np.mean(np.abs(np.subtract(a, b))) for a, b in pairs if a])),
            "exploded": sum(v is None for w in walks for v in (*w.speeds, *w.again)),
        })  # fmt: skip
    return rows


def spearman(one: Sequence[float | None], two: Sequence[float | None]) -> float:
    """Rank correlation of the pairs in which neither is missing; 0 for fewer than three, or if all of one are equal."""
    from scipy.stats import spearmanr

    a, b = _both(one, two)
    return float(spearmanr(a, b).statistic) if len(a) > 2 and len(set(a)) > 1 < len(set(b)) else 0.0


def markdown(rows: Sequence[dict[str, Any]], args: argparse.Namespace) -> str:
    """The table as Markdown."""
    lines = [
        f"{args.n} bodies x {args.gaits} gaits x {args.seconds:g} s; rank correlation of gait speed, mean over bodies "
        "with a 95 % bootstrap interval.",
        "",
        "| level | model | dofs | compile | steps/s | x real time | rank against flex-fine | rank against itself | "
        "bodies | speed | error | exploded |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        ranks = [f"{m:.2f} ({low:.2f} to {high:.2f})" for m, low, high in (row["rank"], row["rank_with_itself"])]
        lines.append(
            f"| {row['level']} | {row['what']} | {row['dofs']:.0f} | {row['compile_ms']:.0f} ms | "
            f"{row['steps_per_s']:,.0f} | {row['real_time']:.1f} | {ranks[0]} | {ranks[1]} | "
            f"{row['rank_of_bodies']:.2f} | {row['speed_ratio']:.2f} | {row['error_mm_s']:.0f} mm/s | "
            f"{row['exploded']} |"
        )
    return "\n".join(lines) + "\n"


def _model(blueprint: Blueprint, level: str) -> tuple[Model, float]:
    """The model of a body at a level, and how long it took from description to model [s]."""
    from mfg.description import FULL_HULL, HULL_VERTICES, describe
    from mfg.robot_files import CONTACT_TIME
    from sim.model import compile_model
    from sim.skin import Fidelity

    fidelity = Fidelity.COMPLIANT if level == "constant" else Fidelity(level)
    description = describe(blueprint, hull_vertices=FULL_HULL if fidelity is Fidelity.HULL else HULL_VERTICES)
    begun = time.perf_counter()
    model = compile_model(description, fidelity=fidelity, contact_time=CONTACT_TIME if level == "constant" else None)
    return model, time.perf_counter() - begun


def passing(name: str, rules: Solvers, seed: int, wanted: int) -> Iterator[int]:
    """Indices of the first random bodies that can be built by some rules."""
    index = 0
    while wanted:
        if body_of(name, rules, seed, index) is not None:
            wanted -= 1
            yield index
        index += 1


def body_of(name: str, rules: Solvers, seed: int, index: int) -> Blueprint | None:
    """The body of a seed and an index, or None where it cannot be built."""
    import numpy as np

    from decoder.latent import sample_latents
    from experiments.study import decoder_of
    from mfg.pipeline import score

    design = decoder_of(name).decode(sample_latents(1, np.random.default_rng([seed, index])))[0]
    outcome = score(design, rules=rules)
    return outcome.blueprint if outcome.ok else None


def _both(one: Sequence[float | None], two: Sequence[float | None]) -> tuple[list[float], list[float]]:
    """The pairs in which neither is missing."""
    pairs = [(a, b) for a, b in zip(one, two, strict=True) if a is not None and b is not None]
    return [a for a, _ in pairs], [b for _, b in pairs]


def mean_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Mean of independent values and its 95 % bootstrap interval."""
    import numpy as np

    known = np.array(values)
    means = known[np.random.default_rng(0).integers(0, len(known), (DRAWS, len(known)))].mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(known.mean()), float(low), float(high)


if __name__ == "__main__":
    sys.exit(main())
