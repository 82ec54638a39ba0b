"""The parts of a report about one robot: what it looks like, how it walks, what it takes to build and to run it."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from analysis import page, plots
from analysis.folder import RunFolder
from analysis.words import REASONS, SCORES

BEST, BLUEPRINT, BUNDLE = "best", "blueprint", "bundle"
PERIOD = 10.0  # distances are told for this long [s]
HEAVY = 5_000_000  # films above this size stay outside of the page [bytes]


def facts(run: RunFolder) -> list[tuple[str, str, str]]:
    """Headline figures of the robot as tiles; fewer where files are missing."""
    walk, blueprint = _walk(run), run.json(BEST, BLUEPRINT, "blueprint.json")
    found: list[tuple[str, str, str]] = []
    if _known(walk, "distance_m", "seconds", "body_length_m"):
        metres = walk["distance_m"] * PERIOD / walk["seconds"]
        found.append((f"{metres / walk['body_length_m']:.1f}", "\u00d7", f"its own length in {PERIOD:g} s"))
        found.append((f"{metres:.2f}", "m", f"walked in {PERIOD:g} s"))
    if _known(walk, "speed_m_s"):
        found.append((f"{walk['speed_m_s']:.2f}", "m/s", "speed along its best heading"))
    total = blueprint.get("scores", {}).get("total", walk.get("s_mfg"))
    if total is not None:
        found.append((f"{total:.2f}", "of 5", "manufacturability score"))
    if "joints" in blueprint:
        found.append((str(len(blueprint["joints"])), "motors", "one at every joint"))
    mass = blueprint.get("robot", {}).get("mass", walk.get("mass_kg"))
    if mass is not None:
        found.append((f"{mass:.2f}", "kg", "with motors and battery"))
    return found


def portrait(run: RunFolder) -> str:
    """Pictures, film and behaviour of the winner; says so if there is none."""
    title = "The robot" if run.kind == "sketch" else "The winner"
    walk, blueprint = _walk(run), run.json(BEST, BLUEPRINT, "blueprint.json")
    if not run.has(BEST):
        return page.section(title, page.paragraph(_none(run)))
    parts = [page.picture(
        run.bytes(BEST, BLUEPRINT, "blueprint.png"),
        "The blueprint: every bone in its own tint, soft skin translucent; inside motors green, battery blue, "
        "controller red, cables yellow.",
    )]  # fmt: skip
    moves = page.picture(run.bytes(BEST, "walk.png"), "The gait of the built twin, one moment after the other.")
    film = page.film(run.bytes(BEST, "walk.mp4", limit=HEAVY), "The same as a film, at true speed.")
    parts += [moves, film]
    if not film and run.has(BEST, "walk.mp4"):
        parts.append(page.html_paragraph(f"The film is in {page.code(f'{BEST}/walk.mp4')}."))
    parts.append(_behaviour(walk))
    scores = blueprint.get("scores")
    if scores:
        parts += [page.heading("Its five scores"), *_scores(scores)]
    for note in blueprint.get("notes", []):
        parts.append(page.paragraph(f"Note of the solvers: {note}", "quiet"))
    if not any(parts):
        parts = [page.html_paragraph(f"The folder {page.code(BEST)} holds no picture and no blueprint.")]
    return page.section(title, *parts)


def bill(run: RunFolder) -> str:
    """What to buy and print."""
    rows = run.csv(BEST, BLUEPRINT, "bom.csv")
    blueprint = run.json(BEST, BLUEPRINT, "blueprint.json")
    if not rows:
        return ""
    cells = [
        (escape(row.get("kind", "")), escape(row.get("item", "")),
         escape(f"{row.get('quantity', '')} {row.get('unit', '')}"), _mass(row.get("mass_g")))
        for row in rows
    ]  # fmt: skip
    masses = [_number(row.get("mass_g")) for row in rows]
    cells.append(("", "everything", "", f"{sum(mass for mass in masses if mass is not None):.0f} g"))
    parts = blueprint.get("parts", [])
    objects = blueprint.get("pieces") or blueprint.get("bodies", [])  # printed as one: bodies, pieces of them, lids
    plates = {laid.get("plate") for laid in objects}
    text = ""
    if parts:
        soft = sum(part.get("material") == "soft" for part in parts)
        text = (
            f"{len(parts)} printed parts in {len(objects)} objects, {len(parts) - soft} rigid and {soft} soft, "
            f"on {len(plates)} plate{'s' if len(plates) != 1 else ''} of the "
            f"{blueprint.get('catalogue', {}).get('printer', {}).get('name', 'printer')}."
        )
    return page.section(
        "What it takes to build it", page.paragraph(text) if text else "",
        page.table(("kind", "item", "quantity", "mass"), cells, (2, 3), total=True),
        page.html_paragraph(
            f"The sources of these figures are in {page.code(f'{BEST}/{BLUEPRINT}/bom.csv')}; those marked "
            "&ldquo;assumed&rdquo; or &ldquo;unverified&rdquo; there are to be checked against what you buy.", "quiet"
        ),
    )  # fmt: skip


def rehearsal(run: RunFolder) -> str:
    """What the dry run on simulated motors gave."""
    dry = run.json(BEST, "dry_run.json")
    if not dry:
        return ""
    latched = dry.get("latched")
    lead = (
        "The policy drove simulated motors through the frames that the real motors understand, with the loop and the "
        "guards that run on the robot. "
    )
    if latched:
        lead += (
            f"The guard {latched.get('guard')!r} stopped it at joint {latched.get('joint')}: "
            f"{latched.get('value')} is beyond {latched.get('bound')}."
        )
    else:
        lead += "No guard had to stop it."
    rows = [
        ("control periods", _shown(dry.get("ticks"), "{:d}", "")),
        ("of them late", _shown(dry.get("overruns"), "{:d}", "")),
        ("joints behind their targets, root mean square", _shown(dry.get("tracking_rms_rad"), "{:.3f}", "rad")),
        ("the same, their lag taken out", _shown(dry.get("tracking_rms_aligned_rad"), "{:.3f}", "rad")),
        ("that lag", _shown(dry.get("tracking_lag_s"), "{:.2f}", "s")),
        ("speed on the virtual bus", _shown(dry.get("speed_m_s"), "{:.2f}", "m/s")),
        ("greatest torque", _shown(dry.get("peak_torque_Nm"), "{:.1f}", "N&thinsp;m")),
        ("state at the end", escape(str(dry.get("state", "")))),
    ]
    table = page.table((), [row for row in rows if row[1]], (1,))
    return page.section("Its dry run", page.paragraph(lead), table)


def next_steps(run: RunFolder) -> str:
    """How to print, build and drive it."""
    if not run.has(BEST):
        return ""
    here = f"{BEST}/{BLUEPRINT}"
    code = page.code
    guide = f"Follow {code(f'{here}/guide.html')}. " if run.has(BEST, BLUEPRINT, "guide.html") else ""
    steps = [
        f"<b>Print.</b> Open {code(f'{here}/print.3mf')} in PrusaSlicer or {code(f'{here}/print_bambu.3mf')} in Bambu "
        f"Studio; rigid and soft filament are assigned. {code(f'{here}/print_settings.txt')} repeats the settings for "
        f"other slicers, with the single parts in {code(f'{here}/parts')}.",
        f"<b>Assemble.</b> {guide}{code(f'{here}/assembly.glb')} shows every part in its place; buy by "
        f"{code(f'{here}/bom.csv')}, and wire by {code(f'{here}/wiring.csv')}: it gives every motor its address.",
        f"<b>Rehearse.</b> On any computer, with simulated motors:"
        f"{page.block(f'bodyplan deploy {BEST}/{BUNDLE} --bus virtual --dry-run')}",
        f"<b>Drive.</b> Feet off the ground, a hand on the power switch, on the robot's own computer:"
        f"{page.block(f'bodyplan deploy {BEST}/{BUNDLE} --bus socketcan:can0')}",
        f"<b>Look closer.</b> The model that was simulated is {code(f'{here}/robot.xml')}; another film of it:"
        f"{page.block(f'bodyplan simulate {here} --policy {BEST}/{BUNDLE} --video again.mp4')}",
    ]
    items = "\n".join(f"<li>{step}</li>" for step in steps)
    return page.section("What to do next", page.paragraph("Paths are relative to the folder of this report."),
                        f"<ol>{items}</ol>")  # fmt: skip


def _walk(run: RunFolder) -> Mapping[str, Any]:
    """Behaviour of the winner from the result, or from the twin that was measured while the run was on."""
    winner = run.result.get("winner")
    if isinstance(winner, dict):
        return winner
    design = run.json(BEST, BLUEPRINT, "blueprint.json").get("design")
    twins = run.finals[run.finals["design"] == design] if design and not run.finals.empty else run.finals[:0]
    if twins.empty:
        return {}
    twin = twins.iloc[0]
    measured = {"distance_m": twin["distance"], "seconds": twin["episode"], "speed_m_s": twin["speed"],
                "body_length_m": twin["body_length"], "mass_kg": twin["mass"], "design": design}  # fmt: skip
    return {name: value for name, value in measured.items() if value == value}  # a missing number is not itself.


def _behaviour(walk: Mapping[str, Any]) -> str:
    if not walk:
        return ""
    rows = [
        ("design", page.code(str(walk["design"])) if "design" in walk else ""),
        ("found", _found(walk)),
        ("distance", _shown(walk.get("distance_m"), "{:.2f}", f"m in {walk.get('seconds', PERIOD):g} s")),
        ("greatest extent of the body", _shown(walk.get("body_length_m"), "{:.2f}", "m")),
        ("fell over", {True: "yes", False: "no"}.get(walk.get("fell", ""), "")),
        ("cost of transport", _shown(walk.get("cost_of_transport"), "{:.2f}", "J/(N&thinsp;m)")),
        ("greatest torque of any motor", _shown(walk.get("max_torque_Nm"), "{:.1f}", "N&thinsp;m")),
        ("load of the hottest motor", _percent(walk.get("overload"), "of what it bears for long")),
        ("fitness", _shown(walk.get("fitness"), "{:.3f}", "m/s")),
    ]
    return page.heading("How it walks") + page.table((), [row for row in rows if row[1]], (1,))


def _scores(scores: Mapping[str, Any]) -> list[str]:
    bars = plots.score_bars({name: scores.get(key) for key, name, _ in SCORES})
    rows = [(escape(name), _shown(scores.get(key), "{:.2f}", ""), escape(meaning)) for key, name, meaning in SCORES]
    rows.append(("all five", _shown(scores.get("total"), "{:.2f}", ""), "The manufacturability score S_mfg, of 5."))
    return [
        page.picture(bars, "The five scores, each between 0 and 1.", 660),
        page.table(("score", "value", "what it says"), rows, (1,), total=True),
    ]


def _none(run: RunFolder) -> str:
    failure = run.result.get("failure")
    if run.kind == "sketch" and failure:
        words = REASONS.get(failure.get("reason", ""), "")
        return f"This body cannot be built. {words} ({failure.get('stage')}: {failure.get('detail')})"
    if not run.result:
        return "The run is not finished, so it has no winner yet."
    return "No body could be built and walks a body length. Try more generations, a larger population or another seed."


def _found(walk: Mapping[str, Any]) -> str:
    return f"generation {walk['generation']}, candidate {walk['candidate']}" if "generation" in walk else ""


def _known(values: Mapping[str, Any], *names: str) -> bool:
    return all(values.get(name) for name in names)


def _shown(value: Any, form: str, unit: str) -> str:
    return "" if value is None else f"{form.format(value)} {unit}".strip()


def _percent(value: Any, what: str) -> str:
    return "" if value is None else f"{100 * value:.0f} % {what}"


def _mass(text: str | None) -> str:
    mass = _number(text)
    return "" if mass is None else f"{mass:.0f} g"


def _number(text: str | None) -> float | None:
    try:
        return float(text or "")
    except ValueError:
        return None
