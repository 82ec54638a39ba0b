"""The smallest change to a body that lets it be built: tried in order of size, judged by the solvers, told exactly."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from decoder.design import DesignError, Material, VoxelDesign
from decoder.edits import cleft, grown, scaled, without_crumbs
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.pipeline import Outcome
from mfg.skeleton import contacts

ROUNDS = 5  # changes on top of each other
THICKER = (1.0, 2.0, 3.0)  # growth that is tried [voxels]
LARGER = (1.08, 1.16, 1.25, 1.35, 1.5)  # scales that are tried
SMALLER = (0.92, 0.85, 0.75)  # the same where a part does not fit the printer
REACH = 1.6  # radius of a ball about a joint in which bone grows, over that of the motor's mount
STAGES = tuple(Stage)

Judge = Callable[[VoxelDesign], Outcome]


@dataclass(frozen=True, eq=False, slots=True)
class Change:
    """One change to a body.

    Attributes:
        what: in words, with segment, amount and place.
        design: the changed body.
        size: bone that is added or taken away, over the bone that was there.
    """

    what: str
    design: VoxelDesign
    size: float

    def __str__(self) -> str:
        """One line for people."""
        return f"{self.what} ({self.size:+.0%} bone)"


@dataclass(frozen=True, eq=False, slots=True)
class Repair:
    """What came of a repair.

    Attributes:
        outcome: of the changed body, or of the given one where nothing helped.
        changes: what was done, in order; empty where nothing had to be or could be done.
        tried: how many bodies were judged, the given one among them.
    """

    outcome: Outcome
    changes: tuple[Change, ...]
    tried: int

    @property
    def ok(self) -> bool:
        """Whether the body can be built now."""
        return self.outcome.ok


def repaired(start: Outcome, judge: Judge, rounds: int = ROUNDS) -> Repair:
    """Change a body until it can be built, the smallest change first.

    Every round takes the changes that could mend what the judge says, in order of size, and keeps the first that
    passes, or else the one that gets furthest (of several, the smallest); it ends where no change gets any further.

    Args:
        start: what the judge said of the body as it is.
        judge: e.g. `mfg.pipeline.score` by some rules; the answer must depend on the design alone.
        rounds: most changes on top of each other.
    """
    outcome = start
    changes: list[Change] = []
    tried = 1
    for _ in range(rounds):
        failure = outcome.failure
        if failure is None:
            break
        best: tuple[tuple[float, float], Change, Outcome] | None = None
        for change in sorted(candidates(outcome, failure), key=lambda change: change.size):
            found = judge(change.design)
            tried += 1
            rank = (-progress(found), change.size)
            if best is None or rank < best[0]:
                best = (rank, change, found)
            if found.ok:
                break
        if best is None or (not best[2].ok and -best[0][0] < progress(outcome)):
            break
        changes.append(best[1])
        outcome = best[2]
    return Repair(outcome, tuple(changes), tried) if outcome.ok else Repair(start, (), tried)


def progress(outcome: Outcome) -> float:
    """How far a body got: the place of the stage that refused it, a little more for every solver that ran."""
    if outcome.failure is None:
        return float(len(STAGES))
    return float(STAGES.index(outcome.failure.stage)) + min(len(outcome.seconds), 99) / 100


def candidates(outcome: Outcome, failure: Failure) -> Iterator[Change]:
    """Changes that could mend a failure, in no order; those that a design cannot hold are left out."""
    for what, make in _edits(outcome, failure):
        try:
            design = make()
        except DesignError:
            continue  # it would reach the border of the grid, or leave a joint without its bone
        size = _size(outcome.design, design)
        if size > 0.0:
            yield Change(what, design, size)


def _edits(outcome: Outcome, failure: Failure) -> Iterator[tuple[str, Callable[[], VoxelDesign]]]:
    design, blueprint = outcome.design, outcome.blueprint
    for factor in SMALLER if failure.reason is Reason.TOO_LARGE else LARGER:
        yield f"the whole body scaled by {factor:g}", lambda f=factor: scaled(design, f)  # type: ignore[misc]
    if failure.stage is Stage.SKELETON:
        yield from _skeleton_edits(design)
    if blueprint.tree is None or failure.miss is None or failure.reason is Reason.TOO_LARGE:
        return
    segments, miss = blueprint.tree.segments, failure.miss
    called = [f"segment {segment} (body_{index})" for index, segment in enumerate(segments)]
    radius = REACH * mount_of(blueprint.catalogue.motor).envelope_radius
    for hinge in (blueprint.hinges[joint] for joint in miss.joints):
        ends, centre = (hinge.parent, hinge.body), hinge.position
        for body, voxels in itertools.product(ends, THICKER):
            what = f"{called[body]} thicker by {voxels:g} voxel(s) near {hinge.name}"
            yield what, lambda s=segments[body], v=voxels, c=centre: grown(design, s, v, c, radius)  # type: ignore[misc]
        a, b = (segments[body] for body in ends)
        for voxels in THICKER:
            yield (
                f"segments {a} and {b} thicker by {voxels:g} voxel(s) near {hinge.name}",
                lambda v=voxels, c=centre, a=a, b=b: grown(grown(design, a, v, c, radius), b, v, c, radius),  # type: ignore[misc]
            )
    for body, voxels in itertools.product(miss.bodies, THICKER):
        what = f"{called[body]} thicker by {voxels:g} voxel(s) all over"
        yield what, lambda s=segments[body], v=voxels: grown(design, s, v)  # type: ignore[misc]


def _skeleton_edits(design: VoxelDesign) -> Iterator[tuple[str, Callable[[], VoxelDesign]]]:
    yield "only the largest piece of every segment kept", lambda: without_crumbs(design)
    rigid = np.where(design.material == Material.RIGID, design.segment, 0)
    linked = {frozenset((joint.parent, joint.child)) for joint in design.joints}
    touching = sorted(pair for pair in contacts(rigid) if frozenset(pair) not in linked)
    for a, b in touching:
        yield f"segments {a} and {b}, which touch without a joint, parted", lambda a=a, b=b: cleft(design, a, b)  # type: ignore[misc]
    if len(touching) > 1:
        yield "all segments that touch without a joint parted", lambda: _parted(design, touching)
    smallest = min(design.segments, key=lambda s: (int((rigid == s).sum()), s))
    for voxels in THICKER:
        what = f"segment {smallest} thicker by {voxels:g} voxel(s) all over"
        yield what, lambda v=voxels: grown(design, smallest, v)  # type: ignore[misc]


def _parted(design: VoxelDesign, pairs: list[tuple[int, int]]) -> VoxelDesign:
    for a, b in pairs:
        design = cleft(design, a, b)
    return design


def _size(before: VoxelDesign, after: VoxelDesign) -> float:
    """Bone added or taken away, over the bone before; for a body of another scale, by how much it grew or shrank."""
    old, new = (d.material == Material.RIGID for d in (before, after))
    change = float((old != new).sum()) / float(old.sum())
    return change + abs((after.pitch / before.pitch) ** 3 - 1.0)
