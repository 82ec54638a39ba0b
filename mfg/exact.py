"""Exact counterparts of what the solvers estimate on fields: rooms, shared volumes, clearance and conflicts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mfg.blueprint import Blueprint, BoxSeat, MotorSeat, WireRun
from mfg.fields import Field
from mfg.mounts import Mount, envelope, envelope_depth, housing, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.solids import Solid, ball_chain, box, cylinder, tube, union

REAMED = 5e-4  # by which the exact joint cylinder exceeds the one on the field, whose error is less [m]
ACCESS = 0.035  # free length above the connector and below the base plate, for a screwdriver [m]
LIFT = 2e-3  # by which a motor must be able to rise beyond the rim of its cup [m]
STRAIGHT = 1e-4  # by which a tunnel may cut the corners of its path [m]
MOUTH = 1.5  # by which a tunnel is let into a cavity [radii]
FACETS = 8  # around a tunnel: its least radius is 8 % short, less than the gap between cable and wall
ROUND = 96  # sides of a cylinder whose volume is measured: its area is 0.07 % short
SAMPLED = 6e-3  # edge of the surface pieces by which a distance is measured: 40 mm comes out 0.15 mm larger [m]


def core(mount: Mount, offset: float, half_length: float, *, way_in: bool = False) -> Solid:
    """The bone processor's cylinder about the joint axis, in the frame of a motor at `offset` along it [m].

    It is at least long enough to leave access to the screws of both mounts, and a little wider than what the processor
    cut on the field: surfaces that nearly coincide would cross everywhere. With `way_in`, for the body that holds the
    motor, the whole motor also fits above its cup: that is how it gets in, before the connector is screwed on.
    """
    low = min(-half_length - offset, mount.base_low - ACCESS)
    high = max(half_length - offset, mount.connector_high + ACCESS)
    if way_in:
        high = max(high, mount.holder_top + mount.motor.length + LIFT)
    return cylinder(mount.attach_radius + REAMED, low, high)


def box_solid(seat: BoxSeat) -> Solid:
    """The box itself, in the design frame."""
    half = np.asarray(seat.size) / 2
    return box((-half).tolist(), half.tolist()).moved(seat.T_design_box)


def box_room(seat: BoxSeat) -> Solid:
    """The cavity of a box with its clearance and the shaft by which it is inserted, in the design frame."""
    half = np.asarray(seat.size) / 2 + seat.clearance
    return box((-half).tolist(), [half[0], half[1], max(half[2], seat.shaft)]).moved(seat.T_design_box)


def motor_solid(blueprint: Blueprint, seat: MotorSeat) -> Solid:
    """The motor's housing, in the design frame."""
    return housing(mount_of(blueprint.catalogue.motor)).moved(seat.T_design_motor)


def tunnel(wire: WireRun) -> Solid:
    """The room of one cable, in the design frame."""
    return ball_chain(straightened(wire.path, STRAIGHT), wire.radius, FACETS)


def opened_tunnel(blueprint: Blueprint, wire: WireRun) -> Solid:
    """What is cut for a cable: its tunnel, let into the cavities at both ends.

    A path ends where the ball about its end just touches the cavity: the bore opens fully `MOUTH` radii farther on.
    """
    seat, box_seat = blueprint.seats[wire.seat], blueprint.box("controller")
    ends = []
    for end, T, half in (
        (wire.path[0], box_seat.T_design_box, np.asarray(box_seat.size) / 2),
        (wire.path[-1], seat.T_design_motor, np.array([0.0, 0.0, blueprint.catalogue.motor.length / 2])),
    ):
        local = (end - T[:3, 3]) @ T[:3, :3]
        inward = np.clip(local, -half, half) - local  # to the nearest point of the box, or of the motor's axis
        length = float(np.linalg.norm(inward))
        ends.append(end + min(MOUTH * wire.radius, length) / max(length, 1e-9) * (T[:3, :3] @ inward))
    path = np.concatenate([ends[:1], straightened(wire.path, STRAIGHT), ends[1:]])
    return ball_chain(path, wire.radius, FACETS)  # holds the tunnel itself, facet by facet


def straightened(path: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Points of a polyline (k, 3) without those within `tolerance` of the chord that skips them [m], ends kept."""
    keep = np.zeros(len(path), bool)
    keep[[0, -1]] = True
    spans = [(0, len(path) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        chord = path[last] - path[first]
        offset = path[first + 1 : last] - path[first]
        along = np.clip(offset @ chord / max(float(chord @ chord), 1e-18), 0.0, 1.0)
        away = np.linalg.norm(offset - along[:, None] * chord, axis=1)
        worst = int(away.argmax())
        if away[worst] > tolerance:
            middle = first + 1 + worst
            keep[middle] = True
            spans += [(first, middle), (middle, last)]
    return path[keep]


def attachment(blueprint: Blueprint, seat: MotorSeat, bones: Sequence[Solid]) -> tuple[float, float]:
    """V_h and V_c: volumes that holder and connector share with their bones outside the attach radius [m3] (Eq. 3)."""
    mount = mount_of(blueprint.catalogue.motor)
    cup = tube(mount.holder_radius, mount.attach_radius, mount.base_low, mount.holder_top, ROUND)
    disc = tube(mount.connector_radius, mount.attach_radius, mount.connector_low, mount.connector_high, ROUND)
    T = seat.T_design_motor
    return bones[seat.holder].overlap(cup.moved(T)), bones[seat.connector].overlap(disc.moved(T))


def filled_mounts(mount: Mount) -> tuple[Solid, Solid]:
    """Holder with the motor in it, and connector, as plain cylinders in the motor frame."""
    return (
        cylinder(mount.holder_radius, mount.base_low, mount.connector_low, ROUND),
        cylinder(mount.connector_radius, mount.connector_low, mount.connector_high, ROUND),
    )


def body_overlap(blueprint: Blueprint, bones: Sequence[Solid]) -> float:
    """V_overlap: volume that bodies share, a body being its bone with its filled mounts [m3] (paper Eq. 9).

    Summed over bones and mounts pair by pair, which is exact while no point lies in three of them.
    """
    cup, disc = filled_mounts(mount_of(blueprint.catalogue.motor))
    owned = list(enumerate(bones))
    for seat in blueprint.seats:
        owned += [(seat.holder, cup.moved(seat.T_design_motor)), (seat.connector, disc.moved(seat.T_design_motor))]
    return sum(a.overlap(b) for (i, a), (j, b) in itertools.combinations(owned, 2) if i != j)


def interference_above(blueprint: Blueprint, seat: BoxSeat, bones: Sequence[Solid]) -> float:
    """V_cap of one module: motors, mounts, other boxes and other bodies' bones in its way in [m3] (paper Eq. 8)."""
    half = np.asarray(seat.size) / 2 + seat.clearance
    top = max(seat.shaft, float(half[2])) + 2 * float(half[2])
    room = box([-half[0], -half[1], half[2]], [half[0], half[1], top]).moved(seat.T_design_box)
    whole = envelope(mount_of(blueprint.catalogue.motor), 0.0)
    obstacles = [bone for index, bone in enumerate(bones) if index != seat.body]
    obstacles += [whole.moved(motor.T_design_motor) for motor in blueprint.seats]
    obstacles += [box_solid(other) for other in blueprint.boxes if other is not seat]
    met = [room ^ obstacle for obstacle in obstacles if room.overlap(obstacle) > 0]
    return union(met).volume if met else 0.0


def largest_ball(blueprint: Blueprint, index: int, bone: Solid) -> float:
    """d_max: radius of the largest ball inside a bone and clear of every mount [m] (paper Eq. 6).

    The field of the bone only proposes where to look; distances are to the solid's surface.
    """
    mount = mount_of(blueprint.catalogue.motor)
    whole = envelope(mount, 0.0)
    inside = bone.minus([whole.moved(seat.T_design_motor) for seat in blueprint.seats])
    if inside.is_empty:
        return 0.0
    field: Field = blueprint.bodies[index].bone
    samples = np.argwhere(field.values > 0)
    depth = field.values[tuple(samples.T)]
    points = (samples + np.asarray(field.corner)) * field.spacing
    for seat in blueprint.seats:
        depth = np.minimum(depth, -envelope_depth(points, seat.T_design_motor, mount))
    best = points[np.argsort(-depth, kind="stable")[:300]]
    tree = cKDTree(surface_points(inside, SAMPLED))
    around = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    step = field.spacing / 2
    while True:
        radius = np.asarray(tree.query(best)[0])
        order = np.argsort(-radius, kind="stable")[:8]
        if step < 2e-4:
            return float(radius[order[0]])
        best = (best[order][:, None] + step * around).reshape(-1, 3)
        step /= 2


def surface_points(solid: Solid, spacing: float) -> NDArray[np.float64]:
    """Centres of surface pieces with no edge longer than `spacing` [m], (n, 3)."""
    corners = solid.vertices[solid.triangles]
    done = []
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        fine = edges.max(1) <= spacing
        done.append(corners[fine].mean(1))
        coarse, first = corners[~fine], edges[~fine].argmax(1)
        rows = np.arange(len(coarse))
        a, b, c = coarse[rows, first], coarse[rows, (first + 1) % 3], coarse[rows, (first + 2) % 3]
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def conflict(blueprint: Blueprint, most: float) -> Failure | None:
    """The first pair of motors, boxes and tunnels that share more than `most` [m3]."""
    things = [
        (f"the motor of {blueprint.hinges[seat.hinge].name}", motor_solid(blueprint, seat)) for seat in blueprint.seats
    ]
    things += [(f"the {seat.kind}", box_solid(seat)) for seat in blueprint.boxes]
    things += [(wire.name, tunnel(wire)) for wire in blueprint.wires]
    for (name, a), (other, b) in itertools.combinations(things, 2):
        shared = a.overlap(b)
        if shared > most:
            return Failure(Stage.PRINT, Reason.OVERLAP, f"{name} and {other} share {1e9 * shared:.1f} mm3")
    return None
