"""Whether the time step of the physics changes which gait is faster more than putting the robot down anew does.

    python -m experiments.step_study -n 10 --seed 0 --out runs/step

Random bodies of the decoder that can be built walk by the same random open-loop gaits with the usual step, with half
and with a quarter of it; and once more with the usual step after what no laboratory can repeat better: a start that is
a micrometre or a millimetre higher, and joints that were homed anew. Toppling is chaotic, so ranks differ by all these.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from evo.pool import Pool
from experiments.fidelity_study import body_of, mean_interval, passing, spearman, study_parser
from experiments.output import DONE, INFEASIBLE, make_folder, progress, say
from experiments.run_folder import write_json
from mfg.outcome import Failure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.output import Solvers
    from sim.actor import Gait
    from sim.model import Model

TIMEOUT = 600.0  # of one body [s]
RESULT, TABLE = "step.json", "step.md"
HEIGHTS = {"a micrometre higher": 1e-6, "a millimetre higher": 1e-3}  # [m]
HOMED = 0.03  # farthest that a joint is from where it reads, by hand against a printed mark [rad]
Speeds = list[float | None]

PAIRS = {  # what is compared, by names of walks
    "step halved, 4 to 2 ms": ("usual", "half"),
    "step halved, 2 to 1 ms": ("half", "quarter"),
    **{f"start {name}": ("usual", name) for name in HEIGHTS},
    f"joints homed within {HOMED} rad": ("usual", "homed"),
    "two such homings": ("homed", "homed again"),
}


def main(argv: list[str] | None = None) -> int:
    """Run the study, print its table and write it with all speeds."""
    args = study_parser("step_study", __doc__, gaits=32).parse_args(argv)
    folder = make_folder(args.out)
    indices = list(progress(passing(args.decoder, args.solver, args.seed, args.n), args.n, "bodies that pass"))
    walk = partial(walks, args.decoder, args.solver, args.seed, args.gaits, args.seconds)
    with Pool[int, dict[str, Speeds]](walk, args.workers, TIMEOUT) as pool:
        done = {index: found for index, found, _ in progress(pool.run(indices), args.n, "walking")}
    bodies: dict[str, dict[str, Speeds]] = {}
    for index in indices:
        if isinstance(walked := done[index], Failure):
            say(f"body {index} was lost: {walked.detail}")
        else:
            bodies[str(index)] = walked
    if not bodies:
        return INFEASIBLE
    table = markdown(list(bodies.values()), args.gaits, args.seconds)
    what = {"seed": args.seed, "decoder": args.decoder, "solver": args.solver, "gaits": args.gaits,
            "seconds": args.seconds, "bodies": bodies}  # fmt: skip
    write_json(folder / RESULT, what)
    (folder / TABLE).write_text(table, encoding="utf-8")
    say(f"written to {folder}")
    print(table)
    return DONE


def walks(name: str, rules: Solvers, seed: int, gaits: int, seconds: float, index: int) -> dict[str, Speeds]:
    """Speeds of the gaits of one body by what was varied [m/s]; None where the physics exploded."""
    import numpy as np

    from mfg.description import describe
    from mfg.robot_files import TIMESTEP
    from sim.gaits import decode, random_points
    from sim.model import compile_model, drive_of
    from sim.rollout import settle

    blueprint = body_of(name, rules, seed, index)
    assert blueprint is not None  # it passed before
    robot = describe(blueprint)
    model = compile_model(robot)
    drive, rng = drive_of(model), np.random.default_rng([seed, index, 1])
    chosen = [decode(drive, point) for point in random_points(drive, gaits, rng)]
    start = settle(model)
    found = {"usual": _speeds(model, chosen, seconds, start)}
    for label, share in (("half", 2), ("quarter", 4)):
        found[label] = _speeds(compile_model(robot, timestep=TIMESTEP / share), chosen, seconds)
    for label, height in HEIGHTS.items():
        lifted = start.copy()
        lifted[3] += height
        found[label] = _speeds(model, chosen, seconds, lifted)
    for label in ("homed", "homed again"):
        off = rng.uniform(-HOMED, HOMED, model.nu)
        found[label] = _speeds(model, [replace(gait, offset=gait.offset + off) for gait in chosen], seconds, start)
    return found


def _speeds(model: Model, gaits: Sequence[Gait], seconds: float, start: Any = None) -> Speeds:
    from sim.rollout import measure, roll_out

    return [None if b is None else b.speed for b in measure(model, roll_out(model, gaits, seconds, start), 1.0)]


def markdown(bodies: Sequence[dict[str, Speeds]], gaits: int, seconds: float) -> str:
    """The table: of each pair the rank correlation over the gaits of a body, its mean and its median over bodies."""
    import numpy as np

    lines = [
        f"{len(bodies)} bodies x {gaits} gaits x {seconds:g} s; rank correlation of their speeds on a body.",
        "", "| what differs | mean, 95 % by bootstrap over bodies | median | least |", "|---|---|---:|---:|",
    ]  # fmt: skip
    for what, (one, two) in PAIRS.items():
        ranks = [spearman(body[one], body[two]) for body in bodies]
        mean, low, high = mean_interval(ranks)
        lines.append(f"| {what} | {mean:.3f} ({low:.2f} to {high:.2f}) | {np.median(ranks):.3f} | {min(ranks):.2f} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
