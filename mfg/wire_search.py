"""Solver: cables through the inside of the bones, bent no sharper than they may be, with slack at every joint."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, WireRun
from mfg.elastic_band import nearest_of, relaxed
from mfg.miss import Miss
from mfg.outcome import Failure, Reason, Stage
from mfg.route_field import Margins, Obstacles, RouteField
from mfg.route_graph import RouteGraph, Way
from mfg.scores import cable_score
from mfg.wire_bottleneck import bottleneck, nearest, where
from mfg.wire_slack import crossings
from mfg.wires import WireSolver, curvature, resampled

Array = NDArray[np.float64]
SHORT = 6e-4  # by how much a tunnel may come closer than it should, which leaves half of the gap [m]
DENSE = 0.003  # between points that stand for a tunnel where others keep away from it [m]
CHORD = 0.005  # on which the curvature of a cable of about that thickness is checked [m]


@dataclass(frozen=True)
class SearchWireSolver:
    """Route every cable in 3-D: deep in the bones where it can, past the joints outside them, and never too bent.

    The free room is a field on the lattice of the bones. From the controller a shortest path goes to every motor, at a
    cost of 1 + 60 / d^1.5 per metre at d millimetres from the nearest surface, so it keeps to the middle. From one
    bone to the next it passes in the room around their joint only. The path is then relaxed like an elastic band, with
    straight ends, and counts if the band keeps clear of everything and its bends are no sharper than the cable allows;
    else other mouths are tried, then the motors in the other order, then with less wall. Last comes the paper's way
    along the surface. Each crossing of a joint gets the slack that the worse end of its range needs.

    Attributes:
        clearance: gap between cable and tunnel wall [m].
        gap: least wall between a tunnel and a mount, box, insertion shaft or other tunnel [m].
        wall: least wall between a tunnel and the surface of its bone, outside of joints [m].
        approach: straight stretch of a tunnel at the controller and at the motor, so that a plug goes in [m].
        reserve: slack at a crossing beyond what the joint's range needs [m].
        step: between points of a path [m].
        schedules: weights of bending [steps^4] and rounds at each that a band is relaxed with, tried in order.
        tries: how many pairs of mouths are tried for one cable.
        max_length: longest cable that is worth pulling [m].
        surface: whether the way along the surface counts where there is none inside.
    """

    clearance: float = 0.0005
    gap: float = 0.0012
    wall: float = 0.0012
    approach: float = 0.008
    reserve: float = 0.005
    step: float = 0.004
    schedules: tuple[tuple[tuple[float, int], ...], ...] = (((40.0, 15),), ((640.0, 8), (160.0, 8), (40.0, 8)))
    tries: int = 12
    max_length: float = 1.5
    surface: bool = True

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `wires` and the cable score, or a wire failure that names the tightest place."""
        radius = blueprint.catalogue.wire.diameter / 2 + self.clearance
        controller = blueprint.box("controller").T_design_box[:3, 3]
        away = [float(np.linalg.norm(seat.T_design_motor[:3, 3] - controller)) for seat in blueprint.seats]
        farthest = sorted(range(len(away)), key=lambda k: (-away[k], k))
        strict = Margins(radius, self.gap, self.wall)
        open_wall = replace(strict, wall=-radius)
        attempts = (
            (strict, farthest),
            (strict, farthest[::-1]),
            (open_wall, farthest),
            (replace(open_wall, shafts=False), farthest),
        )
        failure: Failure | None = None
        graphs: dict[Margins, RouteGraph] = {}
        for margins, order in attempts:
            if margins not in graphs:
                graphs[margins] = RouteGraph(blueprint, RouteField.of(blueprint, margins), margins, self.approach)
            answer = self._routed(blueprint, graphs[margins], order)
            if not isinstance(answer, Failure):
                return self._finished(blueprint, answer, _compromises(answer, blueprint, margins, graphs[strict]))
            failure = failure or answer
        assert failure is not None
        if self.surface:
            along = WireSolver(clearance=self.clearance, max_length=self.max_length).solve(blueprint)
            if isinstance(along, Blueprint):
                return self._on_surface(blueprint, along, failure)
        return failure

    def _on_surface(self, blueprint: Blueprint, along: Blueprint, failure: Failure) -> Blueprint:
        """What the paper's solver found, with slack where it crosses joints as it should."""
        notes = [*along.notes[len(blueprint.notes) :], f"cables run along the surface: {failure.detail}"]
        runs = []
        for run in along.wires:
            held = self._with_slack(blueprint, run)
            if isinstance(held, Failure):
                notes.append(f"{run.name} has no slack: {held.detail}")
            runs.append(run if isinstance(held, Failure) else held)
        return self._finished(blueprint, runs, notes)

    def _finished(self, blueprint: Blueprint, runs: list[WireRun], notes: list[str]) -> Blueprint:
        length = sum(run.length for run in runs)
        sharpest = max((curvature(run.path) for run in runs), default=0.0)
        routed = replace(blueprint, wires=tuple(runs), notes=(*blueprint.notes, *notes))
        return routed.scored(cable=cable_score(length, sharpest, blueprint.catalogue))

    def _with_slack(self, blueprint: Blueprint, run: WireRun) -> WireRun | Failure:
        found = crossings(blueprint, run.seat, resampled(run.path, 0.002), self.reserve)
        return found if isinstance(found, Failure) else replace(run, crossings=found)

    def _routed(self, blueprint: Blueprint, graph: RouteGraph, order: list[int]) -> list[WireRun] | Failure:
        """Serve the seats in this order, every tunnel clear of all hardware and of the tunnels before it."""
        runs: dict[int, WireRun] = {}
        for k in order:
            run = self._served(blueprint, graph, k, [run.path for run in runs.values()])
            if isinstance(run, Failure):
                return run
            runs[k] = run
        return [runs[k] for k in range(len(order))]

    def _served(self, blueprint: Blueprint, graph: RouteGraph, k: int, earlier: list[Array]) -> WireRun | Failure:
        name = f"wire_{blueprint.hinges[blueprint.seats[k].hinge].body}"
        radius, gap = graph.margins.radius, graph.margins.gap
        taken = [resampled(path, DENSE) for path in earlier]
        no_start: set[int] = set()
        no_end: set[int] = set()
        tree = None
        near = graph.taken(k, taken, 2 * radius + gap + SHORT)
        closest: Failure | None = None
        for _ in range(self.tries):
            if tree is None:
                tree = graph.tree(k, near, no_end)
            way = None if tree is None else graph.way(k, tree, near, no_start)
            if way is None:
                break
            path = self._relaxed(blueprint, graph, way, earlier)
            if isinstance(path, _Fault):
                closest = closest or self._fault(blueprint, name, path)
                if path.late:
                    no_end.add(way.end)
                    tree = None
                else:
                    no_start.add(way.start)
                continue
            run = self._with_slack(blueprint, WireRun(name, k, path, radius))
            if isinstance(run, WireRun) and run.length > self.max_length:
                detail = f"{name} would be {run.length:.2f} m long, at most {self.max_length:.2f} m is allowed"
                miss = Miss("length of a cable", "m", run.length, self.max_length, (blueprint.seats[k].hinge,))
                return Failure(Stage.WIRE, Reason.NO_ROUTE, detail, miss)
            return run
        return closest or bottleneck(blueprint, graph.field, graph.margins, k, name, taken)

    def _relaxed(self, blueprint: Blueprint, graph: RouteGraph, way: Way, earlier: list[Array]) -> Array | _Fault:
        """The band along a way, after the first schedule after which it is clear and not too bent, or what is wrong."""
        radius, gap = graph.margins.radius, graph.margins.gap
        limit = 1 / blueprint.catalogue.wire.bend_radius
        others = np.concatenate([resampled(path, DENSE) for path in earlier]) if earlier else np.zeros((0, 3))
        faults = []
        for schedule in self.schedules:
            path = relaxed(way.points, graph.field, others, 2 * radius + gap + SHORT, self.step, schedule)
            fine = resampled(path, 0.002)
            along = np.linspace(0, 1, len(fine))
            bend = bends(fine)
            worst = int(bend.argmax())
            if bend[worst] > limit:
                faults.append(_Fault("bend", float(1 / bend[worst]), fine[worst], along[worst] > 0.5))
                continue
            short = self._short(graph, way, fine, earlier)
            tight = int(short.argmax())
            if short[tight] > SHORT:
                faults.append(_Fault("room", float(short[tight]), fine[tight], along[tight] > 0.5))
                continue
            return path
        return faults[0]

    def _short(self, graph: RouteGraph, way: Way, fine: Array, earlier: list[Array]) -> Array:
        """By how much each point of a path comes too near to something, approaches apart [m]."""
        margins = graph.margins
        free = slice(_inside(fine, way.points[1]), len(fine) - _inside(fine[::-1], way.points[-2]))
        short = np.zeros(len(fine))
        exact = margins.radius + margins.gap - graph.obstacles.distance(fine[free]).min(axis=0)
        short[free] = np.maximum(exact, -graph.field.clearance.sample(fine[free]))
        if earlier:
            away = nearest_of(fine, np.concatenate([resampled(path, 0.002) for path in earlier]))[0]
            short = np.maximum(short, 2 * margins.radius + margins.gap - away)
        return short

    def _fault(self, blueprint: Blueprint, name: str, fault: _Fault) -> Failure:
        place, (joint, body) = where(blueprint, fault.point), nearest(blueprint, fault.point)
        if fault.kind == "bend":
            least = blueprint.catalogue.wire.bend_radius
            return Failure(
                Stage.WIRE,
                Reason.SHARP_BEND,
                f"{name} would bend to a radius of {1e3 * fault.size:.0f} mm {place}, at least {1e3 * least:.0f} mm is "
                f"needed; more bone there or a cable that bends to {1e3 * fault.size:.0f} mm would mend it",
                Miss("radius of a bend", "m", fault.size, least, (joint,), (body,)),
            )
        return Failure(
            Stage.WIRE,
            Reason.NO_ROUTE,
            f"{name} comes {1e3 * fault.size:.1f} mm too near to something {place}; {1e3 * fault.size:.0f} mm more "
            "bone there would mend it",
            Miss("room for a cable", "m", -fault.size, 0.0, (joint,), (body,), fault.size),
        )


@dataclass(frozen=True, eq=False, slots=True)
class _Fault:
    """What is wrong with a path: a bend's radius or how much room is missing [m], where, and in which half."""

    kind: str
    size: float
    point: Array
    late: bool


def _compromises(runs: list[WireRun], blueprint: Blueprint, margins: Margins, strict: RouteGraph) -> list[str]:
    """Notes on the cables that keep less to themselves than they should."""
    if margins == strict.margins:
        return []
    notes = []
    shafts = Obstacles.of(blueprint, shafts=True)
    for run in runs:
        fine = resampled(run.path, 0.002)[5:-8]
        short = -strict.field.clearance.sample(fine) > 2 * SHORT
        if not margins.shafts and (shafts.distance(fine)[-len(blueprint.boxes) :] < run.radius).any():
            notes.append(f"{run.name} crosses an insertion shaft: lay it after the boxes are in")
        elif short.any():
            notes.append(f"{run.name} lies open in the surface of a bone, or nearly, along {2 * int(short.sum())} mm")
    return notes


def bends(path: Array, chord: float = CHORD) -> Array:
    """Curvature at every point of an evenly spaced path (n, 3), zero within a chord of its ends [1/m]."""
    spacing = float(np.linalg.norm(path[1] - path[0]))
    c = max(1, round(chord / spacing))
    found = np.zeros(len(path))
    if len(path) > 2 * c:
        a, b = path[c:-c] - path[: -2 * c], path[2 * c :] - path[c:-c]
        lengths = np.prod([np.linalg.norm(v, axis=1) for v in (a, b, a + b)], axis=0)
        found[c:-c] = 2 * np.linalg.norm(np.cross(a, b), axis=1) / np.maximum(lengths, 1e-12)
    return found


def _inside(fine: Array, outer: Array) -> int:
    """How many points of a path lie before the end of its straight approach."""
    start = fine[0]
    length = float(np.linalg.norm(outer - start))
    travelled = itertools.accumulate(np.linalg.norm(np.diff(fine, axis=0), axis=1), initial=0.0)
    return sum(1 for _ in itertools.takewhile(lambda s: s < length, travelled))
