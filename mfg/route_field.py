"""Where a cable may run: the deep inside of the bones and the room around their joints, as one clearance field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, BoxSeat
from mfg.fields import OUTSIDE, Field, Window, box_distance, cylinder_distance, cylindrical
from mfg.mounts import Mount, mount_of

Array = NDArray[np.float64]
Depth = NDArray[np.float32]
FAR = 0.060  # to which distance from hardware the field is filled [m]
SHALLOW = 0.004  # depth that the cost of a joint's room is that of [m]
NEAR_BONE = 0.012  # a cable outside keeps so near to one of the two bones that it joins [m]
AROUND = (0.020, 0.025)  # how far the room of a joint reaches beyond the mount, across its axis and along it [m]
PINCH = 3.0  # how much dearer the room is where the two bones move past each other closer than a cable is thick
SKIMMING = 1.5  # how much dearer it is where a tunnel would open as a groove


@dataclass(frozen=True)
class Margins:
    """What a tunnel keeps around itself.

    Attributes:
        radius: of the tunnel [m].
        gap: wall to motors' mounts, boxes, shafts and other tunnels [m].
        wall: least wall to the surface of the bone that it runs in; negative lets it open into a groove [m].
        shafts: whether it keeps out of the insertion shafts of the boxes.
    """

    radius: float
    gap: float
    wall: float
    shafts: bool = True


@dataclass(frozen=True, eq=False, slots=True)
class Obstacles:
    """Mounts and boxes as exact solids that the centre line of a tunnel keeps `radius + gap` from.

    Attributes:
        mount: of the motors.
        motors: T_design_motor of each, in the order of the seats.
        boxes: the electronics seats.
        shafts: whether the insertion shafts count.
    """

    mount: Mount
    motors: tuple[Array, ...]
    boxes: tuple[BoxSeat, ...]
    shafts: bool

    @staticmethod
    def of(blueprint: Blueprint, shafts: bool = True) -> Obstacles:
        """All hardware of a blueprint."""
        motors = tuple(seat.T_design_motor for seat in blueprint.seats)
        return Obstacles(mount_of(blueprint.catalogue.motor), motors, blueprint.boxes, shafts)

    def room(self, box: BoxSeat) -> tuple[Array, Array]:
        """Frame and half extents of a box's cavity, with its shaft where that counts."""
        half = np.array(box.size) / 2 + box.clearance
        T = np.array(box.T_design_box)
        if self.shafts and box.shaft > half[2]:
            T[:3, 3] += T[:3, 2] * (box.shaft - half[2]) / 2
            half[2] = (box.shaft + half[2]) / 2
        return T, half

    def distance(self, points: Array) -> Array:
        """Distance from points (n, 3) to every mount, then to every box's room, (s + b, n) [m]; negative inside."""
        found = [np.minimum(*(cylinder_distance(points, T, *part) for part in mount_parts(self.mount)))
                 for T in self.motors]  # fmt: skip
        found += [box_distance(points, *self.room(box)) for box in self.boxes]
        return np.array(found).reshape(-1, len(points))


def mount_parts(mount: Mount) -> tuple[tuple[float, float, float], ...]:
    """Radius, low and high of the filled cup and of the disc [m], motor frame."""
    return (
        (mount.holder_radius, mount.base_low, mount.connector_low),
        (mount.connector_radius, mount.connector_low, mount.connector_high),
    )


@dataclass(frozen=True, eq=False, slots=True)
class RouteField:
    """The free room of a blueprint on the lattice of its bones.

    Attributes:
        clearance: by how much the centre line of a tunnel may move any way before it comes too near to something or
            leaves the free room [m]; negative where it may not be.
        label: body index of every sample where a tunnel may run in that bone; number of bodies + k in the room around
            hinge k, outside the bones or shallow in the two that it joins; -1 elsewhere.
        cost: of running there, per metre: 1 + 60 / d^1.5 at d millimetres from the nearest surface or room.
        joined: (labels, labels), whether a tunnel may pass from one to the other.
    """

    clearance: Field
    label: NDArray[np.int8]
    cost: Depth
    joined: NDArray[np.bool_]

    @staticmethod
    def of(blueprint: Blueprint, margins: Margins) -> RouteField:
        """Lay out the free room of a blueprint with its seats and boxes."""
        bones = [body.bone for body in blueprint.bodies]
        used = passed(blueprint)
        grid, owner = _bones(bones, used)
        depth = grid.values
        near = np.float32(margins.radius + margins.gap)
        allowed = depth - np.float32(margins.radius + margins.wall)
        hardware = _hardware(blueprint, grid, margins.shafts)
        label = np.where(allowed >= 0, owner, np.int8(-1))
        cost = np.full(depth.shape, np.inf, np.float32)
        inside = np.flatnonzero((allowed >= 0) & (hardware >= near))
        cost.ravel()[inside] = _cost(np.minimum(depth.ravel()[inside], hardware.ravel()[inside]))
        bodies = len(bones)
        joined = np.eye(bodies + len(blueprint.hinges), dtype=bool)
        nearest = np.full(depth.shape, np.inf, np.float32)
        for k, seat in enumerate(blueprint.seats):
            hinge = blueprint.hinges[seat.hinge]
            pair = (hinge.parent, hinge.body)
            joined[bodies + k, pair] = joined[pair, bodies + k] = True
            shut = [index for index in range(bodies) if index not in pair or index not in used]
            mount = mount_of(blueprint.catalogue.motor)
            room = _room(seat.T_design_motor, bones, (pair, shut), grid, mount, near)
            if room is None:
                continue
            window, radial, free, dear = room
            allowed[window] = np.maximum(allowed[window], free)
            here = (free >= 0) & (label[window] < 0) & (radial < nearest[window])
            nearest[window][here] = radial[here]
            label[window][here] = bodies + k
            cost[window][here] = dear[here]
        clearance = np.minimum(allowed, hardware - near)
        label[clearance < 0] = -1
        for axis in range(3):
            np.moveaxis(label, axis, 0)[[0, -1]] = -1  # so that every labelled sample has all its neighbours
        return RouteField(grid.with_values(clearance), label, cost, joined)

    def slope(self, points: Array) -> Array:
        """Direction in which the clearance grows at points (n, 3), of unit length or zero, (n, 3)."""
        step = 0.4 * self.clearance.spacing
        probes = points[:, None] + np.concatenate([np.eye(3), -np.eye(3)]) * step
        value = self.clearance.sample(probes).astype(np.float64)
        slope = value[:, :3] - value[:, 3:]
        return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)


def _cost(depth: Depth | np.float32) -> Depth:
    away = 1e3 * np.maximum(depth, np.float32(1e-3))
    return np.asarray(1 + 60 / (away * np.sqrt(away)), np.float32)


def passed(blueprint: Blueprint) -> set[int]:
    """The bodies that lie on the way through the tree from the controller to any motor's holder, both included."""
    parent = {hinge.body: hinge.parent for hinge in blueprint.hinges}

    def upwards(body: int) -> list[int]:
        chain = [body]
        while chain[-1] in parent:
            chain.append(parent[chain[-1]])
        return chain

    home = upwards(blueprint.box("controller").body)
    used = {home[0]}
    for seat in blueprint.seats:
        there = upwards(seat.holder)
        meet = next((body for body in there if body in home), there[-1])
        used.update(there[: there.index(meet) + 1])
        used.update(home[: home.index(meet) + 1] if meet in home else ())
    return used


def _bones(bones: list[Field], used: set[int]) -> tuple[Field, NDArray[np.int8]]:
    """Depth in the used bones on a lattice three samples wider than they are, and which bone it is deepest in."""
    fields = [bones[index] for index in sorted(used)]
    corners = np.array([np.round(field.corner).astype(int) for field in fields])
    low = corners.min(axis=0) - 3
    shape = (corners + [field.values.shape for field in fields]).max(axis=0) + 3 - low
    depth, owner = np.full(shape, OUTSIDE, np.float32), np.zeros(shape, np.int8)
    for index, corner, field in zip(sorted(used), corners - low, fields, strict=True):
        there = tuple(slice(c, c + n) for c, n in zip(corner, field.values.shape, strict=True))
        owner[there][field.values > depth[there]] = index
        depth[there] = np.maximum(depth[there], field.values)
    x, y, z = (int(v) for v in low)
    return Field(depth, (x, y, z), fields[0].spacing), owner


def _part_of(field: Field, grid: Field, window: Window) -> Depth:
    """Depth in a bone at the samples of a window of a larger lattice."""
    corner = np.round(grid.corner).astype(int) + [s.start for s in window]
    x, y, z = (int(v) for v in corner)
    shape = tuple(s.stop - s.start for s in window)
    return field.on_lattice_of(Field(np.zeros(shape, np.float32), (x, y, z), grid.spacing))


def _hardware(blueprint: Blueprint, grid: Field, shafts: bool) -> Depth:
    """Distance to the nearest mount or room of a box, as far as `FAR` [m]."""
    obstacles = Obstacles.of(blueprint, shafts)
    found = np.full(grid.values.shape, FAR, np.float32)
    for T in obstacles.motors:
        reach = float(np.hypot(obstacles.mount.envelope_radius, obstacles.mount.connector_high))
        window = grid.window(T[:3, 3], reach + 0.012)
        if window is None:
            continue
        radial, along = cylindrical(grid.axes(window), T[:3, 3], T[:3, 2])
        for radius, low, high in mount_parts(obstacles.mount):
            across = radial - np.float32(radius)
            axial = np.maximum(np.float32(low) - along, along - np.float32(high))
            found[window] = np.minimum(found[window], _outside(across, axial))
    for box in obstacles.boxes:
        T, half = obstacles.room(box)
        window = grid.window(T[:3, 3], np.abs(T[:3, :3]) @ half + 0.020)
        if window is None:
            continue
        x, y, z = (a - np.float32(c) for a, c in zip(grid.axes(window), T[:3, 3], strict=True))
        beyond = [
            np.abs(x * np.float32(e[0]) + y * np.float32(e[1]) + z * np.float32(e[2])) - np.float32(h)
            for e, h in zip(T[:3, :3].T, half, strict=True)
        ]
        found[window] = np.minimum(found[window], _outside(*beyond))
    return found


def _outside(*beyond: Depth) -> Depth:
    """Euclidean distance outside a product of intervals, from how far a point lies beyond each; negative inside."""
    worst, square = beyond[0], np.square(np.maximum(beyond[0], 0))
    for far in beyond[1:]:
        worst, square = np.maximum(worst, far), square + np.square(np.maximum(far, 0))
    return np.asarray(np.where(worst > 0, np.sqrt(square), worst), np.float32)


def _room(
    T: Array,
    bones: list[Field],
    bodies: tuple[tuple[int, int], list[int]],
    grid: Field,
    mount: Mount,
    near: np.float32,
) -> tuple[Window, Depth, Depth, Depth] | None:
    """Window, distance from the axis, clearance and cost in the room around a joint: outside, near its two bones.

    `bodies` are these two, and those that no tunnel passes.
    """
    across, along_most = mount.envelope_radius + AROUND[0], mount.connector_high + AROUND[1]
    axis = T[:3, 2]
    reach = np.abs(axis) * along_most + np.sqrt(np.maximum(1 - axis**2, 0)) * across
    window = grid.window(T[:3, 3], reach)
    if window is None:
        return None
    radial, along = cylindrical(grid.axes(window), T[:3, 3], axis)
    one, other = (_part_of(bones[index], grid, window) for index in bodies[0])
    nearer, farther = np.maximum(one, other), np.minimum(one, other)
    ends = np.float32(along_most) - np.abs(along)
    # The empty cylinder above and below the mount is as good as the room close to a bone.
    close = np.maximum(nearer + np.float32(NEAR_BONE), np.float32(mount.attach_radius) - radial)
    free = np.minimum(np.minimum(np.float32(across) - radial, ends), close)
    for index in bodies[1]:
        free = np.minimum(free, -near - _part_of(bones[index], grid, window))
    dear = _cost(np.float32(SHALLOW)) * (1 + radial / np.float32(across))
    dear *= np.where(farther > -near, np.float32(PINCH), 1) * np.where(nearer > -near, np.float32(SKIMMING), 1)
    return window, radial, free, dear
