"""`bodyplan run`: any experiment from its TOML file into a run folder, resumable after Ctrl-C or a crash."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import DONE, INFEASIBLE, INTERRUPTED, BadInput, emit, make_folder, progress, say
from experiments.run_folder import (
    CHECKPOINT,
    REPORT,
    RESULT,
    RUN_FILES,
    check_folder,
    cores,
    finished,
    keep_config,
    locked,
    opened,
    terminable,
    worker_count,
    write_json,
)

if TYPE_CHECKING:
    from evo.evaluation import Evaluation
    from evo.record import Record
    from experiments.config import Evolve, Sketch

HELP = "an experiment from its TOML file: evolution, study, sketch or policy"

RECORD, BEST = RUN_FILES["evolve"], "best"
OPTIMISER = 0  # purpose of the optimiser's randomness; candidates have theirs


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("config", type=Path, metavar="CONFIG.toml", help="what to do; see experiments/configs")
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder (runs/ and the name of the configuration)")
    parser.add_argument("--resume", action="store_true", help="go on with the run in DIR if there is one")
    parser.add_argument("--workers", type=worker_count, help="processes; 0 works in this one (one per core)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Run the experiment; status 1 if nothing that can be built came of it, 3 if it was interrupted."""
    from experiments.config import Evolve, Sketch, load_config
    from experiments.policy_config import Policy

    config = load_config(args.config)
    folder = args.out or Path("runs") / args.config.stem
    if isinstance(config, Policy):
        from experiments.train import run_training

        again = f"bodyplan run {args.config} --out {folder} --resume"
        return run_training(config, folder, args.resume, args.workers, again, args.json)
    try:
        with terminable():
            if isinstance(config, Evolve):
                result = run_evolution(config, folder, args.resume, args.workers)
            elif isinstance(config, Sketch):
                result = run_sketch(config, folder, args.resume)
            else:
                from experiments.study import run_study

                return run_study(config, folder, args)
    except KeyboardInterrupt:
        again = f"bodyplan run {args.config} --out {folder} --resume"
        say(f"\nbodyplan: interrupted; everything that was finished is saved. Go on with: {again}")
        return INTERRUPTED
    if args.json:
        emit(result)
    return DONE if result["winner"] is not None else INFEASIBLE


def run_evolution(config: Evolve, folder: Path, resume: bool, workers: int | None) -> dict[str, Any]:
    """Evolve, choose the winner on its built twin, and write the run folder.

    Args:
        config: the experiment.
        folder: of the run.
        resume: go on if a run is there already.
        workers: overrides the configuration's number; it changes no result.

    Raises:
        BadInput: if a run is there and `resume` is not set, or it was made with another configuration.
        OSError: if the folder cannot be written.
    """
    make_folder(folder)
    with locked(folder), opened(config, folder / RECORD, config.search.popsize, resume) as record:
        (folder / CHECKPOINT).mkdir(exist_ok=True)
        result = finished(config.kind, folder)
        if result is not None:
            return result
        count = workers if workers is not None else config.workers
        _evolve(config, record, folder, cores() if count is None else count)
        result = _conclude(config, record, folder)
    say(_summary(result))
    return result


def _evolve(config: Evolve, record: Record, folder: Path, workers: int) -> None:
    """Ask, evaluate and tell to the last generation, then hold the finals; only what is missing is worked out."""
    import numpy as np

    from decoder.latent import LATENT_DIM
    from evo.cma_es import CmaEs
    from evo.evaluate import Evaluate, EvaluateTwin
    from evo.evaluation import Candidate, Evaluation
    from evo.finals import finals
    from evo.loop import ResumeError, evolve
    from evo.pool import Pool
    from experiments.judging import judge_of

    rule, search = config.fitness.rule(), config.search
    rng = np.random.default_rng(np.random.SeedSequence(config.seed, spawn_key=(OPTIMISER,)))
    optimiser = CmaEs(LATENT_DIM, search.popsize, rng, sigma=search.sigma, start=search.start)
    judge = judge_of(config.solver, config.catalogue, config.parts, deployed=True)
    learning = config.learning.rung()
    evaluate = Evaluate(config.seed, config.decoder, rule, config.gait.budget(), judge, learning)
    total = search.generations * search.popsize - record.count()
    if total:
        say(f"{total} evaluations to go: {search.generations} generations of {search.popsize}, {workers} workers")
    try:
        with Pool[Candidate, Evaluation](evaluate, workers, config.timeout) as pool:
            found = evolve(optimiser, record, pool, search.generations, folder / CHECKPOINT)
            for _ in progress(found, total, "evolving") if total else found:
                pass
    except ResumeError as error:
        raise BadInput(f"{folder}: {error}") from None
    twin = EvaluateTwin(config.seed, config.decoder, rule, config.finals.gait.budget(), judge, learning)
    with Pool[Evaluation, Evaluation](twin, workers, config.timeout) as pool:
        left = config.finals.heat - record.count("finals")
        for _ in progress(finals(record, pool, config.finals.heat), left if left > 0 else None, "finals"):
            pass


def _conclude(config: Evolve, record: Record, folder: Path) -> dict[str, Any]:
    """Write the winner's folder, the result and the report; the report comes last, so whoever sees it sees all.

    The winner is the best finalist whose exported model walks; those before it are listed as passed over.
    """
    from evo.evaluate import decode
    from evo.finals import winners
    from experiments.best import Lame, write_best
    from experiments.config import config_hash
    from experiments.judging import judge_of

    judge = judge_of(config.solver, config.catalogue, config.parts, deployed=True)
    evaluations = record.evaluations()
    result: dict[str, Any] = {
        "kind": "evolve",
        "out": str(folder),
        "evaluations": len(evaluations),
        "passed": sum(e.passed for e in evaluations),
        "winner": None,
        "passed_over": [],
    }
    for champion in winners(record):
        if champion.walk is None:
            continue  # never so: a winner walks.
        say("writing the winner's blueprint, policy, video and dry run")
        design = decode(config.decoder, champion.candidate)
        outcome = judge.build(design)
        best = write_best(
            folder / BEST, outcome, champion.walk.gait, config_hash(config), config.film, must_walk=True
        )  # fmt: skip
        if isinstance(best, Lame):
            say(f"{champion.design} is passed over: {best.reason}")
            result["passed_over"].append(_named(champion) | {"reason": best.reason})
            shutil.rmtree(folder / BEST)
            continue
        result["winner"] = _described(champion, best.behaviour, best.dry_run)
        break
    result["seconds"] = round(record.seconds(), 1)
    write_json(folder / RESULT, result)
    _write_report(folder)
    return result


def run_sketch(config: Sketch, folder: Path, resume: bool) -> dict[str, Any]:
    """Build a painted body, find a gait for its twin, and write its folder.

    Raises:
        BadInput: if the folder holds a result and `resume` is not set, or another run, or the design cannot be used.
        OSError: if the folder cannot be written.
    """
    import numpy as np

    from experiments.best import Lame, write_best
    from experiments.build import read_design
    from experiments.config import config_hash
    from experiments.judging import judge_of, tell_round
    from mfg.description import describe
    from sim.gaits import search_gait
    from sim.rollout import Diverged

    design = read_design(Path(config.design))
    judge = judge_of(config.solver, config.catalogue, config.parts, deployed=True)
    make_folder(folder)
    with locked(folder):
        check_folder(config, folder)
        if (folder / RESULT).exists() and not resume:
            raise BadInput(f"{folder} holds a run already; go on with it by --resume, or choose another --out")
        result = finished(config.kind, folder)
        if result is not None:
            if result.get("design") != design.key:
                raise BadInput(f"{config.design} has changed since {folder} was made of it; choose another --out")
            return result
        keep_config(config, folder)
        outcome = judge.build(design, tell_round)
        result = {"kind": "sketch", "out": str(folder), **outcome.to_json(str(folder)), "winner": None}
        trouble = None if outcome.failure is None else f"cannot be built: {outcome.failure}"
        if outcome.ok:
            say("looking for a gait")
            rng = np.random.default_rng(np.random.SeedSequence(config.seed))
            try:
                gait = search_gait(describe(outcome.blueprint), rng, config.gait.budget()).gait
                say("writing blueprint, policy, video and dry run")
                best = write_best(folder / BEST, outcome, gait, config_hash(config), config.film, must_walk=False)
            except Diverged as error:
                best = Lame(str(error))
            if isinstance(best, Lame):
                trouble = f"cannot be simulated: {best.reason}"
            else:
                result["winner"] = {"design": design.key, **best.behaviour, "dry_run": best.dry_run}
        if trouble is not None:
            say(f"bodyplan: {config.design} {trouble}")
        write_json(folder / RESULT, result)
        _write_report(folder)
    return result


def _named(champion: Evaluation) -> dict[str, Any]:
    candidate = champion.candidate
    return {"design": champion.design, "generation": candidate.generation, "candidate": candidate.index}


def _described(champion: Evaluation, behaviour: dict[str, Any], dry_run: dict[str, Any]) -> dict[str, Any]:
    walk = champion.walk
    return {
        **_named(champion),
        "fitness": champion.fitness,
        "s_mfg": champion.scores.total,
        "joints": 0 if walk is None else walk.gait.num_joints,
        "mass_kg": 0.0 if walk is None else walk.mass,
        **behaviour,
        "dry_run": dry_run,
    }


def _summary(result: dict[str, Any]) -> str:
    """The run in a few lines, for people."""
    rows = [("evaluated", f"{result['evaluations']} bodies, {result['passed']} can be built")]
    best = result["winner"]
    if best is None:
        rows.append(("winner", "none: no candidate could be built and walks; try more generations or another seed"))
    else:
        lengths = best["distance_m"] / best["body_length_m"]
        dry = best["dry_run"]
        off = "never drove" if dry["tracking_rms_rad"] is None else f"joints track to {dry['tracking_rms_rad']:.3f} rad"
        rows += [
            ("winner", f"{best['design']} of generation {best['generation']}"),
            ("body", f"{best['joints']} joints, {best['mass_kg']:.2f} kg, {best['body_length_m']:.2f} m, "
                     f"S_mfg {best['s_mfg']:.2f} of 5"),
            ("walks", f"{best['distance_m']:.2f} m in {best['seconds']:g} s, {lengths:.1f} body lengths"),
            ("dry run", f"{dry['ticks']} periods on the virtual bus, {off}"),
            ("print it", str(Path(result["out"]) / BEST / "blueprint")),
        ]  # fmt: skip
    rows.append(("read", str(Path(result["out"]) / REPORT)))
    return "\n".join(f"  {name:10} {text}" for name, text in rows)


def _write_report(folder: Path) -> None:
    from analysis.report import write_report

    write_report(folder)
