"""What the fitness study says: costs and rank correlations of the rungs, and how policies transfer to the twin.

    python -m experiments.fitness_table DIR

reads DIR/bodies.jsonl and writes ladder.md, ladder.json, ladder.png and transfer.png beside it. The study does the same
when it is done; by itself this works on what is measured so far.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.fitness_combination import combinations
from experiments.fitness_rungs import LEAST, RESAMPLES, Row, gold, interval, rank, robust_gold, rungs
from experiments.json_lines import read_rows
from experiments.output import DONE, BadInput

STANDS_STILL = 0.02  # speed of the virtual robot below which a ratio says nothing [m/s]
WORST = 5
QUANTILES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)


def ladder(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Every rung that three bodies or more have: name, bodies, CPU seconds, correlations and an interval.

    Raises:
        BadInput: if fewer than three bodies have a gold.
    """
    rows = with_gold(rows)
    truth = np.array([gold(row) for row in rows])
    robust = np.array([robust_gold(row) for row in rows])
    table = []
    for rung in rungs(rows):
        values = rung.values(rows)
        bodies = int(np.isfinite(values).sum())
        if bodies < LEAST:
            continue
        low, high = interval(values, truth)
        table.append({"rung": rung.name, "bodies": bodies, "cpu_s": rung.seconds(rows), "rank": rank(values, truth),
                      "low": low, "high": high, "rank_robust": rank(values, robust)})  # fmt: skip
    return table


def with_gold(rows: Sequence[Row]) -> list[Row]:
    """The bodies of which the long training is known.

    Raises:
        BadInput: if there are fewer than three.
    """
    found = [row for row in rows if np.isfinite(gold(row))]
    if len(found) < LEAST:
        raise BadInput(f"{len(found)} bodies are measured; a rank correlation needs {LEAST} or more")
    return found


def transfer(rows: Sequence[Row]) -> dict[str, Any]:
    """Speed on the twin over speed on the virtual robot: quantiles, what goes with it, and the worst with causes."""
    found, still, lost = [], 0, 0
    for row in rows:
        before, after = row.get("virtual"), row.get("twin")
        if before is None or after is None:
            lost += 1
        elif before["speed"] < STANDS_STILL:
            still += 1
        else:
            found.append((after["speed"] / before["speed"], row))
    found.sort(key=lambda pair: pair[0])
    ratios = [ratio for ratio, _ in found]
    return {
        "bodies": len(found), "stand_still": still, "lost": lost, "ratios": ratios,
        "quantiles": [float(q) for q in np.quantile(ratios, QUANTILES)] if ratios else [],
        "at_least_0.8": sum(ratio >= 0.8 for ratio in ratios),
        "groups": _groups(found),
        "worst": [{"design": row["design"], "ratio": ratio, "virtual_m_s": row["virtual"]["speed"],
                   "twin_m_s": row["twin"]["speed"], "causes": causes(row)} for ratio, row in found[:WORST]],
    }  # fmt: skip


def causes(row: Row) -> list[str]:
    """What differs between a virtual robot and its twin, as far as the row says, the gravest first."""
    found = []
    if row["twin"].get("upright", 1.0) < 1.0 <= row["virtual"].get("upright", 1.0):
        found.append(f"falls on the twin after {row['twin']['upright'] * row['twin'].get('seconds', 10.0):.1f} s")
    if row.get("twin_ranges_differ"):
        found.append("other joint ranges")
    if row.get("twin_imu_link"):
        found.append("IMU in another link")
    if "twin_mass_kg" in row and row.get("mass_kg"):
        found.append(f"mass x {row['twin_mass_kg'] / row['mass_kg']:.2f}")
    if row.get("twin_hull_shift_m", 0.0) >= 1e-3:
        found.append(f"length differs by {1000 * row['twin_hull_shift_m']:.0f} mm")
    return found


def _groups(found: Sequence[tuple[float, Row]]) -> list[dict[str, Any]]:
    """The median ratio of bodies that share a possible cause, and of those without it."""
    masses = [row["twin_mass_kg"] / row["mass_kg"] for _, row in found if "twin_mass_kg" in row and row.get("mass_kg")]
    middle = float(np.median(masses)) if masses else math.nan
    tests: dict[str, Callable[[Row], bool]] = {
        "falls on the twin": lambda r: r["twin"]["upright"] < 1.0,
        "joint ranges differ": lambda r: r["twin_ranges_differ"],
        f"mass of the twin above x {middle:.2f}": lambda r: r["twin_mass_kg"] / r["mass_kg"] > middle,
        "length differs by 1 mm or more": lambda r: r["twin_hull_shift_m"] >= 1e-3,
        "IMU turned in its link": lambda r: r["twin_imu_turn_rad"] > 1e-3,
        "IMU in another link than the root": lambda r: r["twin_imu_link"] != 0,
    }
    table = []
    for name, test in tests.items():
        sides: dict[bool, list[float]] = {True: [], False: []}
        for ratio, row in found:
            try:
                sides[bool(test(row))].append(ratio)
            except (KeyError, TypeError, ZeroDivisionError):
                continue  # a row of an older version
        medians = {side: float(np.median(values)) if values else math.nan for side, values in sides.items()}
        table.append({"cause": name, "with": len(sides[True]), "median_with": medians[True],
                      "without": len(sides[False]), "median_without": medians[False]})  # fmt: skip
    return table


def markdown(rows: Sequence[Row], result: dict[str, Any]) -> str:
    """All results as text."""
    known = with_gold(rows)
    truth, robust = (np.array([value(row) for row in known]) for value in (gold, robust_gold))
    lines = [
        f"{len(known)} bodies. Gold, chosen beforehand: the best speed without exploration at any checkpoint of the "
        f"long training, median {np.median(truth):.2f} m/s. Its rank correlation with the speed in randomised episodes "
        f"at the end of the same training is {_text(rank(robust, truth))}: no rung can be expected to do much better. "
        "Rungs \"PPO at\" are part of the training that gives the gold, which flatters them the more the later they "
        f"are. Intervals: bootstrap over bodies, {RESAMPLES} resamples.", "",
        "| fitness | bodies | CPU-s | rank correlation | 95 % | with randomised at the end |",
        "|---|---:|---:|---:|---|---:|",
    ]  # fmt: skip
    lines += [f"| {e['rung']} | {e['bodies']} | {_text(e['cpu_s'], 1)} | {_text(e['rank'])} | {_text(e['low'])} to "
              f"{_text(e['high'])} | {_text(e['rank_robust'])} |" for e in result["ladder"]]  # fmt: skip
    return "\n".join(
        [*lines, "", *_about_combinations(result["combinations"]), "", *_about_transfer(result["transfer"])]
    )


def _about_combinations(pools: list[dict[str, Any]]) -> list[str]:
    if not pools:
        return ["Combinations of cheap numbers: too few bodies to choose on some and test on others."]
    first = pools[0]
    lines = [
        f"Cheap fitness chosen on one half of the bodies and tested on the other, {first['halves']} random halves of "
        f"{first['bodies']}; combinations are means of ranks. On the halves for testing the thorough search's score "
        f"has {first['baseline_tested_on']:.2f}.", "",
        "| chosen among | candidates | where chosen | where tested | gain over the thorough search, 10 % to 90 % | "
        "better |", "|---|---:|---:|---:|---|---:|",
    ]  # fmt: skip
    for c in pools:
        low, _, high = c["gain_quantiles"]
        lines.append(f"| {c['pool']} | {c['candidates']} | {c['selected_on']:.2f} | {c['tested_on']:.2f} | "
                     f"{c['gain']:+.2f}, {low:+.2f} to {high:+.2f} | {c['better_share']:.0%} |")  # fmt: skip
    lines.append("")
    for c in pools:
        often = "; ".join(f"{name} ({share:.0%})" for name, share in c["chosen_most"])
        lines.append(f"- {c['pool']}: chosen most {often}. On all bodies, so not tested: {c['chosen_on_all']}, "
                     f"{_text(c['cpu_s'], 1)} CPU-s.")  # fmt: skip
    return lines


def _about_transfer(moved: dict[str, Any]) -> list[str]:
    lines = [
        f"Virtual to twin, unchanged policy, {moved['bodies']} bodies, speed on the twin over speed before "
        f"({moved['stand_still']} bodies stand still below {STANDS_STILL} m/s and {moved['lost']} lack one of the two; "
        f"they are left out). {moved['at_least_0.8']} keep 0.8 or more.",
    ]  # fmt: skip
    if moved["bodies"]:
        lines += ["", "| least | 10 % | 25 % | median | 75 % | 90 % | greatest |", "|---:|" + "---:|" * 6,
                  "| " + " | ".join(_text(q) for q in moved["quantiles"]) + " |", "",
                  "| what differs | bodies | median ratio | others | their median |",
                  "|---|---:|---:|---:|---:|"]  # fmt: skip
        lines += [f"| {g['cause']} | {g['with']} | {_text(g['median_with'])} | {g['without']} | "
                  f"{_text(g['median_without'])} |" for g in moved["groups"]]  # fmt: skip
        lines += ["", "The worst:", ""]
        lines += [f"- {e['design']}: {e['ratio']:.2f}, {e['virtual_m_s']:.2f} to {e['twin_m_s']:.2f} m/s; "
                  f"{', '.join(e['causes']) or 'nothing that the row tells'}" for e in moved["worst"]]  # fmt: skip
    return lines


def _text(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "?"


def _plain(value: Any) -> Any:
    """As JSON has it: what is not finite is null."""
    match value:
        case dict():
            return {key: _plain(entry) for key, entry in value.items()}
        case list() | tuple():
            return [_plain(entry) for entry in value]
        case float():
            return value if math.isfinite(value) else None
    return value


def write_tables(folder: Path) -> str:
    """Write tables and pictures from bodies.jsonl, give the text.

    Raises:
        BadInput: if there are too few bodies.
    """
    from experiments.fitness_pictures import ladder_picture, transfer_picture

    rows = read_rows(folder / "bodies.jsonl")
    found: dict[str, Any] = {
        "bodies": len(rows),
        "ladder": ladder(rows),
        "combinations": combinations(rows),
        "transfer": transfer(rows),
    }
    text = markdown(rows, found)
    (folder / "ladder.md").write_text(text + "\n", encoding="utf-8")
    (folder / "ladder.json").write_text(json.dumps(_plain(found), indent=2) + "\n", encoding="utf-8")
    (folder / "ladder.png").write_bytes(ladder_picture(_plain(found["ladder"])))
    (folder / "transfer.png").write_bytes(transfer_picture(found["transfer"]["ratios"]))
    return text


def main() -> int:
    """Write the tables of a study as far as it is."""
    parser = argparse.ArgumentParser(prog="python -m experiments.fitness_table", description=__doc__)
    parser.add_argument("folder", type=Path, metavar="DIR", help="of the study")
    try:
        print(write_tables(parser.parse_args().folder))
    except BadInput as trouble:
        parser.error(str(trouble))
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
