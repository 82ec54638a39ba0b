"""The pass-through table of several rules on the same bodies, as text and as numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.passthrough import Paired, PassThrough

NAMES = {"paper": "paper", "search": "search", "auto": "search, parts sized", "repair": "search, repaired"}
PAIRS = (("paper", "search"), ("search", "auto"), ("search", "repair"), ("paper", "auto"), ("paper", "repair"))

Verdicts = Mapping[str, Mapping[int, Mapping[str, Any]]]  # by rules and body


def table(verdicts: Verdicts) -> tuple[str, dict[str, Any]]:
    """Integer counts by stage with 95 % intervals, paired differences on the bodies that two rules share, reasons.

    Args:
        verdicts: by rules and body, each with `outcome`, a failure class or "passed", and for a failure its `reason`.

    Returns:
        Markdown, and the same numbers as an object for JSON.
    """
    from analysis.passthrough import ORDER, paired, pass_through

    counts = {rules: pass_through(v["outcome"] for v in found.values()) for rules, found in verdicts.items()}
    lines = ["| bodies refused by | " + " | ".join(NAMES[rules] for rules in counts) + " |", _rule(len(counts))]
    for stage in ORDER:
        lines.append(_row(stage, [str(c.counts[stage]) for c in counts.values()]))
    lines.append(_row("**passed**", [f"**{c.passed}** of {c.n}" for c in counts.values()]))
    lines.append(_row("pass rate (95 %)", [_percent(c) for c in counts.values()]))
    pairs: dict[str, Paired] = {}
    for first, second in PAIRS:
        common = sorted(set(verdicts.get(first, {})) & set(verdicts.get(second, {})))
        if common:
            pairs[f"{second} - {first}"] = paired(
                *([verdicts[rules][body]["outcome"] for body in common] for rules in (first, second))
            )
    lines += ["", "| pass, of the same bodies | both | only first | only second | neither | difference (95 %) | p |",
              _rule(6)]  # fmt: skip
    for name, pair in pairs.items():
        second, first = name.split(" - ")
        low, high = (100 * bound for bound in pair.interval)
        lines.append(_row(
            f"{NAMES[first]}, then {NAMES[second]} (first {pair.n})",
            [str(pair.both), str(pair.first), str(pair.second), str(pair.neither),
             f"{100 * (pair.difference or 0.0):+.1f} points ({low:+.1f} to {high:+.1f})", f"{pair.p_value:.2g}"],
        ))  # fmt: skip
    reasons = {rules: _reasons(found) for rules, found in verdicts.items()}
    lines += ["", "| reason | " + " | ".join(NAMES[rules] for rules in reasons) + " |", _rule(len(reasons))]
    for stage in ORDER:
        for reason in sorted({name for found in reasons.values() for name in found if name.startswith(f"{stage}: ")}):
            lines.append(_row(reason, [str(found.get(reason, 0)) for found in reasons.values()]))
    ends = Counter(v["end"] for v in verdicts.get("auto", {}).values() if v["outcome"] == "passed")
    if ends:
        how = ", ".join(f"{number} end {end}" for end, number in sorted(ends.items()))
        lines += [
            "",
            f"Parts sized: {how} (fixed: the choice repeats; else another of the choices bears its own robot).",
        ]
    result = {
        "ends_of_sizing": dict(sorted(ends.items())),
        "rules": {rules: _numbers(c) | {"reasons": reasons[rules]} for rules, c in counts.items()},
        "paired": {name: _pair(pair) for name, pair in pairs.items()},
    }
    return "\n".join(lines), result


def _reasons(found: Mapping[int, Mapping[str, Any]]) -> dict[str, int]:
    counts = Counter(f"{v['outcome']}: {v['reason']}" for v in found.values() if "reason" in v)
    return dict(sorted(counts.items()))


def _numbers(counts: PassThrough) -> dict[str, Any]:
    return {"n": counts.n, "counts": counts.counts, "pass_rate": counts.rate, "pass_rate_95": list(counts.interval)}


def _pair(pair: Paired) -> dict[str, Any]:
    return {
        "n": pair.n, "both": pair.both, "only_first": pair.first, "only_second": pair.second, "neither": pair.neither,
        "difference": pair.difference, "difference_95": list(pair.interval), "p": pair.p_value,
    }  # fmt: skip


def _percent(counts: PassThrough) -> str:
    low, high = (100 * bound for bound in counts.interval)
    return f"{100 * (counts.rate or 0.0):.1f} % ({low:.1f} to {high:.1f})"


def _row(name: str, cells: list[str]) -> str:
    return f"| {name} | " + " | ".join(cells) + " |"


def _rule(columns: int) -> str:
    return "|---|" + "---:|" * columns
