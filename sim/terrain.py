"""Ground to walk on, laid under a robot before its model is compiled: flat, rough, potholes, slope, steps."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.actor import smooth_step
from sim.model import FLOOR, Model

EXTENT = 20.0  # the relief reaches so far from the origin to every side: 20 s at 1 m/s; flat ground lies beyond [m]
CELL = 0.08  # between the samples of a height field [m]; half of it would cost a third of the steps per second
START = 0.6  # the ground is flat so far around the origin, where the robot settles [m]
BLEND = 0.4  # and rises to its full relief over this distance [m]
FLIGHT = 3  # stairs go up so many steps, then down as many
BASE = 0.3  # thickness of the ground below a height field's lowest point [m]
DROP = 0.02  # from there to the flat ground that lies beyond a height field [m]
BEYOND = FLOOR + "_beyond"  # name of that
STEP = FLOOR + "_step_"  # the boxes of stairs are named by this and a number
BOUNDS = {"height": (0.0, 0.3), "feature": (0.2, 2.0), "angle": (-0.7, 0.7)}

Array = NDArray[np.float64]


class Kind(StrEnum):
    """Of a terrain."""

    FLAT = "flat"  # the plane z = 0
    ROUGH = "rough"  # random bumps without any order
    POTHOLES = "potholes"  # plane ground with round holes, one at a random place in each tile
    SLOPE = "slope"  # a plane that rises towards +x
    STEPS = "steps"  # square stairs around the start: up a flight, down a flight, in every direction


@dataclass(frozen=True, slots=True)
class Terrain:
    """What the ground is like. The defaults are passable for a robot of 0.3 to 0.6 m and 3 to 7 kg.

    Attributes:
        kind: of ground.
        height: from the lowest to the highest point of rough ground, depth of the deepest pothole, rise of one step
            [m].
        feature: distance between bumps, greatest diameter of a pothole, tread of a step [m].
        angle: of a slope, positive where it rises towards +x [rad].
        seed: of rough ground and potholes; the same terrain has the same bytes everywhere.

    Raises:
        ValueError: A field lies out of its bounds; the message names it.
    """

    kind: Kind = Kind.FLAT
    height: float = 0.03
    feature: float = 0.4
    angle: float = 0.14
    seed: int = 0

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "kind", Kind(self.kind))
        except ValueError:
            raise ValueError(f"terrain: kind is {self.kind!r}; it must be one of {', '.join(Kind)}") from None
        for name, (least, most) in BOUNDS.items():
            value = getattr(self, name)
            if not least <= value <= most:
                unit = "rad" if name == "angle" else "m"
                raise ValueError(f"terrain: {name} is {value} {unit}; it must lie in [{least}, {most}] {unit}")
        if self.seed < 0:
            raise ValueError(f"terrain: seed is {self.seed}; it must be 0 or more")


def lay(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    """Put a terrain in the place of the floor of a robot's specification [in place]; compile it afterwards.

    The floor keeps its name, friction and contact law. It stays a plane for flat ground, slopes and steps, which are
    boxes on it with upright risers; rough ground and potholes are height fields. On a slope the robot is set down
    turned with the ground; elsewhere it starts on flat ground.

    Args:
        spec: as `sim.model.make_spec` or `load_spec` gives it.
        terrain: to lay.

    Raises:
        ValueError: if the specification has no plane named as the floor, because another ground was laid already.
    """
    floor = spec.geom(FLOOR)
    if terrain.kind is Kind.FLAT and floor is None:
        return  # a file of somebody else's, whose floor has another name
    laid = any(geom.name == BEYOND or geom.name.startswith(STEP) for geom in spec.geoms)
    if floor is None or floor.type != mujoco.mjtGeom.mjGEOM_PLANE or laid:
        raise ValueError(f"robot {spec.modelname} has no bare plane named {FLOOR!r}; lay one terrain on a fresh model")
    if terrain.kind is Kind.SLOPE:
        _tilt(spec, floor, terrain.angle)
    elif terrain.kind is Kind.STEPS:
        for index, (centre, half) in enumerate(_boxes(terrain)):
            _copy(spec, floor, f"{STEP}{index}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half)
    elif terrain.kind is not Kind.FLAT:
        heights = samples(terrain)
        low, high = float(heights.min()), float(heights.max())
        field = spec.add_hfield(
            name=FLOOR, nrow=len(heights), ncol=len(heights), size=(EXTENT, EXTENT, max(high - low, 1e-6), BASE)
        )
        field.userdata = heights.ravel()
        _copy(spec, floor, BEYOND, pos=(0.0, 0.0, low - DROP))
        floor.type, floor.hfieldname, floor.pos = mujoco.mjtGeom.mjGEOM_HFIELD, FLOOR, (0.0, 0.0, low)


def height_at(terrain: Terrain, x: ArrayLike, y: ArrayLike) -> Array:
    """Height of the ground at points of any one shape within the extent [m]; frame of the world, z up.

    Between the samples of a height field it is that of MuJoCo's triangles, the quad's diagonal along (1, 1).
    """
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    if terrain.kind is Kind.SLOPE:
        return math.tan(terrain.angle) * x
    if terrain.kind is Kind.STEPS:
        return terrain.height * _level(_ring(terrain, np.maximum(np.abs(x), np.abs(y)))).astype(np.float64)
    if terrain.kind is Kind.FLAT:
        return np.zeros(x.shape)
    return _interpolated(samples(terrain), EXTENT, x, y)


def ground_at(model: Model, x: ArrayLike, y: ArrayLike) -> Array:
    """Height of the ground of a compiled model at points of any one shape [m], whatever terrain was laid.

    It is the highest of the world's planes, height fields and upright boxes there; 0 without any.
    """
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    top = np.full(x.shape, -np.inf)
    for geom in np.flatnonzero(model.geom_bodyid == 0):
        px, py, pz = model.geom_pos[geom]
        half = model.geom_size[geom]
        match model.geom_type[geom]:
            case mujoco.mjtGeom.mjGEOM_PLANE:
                turn = np.zeros(9)
                mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
                nx, ny, nz = turn[2::3]
                top = np.maximum(top, pz - (nx * (x - px) + ny * (y - py)) / nz)
            case mujoco.mjtGeom.mjGEOM_BOX:
                inside = (np.abs(x - px) <= half[0]) & (np.abs(y - py) <= half[1])
                top = np.where(inside, np.maximum(top, pz + half[2]), top)
            case mujoco.mjtGeom.mjGEOM_HFIELD:
                field = model.geom_dataid[geom]
                extent, _, scale, _ = model.hfield_size[field]
                rows, first = int(model.hfield_nrow[field]), int(model.hfield_adr[field])
                heights = model.hfield_data[first : first + rows * rows].reshape(rows, rows)
                found = pz + scale * _interpolated(heights, extent, x - px, y - py)
                inside = np.maximum(np.abs(x - px), np.abs(y - py)) <= extent
                top = np.where(inside, np.maximum(top, found), top)
    return np.where(np.isfinite(top), top, 0.0)


def is_level(model: Model) -> bool:
    """Whether the ground of a compiled model is the bare plane z = 0, or nothing at all."""
    ground = np.flatnonzero(model.geom_bodyid == 0)
    return all(model.geom_type[ground] == mujoco.mjtGeom.mjGEOM_PLANE) and bool(
        np.allclose(model.geom_pos[ground, 2], 0.0) and np.allclose(model.geom_quat[ground, 0], 1.0)
    )


@functools.lru_cache(maxsize=4)
def samples(terrain: Terrain) -> NDArray[np.float32]:
    """Heights of rough ground or potholes at the grid's nodes [m], (n, n), rows along y and columns along x.

    Nodes lie `CELL` apart from -`EXTENT` to `EXTENT`. All are within [-height, height], and 0 about the origin.
    """
    rng = np.random.default_rng(terrain.seed)
    at = np.linspace(-EXTENT, EXTENT, round(2 * EXTENT / CELL) + 1)
    relief = _bumps(at, terrain, rng) if terrain.kind is Kind.ROUGH else _potholes(at, terrain, rng)
    near = slice(*np.searchsorted(at, (-START - BLEND, START + BLEND)))
    away = np.hypot(at[near, None], at[None, near])
    relief[near, near] *= smooth_step((away - START) / BLEND)
    heights = relief.astype(np.float32)
    heights.setflags(write=False)
    return heights


def _bumps(at: Array, terrain: Terrain, rng: np.random.Generator) -> Array:
    """Random heights on a lattice of half a feature, blended between its nodes without exceeding them."""
    spacing = terrain.feature / 2
    count = math.ceil(2 * EXTENT / spacing) + 2
    lattice = terrain.height * rng.uniform(-0.5, 0.5, (count, count))
    place = (at + EXTENT) / spacing
    node = place.astype(int)
    weight = smooth_step(place - node)
    weights = np.zeros((len(at), count))
    weights[np.arange(len(at)), node] = 1 - weight
    weights[np.arange(len(at)), node + 1] = weight
    relief: Array = weights @ lattice @ weights.T
    return relief


def _potholes(at: Array, terrain: Terrain, rng: np.random.Generator) -> Array:
    """Holes with a level bottom and walls over two fifths of their radius, one in each tile of two features."""
    tile = 2 * terrain.feature
    count = math.ceil(2 * EXTENT / tile) + 1
    radius = terrain.feature / 2 * rng.uniform(0.6, 1.0, (count, count))
    depth = terrain.height * rng.uniform(0.5, 1.0, (count, count))
    margin = radius + terrain.feature / 10  # so that no two holes meet
    x, y = margin + (tile - 2 * margin) * rng.random((2, count, count))  # the hole's centre within its tile
    index = ((at + EXTENT) / tile).astype(int)
    inside = at + EXTENT - index * tile
    x, y, R, D = (value[index][:, index] for value in (x, y, radius, depth))
    away = np.hypot(inside[None, :] - x, inside[:, None] - y)
    hole = away < R
    relief = np.zeros(away.shape)
    relief[hole] = -D[hole] * smooth_step((R[hole] - away[hole]) / (0.4 * R[hole]))
    return relief


def _ring(terrain: Terrain, away: Array) -> NDArray[np.int64]:
    """Which square ring around the start a point belongs to that lies `away` in its farther coordinate [m]."""
    ring = np.floor((away - START) / terrain.feature).astype(np.int64) + 1
    return np.where(ring <= _rings(terrain), np.maximum(ring, 0), 0)


def _rings(terrain: Terrain) -> int:
    """How many rings stairs have: whole flights, up and down, within the extent."""
    return math.floor((EXTENT - START) / terrain.feature) // (2 * FLIGHT) * 2 * FLIGHT


def _level(ring: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many steps up a ring lies."""
    return FLIGHT - np.abs(FLIGHT - ring % (2 * FLIGHT))


def _boxes(terrain: Terrain) -> Iterator[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Centre and half size of each box of the stairs [m], four to a ring."""
    half = terrain.feature / 2
    for ring in range(1, _rings(terrain) + 1):
        top = terrain.height * int(_level(np.array(ring)))
        if top <= 0:
            continue
        middle = START + (ring - 0.5) * terrain.feature
        low = (top - BASE) / 2  # boxes reach below the plane, so that feet are pushed up and not through them
        thick = (top + BASE) / 2
        for side in (-middle, middle):
            yield (side, 0.0, low), (half, middle + half, thick)
            yield (0.0, side, low), (middle - half, half, thick)


def _tilt(spec: mujoco.MjSpec, floor: mujoco.MjsGeom, angle: float) -> None:
    """Turn the floor, and what stands freely on it, so that it rises towards +x."""
    turn = np.array([math.cos(angle / 2), 0.0, -math.sin(angle / 2), 0.0])
    floor.quat = turn
    for body in spec.bodies:
        if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints):
            place, attitude = np.zeros(3), np.zeros(4)
            mujoco.mju_rotVecQuat(place, np.asarray(body.pos, np.float64), turn)
            mujoco.mju_mulQuat(attitude, turn, np.asarray(body.quat, np.float64))
            body.pos, body.quat = place, attitude


def _copy(spec: mujoco.MjSpec, floor: mujoco.MjsGeom, name: str, **changed: object) -> None:
    """Add a piece of ground to the world that touches as the floor does."""
    same = ("type", "pos", "size", "contype", "conaffinity", "condim", "friction", "solref", "solimp", "margin", "rgba")
    spec.worldbody.add_geom(name=name, **{field: getattr(floor, field) for field in same} | changed)


def _interpolated(heights: NDArray[np.float32], extent: float, x: Array, y: Array) -> Array:
    """Height of a field (n, n) that reaches from -extent to extent, on its triangles; the edge's height beyond."""
    last = len(heights) - 1
    u, v = (np.clip((along + extent) / (2 * extent) * last, 0.0, last) for along in (x, y))
    column, row = (np.minimum(along.astype(int), last - 1) for along in (u, v))
    u, v = u - column, v - row
    near, far = heights[row, column].astype(np.float64), heights[row + 1, column + 1]
    along_x, along_y = heights[row, column + 1], heights[row + 1, column]
    return np.where(
        u >= v, near + u * (along_x - near) + v * (far - along_x), near + v * (along_y - near) + u * (far - along_y)
    )
