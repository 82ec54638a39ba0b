"""Figures of the fitness study: what a rung costs and how well it ranks, and how policies fare on the twin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.plots import BEST, FILL, INK, QUIET, panel, png, styled

FAMILIES = {"random": FILL, "open-loop": "#2b8a57", "short PPO": "#e0a526", "PPO at": BEST}  # how names begin


def ladder_picture(table: Sequence[dict[str, Any]]) -> bytes:
    """Rank correlation with its interval against CPU seconds, a point per rung."""
    with styled():
        axes, figure = panel(7.2, 4.0)
        for begins, colour in FAMILIES.items():
            mine = [e for e in table if e["rung"].startswith(begins) and e["rank"] is not None and e["cpu_s"]]
            if not mine:
                continue
            at = np.array([e["cpu_s"] for e in mine])
            at = at * np.exp(np.linspace(-0.05, 0.05, len(mine)))  # rungs of one cost stand side by side
            y = np.array([e["rank"] for e in mine])
            low, high = (np.array([e[side] for e in mine], dtype=np.float64) for side in ("low", "high"))
            axes.vlines(at, low, high, color=colour, lw=0.9, alpha=0.55)
            axes.plot(at, y, "o", color=colour, ms=4.5, label={"PPO at": "long PPO"}.get(begins, begins))
        axes.axhline(0.56, color=QUIET, lw=1.0, ls=(0, (4, 3)), label="prototype, 0.56 at 6.8 CPU-s")
        axes.set_xscale("log")
        axes.set_ylim(top=1.02)
        axes.set_xlabel("computing time per body [CPU-s]", loc="right")
        axes.set_ylabel("rank correlation with the long training")
        axes.grid(axis="y")
        axes.legend(loc="lower right")
        return png(figure)


def transfer_picture(ratios: Sequence[float]) -> bytes:
    """Bodies per interval of the speed on the twin over that of the virtual robot."""
    with styled():
        axes, figure = panel(6.4, 2.9)
        edges = np.arange(0.0, max(1.5, *ratios, 0.0) + 0.1, 0.1) if ratios else np.arange(0.0, 1.6, 0.1)
        axes.hist(np.asarray(ratios), edges.tolist(), rwidth=0.9, color=FILL)
        if ratios:
            middle = float(np.median(ratios))
            axes.axvline(middle, color=INK, lw=1.2, ls=(0, (4, 3)), label=f"median, {middle:.2f}")
            axes.legend(loc="upper right")
        axes.axvline(1.0, color=BEST, lw=1.2)
        axes.set_xlabel("speed on the twin over speed of the virtual robot", loc="right")
        axes.set_ylabel("bodies")
        axes.locator_params(axis="y", integer=True)
        return png(figure)
