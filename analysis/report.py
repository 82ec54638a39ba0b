"""One self-contained HTML file about a run: what was run, what came of it, what to do with it, how to repeat it."""

from __future__ import annotations

import json
import os
from html import escape
from pathlib import Path

from analysis import page, population, winner
from analysis.folder import RunFolder, read_folder
from analysis.lda import FailureLda
from analysis.passthrough import PASSED, pass_through

REPORT = "report.html"


def write_report(folder: Path, lda: FailureLda | None = None) -> Path:
    """Write `report.html` into a run folder, from whatever is there; a report of an unfinished run says so.

    Args:
        folder: of an evolution, a study or a sketch.
        lda: the failure map, if it is known already.

    Returns:
        The file.

    Raises:
        RecordsError: if it is not the folder of a run, or its run file cannot be read.
        OSError: if the report cannot be written.
    """
    run = read_folder(folder)
    name = folder.resolve().name
    title = {"evolve": "An evolution", "study": "A study", "sketch": "A sketch"}[run.kind] + f": {name}"
    html = page.document(f"{title} - bodyplan", [f"<h1>{escape(title)}</h1>", *_parts(run, lda)])
    path = folder / REPORT
    partial = path.with_name(path.name + ".partial")
    partial.write_text(html, encoding="utf-8")
    os.replace(partial, path)
    return path


def _parts(run: RunFolder, lda: FailureLda | None) -> list[str]:
    parts = [page.paragraph(_lead(run), "lead"), *(page.paragraph(text, "note") for text in _warnings(run))]
    if run.kind == "study":
        parts += [page.tiles(_study_facts(run)), population.passing(run), population.scores(run)]
        parts += [population.examples(run), population.failures(run, lda or population.failure_map(run))]
        return [*parts, _provenance(run)]
    parts += [page.tiles(winner.facts(run)), winner.portrait(run), winner.bill(run), winner.rehearsal(run)]
    parts.append(winner.next_steps(run))
    if run.kind == "evolve":
        score = run.json("best", "blueprint", "blueprint.json").get("scores", {}).get("total")
        parts += [population.evolution(run), population.passing(run), population.scores(run, score)]
        parts.append(population.failures(run, lda or population.failure_map(run)))
    return [*parts, _provenance(run)]


def _lead(run: RunFolder) -> str:
    if run.kind == "sketch":
        design = Path(str(run.config.get("design", "a painted body"))).name
        return f"{design}: its blueprint, a gait that was searched for it, and a dry run."
    decoder = run.meta.get("decoder", "?")
    seed = run.meta.get("seed", "?")
    if run.kind == "study":
        rules = f" by the rules {run.config['solver']!r}" if "solver" in run.config else ""
        return (
            f"{len(run.records)} random bodies of the decoder {decoder!r}, seed {seed}, went through all manufacturing "
            f"solvers{rules}: what share can be built, and what stops the others?"
        )
    search = run.config.get("search", {})
    shape = ""
    if {"generations", "popsize"} <= set(search):
        shape = f"{search['generations']} generations of {search['popsize']}, "
    return (
        f"{len(run.records)} bodies were evaluated ({shape}decoder {decoder!r}, seed {seed}). Each was decoded, fitted "
        "with motors, electronics and cables, and, if it can be built, walked in simulation. The best were built "
        "in full and measured again with their real masses and motors."
    )


def _warnings(run: RunFolder) -> list[str]:
    found = list(run.problems)
    search = run.config.get("search", {})
    total = run.config.get("n") if run.kind == "study" else search.get("generations", 0) * search.get("popsize", 0)
    if run.kind != "sketch" and not run.result:
        of = f" of {total}" if total else ""
        found.append(f"This run is not finished: {len(run.records)}{of} bodies are evaluated. What follows is so far.")
    lost = int((run.records["stage"] == "worker").sum())
    if lost:
        found.append(
            f"{lost} evaluation{'s' if lost > 1 else ''} ended with a crash, a time limit or physics that exploded, "
            "and say nothing about the bodies; see the table of failures."
        )
    return [text[0].upper() + text[1:] + ("" if text.endswith(".") else ".") for text in found]


def _study_facts(run: RunFolder) -> list[tuple[str, str, str]]:
    counts = pass_through(run.records["outcome"])
    if counts.rate is None:
        return []
    low, high = counts.interval
    facts = [
        (f"{100 * counts.rate:.1f}", "%", f"can be built (95 %: {100 * low:.1f} to {100 * high:.1f} %)"),
        (str(counts.n), "bodies", "drawn at random"),
    ]
    passed = run.records["s_mfg"][run.records["outcome"] == PASSED]
    if len(passed):
        facts.append((f"{passed.median():.2f}", "of 5", "median score of those that can be built"))
    if "seconds" in run.result:
        facts.append((f"{run.result['seconds']:.0f}", "s", "to work all of it out"))
    return facts


def _provenance(run: RunFolder) -> str:
    rows = [("seed", escape(str(run.meta.get("seed", run.config.get("seed", "")))))]
    if "config_hash" in run.meta:
        rows.append(("configuration", page.code(run.meta["config_hash"])))
    if "seconds" in run.result and run.kind != "sketch":
        rows.append(("wall time of the last session", f"{run.result['seconds']:.0f} s"))
    if not run.records.empty:
        rows.append(("computing time of all evaluations", f"{run.records['seconds'].sum():.0f} s"))
    rows += [(escape(name), escape(version)) for name, version in _versions(run).items()]
    again = page.html_paragraph(
        f"The same configuration and seed give the same run, on any number of cores: "
        f"{page.code('bodyplan run config.toml --out again')}."
    )
    config = page.folded("The configuration, every default spelled out", page.block(run.config_text.strip()))
    return page.section(
        "How to repeat it", again if run.config_text else "", page.table((), [row for row in rows if row[1]]),
        config if run.config_text else "",
    )  # fmt: skip


def _versions(run: RunFolder) -> dict[str, str]:
    try:
        found = json.loads(run.meta.get("versions", "{}"))
    except ValueError:
        return {}
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, dict) else {}
