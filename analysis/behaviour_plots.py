"""Figures about how a robot moves: what touches the ground when, what the motors give, how the joints swing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.plots import BEST, INK, QUIET, RULE, panel, panels, png, styled

Array = NDArray[np.float64]

BEYOND = "#d1495b"  # what a motor could not do for long
COLUMNS = 4
POINTS = 2000  # most that one panel scatters


def gait_diagram(links: Sequence[str], touching: NDArray[np.bool_], period: float, start: float = 0.0) -> bytes:
    """A row per link with bars while it touches the ground, and the share of the time that it does.

    Args:
        links: their names, the first on top.
        touching: at each control step, (k, links).
        period: of the control [s].
        start: time of the first step [s].
    """
    k = len(touching)
    with styled():
        axes, figure = panel(7.6, 0.34 * len(links) + 0.8)
        for row in range(len(links)):
            y = len(links) - 1 - row
            edges = np.flatnonzero(np.diff(np.concatenate([[False], touching[:, row], [False]]).astype(int)))
            bars = [(start + period * a, period * (b - a)) for a, b in edges.reshape(-1, 2)]
            axes.barh(y, k * period, 0.56, left=start, color="#f1f3f5")
            axes.broken_barh(bars, (y - 0.28, 0.56), color=BEST if row else QUIET)
            axes.text(start + k * period * 1.012, y, f"{touching[:, row].mean():.0%}", va="center", color=INK)
        axes.set_yticks(np.arange(len(links))[::-1], list(links))
        axes.set_ylim(-0.6, len(links) - 0.4)
        axes.set_xlim(start, start + k * period)
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("time [s]", loc="right")
        return png(figure)


def torque_speed(
    joints: Sequence[str], torque: Array, speed: Array, peak: Array, stall: Array, no_load: Array, continuous: Array,
    rms: Array,
) -> bytes:  # fmt: skip
    """Torque against speed of each joint, within what its motor can give and what it bears for long.

    Args:
        joints: their names, n.
        torque: at control steps [N.m], (k, n).
        speed: at the same [rad/s], (k, n).
        peak: greatest torque of each motor [N.m], (n,).
        stall: where its torque-speed line meets standstill [N.m], (n,).
        no_load: speed without torque [rad/s], (n,).
        continuous: torque that it bears for long [N.m], (n,).
        rms: root mean square of the torque [N.m], (n,).
    """
    columns = min(COLUMNS, len(joints))
    rows = -(-len(joints) // columns)
    some = np.linspace(0, len(torque) - 1, min(len(torque), POINTS)).round().astype(int)
    with styled():
        grid, figure = panels(1.9 * max(columns, 2), 1.75 * rows + 0.75, rows, columns, sharex=True, sharey=True)
        for j, axes in enumerate(grid.flat):
            if j >= len(joints):
                axes.set_visible(False)
                continue
            w = np.linspace(-no_load[j], no_load[j], 201)
            top = np.clip(stall[j] * (1 - w / no_load[j]), 0, peak[j])
            axes.fill_between(w, -top[::-1], top, color="#f1f3f5", lw=0)
            axes.plot(w, top, color=QUIET, lw=0.9)
            axes.plot(w, -top[::-1], color=QUIET, lw=0.9, label="what the motor can give")
            for side in (-1, 1):
                axes.axhline(side * continuous[j], color=INK, lw=0.8, ls=(0, (4, 3)),
                             label="what it bears for long, rms" if side > 0 else None)  # fmt: skip
            over = rms[j] > continuous[j]
            axes.plot(speed[some, j], torque[some, j], ".", ms=2.4, mew=0, alpha=0.6, color=BEYOND if over else BEST)
            axes.set_title(f"{joints[j]}: {rms[j]:.1f} N.m rms", fontsize=8.5, color=BEYOND if over else INK)
            axes.tick_params(labelsize=7.5)
        for j in range(len(joints)):
            if j + columns >= len(joints):
                grid.flat[j].tick_params(labelbottom=True)
        handles, labels = grid.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=2)
        figure.supxlabel("speed [rad/s]", fontsize=9.0)
        figure.supylabel("torque [N.m]", fontsize=9.0)
        return png(figure)


def joint_traces(joints: Sequence[str], angle: Array, bounds: Array, period: float, start: float = 0.0) -> bytes:
    """The angle of each joint over time within its range.

    Args:
        joints: their names, n.
        angle: at control steps [rad], (k, n).
        bounds: least and greatest angle of each joint [rad], (n, 2).
        period: of the control [s].
        start: time of the first step [s].
    """
    columns = min(2, len(joints))
    rows = -(-len(joints) // columns)
    time = start + period * np.arange(len(angle))
    with styled():
        grid, figure = panels(7.6, 1.05 * rows + 0.45, rows, columns, sharex=True)
        for j, axes in enumerate(grid.flat):
            if j >= len(joints):
                axes.set_visible(False)
                continue
            low, high = bounds[j]
            spare = 0.06 * (high - low)
            axes.axhspan(low, high, color="#f1f3f5", lw=0)
            axes.plot(time, angle[:, j], color=BEST, lw=1.2)
            axes.set_ylim(low - spare, high + spare)
            axes.set_xlim(time[0], time[-1])
            axes.set_title(f"{joints[j]} [rad]", fontsize=8.5)
            axes.tick_params(labelsize=7.5)
            if j + columns >= len(joints):
                axes.tick_params(labelbottom=True)
        figure.supxlabel("time [s]", fontsize=9.0)
        return png(figure)


def path_from_above(xy: Array, heading: float | None, period: float) -> bytes:
    """The way of the centre of mass over the floor, a dot every second; an arrow for the best heading at the start.

    Args:
        xy: at control steps [m], (k, 2).
        heading: direction in which the body went best [rad], None for no arrow.
        period: of the control [s].
    """
    xy = xy - xy[0]
    reach = max(float(np.ptp(xy, axis=0).max()), 0.05)
    wide, high = (max(float(np.ptp(axis)), 0.25 * reach) for axis in xy.T)
    with styled():
        axes, figure = panel(5.2, min(5.2 * high / wide, 4.2) + 0.7)
        axes.plot(*xy.T, color=BEST, lw=1.4)
        every = round(1.0 / period)
        axes.plot(*xy[::every].T, ".", color=BEST, ms=5)
        axes.plot(0.0, 0.0, "o", color="white", mec=INK, ms=6)
        if heading is not None:
            axes.annotate(
                "", xy=(0.16 * reach * np.cos(heading), 0.16 * reach * np.sin(heading)), xytext=(0.0, 0.0),
                arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.2},
            )  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(color=RULE)
        axes.set_xlabel("x [m]", loc="right")
        axes.set_ylabel("y [m]", loc="top")
        return png(figure)
