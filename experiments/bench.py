"""`make bench`: one table of what each part costs, ratios within one run, and the same as JSON.

Every figure is a median or a rate of this run on this machine. Ratios compare two ways to the same answer, measured
within seconds of each other, so they hold on other machines too.
"""

from __future__ import annotations

import argparse
import itertools
import json
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.bench_search import search
from experiments.bench_training import training
from experiments.measuring import clock, peak, throughput, timed
from experiments.output import VERSION, count, make_folder, progress, say
from experiments.run_folder import cores

if TYPE_CHECKING:
    from decoder.design import VoxelDesign
    from evo.evaluation import Candidate
    from mfg.pipeline import Outcome

SEED = 0
DECODE, DECODE_MANY = 0.3, 0.08  # goals for a body decoded by itself and in a batch [s]
BATCH, BATCHES = 32, 5  # bodies of a batch, and how many are timed
SCORE, BUILD, BARE = 0.15, 0.7, 0.95  # goals of the design, on two cores: [s], [s], ratio
MODEL = 0.06  # goal for a virtual robot, from voxels to what MuJoCo steps [s]
HELP_TIME = 0.5  # goal [s]
GAITS, GAIT_SECONDS, REPEATS = 16, 4.0, 3  # of the comparison with the bare simulator
MARK = "<!-- bench -->"
SECTIONS = ("paper", "motor-scan", "search", "simulator", "training", "workers", "start", "memory")

Row = dict[str, Any]  # {"what", "value", "unit", "goal": text or None, "note": text or None}


def main() -> int:
    """Measure everything, print the table, write it as JSON and into the README."""
    parser = argparse.ArgumentParser(prog="python -m experiments.bench", description=__doc__)
    parser.add_argument("-n", type=count, default=30, help="designs (30)")
    parser.add_argument("--searched", type=count, default=50, help="designs for the search rules (50)")
    parser.add_argument("--evaluations", type=count, default=24, help="evaluations per number of workers (24)")
    parser.add_argument("--only", choices=SECTIONS, help="measure this alone; other rows of --out stay as they are")
    parser.add_argument("--out", type=Path, required=True, help="JSON to write")
    parser.add_argument("--readme", type=Path, help="put the table between its two bench marks")
    args = parser.parse_args()
    make_folder(args.out.parent)
    earlier = None if args.only is None else earlier_rows(args.out)  # before anything is measured in vain
    learning = training(row, cores())
    sections = (designs(args.n), motor_scan(), search(row, args.searched), simulator(), learning,
                workers(args.evaluations), start(), memory())  # fmt: skip
    chosen = [s for name, s in zip(SECTIONS, sections, strict=True) if args.only in (None, name)]
    found = []
    for entry in itertools.chain.from_iterable(chosen):  # Generators: each section measures when its turn comes.
        say(line(entry))
        found.append(entry)
    rows = found if earlier is None else replaced(earlier, found)
    result = {"bodyplan": VERSION, "machine": machine(), "seed": SEED, "designs": args.n, "rows": rows}
    args.out.write_text(json.dumps(result, indent=2) + "\n", "utf-8")
    table = f"Measured on {machine()}.\n\n{markdown(rows)}"
    if args.readme is not None:
        before, _, rest = args.readme.read_text("utf-8").partition(MARK)
        after = rest.partition(MARK)[2]
        if not after:
            raise SystemExit(f"{args.readme} lacks two lines {MARK}; the table goes between them")
        args.readme.write_text(f"{before}{MARK}\n{table}{MARK}{after}", "utf-8")
    print(table)
    return 0


def earlier_rows(path: Path) -> list[Row]:
    """The rows of a table that was measured before; without one, an exit in one line."""
    try:
        return list(json.loads(path.read_text("utf-8"))["rows"])
    except (OSError, ValueError, KeyError, TypeError):
        raise SystemExit(
            f"{path} holds no earlier table, and --only measures a part of one: measure all of it first"
        ) from None


def replaced(rows: list[Row], found: list[Row]) -> list[Row]:
    """The rows with those of them that were measured again in their places.

    Raises:
        ValueError: one that was measured is not among them.
    """
    new = {entry["what"]: entry for entry in found}
    missing = sorted(new.keys() - {entry["what"] for entry in rows})
    if missing:
        raise ValueError(f"the earlier table has no row {missing[0]!r}: measure all of it")
    return [new.get(entry["what"], entry) for entry in rows]


def designs(n: int) -> Iterator[Row]:
    """Seconds per design for decode, and by the paper's rules for score and build, split by stage."""
    import numpy as np

    from decoder.latent import DEFAULT_DECODER, make_decoder, sample_latents
    from mfg.description import describe
    from mfg.export import write_blueprint
    from mfg.pipeline import build, score, virtual
    from sim.model import compile_model

    decoder = make_decoder(DEFAULT_DECODER)
    latents = sample_latents(n + 1, np.random.default_rng(SEED))
    bodies: list[VoxelDesign] = []
    decode = []
    for latent in latents:
        seconds, found = timed(decoder.decode, latent[None])
        decode.append(seconds)
        bodies += found
    many = sample_latents(BATCH, np.random.default_rng([SEED, BATCH]))
    together = statistics.median(clock(lambda: decoder.decode(many)) for _ in range(BATCHES)) / BATCH
    score(bodies[0], rules="paper")  # Warms caches that every process fills once.
    scored = [timed(score, body, rules="paper") for body in progress(bodies[1:], n, "score")]
    robots = [body for body in bodies if virtual(body).ok]
    models = [timed(lambda b: compile_model(describe(virtual(b).blueprint)), body)[0] for body in robots]
    yield row("decode, one body", statistics.median(decode[1:]), "s/design", f"<= {DECODE}", DEFAULT_DECODER)
    yield row(f"decode, {BATCH} together", together, "s/design", f"<= {DECODE_MANY}", DEFAULT_DECODER)
    yield row("voxels to compiled model", statistics.median(models), "s/design", f"<= {MODEL}", "virtual robot")
    yield row("paper: score, any design", statistics.median(t for t, _ in scored), "s/design", f"<= {SCORE}")
    passed = [(t, o) for t, o in scored if o.ok]
    if not passed:
        raise SystemExit(
            f"none of {n} designs can be built by the paper's rules, so there is nothing to time; take more with -n"
        )
    yield row("paper: score, design that passes", statistics.median(t for t, _ in passed), "s/design")
    yield from stages("paper", [o for _, o in passed])
    built = [timed(build, o.design, rules="paper") for _, o in progress(passed, len(passed), "build")]
    yield row("paper: build, design that passes", statistics.median(t for t, _ in built), "s/design", f"<= {BUILD}")
    yield from stages("paper", [o for _, o in built], only=("finish",))
    with tempfile.TemporaryDirectory() as folder:
        written = [timed(write_blueprint, o, Path(folder) / o.design.key)[0] for _, o in built if o.ok]
    yield row("paper: write blueprint folder", statistics.median(written), "s/design")
    agree = sum(o.ok for _, o in built)
    yield row("paper: passes of score that build confirms", agree / len(built), "", note=f"{agree} of {len(built)}")


def stages(name: str, outcomes: list[Outcome], only: tuple[str, ...] = ()) -> Iterator[Row]:
    """The median of every stage."""
    for stage in outcomes[0].seconds:
        if not only or stage in only:
            seconds = [o.seconds[stage] for o in outcomes if stage in o.seconds]
            yield row(f"- {name}: {stage}", statistics.median(seconds), "s/design")


def motor_scan() -> Iterator[Row]:
    """The scan over offsets on sampled fields against the plain way, one exact boolean per offset and part."""
    from mfg import solids
    from mfg.blueprint import Blueprint
    from mfg.motors import MotorSolver
    from mfg.mounts import connector, holder, motor_pose, mount_of
    from mfg.parts import PAPER
    from mfg.pipeline import SCORING, run

    solver = MotorSolver()
    before = SCORING[: next(i for i, s in enumerate(SCORING) if isinstance(s, MotorSolver))]
    body = next(b for b in random_designs() if run((*before, solver), Blueprint(b, PAPER)).ok)
    blueprint = run(before, Blueprint(body, PAPER)).blueprint
    mount = mount_of(PAPER.motor)
    shapes = (holder(mount), connector(mount))
    bones = [solids.from_field(b.bone) for b in blueprint.bodies]

    def naive() -> list[float]:
        return [
            bones[index].overlap(shape.moved(motor_pose(hinge.position, hinge.axis, float(offset))))
            for hinge in blueprint.hinges
            for pair in ((hinge.parent, hinge.body), (hinge.body, hinge.parent))
            for index, shape in zip(pair, shapes, strict=True)
            for offset in solver.offsets()
        ]

    fast = statistics.median(clock(lambda: solver.solve(blueprint)) for _ in range(5))
    slow = clock(naive)
    joints = len(blueprint.hinges)
    yield row("motor scan", fast / joints, "s/joint", note=f"{len(solver.offsets())} offsets x 2 assignments")
    yield row("motor scan by exact booleans", slow / joints, "s/joint")
    yield row("motor scan: times faster", slow / fast, "x")


def simulator() -> Iterator[Row]:
    """Physics steps per second of our batched rollouts against a bare loop over mj_step on the same model."""
    import mujoco
    import numpy as np

    from mfg.description import describe
    from mfg.pipeline import score
    from sim.actor import smooth_step
    from sim.gaits import decode, random_points
    from sim.model import compile_model, drive_of
    from sim.rollout import CONTROL_PERIOD, LEAD_IN, roll_out, settle

    outcome = next(o for o in map(score, random_designs()) if o.ok)
    model = compile_model(describe(outcome.blueprint))
    drive = drive_of(model)
    gaits = [decode(drive, point) for point in random_points(drive, GAITS, np.random.default_rng(SEED))]
    start = settle(model)
    substeps = round(CONTROL_PERIOD / model.opt.timestep)
    at = np.arange(round((LEAD_IN + GAIT_SECONDS) / CONTROL_PERIOD)) * CONTROL_PERIOD
    fade = smooth_step(at / LEAD_IN)[:, None]
    targets = [fade * gait.targets(at) for gait in gaits]
    data = mujoco.MjData(model)

    def bare() -> None:
        for orders in targets:
            mujoco.mj_setState(model, data, start, mujoco.mjtState.mjSTATE_INTEGRATION)
            for order in orders:
                data.ctrl[:] = order
                mujoco.mj_step(model, data, substeps)

    # Processor time of one thread, and in turns: a busy machine slows both alike.
    bare()
    seconds = [
        (clock(bare, time.process_time), clock(lambda: roll_out(model, gaits, GAIT_SECONDS, start), time.process_time))
        for _ in range(REPEATS)
    ]
    steps = GAITS * len(at) * substeps
    theirs, ours = (steps / statistics.median(column) for column in zip(*seconds, strict=True))
    yield row("simulator, one thread", ours, "steps/s", note=f"{model.nu} joints, {GAITS} gaits")
    yield row("bare mj_step, same model and gaits", theirs, "steps/s")
    yield row("simulator against bare", ours / theirs, "x", f">= {BARE}")


def workers(n: int) -> Iterator[Row]:
    """Evaluations (decode, score, gait) per second with 1 and with 2 worker processes."""
    import numpy as np

    from decoder.latent import sample_latents
    from evo.evaluate import Evaluate
    from evo.evaluation import Candidate

    latents = sample_latents(n + 2, np.random.default_rng(SEED))
    tasks = [Candidate(0, k, latent) for k, latent in enumerate(latents)]
    rates = []
    for number in (1, 2):
        rates.append(throughput(Evaluate(SEED), tasks, number, f"{number} workers"))
        yield row(f"evaluations, {number} worker{'s' * (number > 1)}", rates[-1], "1/s")
    yield row("two workers against one", rates[1] / rates[0], "x")


def start() -> Iterator[Row]:
    """Wall time of `bodyplan --help`."""
    command = [sys.executable, "-m", "experiments.cli", "--help"]
    seconds = [clock(lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL)) for _ in range(5)]
    yield row("bodyplan --help", statistics.median(seconds), "s", f"< {HELP_TIME}")


def memory() -> Iterator[Row]:
    """Peak resident memory of a worker after a few evaluations, and of this process after everything above."""
    import numpy as np

    from decoder.latent import sample_latents
    from evo.evaluation import Candidate
    from evo.pool import Pool

    tasks = [Candidate(0, k, z) for k, z in enumerate(sample_latents(4, np.random.default_rng(SEED)))]
    with Pool[Candidate, float](peak_after, 1, 300.0) as pool:
        peaks = [mib for _, mib, _ in pool.run(tasks) if isinstance(mib, float)]
    yield row("peak memory, a worker", max(peaks), "MiB")
    yield row("peak memory, this process", peak(), "MiB")


def peak_after(candidate: Candidate) -> float:
    """Evaluate a candidate, then give the peak memory so far of the process that did [MiB]."""
    from evo.evaluate import Evaluate

    Evaluate(SEED)(candidate)
    return peak()


def random_designs() -> Iterator[VoxelDesign]:
    """Bodies from the prior, one after the other."""
    import numpy as np

    from decoder.latent import DEFAULT_DECODER, make_decoder, sample_latents

    decoder = make_decoder(DEFAULT_DECODER)
    rng = np.random.default_rng(SEED)
    while True:
        yield from decoder.decode(sample_latents(1, rng))


def row(what: str, value: float, unit: str, goal: str | None = None, note: str | None = None) -> Row:
    """One line of the table."""
    return {"what": what, "value": value, "unit": unit, "goal": goal, "note": note}


def line(row: Row) -> str:
    """One line for the terminal."""
    goal = f"   (goal {row['goal']})" if row["goal"] else ""
    note = f"   {row['note']}" if row["note"] else ""
    return f"{row['what']:40s} {row['value']:10.4g} {row['unit']}{goal}{note}"


def markdown(rows: list[Row]) -> str:
    """The table of the README."""
    lines = ["| what | measured | goal |", "|---|---:|---|"]
    for r in rows:
        note = f" ({r['note']})" if r["note"] else ""
        value = f"{r['value']:.3g}" if r["value"] < 1000 else f"{r['value']:.0f}"
        lines.append(f"| {r['what']}{note} | {value} {r['unit']} | {r['goal'] or ''} |")
    return "\n".join(lines) + "\n"


def machine() -> str:
    """What this was measured on."""
    import os

    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        name = next((t.split(":")[1].strip() for t in info.read_text().splitlines() if "model name" in t), name)
    return f"{os.cpu_count()} x {name}, Python {platform.python_version()}"


if __name__ == "__main__":
    sys.exit(main())
