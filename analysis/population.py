"""The parts of a report about many designs: what passes, what scores how, what fails where, and what evolved."""

from __future__ import annotations

from html import escape

import numpy as np

from analysis import page, plots
from analysis.folder import RUN_FILES, RunFolder
from analysis.lda import FailureLda, failure_lda
from analysis.passthrough import PAPER_REMAINING, PASSED, PassThrough, pass_through
from analysis.records import by_reason, latents, with_repairs
from analysis.words import REASONS, STAGES
from mfg.outcome import Stage

ANALYSIS = 3  # purpose of the randomness of the analysis; 0 to 2 are evolution's


def failure_map(run: RunFolder) -> FailureLda:
    """Where the failures of a run lie, always with the same answer."""
    seed = int(run.meta.get("seed", 0))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(ANALYSIS,)))
    return failure_lda(latents(run.records), list(run.records["outcome"]), rng)


def passing(run: RunFolder) -> str:
    """What each stage lets through (paper Table I)."""
    counts = pass_through(run.records["outcome"])
    if not counts.n:
        return page.section("What passes", page.paragraph("No design has been evaluated yet."))
    low, high = counts.interval
    text = (
        f"{counts.passed} of {counts.n} designs can be built: {_percent(counts.rate)} "
        f"(95 % interval {_percent(low)} to {_percent(high)}). Each stage is counted over the designs that reached it."
    )
    if run.kind == "study" and run.config.get("repair") is True:
        mended = pass_through(with_repairs(run.records, run.path / RUN_FILES["study"])["repaired"])
        low, high = mended.interval
        text += (
            f" Changed as little as helps, {mended.passed} of them can be built: {_percent(mended.rate)} (95 % "
            f"interval {_percent(low)} to {_percent(high)}); records.csv says what was changed."
        )
    if run.kind == "evolve":
        text += " Evolution favours what can be built, so this is no estimate for random bodies; a study gives that."
    caption = (
        "Share that each stage lets through. The black marks are the figures of the paper (its Table I), which are for "
        "random bodies of another decoder, by the paper's rules."
    )
    return page.section(
        "What passes", page.paragraph(text), pass_through_table(counts),
        page.picture(plots.pass_through_bars(counts), caption, 660),
    )  # fmt: skip


def pass_through_table(counts: PassThrough) -> str:
    """The table as HTML."""
    rows = [
        (row.stage, str(row.reached), str(row.failed), _percent(row.remaining),
         _percent(PAPER_REMAINING.get(row.stage)), escape(STAGES[row.stage]))
        for row in counts.rows()
        if row.stage != Stage.WORKER or row.failed
    ]  # fmt: skip
    rows.append(("all stages", str(counts.n), str(counts.n - counts.passed), _percent(counts.rate),
                 _percent(PAPER_REMAINING[PASSED]), "The design can be built."))  # fmt: skip
    header = ("stage", "reached", "failed", "remaining", "paper", "what passing means")
    return page.table(header, rows, (1, 2, 3, 4), total=True)


def scores(run: RunFolder, winner: float | None = None) -> str:
    """The histogram of S_mfg (paper Fig. 3E)."""
    records = run.records
    if records.empty:
        return ""
    ok = records["outcome"] == PASSED
    text = (
        "The manufacturability score is the sum of five scores between 0 and 1. A design that fails keeps the scores "
        "of the stages it passed."
    )
    if ok.any():
        middle = records["s_mfg"][ok]
        text += (
            f" Designs that can be built have {middle.median():.2f} in the middle, from {middle.min():.2f} "
            f"to {middle.max():.2f}."
        )
    png = plots.score_histogram(list(records["s_mfg"][ok]), list(records["s_mfg"][~ok]), winner)
    return page.section("How well they score", page.paragraph(text), page.picture(png, "Designs by score.", 660))


def failures(run: RunFolder, lda: FailureLda) -> str:
    """Why designs fail, in words, and where they lie in latent space (paper Fig. 3A)."""
    failed = run.records[run.records["outcome"] != PASSED]
    if failed.empty:
        return page.section("What fails", page.paragraph("Nothing failed.")) if len(run.records) else ""
    rows = []
    groups = sorted(by_reason(failed), key=lambda item: -len(item[1]))
    for (stage, reason), group in groups:
        first = group.iloc[0]
        example = " ".join(filter(None, [page.code(first["design"] or ""), escape(first["detail"] or "")]))
        words = REASONS.get(reason, "")
        why = f"{escape(words)}<br><span class='quiet'>{escape(reason)}</span>"
        rows.append((escape(stage), str(len(group)), why, example))
    table = page.table(("stage", "designs", "why", "for example"), rows, (1,))
    return page.section("What fails, and where in latent space", table, *_map(run, lda))


def evolution(run: RunFolder) -> str:
    """Fitness over generations."""
    records = run.records
    png = None
    if not records.empty:
        png = plots.fitness_curve(
            records["generation"].to_numpy(), records["fitness"].to_numpy(), (records["outcome"] == PASSED).to_numpy()
        )
    if png is None:
        return page.section("Evolution", page.paragraph("No design has a fitness yet."))
    fitness = run.config.get("fitness", {})
    rule = {
        "penalty": f"Fitness is task speed minus {fitness.get('weight', '?')} (1 - S_mfg / 5), in m/s.",
        "constraint": f"Fitness is task speed [m/s]; a design needs S_mfg of at least {fitness.get('bound', '?')}.",
        "speed": "Fitness is task speed [m/s].",
    }.get(fitness.get("mode", ""), "")
    caption = "Above: fitness of every body that can be built. Below: share of each generation that can be built."
    return page.section(
        "Evolution", page.paragraph(f"{rule} Designs that cannot be built have none: they are ranked behind the others "
                                    "by how far they got."), page.picture(png, caption, 660),
    )  # fmt: skip


def examples(run: RunFolder) -> str:
    """Pictures of designs that passed and of each way to fail (paper Fig. 2)."""
    caption = (
        "Motors green, battery blue, controller red, cables yellow, skin translucent. First designs that can be built, "
        "best first, then examples of every class of failure, as far as the solvers got with them."
    )
    return page.section("Examples", page.picture(run.bytes("sheet.png"), caption))


def _map(run: RunFolder, lda: FailureLda) -> list[str]:
    left = ", ".join(f"{name} ({size})" for name, size in lda.left_out.items())
    without = f" Left out, because too few or because they say nothing about the design: {left}." if left else ""
    accuracy, chance, p = lda.balanced_accuracy, lda.chance, lda.permutation_p
    if accuracy is None or chance is None or p is None or lda.interval is None:
        return [page.paragraph(f"There are too few failures to map: two classes of ten each are needed.{without}")]
    low, high = lda.interval
    clear = (accuracy - chance) / (1.0 - chance)  # 0 is guessing, 1 is certainty
    if p >= 0.05:
        verdict = "so this many designs do not show that kinds of failure have regions of their own in latent space"
    elif clear < 0.5:
        verdict = "so kinds of failure do differ in where they lie in latent space, but their regions overlap widely"
    else:
        verdict = "so failures of one kind lie together in latent space, where a search can avoid them"
    text = (
        f"Linear discriminants recognise the class of {_percent(accuracy)} of failures they have not seen, every class "
        f"counted alike (95 % interval {_percent(low)} to {_percent(high)}); guessing gives {_percent(chance)}, and "
        f"random labels do as well with probability {p:.3g}: {verdict}.{without}"
    )
    if run.kind == "evolve":
        text += " Bodies of an evolution descend from one another, so take the probability as a hint only."
    caption = (
        "Failures on their linear discriminants. Left as the paper's Fig. 3A, fitted to the points shown: with "
        "more latent dimensions than points even noise falls apart into clusters. Right the same points, each on "
        "discriminants that have not seen it: only what is apart here is apart in truth."
    )
    return [page.heading("The map of failures"), page.paragraph(text), page.picture(plots.lda_map(lda), caption)]


def _percent(share: float | None) -> str:
    return "\u2013" if share is None else f"{100 * share:.1f} %"
