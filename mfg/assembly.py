"""The order in which a robot goes together, found by taking it apart: every way in is checked on the solids.

What can be pulled out along a straight line can be pushed in along it, and stays free while other things leave. So
taking out whatever is free, in any order, finds a whole order wherever there is one. What nothing frees is taken out
all the same, and its step says what is in the way.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from mfg.blueprint import Blueprint
from mfg.joining import join_way
from mfg.masses import wire_stretches
from mfg.ways import TOOLS, Leg, Scene, Way, box_way, lid_way, motor_way, tool_room

Kind = Literal["place", "cable", "motor", "body_screws", "join", "output_screws", "box", "lid"]


@dataclass(frozen=True, eq=False, slots=True)
class Step:
    """One thing that a person does.

    Attributes:
        kind: what is done: a printed body is taken to the bench, a cable drawn in, a motor or a box put in, a body
            pushed onto a motor's output, screws driven, a lid put on and screwed down.
        body: index of the body that receives it; of a join, the one that stays.
        index: of the seat (cable, motor, screws, join), box or lid; of the body where one is placed.
        adds: names of all parts that this step brings in, as in `part_names`.
        moved: bodies that move in a join, with everything in them.
        legs: the way in, first leg first; empty where none is checked (place, cable, screws).
        angle: of the joint while it is joined [rad].
        feeds: wires, by index, whose loose ends are drawn on through the next body while it is joined.
        needs: indices of the steps without which this one cannot be done, all earlier.
        room: free height above the screw heads for a tool [m].
        soft: whether soft skin must bend out of the way.
        trouble: why there is no free straight way, empty where there is one.
    """

    kind: Kind
    body: int
    index: int
    adds: tuple[str, ...] = ()
    moved: tuple[int, ...] = ()
    legs: tuple[Leg, ...] = ()
    angle: float = 0.0
    feeds: tuple[int, ...] = ()
    needs: tuple[int, ...] = ()
    room: float = 0.0
    soft: bool = False
    trouble: str = ""


def part_names(blueprint: Blueprint) -> tuple[str, ...]:
    """Everything that an assembly must bring in, each once: printed parts, motors, screws, cables, boxes."""
    hinges = [blueprint.hinges[seat.hinge].name for seat in blueprint.seats]
    return (
        *(part.name for part in blueprint.parts),
        *(f"{lid.part}_screws" for lid in blueprint.lids),
        *(f"{name}_{what}" for name in hinges for what in ("motor", "body_screws", "output_screws")),
        *(wire.name for wire in blueprint.wires),
        *(box.kind for box in blueprint.boxes),
    )


def assembly_steps(blueprint: Blueprint) -> tuple[Step, ...]:
    """The steps by which a built robot is put together, first to last; same blueprint, same steps.

    Raises:
        ValueError: if the blueprint has no printed parts.
    """
    if not blueprint.parts:
        raise ValueError(f"design {blueprint.design.key} has no printed parts yet; build it before it is assembled")
    scene = Scene.of(blueprint)
    bench = _Bench(scene)
    for move in reversed(_taken_apart(scene)):
        bench.undo(move)
    return bench.finished()


@dataclass(frozen=True, eq=False, slots=True)
class _Move:
    """Something that left a group of joined bodies: a box, or the child's side of a joint."""

    kind: Literal["box", "join"]
    index: int
    group: frozenset[int]
    way: Way


def _taken_apart(scene: Scene) -> list[_Move]:
    """Everything that leaves, first to leave first, until all bodies lie apart and are empty but for motors."""
    blueprint, moves = scene.blueprint, []
    groups = [frozenset(range(len(blueprint.bodies)))]
    inside = list(range(len(blueprint.boxes)))
    # The battery is the last to go in and the first to come out.
    inside.sort(key=lambda k: (blueprint.boxes[k].kind != "battery", k))
    while True:
        for index in list(inside):
            group = next(g for g in groups if blueprint.boxes[index].body in g)
            way = box_way(scene, index, group, set(inside) - {index})
            lids = [lid_way(scene, k, group).free for k, lid in enumerate(blueprint.lids) if lid.box == index]
            if (way.free and all(lids)) or len(group) == 1:
                inside.remove(index)
                moves.append(_Move("box", index, group, way))
        edges = [(k, g) for g in groups for k, s in enumerate(blueprint.seats) if {s.holder, s.connector} <= g]
        if not edges:
            return moves
        # Later bodies leave first, so that the robot grows from its root; whole limbs only where no leaf is free.
        edges.sort(key=lambda edge: (len(scene.side(*edge)), -edge[0]))
        moves.append(_split(scene, edges))
        k, group = moves[-1].index, moves[-1].group
        away = scene.side(k, group)
        groups = [g for g in groups if g != group] + [group - away, away]


def _split(scene: Scene, edges: list[tuple[int, frozenset[int]]]) -> _Move:
    """The first joint that comes apart, by simple ways if there is one; else the one that meets least."""
    tried: list[_Move] = []
    for thorough in (False, True):
        for k, group in edges:
            tried.append(_Move("join", k, group, join_way(scene, k, group, thorough=thorough)))
            if tried[-1].way.free and not tried[-1].way.soft:
                return tried[-1]
    return min(tried[len(edges) :], key=lambda move: (not move.way.free, move.way.blocked))


@dataclass(eq=False, slots=True)
class _Bench:
    """The steps so far, and which of them later ones rest on."""

    scene: Scene
    steps: list[Step] = field(default_factory=list)
    made: dict[tuple[Kind, int], int] = field(default_factory=dict)

    def add(self, step: Step, *needs: tuple[Kind, int]) -> None:
        self.made[step.kind, step.index] = len(self.steps)
        self.steps.append(replace(step, needs=tuple(sorted({self.made[n] for n in needs}))))

    def undo(self, move: _Move) -> None:
        """Put back what left."""
        blueprint, way = self.scene.blueprint, move.way
        if move.kind == "box":
            seat = blueprint.boxes[move.index]
            self.prepare(seat.body)
            step = Step("box", seat.body, move.index, (seat.kind,), legs=way.legs, soft=way.soft, trouble=way.trouble)
            needs: list[tuple[Kind, int]] = [("place", seat.body)]
            if seat.kind == "controller":  # Its cables are plugged in just before.
                needs += [("cable", k) for k in range(len(blueprint.wires)) if ("cable", k) in self.made]
                needs += [("join", s.index) for s in self.steps if s.kind == "join" and s.feeds]
            self.add(step, *needs)
            for k, lid in enumerate(blueprint.lids):
                if lid.box == move.index:
                    way, adds = lid_way(self.scene, k, move.group), (lid.part, f"{lid.part}_screws")
                    self.add(Step("lid", seat.body, k, adds, legs=way.legs, soft=way.soft, trouble=way.trouble),
                             ("box", move.index))  # fmt: skip
            return
        k, away = move.index, self.scene.side(move.index, move.group)
        seat_k = blueprint.seats[k]
        stay = move.group - away
        for body in (*sorted(stay), *sorted(away)):
            self.prepare(body)
        feeds = tuple(w for w in range(len(blueprint.wires)) if _crosses(blueprint, w, stay, away))
        name = blueprint.hinges[seat_k.hinge].name
        keeps = seat_k.holder if seat_k.holder in stay else seat_k.connector
        room, by = tool_room(self.scene, k, move.group, output=True)
        self.add(
            Step("join", keeps, k, moved=tuple(sorted(away)), legs=way.legs, angle=way.angle, feeds=feeds,
                 soft=way.soft, trouble=way.trouble),
            ("place", seat_k.holder), ("place", seat_k.connector), ("body_screws", k),
            *(("cable", blueprint.wires[w].seat) for w in feeds),
        )  # fmt: skip
        self.add(Step("output_screws", seat_k.connector, k, (f"{name}_output_screws",), room=room,
                      trouble=_covered(by)), ("join", k))  # fmt: skip

    def prepare(self, body: int) -> None:
        """Lay a body on the bench, if it is not there yet, and fill it with its motors."""
        if ("place", body) in self.made:
            return
        blueprint = self.scene.blueprint
        lids = {lid.part for lid in blueprint.lids}
        here = tuple(p.name for p in blueprint.parts if p.body == body and p.name not in lids)
        self.add(Step("place", body, body, here))
        for k, seat in enumerate(blueprint.seats):
            if seat.holder != body:
                continue
            name = blueprint.hinges[seat.hinge].name
            wires = tuple(wire.name for wire in blueprint.wires if wire.seat == k)
            if wires:
                self.add(Step("cable", body, k, wires), ("place", body))
            way = motor_way(self.scene, k)
            room, by = tool_room(self.scene, k, [body], output=False)
            before: list[tuple[Kind, int]] = [("place", body), *([("cable", k)] if wires else [])]  # type: ignore[list-item]
            self.add(Step("motor", body, k, (f"{name}_motor",), legs=way.legs, soft=way.soft, trouble=way.trouble),
                     *before)  # fmt: skip
            self.add(Step("body_screws", body, k, (f"{name}_body_screws",), room=room,
                          trouble=_covered(by)), ("motor", k))  # fmt: skip

    def finished(self) -> tuple[Step, ...]:
        """All steps; a controller that had to go in before its last cable says so."""
        steps = list(self.steps)
        for at, step in enumerate(steps):
            if step.kind != "box" or self.scene.blueprint.boxes[step.index].kind != "controller":
                continue
            late = [s for s in steps[at:] if s.kind == "cable" or s.feeds]
            if late:
                names = sorted({w for s in late for w in (s.adds if s.kind == "cable" else ())}
                               | {self.scene.blueprint.wires[w].name for s in late for w in s.feeds})  # fmt: skip
                told = f"{', '.join(names)} arrive only later: plug them in first and leave their motor ends loose"
                steps[at] = replace(step, trouble="; ".join(t for t in (step.trouble, told) if t))
        return tuple(steps)


def _covered(by: str) -> str:
    return f"{by} covers the screw heads at less than {1e3 * TOOLS[-1]:.0f} mm" if by else ""


def _crosses(blueprint: Blueprint, wire: int, stay: frozenset[int], away: frozenset[int]) -> bool:
    """Whether a cable that hangs on its motor in one group of bodies runs on into the other."""
    run = blueprint.wires[wire]
    holder = blueprint.seats[run.seat].holder
    bodies = {body for body, _ in wire_stretches(run, blueprint)}
    bodies |= {box.body for box in blueprint.boxes if box.kind == "controller"}
    return (holder in stay and bool(bodies & away)) or (holder in away and bool(bodies & stay))
