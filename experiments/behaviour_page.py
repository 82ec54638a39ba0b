"""The report of one policy on one robot: figures, gait, motors against their limits, and how it looks, on one page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim.behaviour import MotorLimits, MotorUse
    from sim.model import Model
    from sim.rollout import Behaviour, Rollouts

FILE = "behaviour.html"  # in a folder
SHOWN = 5.0  # of the end of the episode in the diagrams over time [s]
MOMENTS = 6


def page_path(path: Path) -> Path:
    """The file of a report that was asked for as a file that ends in .html, or as a folder."""
    return path if path.suffix.lower() == ".html" else path / FILE


def write_behaviour_page(
    path: Path,
    model: Model,
    rollouts: Rollouts,
    behaviour: Behaviour,
    *,
    title: str,
    facts: Sequence[tuple[str, str]] = (),
    film: Path | None = None,
) -> Path:
    """Write the report of the first of some rollouts, which did not fail.

    Args:
        path: a file that ends in .html, or a folder, which is made.
        model: of the robot.
        rollouts: what it did.
        behaviour: what `measure` says of it.
        title: of the page.
        facts: what the page says of robot and policy, by name.
        film: MP4 to put into the page.

    Returns:
        The file.

    Raises:
        OSError: if it cannot be written.
    """
    from analysis import page
    from sim.behaviour import motor_limits, motor_uses, motor_warnings

    path = page_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    limits, uses = motor_limits(model), motor_uses(model, rollouts)
    parts = [
        f"<h1>{escape(title)}</h1>",
        page.paragraph("What a policy makes of a robot in simulation, and whether its motors could do it.", "lead"),
        _verdict(behaviour, motor_warnings(limits, uses)),
        page.tiles(_headline(behaviour, uses)),
        page.section("How it looks", page.picture(_strip(model, rollouts), "Moments from the start to the end."),
                     page.film(None if film is None else film.read_bytes(), "The episode in real time."),
                     *_path(rollouts, behaviour)),
        page.section("Gait", *_gait(model, rollouts)),
        page.section("Motors", *_motors(rollouts, limits, uses)),
        page.section("Joints", *_joints(model, rollouts)),
        page.section("About this page", page.table((), [(escape(k), escape(v)) for k, v in facts])) if facts else "",
    ]  # fmt: skip
    path.write_text(page.document(title, parts), encoding="utf-8")
    return path


def _verdict(behaviour: Behaviour, cannot: Sequence[str]) -> str:
    from analysis import page

    after = behaviour.upright * behaviour.seconds
    fell = (
        page.paragraph(f"It fell after {after:.1f} s of {behaviour.seconds:.0f} s.", "note") if behaviour.fell else ""
    )
    if not cannot:
        return fell + page.paragraph("The motors can do all that was asked of them, and for long.", "quiet")
    rows = "".join(f"<li>{escape(line)}</li>" for line in cannot)
    return f'{fell}<div class="note"><b>The real motors could not do this.</b><ul>{rows}</ul></div>'


def _headline(behaviour: Behaviour, uses: Sequence[MotorUse]) -> list[tuple[str, str, str]]:
    hot = max(uses, key=lambda use: use.rms_share)
    strong = max(uses, key=lambda use: use.peak_share)
    cost = behaviour.cost_of_transport
    return [
        (f"{behaviour.speed:.2f}", "m/s", "along its best heading"),
        (f"{behaviour.speed / behaviour.body_length:.2f}", "/s", f"body lengths of {behaviour.body_length:.2f} m"),
        (f"{behaviour.distance:.2f}", "m", f"from start to end in {behaviour.seconds:.0f} s"),
        ("–" if cost is None else f"{cost:.2f}", "", "cost of transport: work per weight and metre"),
        (f"{100 * hot.rms_share:.0f}", "%", f"of what a motor bears for long, at {hot.joint}"),
        (f"{100 * strong.peak_share:.0f}", "%", f"of a motor's peak torque, at {strong.joint}"),
    ]


def _strip(model: Model, rollouts: Rollouts) -> bytes:
    import io

    from PIL import Image

    from sim.video import strip

    data = io.BytesIO()
    Image.fromarray(strip(model, rollouts, count=MOMENTS)).save(data, format="png", optimize=True)
    return data.getvalue()


def _path(rollouts: Rollouts, behaviour: Behaviour) -> list[str]:
    from analysis import behaviour_plots as plots
    from analysis import page
    from sim.rollout import CONTROL_PERIOD

    moves = behaviour.distance > 0.05 * behaviour.body_length
    figure = plots.path_from_above(rollouts.com[0, :, :2], behaviour.heading if moves else None, CONTROL_PERIOD)
    caption = (
        "The way of the centre of mass from above, a dot every second; the ring is the start, the arrow the heading of "
        "the body along which the speed is measured."
    )
    return [page.picture(figure, caption, 480)]


def _gait(model: Model, rollouts: Rollouts) -> list[str]:
    from analysis import behaviour_plots as plots
    from analysis import page
    from sim.behaviour import stance
    from sim.rollout import CONTROL_PERIOD

    found, first = stance(model, rollouts), _first(rollouts)
    diagram = plots.gait_diagram(found.links, found.touching[first:], CONTROL_PERIOD, first * CONTROL_PERIOD)
    return [page.picture(diagram, "When each link touches the ground, and for which share of the time shown; "
                                  "the root is grey.")]  # fmt: skip


def _motors(rollouts: Rollouts, limits: Sequence[MotorLimits], uses: Sequence[MotorUse]) -> list[str]:
    import numpy as np

    from analysis import behaviour_plots as plots
    from analysis import page
    from sim.rollout import CONTROL_PERIOD

    def of(name: str) -> Any:
        return np.array([getattr(limit, name) for limit in limits])

    figure = plots.torque_speed(
        [limit.joint for limit in limits], rollouts.torque[0], rollouts.speed[0], of("peak"), of("stall"),
        of("no_load"), of("continuous"), np.array([use.rms_torque for use in uses]),
    )  # fmt: skip
    rows = [
        (escape(u.joint), f"{u.peak_torque:.1f}", f"{u.peak_share:.0%}", f"{u.rms_torque:.1f}", f"{u.rms_share:.0%}",
         f"{u.peak_speed:.1f}", f"{u.speed_share:.0%}", f"{u.at_limit:.0%}") for u in uses
    ]  # fmt: skip
    header = ("joint", "peak [N.m]", "of peak", "rms [N.m]", "of rating", "speed [rad/s]", "of no-load", "at limit")
    power = rollouts.work[0] / (len(rollouts.torque[0]) - 1) / CONTROL_PERIOD
    return [
        page.picture(figure, "Torque against speed at every control step, within what the motor can give (grey); the "
                             "dashed lines are the torque that it bears for long. Red where the rms is beyond them."),
        page.table(header, rows, numbers=range(1, 8)),
        page.paragraph(f"All motors together do {power:.1f} W of mechanical work on average. The rating is the torque "
                       "that a motor bears for long; at its limit it gives all that it can at its speed.", "quiet"),
    ]  # fmt: skip


def _joints(model: Model, rollouts: Rollouts) -> list[str]:
    from analysis import behaviour_plots as plots
    from analysis import page
    from sim.model import drive_of
    from sim.rollout import CONTROL_PERIOD

    drive, first = drive_of(model), _first(rollouts)
    angle = rollouts.qpos[0, first:][:, drive.position]
    figure = plots.joint_traces(drive.names, angle, drive.range, CONTROL_PERIOD, first * CONTROL_PERIOD)
    return [page.picture(figure, "The angle of each joint within its range (grey).")]


def _first(rollouts: Rollouts) -> int:
    """The first step of the diagrams over time: at the end of an episode the gait is at its most ordinary."""
    from sim.rollout import CONTROL_PERIOD

    return max(0, rollouts.qpos.shape[1] - 1 - round(SHOWN / CONTROL_PERIOD))
