"""`bodyplan study`: what share of random bodies can be built, and what stops the others."""

from __future__ import annotations

import argparse
import functools
import shlex
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.judging import add_pipeline_options, judge_of
from experiments.output import (
    DEFAULT_SOLVER,
    DONE,
    INTERRUPTED,
    PRIORS,
    BadInput,
    add_decoder_option,
    count,
    emit,
    make_folder,
    progress,
    say,
    seed,
)
from experiments.run_folder import (
    REPORT,
    RUN_FILES,
    STUDY_RESULT,
    cores,
    locked,
    opened,
    terminable,
    worker_count,
    write_json,
)
from experiments.study_result import rates, result_of, summary

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from decoder.latent import Decoder
    from evo.evaluation import Candidate, Evaluation
    from evo.judge import Judge
    from evo.record import Record
    from experiments.config import Study
    from mfg.pipeline import Outcome

HELP = "pass-through table, score histogram and failure map of random bodies"

RECORD, RESULT = RUN_FILES["study"], STUDY_RESULT
TABLE, RATES, SHEET = "records.csv", "pass_through.csv", "sheet.png"
TIMEOUT = 900.0  # a design that takes longer is given up; a hang, for whatever takes a second [s]
PICTURE, COLUMNS = (320, 240), 4  # of one example [pixel]
PASSED_SHOWN, FAILED_SHOWN = 8, 4  # examples on the sheet: of designs that can be built, and of each class of failure


@dataclass(frozen=True, slots=True)
class Score:
    """Decode and score one candidate; the answer depends on these fields and the candidate alone.

    Attributes:
        decoder: for `decoder.latent.make_decoder`.
        judge: says whether a body can be built.
        repair: whether bodies that cannot be built are changed until they can.
    """

    decoder: str
    judge: Judge
    repair: bool = False

    def __call__(self, candidate: Candidate) -> Evaluation:
        """Verdict and scores without exact solids."""
        from evo.evaluation import Evaluation

        outcome = self.outcome(candidate)
        mended = self._repaired(candidate, outcome) if self.repair and not outcome.ok else None
        return Evaluation(
            candidate, outcome.design.key, outcome.scores, outcome.failure, stages=dict(outcome.seconds),
            repaired=mended,
        )  # fmt: skip

    def outcome(self, candidate: Candidate) -> Outcome:
        """All that the solvers say."""
        return self.judge.score(decoder_of(self.decoder).decode(candidate.latent[None])[0])

    def _repaired(self, candidate: Candidate, outcome: Outcome) -> Evaluation:
        from evo.evaluation import Evaluation
        from mfg.repair import repaired

        start = time.perf_counter()
        found = repaired(outcome, self.judge.score)
        return Evaluation(
            candidate, found.outcome.design.key, found.outcome.scores, found.outcome.failure,
            stages={"repair": time.perf_counter() - start}, changes=tuple(map(str, found.changes)),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Draw:
    """Draw one candidate as far as the solvers got with it."""

    score: Score

    def __call__(self, candidate: Candidate) -> NDArray[np.uint8]:
        """A picture of its blueprint, or of the design where not even a skeleton came of it."""
        from mfg.picture import picture_of_blueprint, picture_of_design

        outcome = self.score.outcome(candidate)
        if not outcome.blueprint.bodies:
            return picture_of_design(outcome.design, PICTURE)
        return picture_of_blueprint(outcome.blueprint, PICTURE)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("-n", type=count, default=1000, help="how many bodies (1000)")
    parser.add_argument("--seed", type=seed, default=0, help="seed of the draw (0)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    add_decoder_option(parser)
    parser.add_argument("--prior", choices=PRIORS, default="normal", help="law of the latents (normal)")
    add_pipeline_options(parser)
    parser.add_argument(
        "--repair",
        action="store_true",
        help="change bodies that cannot be built as little as helps, and count these apart",
    )
    parser.add_argument("--workers", type=worker_count, help="processes; 0 works in this one (one per core)")
    parser.add_argument("--resume", action="store_true", help="go on with the study in DIR if there is one")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Run a study from the command line; status 3 if it was interrupted."""
    from experiments.config import Study

    judge_of(args.solver, args.catalogue, args.parts)  # parts that cannot be read leave nothing behind.
    parts = None if args.parts is None else str(args.parts.resolve())
    config = Study(
        "study", args.n, args.seed, args.decoder, args.prior, args.solver, args.catalogue, parts, args.repair
    )  # fmt: skip
    try:
        with terminable():
            return run_study(config, args.out, args)
    except KeyboardInterrupt:
        words = [
            f"-n {args.n}",
            f"--seed {args.seed}",
            f"--decoder {shlex.quote(args.decoder)}",
            f"--prior {args.prior}",
            *([f"--solver {args.solver}"] if args.solver != DEFAULT_SOLVER else []),
            *([f"--catalogue {args.catalogue}"] if args.catalogue != "paper" else []),
            *([f"--parts {shlex.quote(parts)}"] if parts is not None else []),
            *(["--repair"] if args.repair else []),
        ]
        say(f"\nbodyplan: interrupted; everything that was finished is saved. Go on with: bodyplan study "
            f"{' '.join(words)} --out {args.out} --resume")  # fmt: skip
        return INTERRUPTED


def run_study(config: Study, folder: Path, args: argparse.Namespace) -> int:
    """Draw, score and analyse; what is recorded already is not worked out again.

    Args:
        config: the study.
        folder: to write to.
        args: `resume`, `workers` (overrides the configuration's; it changes no result) and `json`.

    Raises:
        BadInput: if a study is there and `resume` is not set, or it was made with another configuration.
        OSError: if the folder cannot be written.
    """
    make_folder(folder)
    with locked(folder), opened(config, folder / RECORD, config.n, args.resume) as record:
        workers = args.workers if args.workers is not None else config.workers
        workers = cores() if workers is None else workers
        _score_all(config, record, workers)
        result = _analyse(config, record, folder, workers)
    if args.json:
        emit(result)
    else:
        print(summary(result, TABLE, folder / REPORT))
    return DONE


def _score_all(config: Study, record: Record, workers: int) -> None:
    """Score what is missing; every answer is committed as it comes."""
    from evo.evaluation import Candidate, Evaluation
    from evo.pool import Pool
    from mfg.outcome import Failure

    latents = _latents(config)
    known = {evaluation.candidate.index: evaluation.candidate for evaluation in record.evaluations()}
    for index, candidate in known.items():
        if candidate.latent.tobytes() != latents[index].tobytes():
            raise BadInput(f"body {index} of the study on disk has another latent than seed {config.seed} gives now; "
                           "it was made with another version of numpy: choose another --out")  # fmt: skip
    missing = [Candidate(0, index, latents[index]) for index in range(config.n) if index not in known]
    if not missing:
        return
    say(f"{len(missing)} bodies to go, {workers} workers")
    with Pool[Candidate, Evaluation](_score(config), workers, TIMEOUT) as pool:
        for candidate, answer, seconds in progress(pool.run(missing), len(missing), "scoring"):
            evaluation = Evaluation(candidate, failure=answer) if isinstance(answer, Failure) else answer
            record.add(evaluation, seconds)


def _analyse(config: Study, record: Record, folder: Path, workers: int) -> dict[str, Any]:
    """Write tables, figures, result and report; the report comes last, so whoever sees it sees all."""
    from analysis import plots
    from analysis.folder import read_folder
    from analysis.passthrough import PASSED, pass_through
    from analysis.population import failure_map
    from analysis.records import with_repairs, write_csv
    from analysis.report import write_report

    run = read_folder(folder)
    counts, lda = pass_through(run.records["outcome"]), failure_map(run)
    table = with_repairs(run.records, folder / RECORD) if config.repair else run.records
    mended = pass_through(table["repaired"]) if config.repair else None
    write_csv(table, folder / TABLE)
    (folder / RATES).write_text(rates(counts, mended), encoding="utf-8")
    ok = run.records["outcome"] == PASSED
    figures = {
        "pass_through.png": plots.pass_through_bars(counts),
        "scores.png": plots.score_histogram(list(run.records["s_mfg"][ok]), list(run.records["s_mfg"][~ok])),
        "failures.png": plots.lda_map(lda),
    }
    for name, png in figures.items():
        if png is not None:
            (folder / name).write_bytes(png)
    _draw_examples(config, record.evaluations(), folder / SHEET, workers)
    result = result_of(config, counts, mended, lda, round(record.seconds(), 1))
    write_json(folder / RESULT, result)
    write_report(folder, lda)
    return result


def _draw_examples(config: Study, evaluations: list[Evaluation], path: Path, workers: int) -> None:
    """A contact sheet: designs that can be built over the whole range of scores, then every class of failure."""
    from evo.evaluation import Candidate
    from evo.pool import Pool
    from mfg.outcome import Failure
    from mfg.picture import contact_sheet
    from mfg.render import save_png

    shown = _examples(evaluations)
    images: dict[int, NDArray[np.uint8]] = {}
    with Pool[Candidate, "NDArray[np.uint8]"](Draw(_score(config)), workers, TIMEOUT) as pool:
        drawn = pool.run([evaluation.candidate for evaluation in shown])
        for candidate, image, _ in progress(drawn, len(shown), "drawing"):
            if not isinstance(image, Failure):
                images[candidate.index] = image
    labels = {e.candidate.index: _label(e) for e in shown if e.candidate.index in images}
    if labels:
        sheet = contact_sheet([images[k] for k in labels], list(labels.values()), min(COLUMNS, len(labels)))
        save_png(path, sheet)


def _examples(evaluations: list[Evaluation]) -> list[Evaluation]:
    """Designs to show: built ones spread evenly from best to worst, the first of every class of failure."""
    from mfg.outcome import Stage

    passed = sorted((e for e in evaluations if e.passed), key=lambda e: (-e.scores.total, e.candidate.index))
    number = min(PASSED_SHOWN, len(passed))
    shown = [passed[round(k * (len(passed) - 1) / max(number - 1, 1))] for k in range(number)]
    for stage in Stage:
        # A design that crashed or hung a worker might do so again, so it is not drawn.
        failed = [e for e in evaluations if e.failure is not None and e.failure.stage == stage != Stage.WORKER]
        shown += failed[:FAILED_SHOWN]
    return shown


def _label(evaluation: Evaluation) -> str:
    name = f"{evaluation.candidate.index}"
    if evaluation.failure is None:
        return f"{name}  S = {evaluation.scores.total:.2f}"
    return f"{name}  {evaluation.failure.stage}: {evaluation.failure.reason}"


def _score(config: Study) -> Score:
    return Score(config.decoder, judge_of(config.solver, config.catalogue, config.parts), config.repair)


def _latents(config: Study) -> NDArray[np.float32]:
    import numpy as np

    from decoder.latent import sample_latents

    return sample_latents(config.n, np.random.default_rng(config.seed), config.prior)


@functools.cache
def decoder_of(name: str) -> Decoder:
    """Each process makes a decoder once."""
    from decoder.latent import make_decoder

    return make_decoder(name)
