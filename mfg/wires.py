"""Solver: one cable tunnel from the controller to every motor, along the bones (paper: wire solver node)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mfg.blueprint import Blueprint, WireRun
from mfg.miss import Miss
from mfg.outcome import Failure, Reason, Stage
from mfg.routing import Hardware, Net
from mfg.scores import cable_score

Array = NDArray[np.float64]
SAG = 2.5e-4  # how much nearer to a sharp edge a chord may pass than its ends [m]
CHORD = 0.010  # scale on which the curvature of a cable is measured [m]


@dataclass(frozen=True)
class WireSolver:
    """Route every cable by geodesics on the surface of the merged bones and mounts, then smooth it.

    Reference points are set off from the faces of the controller and from the side of each motor's housing where its
    holder's bone covers it; each snaps to the nearest surface vertex that a straight tunnel reaches past all hardware.
    Between them a shortest path follows mesh edges, a moving average smooths it, and points that came too near to
    hardware are pushed out again. The farthest motor is served first, or last where that fails; later cables keep clear
    of earlier ones, and of the insertion shafts where they can: a note says where they cannot.

    Attributes:
        clearance: gap between cable and tunnel wall [m].
        gap: least wall between a tunnel and a motor or box that it does not serve, and between two tunnels [m].
        stride: the surface is meshed on every stride-th sample of the fields.
        bridge: parts of the surface that do not touch are linked across gaps up to this [m].
        step: between points of a path [m].
        window: length of the moving average [m].
        max_length: longest cable that is worth pulling [m].
        max_turn: most that a tunnel may turn within two chords of its curvature, (assumed) from pulling cable through
            printed tunnels: a right angle passes, a hairpin does not [rad].
    """

    clearance: float = 0.0005
    gap: float = 0.001
    stride: int = 2
    bridge: float = 0.030
    step: float = 0.004
    window: float = 0.032
    max_length: float = 1.5
    max_turn: float = 2.2

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `wires` and the cable score, or a wire failure."""
        radius = blueprint.catalogue.wire.diameter / 2 + self.clearance
        hardware = Hardware.of(blueprint)
        net = Net(blueprint, hardware, radius, self.gap, self.stride, self.bridge)
        controller = blueprint.box("controller").T_design_box[:3, 3]
        away = [float(np.linalg.norm(seat.T_design_motor[:3, 3] - controller)) for seat in blueprint.seats]
        farthest = sorted(range(len(away)), key=lambda k: (-away[k], k))
        answer = self._routed(blueprint, net, hardware, radius, farthest)
        if isinstance(answer, Failure):
            # Whoever comes first takes the best way; the other order leaves the far cables what the near ones spare.
            answer = self._routed(blueprint, net, hardware, radius, farthest[::-1])
        if isinstance(answer, Failure):
            return answer
        runs, notes = answer
        wires = tuple(runs[k] for k in range(len(away)))
        length = sum(run.length for run in wires)
        sharpest = max((curvature(run.path) for run in wires), default=0.0)
        routed = replace(blueprint, wires=wires, notes=(*blueprint.notes, *notes))
        return routed.scored(cable=cable_score(length, sharpest, blueprint.catalogue))

    def _routed(
        self, blueprint: Blueprint, net: Net, hardware: Hardware, radius: float, order: list[int]
    ) -> tuple[dict[int, WireRun], list[str]] | Failure:
        """Serve the seats in this order, every tunnel clear of all hardware and of the tunnels before it."""
        runs: dict[int, WireRun] = {}
        notes = []
        for k in order:
            joint = (blueprint.seats[k].hinge,)
            name = f"wire_{blueprint.hinges[joint[0]].body}"
            earlier = [run.path for run in runs.values()]
            found = net.route(k, earlier)
            if found is None:
                detail = f"no free way along the bones to the motor of {name}"
                return Failure(Stage.WIRE, Reason.NO_ROUTE, detail, Miss("room for a cable", "m", joints=joint))
            rough, compromise = found
            path = self._smooth(rough, hardware, k, radius, earlier)
            if path is None:
                detail = f"{name} cannot be kept clear of motors, boxes and cables"
                return Failure(Stage.WIRE, Reason.NO_ROUTE, detail, Miss("room for a cable", "m", joints=joint))
            # Two chords that turn by q have the curvature 2 sin(q / 2) / chord.
            turn = 2 * math.asin(min(1.0, curvature(path) * CHORD / 2))
            if turn > self.max_turn:
                return Failure(
                    Stage.WIRE,
                    Reason.SHARP_BEND,
                    f"{name} would turn by {math.degrees(turn):.0f} degrees within {2e3 * CHORD:.0f} mm, at most "
                    f"{math.degrees(self.max_turn):.0f} degrees can a cable be pushed around",
                    Miss("turn of a cable", "rad", turn, self.max_turn, joint),
                )
            runs[k] = WireRun(name, k, path, radius)
            if runs[k].length > self.max_length:
                return Failure(
                    Stage.WIRE,
                    Reason.NO_ROUTE,
                    f"{name} would be {runs[k].length:.2f} m long, at most {self.max_length:.2f} m is allowed",
                    Miss("length of a cable", "m", runs[k].length, self.max_length, joint),
                )
            if compromise:
                notes.append(f"{name} {compromise}")
        return runs, notes

    def _smooth(self, path: Array, hardware: Hardware, seat: int, radius: float, earlier: list[Array]) -> Array | None:
        """Moving average over evenly spaced points, ends fixed, then pushed out of whatever it came too near to.

        Where a wide average would cut through hardware or an earlier tunnel, a narrower one is taken.

        Returns:
            The path, or None where none keeps clear.
        """
        taken = cKDTree(np.concatenate([resampled(other, 0.001) for other in earlier])) if earlier else None
        apart = 2 * radius + self.gap
        need = hardware.needs(seat, radius, self.gap)[:, None]
        least = hardware.needs(seat, radius, 0.0)[:, None] - SAG
        rough = resampled(path, self.step)
        span = max(1, round(self.window / self.step / 2))
        while span > 0:
            path = moving_average(moving_average(rough, span), span)
            for _ in range(12):
                if taken is not None:
                    away, nearest = (np.asarray(a) for a in taken.query(path[1:-1]))
                    outward = (path[1:-1] - np.asarray(taken.data)[nearest]) / np.maximum(away, 1e-6)[:, None]
                    path[1:-1] += np.maximum(apart - away, 0.0)[:, None] * outward
                short = need + SAG - hardware.distance(path[1:-1])
                worst = short.argmax(axis=0)
                low = np.flatnonzero(short.max(axis=0) > 1e-5)
                if not len(low):
                    break
                which, points = worst[low], path[1:-1][low]
                path[1 + low] += short[which, low][:, None] * hardware.outward(points, which)
            fine = resampled(path, 0.001)[1:-1]
            alone = taken is None or bool((np.asarray(taken.query(fine)[0]) >= 2 * radius).all())
            if alone and (hardware.distance(fine) >= least).all():
                return path
            span //= 2
        return None


def resampled(path: Array, step: float) -> Array:
    """Points evenly spaced along a polyline (k, 3), about `step` apart, ends kept."""
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, travelled[-1], max(3, math.ceil(travelled[-1] / step) + 1))
    return np.stack([np.interp(at, travelled, path[:, a]) for a in range(3)], axis=-1)


def moving_average(path: Array, span: int) -> Array:
    """Mean over up to `span` points on either side, fewer near the ends, which stay where they are."""
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(path, axis=0)])
    index = np.arange(len(path))
    reach = np.minimum(span, np.minimum(index, len(path) - 1 - index))
    return (total[index + reach + 1] - total[index - reach]) / (2 * reach + 1)[:, None]


def curvature(path: Array, chord: float = CHORD) -> float:
    """Greatest curvature of a polyline on the scale of `chord` [1/m].

    The polyline is resampled evenly; the curvature at a point is that of the circle through it and the points one
    chord before and after: kappa = 2 |a x b| / (|a| |b| |a + b|) with a, b the two steps.
    """
    points = resampled(path, chord / 4)
    a, b = points[4:-4] - points[:-8], points[8:] - points[4:-4]
    if not len(a):
        return 0.0
    lengths = [np.linalg.norm(v, axis=1) for v in (a, b, a + b)]
    twice_area = np.linalg.norm(np.cross(a, b), axis=1)
    return float((2 * twice_area / np.maximum(np.prod(lengths, axis=0), 1e-12)).max())
