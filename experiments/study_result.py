"""What a study comes to: the object in study.json, the table for spreadsheets and the lines for people."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.lda import FailureLda
    from analysis.passthrough import PassThrough
    from experiments.config import Study


def result_of(
    config: Study, counts: PassThrough, mended: PassThrough | None, lda: FailureLda, seconds: float
) -> dict[str, Any]:
    """The object in study.json.

    Args:
        config: of the study.
        counts: by the plain rules.
        mended: where a body that was repaired counts as what came of it, or None.
        lda: what latents tell of failures.
        seconds: wall time of all sessions.
    """
    return {
        "n": counts.n,
        "seed": config.seed,
        "decoder": config.decoder,
        "prior": config.prior,
        "solver": config.solver,
        "catalogue": config.catalogue,
        **_counted(counts),
        "repaired": None if mended is None else _counted(mended),
        "lda": lda.to_json(),
        "seconds": seconds,
    }


def _counted(counts: PassThrough) -> dict[str, Any]:
    return {
        "counts": counts.counts,
        "remaining": {row.stage: row.remaining for row in counts.rows()},
        "pass_rate": counts.rate,
        "pass_rate_95": list(counts.interval),
    }


def rates(counts: PassThrough, mended: PassThrough | None) -> str:
    """CSV: one line per stage with integer counts, and one for all; with what was refused after repair, if that was."""
    lines = ["stage,reached,failed,remaining"]
    for row in counts.rows():
        lines.append(
            f"{row.stage},{row.reached},{row.failed},{'' if row.remaining is None else f'{row.remaining:.6f}'}"
        )
    rate = "" if counts.rate is None else f"{counts.rate:.6f}"
    lines.append(f"all,{counts.n},{counts.n - counts.passed},{rate}")
    if mended is not None:
        after = [row.failed for row in mended.rows()] + [mended.n - mended.passed]
        columns = ["failed_after_repair", *map(str, after)]
        lines = [f"{line},{column}" for line, column in zip(lines, columns, strict=True)]
    return "\n".join(lines) + "\n"


def summary(result: dict[str, Any], records: str, report: Path) -> str:
    """The result for people; `records` and `report` are where they read more."""
    mended = result["repaired"]
    lines = [_rate(result, result["n"], "can be built")]
    if mended is not None:
        lines.append(_rate(mended, result["n"], f"can be built once changed as little as helps, see {records}"))
    for stage, remaining in result["remaining"].items():
        if stage != "worker" or result["counts"][stage]:
            share = "none got here" if remaining is None else f"{100 * remaining:6.2f} % remain"
            after = "" if mended is None else f"   {mended['counts'][stage]:5} after repair"
            lines.append(f"  {stage:12} {result['counts'][stage]:5} failed   {share}{after}")
    lda = result["lda"]
    if lda["balanced_accuracy"] is not None:
        lines.append(f"latents tell the class of {100 * lda['balanced_accuracy']:.0f} % of failures not seen before "
                     f"(guessing {100 * lda['chance']:.0f} %, p = {lda['permutation_p']:.3g})")  # fmt: skip
    return "\n".join([*lines, f"read {report}"])


def _rate(counted: dict[str, Any], n: int, what: str) -> str:
    low, high = counted["pass_rate_95"]
    return (f"{counted['counts']['passed']} of {n} bodies {what}: {100 * counted['pass_rate']:.1f} % "
            f"(95 %: {100 * low:.1f} to {100 * high:.1f} %)")  # fmt: skip
