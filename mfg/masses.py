"""Mass, centre and inertia of each body: what the printer lays down plus every component at its pose."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, MassProperties, Transform, WireRun
from mfg.catalogue import Filament, Motor
from mfg.moments import (
    NOTHING,
    Moments,
    box_moments,
    covering_moments,
    cylinder_moments,
    outline_moments,
    placed,
    point_moments,
    polyline_moments,
    printed_moments,
)
from mfg.mounts import Mount, connector, holder, motor_pose, mount_of
from mfg.outline import Outline, outline


def outlines(blueprint: Blueprint) -> list[tuple[Outline, Outline | None]]:
    """The outline of every body's bone and, where it has one, of its skin with the bone in it."""
    return [(outline(b.bone), None if b.skin is None else outline(b.skin)) for b in blueprint.bodies]


def body_masses(
    blueprint: Blueprint, shapes: Sequence[tuple[Outline, Outline | None]] | None = None
) -> tuple[MassProperties, ...]:
    """Mass properties of every body, in the order of `blueprint.bodies`.

    Printed matter is taken from `blueprint.parts` where they exist and from the fields otherwise, with the mounts of
    motors that have seats and the walls about boxes and tunnels that have places. A motor belongs to
    the body that holds its housing; its rotor turns with the output, but is counted here as part of the motor, and its
    spin enters the simulation as armature. Before motors have seats they sit at their hinges, on the parent, and
    before the electronics have theirs they sit at the root's centre. `shapes` are the blueprint's `outlines`, from
    a caller who has them already.
    """
    moments = [NOTHING for _ in blueprint.bodies]
    for body, printed in printed_by_body(blueprint, shapes):
        moments[body] = moments[body] + printed
    for body, component in component_moments(blueprint):
        moments[body] = moments[body] + component
    return tuple(m.properties() for m in moments)


def printed_by_body(
    blueprint: Blueprint, shapes: Sequence[tuple[Outline, Outline | None]] | None = None
) -> list[tuple[int, Moments]]:
    """(body, moments) of everything that is printed."""
    rigid, soft, width = blueprint.catalogue.rigid, blueprint.catalogue.soft, blueprint.catalogue.printer.line_width
    if blueprint.parts:
        return [(part.body, printed_moments(part.solid.vertices, part.solid.triangles,
                                            rigid if part.material == "rigid" else soft, width))
                for part in blueprint.parts]  # fmt: skip
    found = []
    for index, (body, (bone, skin)) in enumerate(zip(blueprint.bodies, shapes or outlines(blueprint), strict=True)):
        found.append((index, outline_moments(bone, rigid, width)))
        if body.skin is not None and skin is not None:
            covered = (body.bone.sample(skin.points) < -width, body.skin.sample(bone.points) > width)
            found.append((index, covering_moments(skin, bone, covered, soft, width)))
    mount = mount_of(blueprint.catalogue.motor)
    for seat in blueprint.seats:
        cup, disc = mount_moments(mount, rigid, width)
        # What a half shares with its bone is counted there.
        found.append((seat.holder, placed(cup.outside(seat.holder_volume), seat.T_design_motor)))
        found.append((seat.connector, placed(disc.outside(seat.connector_volume), seat.T_design_motor)))
    return found + _about_cavities(blueprint)


def _about_cavities(blueprint: Blueprint) -> list[tuple[int, Moments]]:
    """(body, moments) of the walls about boxes and tunnels, less the infill that was where these are."""
    rigid, width = blueprint.catalogue.rigid, blueprint.catalogue.printer.line_width
    wall = rigid.density * (1.0 - rigid.infill) * rigid.walls * width  # [kg/m2]
    filled = rigid.density * rigid.infill  # [kg/m3]
    found = []
    for box in blueprint.boxes:
        x, y, z = (side + 2 * box.clearance for side in box.size)
        mass = wall * 2 * (x * y + y * z + z * x) - filled * x * y * z
        found.append((box.body, box_moments(mass, (x, y, z), box.T_design_box)))
    for wire in blueprint.wires:
        linear = wall * 2 * np.pi * wire.radius - filled * np.pi * wire.radius**2
        for body, path in wire_stretches(wire, blueprint):
            inside = blueprint.bodies[body].bone.sample((path[:-1] + path[1:]) / 2) > 0
            found.append((body, polyline_moments(linear, path, inside)))
    return found


@dataclass(frozen=True, eq=False, slots=True)
class HalfMount:
    """One half of a motor's mount as if it were printed alone, motor frame.

    Attributes:
        printed: of its walls and infill.
        volume: of the half [m3].
    """

    printed: Moments
    volume: float

    def outside(self, shared: float) -> Moments:
        """Of what lies outside of its bone, where it shares so much of its volume with that [m3]."""
        return self.printed.scaled(max(0.0, 1.0 - shared / self.volume))


@lru_cache(maxsize=8)
def mount_moments(mount: Mount, filament: Filament, line_width: float) -> tuple[HalfMount, HalfMount]:
    """The cup and the disc of a mount."""
    cup, disc = (
        HalfMount(printed_moments(solid.vertices, solid.triangles, filament, line_width), solid.volume)
        for solid in (holder(mount), connector(mount))
    )
    return cup, disc


def component_moments(blueprint: Blueprint) -> list[tuple[int, Moments]]:
    """(body, moments) of every motor, box and wire."""
    catalogue = blueprint.catalogue
    found = []
    if blueprint.seats:
        found += [(seat.holder, motor_moments(catalogue.motor, seat.T_design_motor)) for seat in blueprint.seats]
    else:
        found += [
            (h.parent, motor_moments(catalogue.motor, motor_pose(h.position, h.axis, 0.0))) for h in blueprint.hinges
        ]
    masses = {"battery": catalogue.battery.mass, "controller": catalogue.computer.mass}
    if blueprint.boxes:
        found += [(seat.body, box_moments(masses[seat.kind], seat.size, seat.T_design_box)) for seat in blueprint.boxes]
    elif blueprint.bodies:
        pose = np.eye(4)
        pose[:3, 3] = blueprint.bodies[0].bone.centroid()
        found.append((0, box_moments(catalogue.battery.mass, catalogue.battery.size, pose)))
        found.append((0, box_moments(catalogue.computer.mass, catalogue.computer.size, pose)))
    linear = catalogue.wire.mass_per_metre
    for wire in blueprint.wires:
        found += [(body, polyline_moments(linear, path)) for body, path in wire_stretches(wire, blueprint)]
        for crossing in wire.crossings:
            hinge = blueprint.hinges[crossing.hinge]
            loop = point_moments(linear * crossing.slack / 2, crossing.position)
            found += [(hinge.parent, loop), (hinge.body, loop)]
    return found


def motor_moments(motor: Motor, pose: Transform) -> Moments:
    """A motor as a uniform cylinder about z of its frame."""
    return cylinder_moments(motor.mass, motor.diameter / 2, motor.length, pose)


def wire_stretches(wire: WireRun, blueprint: Blueprint) -> list[tuple[int, NDArray[np.float64]]]:
    """(body, path (k, 3)) of the stretches of a cable, each with the body it lies deepest in, controller first."""
    middle = (wire.path[:-1] + wire.path[1:]) / 2
    depth = np.stack([(body.skin or body.bone).sample(middle) for body in blueprint.bodies])
    seat = blueprint.seats[wire.seat]
    owner = np.where(depth.max(0) > -0.5, depth.argmax(0), seat.holder)  # beyond every lattice: with the motor
    cuts = [0, *(np.flatnonzero(np.diff(owner)) + 1).tolist(), len(owner)]
    return [(int(owner[a]), wire.path[a : b + 1]) for a, b in itertools.pairwise(cuts)]
