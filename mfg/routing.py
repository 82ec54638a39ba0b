"""The surface of a body as a graph to route cables on, and the hardware that they must not meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from mfg.blueprint import Blueprint, BoxSeat, MotorSeat
from mfg.fields import OUTSIDE, Field, box_depth, box_distance
from mfg.insertion import mount_reach
from mfg.mounts import Mount, envelope_depth, mount_of
from mfg.solids import surface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
NEAREST = 12  # surface vertices that a reference point tries to snap to
AZIMUTHS = 16  # reference points around a motor
FACE = 3  # reference points along each side of a face of the controller, at most


@dataclass(frozen=True, eq=False, slots=True)
class Hardware:
    """The motors' housings, then the boxes, as solids that tunnels must not meet.

    Attributes:
        mount: of the motors.
        centre, axis: of every housing, (s, 3).
        boxes: the electronics seats.
    """

    mount: Mount
    centre: Array
    axis: Array
    boxes: tuple[BoxSeat, ...]

    @staticmethod
    def of(blueprint: Blueprint) -> Hardware:
        """All hardware of a blueprint."""
        T = np.array([seat.T_design_motor for seat in blueprint.seats]).reshape(-1, 4, 4)
        return Hardware(mount_of(blueprint.catalogue.motor), T[:, :3, 3], T[:, :3, 2], blueprint.boxes)

    def distance(self, points: Array) -> Array:
        """Distance from points (n, 3) to every housing and box, (s + b, n) [m]; negative inside."""
        offset = points - self.centre[:, None]
        along = np.einsum("snc,sc->sn", offset, self.axis)
        radial = np.sqrt(np.maximum(np.einsum("snc,snc->sn", offset, offset) - along**2, 0.0))
        radial -= self.mount.housing_radius
        axial = np.maximum(self.mount.housing_low - along, along - self.mount.housing_high)
        housings = np.hypot(np.maximum(radial, 0), np.maximum(axial, 0)) + np.minimum(np.maximum(radial, axial), 0)
        boxes = [box_distance(points, box.T_design_box, np.array(box.size) / 2) for box in self.boxes]
        return np.concatenate([housings, np.array(boxes).reshape(-1, len(points))])

    def outward(self, points: Array, which: NDArray[np.integer]) -> Array:
        """Unit direction in which the distance of each point (n, 3) to its own piece of hardware grows, (n, 3)."""
        h = 1e-5
        probes = points[:, None] + np.concatenate([np.eye(3), -np.eye(3)]) * h
        distance = self.distance(probes.reshape(-1, 3)).reshape(-1, len(points), 6)
        own = distance[which, np.arange(len(points))]
        slope = own[:, :3] - own[:, 3:]
        return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)

    def needs(self, seat: int, radius: float, gap: float) -> Array:
        """Least distance of the centre line of one wire to every housing and box [m], (s + b,).

        A tunnel opens into the cavity that it serves without touching what sits in it, and leaves `gap` elsewhere.
        """
        need = np.full(len(self.centre) + len(self.boxes), radius + gap)
        need[seat] = radius + (self.mount.cavity_radius - self.mount.housing_radius) / 2
        for index, box in enumerate(self.boxes):
            if box.kind == "controller":
                need[len(self.centre) + index] = radius + box.clearance / 2
            elif gap == 0.0:
                need[len(self.centre) + index] = radius
        return need


class Net:
    """The merged surface as a graph, with one source node per motor and one sink per free side of the controller."""

    def __init__(
        self, blueprint: Blueprint, hardware: Hardware, radius: float, gap: float, stride: int, bridge: float
    ) -> None:
        """Mesh the merged bodies and link the reference points to them; arguments as in `WireSolver`."""
        self.hardware, self.gap, self.radius = hardware, gap, radius
        self.vertices, triangles = surface(merged(blueprint, stride))
        self.tree = cKDTree(self.vertices)
        self.distance = hardware.distance(self.vertices)
        self.in_shaft = np.zeros(len(self.vertices), bool)
        for box in blueprint.boxes:
            self.in_shaft |= _shaft_depth(self.vertices, box) > -radius
        n = len(self.vertices)
        tail, head = bridged(self.vertices, *mesh_edges(triangles), bridge)
        length = np.linalg.norm(self.vertices[tail] - self.vertices[head], axis=1)
        # A link across a sharp rim may cut through what lies below it.
        nearest = self.distance.min(axis=0)
        least = radius + gap / 2
        doubtful = np.flatnonzero(np.maximum(nearest[tail], nearest[head]) - length / 2 < least)
        middle = (self.vertices[tail[doubtful]] + self.vertices[head[doubtful]]) / 2
        length[doubtful[hardware.distance(middle).min(axis=0) < least]] = np.inf
        links = [np.column_stack([tail, head])]
        weights = [length]
        self.motor_ends: list[tuple[Array, NDArray[np.int64]]] = []
        for k, seat in enumerate(blueprint.seats):
            points = motor_references(blueprint, seat, hardware.mount, radius)
            snapped, hop, points = self._snap(points, hardware.needs(k, radius, gap))
            snapped, first = np.unique(snapped, return_index=True)  # The nearest first: hops are sorted.
            self.motor_ends.append((points[first], snapped))
            links.append(np.column_stack([np.full(len(first), n + k), snapped]))
            weights.append(hop[first])
        self.sinks = n + len(blueprint.seats)
        box = blueprint.box("controller")
        need = hardware.needs(0, radius, gap)
        need[: len(hardware.centre)] = radius + gap
        snapped, hop, self.starts = self._snap(box_references(box, radius, gap), need)
        self.start_vertex = snapped
        links.append(np.column_stack([snapped, self.sinks + np.arange(len(snapped))]))
        weights.append(hop)
        pairs = np.concatenate(links)
        size = self.sinks + len(snapped)
        self.graph = sparse.csr_matrix((np.concatenate(weights), (pairs[:, 0], pairs[:, 1])), shape=(size, size))

    def _snap(self, points: Array, need: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """Nearest vertex that a straight tunnel from each reference point reaches; points without one are dropped.

        Returns:
            Vertex index, length of the tunnel and reference point, sorted by that length.
        """
        count = min(NEAREST, len(self.vertices))
        hop, near = (np.asarray(a).reshape(len(points), count) for a in self.tree.query(points, k=count))
        share = np.linspace(0, 1, 7)[:, None]
        along = points[:, None, None] + share * (self.vertices[near] - points[:, None])[:, :, None]
        distance = self.hardware.distance(along.reshape(-1, 3)).reshape(-1, *near.shape, len(share))
        clear = np.asarray((distance >= need[:, None, None, None] - 1e-6).all(axis=(0, 3)))
        some = np.flatnonzero(clear.any(axis=1))
        pick = clear[some].argmax(axis=1)
        length = hop[some, pick]
        order = np.argsort(length, kind="stable")
        return near[some, pick][order].astype(np.int64), length[order], points[some][order]

    def route(self, seat: int, earlier: list[Array]) -> tuple[Array, str] | None:
        """Path (k, 3) from the controller to a motor, and what it had to give up, or None if there is none."""
        need = self.hardware.needs(seat, self.radius, self.gap)
        solid = np.asarray((self.distance - need[:, None]).min(axis=0) < 0)
        apart = 2 * self.radius + self.gap
        taken, used = np.zeros(len(self.vertices), bool), np.zeros(len(self.starts), bool)
        for path in earlier:
            taken[np.unique(np.concatenate(self.tree.query_ball_point(path, apart)).astype(int))] = True
            used |= np.asarray(np.linalg.norm(self.starts[:, None] - path, axis=2).min(axis=1) < apart)
        for blocked, closed, compromise in (
            (solid | self.in_shaft | taken, used, ""),
            (solid | taken, used, "crosses an insertion shaft: lay it after the boxes are in"),
        ):
            found = self._shortest(seat, blocked, closed)
            if found is not None:
                return found, compromise
        return None

    def _shortest(self, seat: int, blocked: Mask, closed: Mask) -> Array | None:
        shut = np.concatenate([blocked, np.zeros(self.sinks - len(blocked), bool), closed])
        weights = np.where(shut[self.graph.indices], np.inf, self.graph.data)
        graph = sparse.csr_matrix((weights, self.graph.indices, self.graph.indptr), shape=self.graph.shape)
        source = len(self.vertices) + seat
        length, before = csgraph.dijkstra(graph, indices=[source], return_predecessors=True)
        ends, before = length[0, self.sinks :], before[0]
        if not np.isfinite(ends).any():
            return None
        best = int(np.argmin(ends))
        chain = [int(before[self.sinks + best])]
        while before[chain[-1]] != source:
            chain.append(int(before[chain[-1]]))
        points, snapped = self.motor_ends[seat]
        end = points[int(np.searchsorted(snapped, chain[-1]))]
        return np.concatenate([self.starts[best : best + 1], self.vertices[chain], end[None]])


def merged(blueprint: Blueprint, stride: int) -> Field:
    """Union of all bones and mounts on every stride-th sample of their lattice."""
    spacing = blueprint.bodies[0].bone.spacing * stride
    mount = mount_of(blueprint.catalogue.motor)
    reach = mount_reach(mount) + 2 * spacing
    corners = [np.array(body.bone.corner) for body in blueprint.bodies]
    ends = [corner + body.bone.values.shape for corner, body in zip(corners, blueprint.bodies, strict=True)]
    centres = np.array([seat.T_design_motor[:3, 3] for seat in blueprint.seats]).reshape(-1, 3)
    low = np.floor(np.min([*(c / stride for c in corners), *((centres - reach) / spacing)], axis=0)).astype(int)
    high = np.ceil(np.max([*(e / stride for e in ends), *((centres + reach) / spacing)], axis=0)).astype(int) + 1
    values = np.full(high - low, OUTSIDE, np.float32)
    for corner, body in zip(corners, blueprint.bodies, strict=True):
        skip = -corner % stride  # To the first sample of the coarse lattice.
        coarse = body.bone.values[tuple(slice(s, None, stride) for s in skip)]
        there = tuple(slice(s, s + n) for s, n in zip((corner + skip) // stride - low, coarse.shape, strict=True))
        values[there] = np.maximum(values[there], coarse)
    for seat in blueprint.seats:
        first = np.floor((seat.T_design_motor[:3, 3] - reach) / spacing).astype(int)
        last = np.ceil((seat.T_design_motor[:3, 3] + reach) / spacing).astype(int) + 1
        axes = [np.arange(a, b) * spacing for a, b in zip(first, last, strict=True)]
        depth = envelope_depth(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), seat.T_design_motor, mount)
        there = tuple(slice(a, b) for a, b in zip(first - low, last - low, strict=True))
        values[there] = np.maximum(values[there], depth)
    return Field(values, (int(low[0]), int(low[1]), int(low[2])), spacing)


def mesh_edges(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Directed edges of a closed mesh and, across each of them, the link between the two opposite corners.

    With edges alone a shortest path follows the lattice that the mesh was made on, up to 27 % too long; with both it
    is within 15 %.
    """
    # Each edge of a closed mesh is met once in either direction.
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    opposite = np.roll(triangles, -2, axis=1).ravel()
    size = int(triangles.max()) + 1
    key, twin = tail * size + head, head * size + tail
    order = np.argsort(key, kind="stable")
    at = order[np.minimum(np.searchsorted(key[order], twin), len(key) - 1)]
    paired = key[at] == twin
    return np.concatenate([tail, opposite[paired]]), np.concatenate([head, opposite[at[paired]]])


def motor_references(blueprint: Blueprint, seat: MotorSeat, mount: Mount, radius: float) -> Array:
    """Points beside a housing, near its lower end, where the holder's bone covers the cup: (n, 3) [m].

    A tunnel that ends there opens into the motor's cavity. All sides serve where the bone covers none.
    """
    T = seat.T_design_motor
    angle = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    side = np.cos(angle)[:, None] * T[:3, 0] + np.sin(angle)[:, None] * T[:3, 1]
    height = mount.housing_low + 2 * radius
    foot = T[:3, 3] + height * T[:3, 2]
    covered = blueprint.bodies[seat.holder].bone.sample(foot + (mount.holder_radius + radius) * side) > 0
    side = side[covered] if covered.any() else side
    return foot + (mount.housing_radius + radius + (mount.cavity_radius - mount.housing_radius) / 2) * side


def box_references(box: BoxSeat, radius: float, gap: float) -> Array:
    """Points before all faces of a box but its opening, far enough apart for tunnels: (n, 3) [m]."""
    half = np.array(box.size) / 2
    points = []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1), (2, -1)):
        across = [a for a in range(3) if a != axis]
        counts = [max(1, min(FACE, int(2 * (half[a] - radius) / (2 * radius + gap)) + 1)) for a in across]
        grids = [np.linspace(-1, 1, c) * (half[a] - radius) if c > 1 else np.zeros(1)
                 for a, c in zip(across, counts, strict=True)]  # fmt: skip
        face = np.zeros((counts[0] * counts[1], 3))
        face[:, across] = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 2)
        face[:, axis] = sign * (half[axis] + radius + box.clearance / 2)
        points.append(face)
    return np.concatenate(points) @ box.T_design_box[:3, :3].T + box.T_design_box[:3, 3]


def _shaft_depth(points: Array, box: BoxSeat) -> NDArray[np.float32]:
    half = np.array(box.size) / 2 + box.clearance
    T = box.T_design_box.copy()
    T[:3, 3] += T[:3, 2] * (box.shaft / 2)
    return box_depth(points, T, np.array([half[0], half[1], max(box.shaft, half[2]) / 2]))


def bridged(
    vertices: Array, tail: NDArray[np.int64], head: NDArray[np.int64], bridge: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The edges, with the nearest vertices of separate pieces linked where they are at most `bridge` apart."""
    n = len(vertices)
    count, label = csgraph.connected_components(
        sparse.csr_matrix((np.ones(len(tail)), (tail, head)), shape=(n, n)), directed=False
    )
    joined = label == np.bincount(label).argmax()
    links: list[tuple[int, int]] = []
    for _ in range(count - 1):
        rest = np.flatnonzero(~joined)
        inside = np.flatnonzero(joined)
        distance, nearest = (np.asarray(a) for a in cKDTree(vertices[inside]).query(vertices[rest]))
        best = int(np.argmin(distance))
        if distance[best] > bridge:
            break
        links.append((int(rest[best]), int(inside[nearest[best]])))
        joined |= label == label[rest[best]]
    if not links:
        return tail, head
    a, b = np.array(links).T
    return np.concatenate([tail, a, b]), np.concatenate([head, b, a])
