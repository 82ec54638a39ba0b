"""Figures as PNG bytes, in one quiet style: the only importer of matplotlib."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from analysis.lda import FailureLda
from analysis.passthrough import PAPER_REMAINING, PassThrough

INK, QUIET, RULE, FILL, BEST = "#22272b", "#6b747c", "#d5dade", "#8fa3b3", "#1f6f8b"
# One colour per outcome in every figure; told apart by lightness too, for print and for the colour-blind.
COLOURS = {
    "skeleton": "#7b5ea7", "motor": "#2b8a57", "electronics": "#d1495b", "wire": "#e0a526", "print": "#4a5560",
    "worker": "#b9bec3", "passed": BEST,
}  # fmt: skip
MARKERS = {"skeleton": "s", "motor": "o", "electronics": "^", "wire": "D", "print": "v"}
DPI = 144
_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif", "font.size": 9.5, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": QUIET,
    "axes.titlesize": 9.5, "axes.titlelocation": "left", "axes.spines.top": False, "axes.spines.right": False,
    "axes.linewidth": 0.8, "xtick.color": QUIET, "ytick.color": QUIET, "xtick.labelcolor": INK,
    "ytick.labelcolor": INK, "grid.color": RULE, "grid.linewidth": 0.6, "axes.axisbelow": True,
    "legend.frameon": False, "legend.fontsize": 9.0, "figure.facecolor": "white", "savefig.facecolor": "white",
}  # fmt: skip


def pass_through_bars(table: PassThrough) -> bytes:
    """Share of designs that every stage lets through, of those that reached it, beside the paper's."""
    rows = [row for row in table.rows() if row.stage != "worker" or row.failed]
    with styled():
        axes, figure = panel(6.4, 0.42 * (len(rows) + 1) + 0.9)
        names = [row.stage for row in rows] + ["all stages"]
        shares = [row.remaining for row in rows] + [table.rate]
        place = np.arange(len(names))[::-1]
        for name, share, y in zip(names, shares, place, strict=True):
            colour = BEST if name == "all stages" else FILL
            axes.barh(y, 100.0, 0.62, color="#f1f3f5")
            axes.barh(y, 100.0 * (share or 0.0), 0.62, color=colour)
            axes.text(101.5, y, "none got here" if share is None else f"{100 * share:.1f} %", va="center", color=INK)
            paper = PAPER_REMAINING.get("passed" if name == "all stages" else name)
            if paper is not None:
                axes.plot([100 * paper] * 2, [y - 0.42, y + 0.42], color=INK, lw=1.4)
        axes.plot([], [], color=INK, lw=1.4, label="paper, n = 1000")
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.16), handlelength=1.2)
        axes.set_yticks(place, names)
        axes.set_xlim(0, 100)
        axes.set_xlabel("remaining of those that reached the stage [%]", loc="right")
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
        return png(figure)


def score_histogram(passed: Sequence[float], failed: Sequence[float], winner: float | None = None) -> bytes:
    """Designs per interval of S_mfg (paper Fig. 3E); failed ones have the scores of the stages they passed."""
    with styled():
        axes, figure = panel(6.4, 2.9)
        edges = np.linspace(0.0, 5.0, 26).tolist()
        axes.hist(
            [np.asarray(passed), np.asarray(failed)], edges, stacked=True, rwidth=0.9, color=[BEST, RULE],
            label=[f"can be built ({len(passed)})", f"failed, partial score ({len(failed)})"],
        )  # fmt: skip
        if winner is not None:
            axes.axvline(winner, color=INK, lw=1.2, ls=(0, (4, 3)), label=f"winner, {winner:.2f}")
        axes.grid(axis="y")
        axes.set_xlim(0, 5)
        axes.set_xlabel(r"manufacturability score $S_\mathrm{mfg}$, 5 is best")
        axes.set_ylabel("designs")
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        figure.legend(loc="outside upper right", ncols=3)
        return png(figure)


def lda_map(lda: FailureLda) -> bytes | None:
    """Failures on their discriminants (paper Fig. 3A), fitted to them and held out; None without two classes."""
    if lda.balanced_accuracy is None:
        return None
    with styled():
        figure = Figure(figsize=(7.6, 3.9), layout="constrained", dpi=DPI)
        panels = figure.subplots(1, 2)
        titles = ("Discriminants fitted to these very designs", "The same, each design held out of its fit")
        for axes, points, title in zip(panels, (lda.fitted, lda.held_out), titles, strict=True):
            _scatter(axes, points, lda)
            axes.set_title(title)
        _same_limits(panels)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        return png(figure)


def fitness_curve(
    generation: NDArray[np.int64], fitness: NDArray[np.float64], passed: NDArray[np.bool_]
) -> bytes | None:
    """Fitness over generations: every body, the median and the best so far; None where nothing has a fitness."""
    has = np.isfinite(fitness)
    if not has.any():
        return None
    last = int(generation.max())
    every = np.arange(last + 1)
    best = np.maximum.accumulate([fitness[has & (generation == g)].max(initial=-np.inf) for g in every])
    median = [np.median(fitness[has & (generation == g)]) if (has & (generation == g)).any() else np.nan for g in every]
    share = [100.0 * passed[generation == g].mean() if (generation == g).any() else np.nan for g in every]
    with styled():
        figure = Figure(figsize=(6.4, 3.9), layout="constrained", dpi=DPI)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
        upper.plot(generation[has], fitness[has], ".", color=FILL, ms=4, alpha=0.7, label="each body")
        upper.plot(every, median, color=QUIET, lw=1.2, marker=".", ms=4, label="median")
        reached = np.isfinite(best)
        upper.step(every[reached], best[reached], where="post", color=BEST, lw=2, label="best so far")
        upper.set_ylabel("fitness [m/s]")
        upper.grid(axis="y")
        figure.legend(loc="outside upper right", ncols=3)
        lower.bar(every, share, 0.7, color=FILL)
        lower.set_ylim(0, 100)
        lower.set_ylabel("can be\nbuilt [%]")
        lower.set_xlabel("generation")
        lower.set_xlim(-0.6, last + 0.6)
        lower.xaxis.set_major_locator(MaxNLocator(integer=True))
        return png(figure)


def training_curve(seconds: Sequence[float], bodies: Sequence[float], figures: Mapping[str, Sequence[float]]) -> bytes:
    """Every figure of a training against the compute spent, a panel each; losses on a logarithmic scale.

    Args:
        seconds: of training, of every row.
        bodies: seen by then; only the last is told.
        figures: by name, a value per row, NaN where a row has none; names that begin with "loss_" are losses.
    """
    columns = min(4, max(len(figures), 1))
    rows = max(-(-len(figures) // columns), 1)
    unit, name = (3600.0, "h") if seconds[-1] >= 7200.0 else (60.0, "min") if seconds[-1] >= 120.0 else (1.0, "s")
    with styled():
        figure = Figure(figsize=(2.3 * columns, 1.6 * rows + 0.6), layout="constrained", dpi=DPI)
        panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True)).ravel()
        for axes, (label, values) in zip(panels, figures.items(), strict=False):
            y = np.asarray(values, np.float64)
            has = np.isfinite(y)
            loss = label.startswith("loss_")
            axes.plot(np.asarray(seconds)[has] / unit, y[has], color=QUIET if loss else BEST, lw=1.4, marker=".", ms=3)
            if loss and has.any() and (y[has] > 0.0).all():
                axes.set_yscale("log")
            axes.set_title(label.replace("_", " "), fontsize=8.5)
            axes.tick_params(labelsize=7.5)
            axes.grid(axis="y")
        for axes in panels[len(figures) :]:
            axes.set_visible(False)
        for axes in panels[max(len(figures) - columns, 0) : len(figures)]:
            axes.tick_params(labelbottom=True)  # the lowest of its column, which need not be in the last row
        figure.supxlabel(f"time spent on training [{name}], {bodies[-1]:.0f} bodies in all",
                         fontsize=9.0)  # fmt: skip
        return png(figure)


def score_bars(scores: Mapping[str, float | None]) -> bytes:
    """The five scores of one design; what it did not reach is left open."""
    with styled():
        axes, figure = panel(6.4, 2.0)
        place = np.arange(len(scores))[::-1]
        for y, value in zip(place, scores.values(), strict=True):
            axes.barh(y, 1.0, 0.6, color="#f1f3f5")
            axes.barh(y, value or 0.0, 0.6, color=BEST)
            axes.text(1.015, y, "not reached" if value is None else f"{value:.2f}", va="center")
        axes.set_yticks(place, list(scores))
        axes.set_xlim(0, 1)
        axes.spines[["left", "bottom"]].set_visible(False)
        axes.tick_params(length=0)
        axes.set_xticks([])
        return png(figure)


def _scatter(axes: Axes, points: NDArray[np.float64], lda: FailureLda) -> None:
    flat = len(lda.classes) == 2  # then there is one discriminant; heights only keep points apart.
    for k, (name, size) in enumerate(zip(lda.classes, lda.sizes, strict=True)):
        mine = lda.labels == k
        x, y = points[mine, 0], points[mine, 1]
        if flat:
            y = k + 0.5 * np.modf(np.arange(mine.sum()) * 0.618034)[0]
        axes.plot(x, y, MARKERS[name], color=COLOURS[name], ms=3.6, alpha=0.75, mew=0, ls="", label=f"{name} ({size})")
    axes.set_xlabel("LD1")
    axes.set_ylabel("" if flat else "LD2")
    axes.set_xticks([])
    axes.set_yticks([])


def _same_limits(panels: Sequence[Axes]) -> None:
    """One scale for both maps: that held-out points lie closer together is the message."""
    for read, write in (("get_xlim", "set_xlim"), ("get_ylim", "set_ylim")):
        low, high = zip(*(getattr(axes, read)() for axes in panels), strict=True)
        for axes in panels:
            getattr(axes, write)(min(low), max(high))


def styled() -> AbstractContextManager[None]:
    """Within it, figures are made in the style of the reports."""
    return mpl.rc_context(_STYLE)


def panel(width: float, height: float) -> tuple[Axes, Figure]:
    """A figure of one panel, in inches."""
    figure = Figure(figsize=(width, height), layout="constrained", dpi=DPI)
    return figure.subplots(), figure


def panels(width: float, height: float, rows: int, columns: int, **options: Any) -> tuple[NDArray[Any], Figure]:
    """A figure of many panels, in inches: axes (rows, columns)."""
    figure = Figure(figsize=(width, height), layout="constrained", dpi=DPI)
    return figure.subplots(rows, columns, squeeze=False, **options), figure


def png(figure: Figure) -> bytes:
    """The bytes of a figure's file, the same for the same figure."""
    data = io.BytesIO()
    figure.savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()
