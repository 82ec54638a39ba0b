"""What the study of fitness rungs says: costs, rank correlations, and how policies transfer to the twin."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from experiments.output import BadInput

Array = NDArray[np.float64]
Row = dict[str, Any]

RESAMPLES, SEED = 2000, 0  # of the bootstrap over bodies
LEAST = 3  # bodies that a correlation needs
BASELINE = "open-loop gait, CMA-ES 20 x 12: score"


def gold(row: Row) -> float:
    """What rungs are measured by: the best speed without exploration that the long training reached [m/s]."""
    return max(point["speed"] for point in row["training"])


def _speeds(row: Row) -> Array:
    return np.sort([gait["speed"] for gait in row["random"]] or [0.0])[::-1]


def _steady(row: Row) -> float:
    """Best random gait by speed times the share upright."""
    return max((gait["speed"] * gait["upright"] for gait in row["random"]), default=0.0)


def rungs(rows: list[Row]) -> dict[str, tuple[Callable[[Row], float], Callable[[Row], float]]]:
    """Name -> (fitness of a body, CPU seconds it took)."""
    found: dict[str, tuple[Callable[[Row], float], Callable[[Row], float]]] = {
        "random gaits: best": (lambda r: float(_speeds(r)[0]), lambda r: r["cpu_random"]),
        "random gaits: best that stays upright": (_steady, lambda r: r["cpu_random"]),
        "random gaits: mean of the best 6": (lambda r: float(_speeds(r)[:6].mean()), lambda r: r["cpu_random"]),
        "random gaits: median": (lambda r: float(np.median(_speeds(r))), lambda r: r["cpu_random"]),
        "open-loop gait, CMA-ES 13 x 8: score": (lambda r: r["screening"]["score"], lambda r: r["cpu_screening"]),
        BASELINE: (lambda r: r["thorough"]["score"], lambda r: r["cpu_thorough"]),
        "geometric mean of the best random gait and the score of 13 x 8": (
            lambda r: float(np.sqrt(_speeds(r)[0] * max(r["screening"]["score"], 0.0))),
            lambda r: r["cpu_random"] + r["cpu_screening"],
        ),
        "short PPO: corrected gait": (lambda r: r["race"][0], lambda r: r["cpu_race"] / len(r["race"])),
        "short PPO: best of 4 starts": (lambda r: max(r["race"]), lambda r: r["cpu_race"]),
    }
    for k, point in enumerate(rows[0]["training"][:-1]):
        name = f"PPO {point['steps'] / 1000:.0f} k"

        def cost(row: Row, k: int = k) -> float:
            return float(row["cpu_race"] + sum(p["cpu"] for p in row["training"][: k + 1]))

        found[f"{name}: exploring"] = (lambda r, k=k: r["training"][k]["exploring"], cost)  # type: ignore[misc]
        found[f"{name}: the policy itself"] = (lambda r, k=k: r["training"][k]["speed"], cost)  # type: ignore[misc]
        found[f"{name}: randomised"] = (lambda r, k=k: r["training"][k]["robust"], cost)  # type: ignore[misc]
    return found


def rank(fitness: Array, truth: Array) -> float:
    """Spearman's correlation; 0 where either says the same of every body."""
    return float(_ranks(fitness[None], truth[None])[0])


def _ranks(fitness: Array, truth: Array) -> Array:
    """Spearman's correlation of every row of (m, n)."""
    x, y = (rankdata(values, axis=1) for values in (fitness, truth))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    spread = np.sqrt((x * x).sum(axis=1) * (y * y).sum(axis=1))
    return np.asarray((x * y).sum(axis=1) / np.where(spread > 0, spread, 1.0))


def interval(fitness: Array, truth: Array) -> tuple[float, float]:
    """95 % bootstrap interval of `rank` over bodies."""
    rng = np.random.default_rng(SEED)
    picks = rng.integers(0, len(truth), (RESAMPLES, len(truth)))
    low, high = np.quantile(_ranks(fitness[picks], truth[picks]), [0.025, 0.975])
    return float(low), float(high)


def ladder(rows: list[Row]) -> list[dict[str, Any]]:
    """Every rung: name, median CPU seconds, rank correlation with the gold and its interval.

    Raises:
        BadInput: if there are fewer than three bodies.
    """
    if len(rows) < LEAST:
        raise BadInput(f"{len(rows)} bodies are measured; a rank correlation needs {LEAST} or more")
    truth = np.array([gold(row) for row in rows])
    table = []
    for name, (fitness, cost) in rungs(rows).items():
        values = np.nan_to_num(np.array([fitness(row) for row in rows], dtype=np.float64))
        low, high = interval(values, truth)
        table.append({"rung": name, "cpu_s": float(np.median([cost(row) for row in rows])), "rank": rank(values, truth),
                      "low": low, "high": high})  # fmt: skip
    return table


def transfer(rows: list[Row]) -> dict[str, Any]:
    """Speed on the twin over speed on the virtual robot: quantiles, and the worst with what differs."""
    found = []
    for row in rows:
        before, after = row["virtual"], row["twin"]
        if before is None or after is None or before["speed"] < 0.01:
            continue
        causes = []
        if after["upright"] < 1 <= before["upright"]:
            causes.append("it falls on the twin")
        if row["twin_ranges_differ"]:
            causes.append("other joint ranges")
        causes.append(f"mass x {row['twin_mass_kg'] / row['mass_kg']:.2f}")
        ratio = after["speed"] / before["speed"]
        found.append({"design": row["design"], "ratio": ratio, "virtual_m_s": before["speed"], "causes": causes})
    ratios = np.array([entry["ratio"] for entry in found])
    quantiles = [float(q) for q in np.quantile(ratios, [0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0])] if len(ratios) else []
    return {"bodies": len(found), "quantiles": quantiles, "worst": sorted(found, key=lambda e: e["ratio"])[:5]}


def markdown(rows: list[Row]) -> str:
    """Both results as text."""
    lines = [f"{len(rows)} bodies; gold: best deterministic speed of the long training, median "
             f"{np.median([gold(row) for row in rows]):.2f} m/s.", "",
             "| fitness | CPU-s | rank correlation | 95 % |", "|---|---:|---:|---|"]  # fmt: skip
    lines += [
        f"| {e['rung']} | {e['cpu_s']:.1f} | {e['rank']:.2f} | {e['low']:.2f} to {e['high']:.2f} |"
        for e in ladder(rows)
    ]
    moved = transfer(rows)
    lines += ["", f"Virtual to twin, {moved['bodies']} bodies, speed ratio:", "",
              "| least | 10 % | 25 % | median | 75 % | 90 % | greatest |", "|---:|" + "---:|" * 6,
              "| " + " | ".join(f"{q:.2f}" for q in moved["quantiles"]) + " |", ""]  # fmt: skip
    lines += [f"- {e['design']}: {e['ratio']:.2f} of {e['virtual_m_s']:.2f} m/s; {', '.join(e['causes'])}"
              for e in moved["worst"]]  # fmt: skip
    return "\n".join(lines)


def write_tables(folder: Path) -> str:
    """Write ladder.md and ladder.json from bodies.jsonl, give the text.

    Raises:
        BadInput: if there are too few bodies.
    """
    from experiments.fitness_study import read_rows

    rows = read_rows(folder / "bodies.jsonl")
    text = markdown(rows) if len(rows) >= LEAST else ""
    result = {"bodies": len(rows), "ladder": ladder(rows), "transfer": transfer(rows)}
    (folder / "ladder.md").write_text(text + "\n", encoding="utf-8")
    (folder / "ladder.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return text
