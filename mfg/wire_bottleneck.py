"""Why no cable gets through: the widest way there is, and where that is tightest."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from mfg.blueprint import Blueprint
from mfg.fields import Field
from mfg.miss import Miss
from mfg.mounts import mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.route_field import Margins, RouteField
from mfg.route_graph import controller_mouths, motor_mouths

Array = NDArray[np.float64]
SEARCHED = 0.020  # by how much less room than needed the widest way may have at most [m]
ACCURACY = 1e-4  # of that [m]
AHEAD = 0.020  # from where a tunnel opens into a cavity to where a way is looked for [m]


def bottleneck(
    blueprint: Blueprint, field: RouteField, margins: Margins, seat: int, name: str, taken: list[Array]
) -> Failure:
    """Name the tightest place of the widest way from the controller to a motor.

    The widest way maximises the least clearance along it; that is found by halving, on the samples of the lattice.

    Args:
        blueprint: with seats and boxes.
        field: its free room.
        margins: of every tunnel.
        seat: index of the motor.
        name: of the cable.
        taken: earlier tunnels, as points.
    """
    clearance = field.clearance.values.copy()
    if taken:
        others = np.concatenate(taken)
        reach = 2 * margins.radius + margins.gap
        low, high = others.min(axis=0) - reach, others.max(axis=0) + reach
        window = field.clearance.window((low + high) / 2, (high - low) / 2)
        if window is not None:
            points = np.stack(np.broadcast_arrays(*field.clearance.axes(window)), axis=-1).reshape(-1, 3)
            away = np.asarray(cKDTree(others).query(points)[0])
            shape = clearance[window].shape
            clearance[window] = np.minimum(clearance[window], (away - reach).reshape(shape).astype(np.float32))
    start, out = controller_mouths(blueprint.box("controller"), margins)
    sources = _samples(field.clearance, start + AHEAD * out)
    end, out = motor_mouths(blueprint.seats[seat], mount_of(blueprint.catalogue.motor), margins.radius)
    sinks = _samples(field.clearance, end + AHEAD * out)
    low_room, high_room = -SEARCHED, float(min(clearance[tuple(sources.T)].max(), clearance[tuple(sinks.T)].max()))
    need = f"{1e3 * margins.radius:.1f} mm"
    hinge = blueprint.seats[seat].hinge
    joint = blueprint.hinges[hinge].name
    if high_room <= low_room or not _connected(clearance, low_room, sources, sinks):
        return Failure(
            Stage.WIRE,
            Reason.NO_ROUTE,
            f"{name} finds no way from the controller to the motor of {joint}, even with {1e3 * SEARCHED:.0f} mm less "
            "room around it than it needs; bone that joins the two would mend it",
            Miss("room for a cable", "m", joints=(hinge,)),
        )
    while high_room - low_room > ACCURACY:
        middle = (low_room + high_room) / 2
        if _connected(clearance, middle, sources, sinks):
            low_room = middle
        else:
            high_room = middle
    tightest = _tightest(field.clearance.with_values(clearance), low_room, sources, sinks)
    place, (near, body) = where(blueprint, tightest), nearest(blueprint, tightest)
    joints = tuple(sorted({hinge, near}))
    if low_room >= 0:
        return Failure(
            Stage.WIRE,
            Reason.NO_ROUTE,
            f"{name} has a way with {1e3 * low_room:.1f} mm to spare, tightest {place}, but none that it can enter "
            f"straight at the controller and at the motor of {joint}; more bone around these would mend it",
            Miss("room for a cable", "m", joints=joints, bodies=(body,)),
        )
    return Failure(
        Stage.WIRE,
        Reason.NO_ROUTE,
        f"{name} needs a tunnel of radius {need}, the widest way to the motor of {joint} has room for "
        f"{1e3 * (margins.radius + low_room):.1f} mm, {place}; {math.ceil(-1e3 * low_room):d} mm more bone there "
        "would mend it",
        Miss("room for a cable", "m", margins.radius + low_room, margins.radius, joints, (body,), -low_room),
    )


def nearest(blueprint: Blueprint, point: Array) -> tuple[int, int]:
    """The joint nearest to a point, and the body in which it is or that is nearest to it: their indices."""
    away = [float(np.linalg.norm(hinge.position - point)) for hinge in blueprint.hinges]
    depth = [float(body.bone.sample(point[None])[0]) for body in blueprint.bodies]
    return int(np.argmin(away)), int(np.argmax(depth))


def where(blueprint: Blueprint, point: Array) -> str:
    """Say where a point is: in which body, and how far from which joint."""
    near, around = nearest(blueprint, point)
    joint, body = blueprint.hinges[near], blueprint.bodies[around]
    side = "in" if float(body.bone.sample(point[None])[0]) > 0 else "beside"
    return f"{side} {body.name}, {_mm(joint.position - point)} mm from {joint.name}"


def _mm(offset: Array) -> str:
    return f"{1e3 * float(np.linalg.norm(offset)):.0f}"


def _samples(grid: Field, points: Array) -> NDArray[np.int64]:
    """Indices of the nearest samples to points (n, 3), (n, 3)."""
    index = np.round((points - grid.origin) / grid.spacing).astype(np.int64)
    return np.clip(index, 0, np.array(grid.values.shape) - 1)


def _connected(
    clearance: NDArray[np.float32], least: float, sources: NDArray[np.int64], sinks: NDArray[np.int64]
) -> bool:
    pieces, _ = ndimage.label(clearance >= least)
    one, other = (set(pieces[tuple(ends.T)].tolist()) - {0} for ends in (sources, sinks))
    return bool(one & other)


def _tightest(grid: Field, least: float, sources: NDArray[np.int64], sinks: NDArray[np.int64]) -> Array:
    """The tightest sample of a way that keeps to clearances above `least` and, where it can, far above."""
    values = grid.values
    cells = np.flatnonzero(values >= least)
    index = np.full(values.size, -1, np.int64)
    index[cells] = np.arange(len(cells))
    dear = 1 / np.maximum(values.ravel()[cells].astype(np.float64) - least + 1e-4, 1e-4)
    tails, heads = [], []
    for axis in range(3):
        first = index.reshape(values.shape)[(slice(None),) * axis + (slice(None, -1),)].ravel()
        second = index.reshape(values.shape)[(slice(None),) * axis + (slice(1, None),)].ravel()
        both = (first >= 0) & (second >= 0)
        tails.append(first[both])
        heads.append(second[both])
    tail, head = np.concatenate(tails), np.concatenate(heads)
    graph = sparse.csr_matrix((dear[tail] + dear[head], (tail, head)), shape=(len(cells), len(cells)))
    begin, end = (np.unique(index[np.ravel_multi_index(tuple(ends.T), values.shape)]) for ends in (sources, sinks))
    begin, end = begin[begin >= 0], end[end >= 0]
    length, before, _ = csgraph.dijkstra(graph, directed=False, indices=begin, return_predecessors=True, min_only=True)
    node = int(end[np.argmin(length[end])])
    chain = [node]
    while before[node] >= 0:
        node = int(before[node])
        chain.append(node)
    tight = cells[min(chain, key=lambda n: float(values.flat[cells[n]]))]
    return (np.array(np.unravel_index(tight, values.shape)) + np.asarray(grid.corner)) * grid.spacing
