"""What the search rules cost: seconds, memory, one process and two, and motor seats by one boolean per candidate."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from experiments.measuring import TIMEOUT, clock, peak, throughput, timed
from experiments.output import progress
from experiments.study import decoder_of

if TYPE_CHECKING:
    from decoder.design import VoxelDesign
    from evo.evaluation import Candidate
    from mfg.blueprint import Blueprint
    from mfg.solids import Solid

SCORE, BUILD, MEMORY, TWO = 0.25, 1.2, 600.0, 1.8  # goals: [s], [s], [MiB], ratio
SEED = 0

Row = dict[str, Any]


@dataclass(frozen=True, eq=False, slots=True)
class Cost:
    """What one design took.

    Attributes:
        ok: whether it passed.
        score: wall time of the verdict [s].
        stages: of that, by solver [s].
        build: wall time of the whole blueprint [s]; None where it was not built.
        memory: peak of the process so far [MiB].
    """

    ok: bool
    score: float
    stages: dict[str, float]
    build: float | None
    memory: float


@dataclass(frozen=True, slots=True)
class Judge:
    """Score one candidate by the search rules; build what passes, if asked to."""

    build: bool

    def __call__(self, candidate: Candidate) -> Cost:
        """Decode, which is not timed, then judge."""
        from mfg.pipeline import build, score

        design = _body(candidate)
        seconds, outcome = timed(score, design, rules="search")
        built = timed(build, design, rules="search")[0] if self.build and outcome.ok else None
        return Cost(outcome.ok, seconds, dict(outcome.seconds), built, peak())


def search(row: Callable[..., Row], n: int) -> Iterator[Row]:
    """Rows of the table.

    Args:
        row: `experiments.bench.row`.
        n: designs.
    """
    import numpy as np

    from decoder.latent import sample_latents
    from evo.evaluation import Candidate
    from evo.pool import Pool

    tasks = [Candidate(0, k, z) for k, z in enumerate(sample_latents(n + 2, np.random.default_rng(SEED)))]
    with Pool[Candidate, Cost](Judge(build=True), 1, TIMEOUT) as pool:
        list(pool.run(tasks[:2]))  # The worker starts and warms up.
        found = [c for _, c, _ in progress(pool.run(tasks[2:]), n, "search") if isinstance(c, Cost)]
    passed = [cost for cost in found if cost.ok]
    if not passed:
        raise SystemExit(f"none of {n} designs passes the search rules; take more with --searched")
    note = f"{len(found)} designs, {len(passed)} pass"
    yield row("search: score", statistics.median(c.score for c in found), "s/design", f"<= {SCORE}", note)
    for stage in passed[0].stages:
        yield row(f"- search: {stage}", statistics.median(c.stages[stage] for c in passed), "s/design")
    built = [cost.build for cost in passed if cost.build is not None]
    yield row("search: build", statistics.median(built), "s/design", f"<= {BUILD}")
    yield row("search: peak memory", max(cost.memory for cost in found), "MiB", f"<= {MEMORY:g}", "one process, all")
    one, two = (throughput(Judge(build=False), tasks, number, f"search, {number} workers") for number in (1, 2))
    yield row("search: two processes against one", two / one, "x", f">= {TWO}")
    yield from _motor_seats(row, [_body(task) for task in tasks[:6]])


def _body(candidate: Candidate) -> VoxelDesign:
    from decoder.latent import DEFAULT_DECODER

    return decoder_of(DEFAULT_DECODER).decode(candidate.latent[None])[0]


def _motor_seats(row: Callable[..., Row], bodies: list[VoxelDesign]) -> Iterator[Row]:
    """Which seats fuse with both bones: by fields sampled once, and by two exact booleans for each candidate."""
    from mfg import solids
    from mfg.blueprint import Blueprint
    from mfg.motor_candidates import Candidates
    from mfg.motor_search import SearchMotorSolver
    from mfg.motors import MotorSolver
    from mfg.mounts import connector, holder, mount_of
    from mfg.parts import PAPER
    from mfg.pipeline import SEARCHING, run

    solver = SearchMotorSolver()
    before = SEARCHING[: next(i for i, s in enumerate(SEARCHING) if isinstance(s, SearchMotorSolver))]
    scan = MotorSolver(solver.min_overlap, solver.alpha, solver.scan, solver.slice)
    every = replace(scan, min_overlap=0.0)  # so that refused candidates are told, too
    shapes = holder(mount_of(PAPER.motor)), connector(mount_of(PAPER.motor))
    fast = slow = 0.0
    agree = tried = 0
    blueprints: list[Blueprint] = [found.blueprint for found in
                                   (run(before, Blueprint(body, PAPER)) for body in bodies) if found.ok]  # fmt: skip
    for blueprint in progress(blueprints, len(blueprints), "naive"):
        bones: list[Solid] = [solids.from_field(body.bone) for body in blueprint.bodies]
        fast += clock(lambda b=blueprint: solver.solve(b))  # type: ignore[misc]
        for index in range(len(blueprint.hinges)):
            plastic = solver.plastic(blueprint.catalogue, solver.most_walls)
            seats = Candidates.of(blueprint, index, every, solver.step, solver.spread, solver.candidates, plastic).seats
            started = time.perf_counter()
            exact = [min(bones[body].overlap(shape.moved(seat.T_design_motor))
                         for body, shape in zip((seat.holder, seat.connector), shapes, strict=True))
                     for seat in seats]  # fmt: skip
            slow += time.perf_counter() - started
            sampled = [min(seat.holder_volume, seat.connector_volume) for seat in seats]
            least = solver.min_overlap
            agree += sum((a >= least) == (b >= least) for a, b in zip(exact, sampled, strict=True))
            tried += len(seats)
    note = f"{tried} candidates on {len(blueprints)} bodies; strength, clearance and choice are in the search only"
    yield row("search: whole motor search", fast / len(blueprints), "s/design")
    yield row("search: the same candidates by exact booleans", slow / len(blueprints), "s/design", None, note)
    yield row("search: times faster", slow / fast, "x")
    yield row("search: verdicts of sampled and exact volumes that agree", agree / tried, "")
