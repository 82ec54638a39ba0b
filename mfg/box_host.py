"""A bone that may take a battery or a controller: its free room, and the scores of what sits in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, BoxSeat
from mfg.fields import Field, cylinder_distance
from mfg.insertion import interference_above, mount_reach, outer_surface, shaft_height
from mfg.mounts import Mount, mount_of
from mfg.scores import (
    crossings,
    electronics_install_score,
    electronics_score,
    largest_clearance,
    oriented_extents,
    size_penalty,
)

Array = NDArray[np.float64]
Kind = Literal["battery", "controller"]
KINDS: tuple[Kind, ...] = ("battery", "controller")


@dataclass(frozen=True, eq=False)
class Host:
    """A body that may take a box.

    Attributes:
        blueprint: with seats.
        index: of the body.
        mount: of every motor.
    """

    blueprint: Blueprint
    index: int
    mount: Mount

    @property
    def name(self) -> str:
        """The body's name."""
        return self.blueprint.bodies[self.index].name

    @cached_property
    def samples(self) -> int:
        """Bone volume in lattice samples."""
        return int(np.count_nonzero(self.blueprint.bodies[self.index].bone.values > 0))

    @cached_property
    def middle(self) -> Array:
        """Centre of mass of the bone [m], (3,)."""
        bone = self.blueprint.bodies[self.index].bone
        return (np.argwhere(bone.values > 0).mean(axis=0) + bone.corner) * bone.spacing

    @cached_property
    def free(self) -> Field:
        """Depth of the bone away from motor mounts."""
        return free_depth(self.blueprint, self.index)

    @cached_property
    def anchor(self) -> Array:
        """Centre of mass of the bone without the room of the mounts [m]."""
        return self.free.centroid()

    @cached_property
    def frames(self) -> tuple[Array, Array]:
        """Right-handed frames (columns) to turn boxes in: the design axes, the bone's principal axes."""
        points = np.argwhere(self.free.values > 0).astype(np.float64)
        centred = points - points.mean(axis=0)
        _, axes = np.linalg.eigh(centred.T @ centred)
        for column in range(2):  # Fix the signs that an eigenvector leaves open.
            axes[:, column] *= np.sign(axes[np.abs(axes[:, column]).argmax(), column])
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        return np.eye(3), axes

    @property
    def outline(self) -> Array:
        """Points on the surface of the bone with its own mounts [m], (n, 3)."""
        bone = self.blueprint.bodies[self.index].bone
        rims = [
            _rims(seat.T_design_motor, self.mount, seat.holder == self.index)
            for seat in self.blueprint.seats
            if self.index in (seat.holder, seat.connector)
        ]
        return np.concatenate([crossings(bone), *rims])

    def seat(
        self, kind: Kind, frame: Array, centre: Array, half: Array, way: tuple[int, int], clearance: float
    ) -> BoxSeat:
        """A box seat whose z axis points along the given way of the frame."""
        axis, sign = way
        z, x = sign * frame[:, axis], frame[:, (axis + 1) % 3]
        T = np.eye(4)
        T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = x, np.cross(z, x), z, self.anchor + frame @ centre
        size = 2 * half[[(axis + 1) % 3, (axis + 2) % 3, axis]]
        seat = BoxSeat(kind, self.index, (float(size[0]), float(size[1]), float(size[2])), T, clearance, 0.0)
        return replace(seat, shaft=shaft_height(outer_surface(self.blueprint.bodies[self.index]), seat))


def scored(blueprint: Blueprint, boxes: tuple[BoxSeat, ...], hosts: list[Host]) -> Blueprint:
    """The blueprint with the boxes in their hosts and the two electronics scores; of two hosts the worse one counts."""
    placed = replace(blueprint, boxes=boxes)
    catalogue = blueprint.catalogue
    V_cap = sum(interference_above(placed, box) for box in boxes)
    electronics = [
        electronics_score(
            largest_clearance(host.free),
            size_penalty(oriented_extents(host.outline), catalogue.printer.volume),
            catalogue,
        )
        for host in hosts
    ]
    return placed.scored(electronics=min(electronics), electronics_install=electronics_install_score(V_cap, catalogue))


def free_depth(blueprint: Blueprint, index: int) -> Field:
    """Depth of a bone that also keeps away from every motor mount: min(phi, distance to the mounts)."""
    bone, mount = blueprint.bodies[index].bone, mount_of(blueprint.catalogue.motor)
    inside = np.nonzero(bone.values > 0)
    points = (np.stack(inside, axis=-1) + np.array(bone.corner)) * bone.spacing
    depth = bone.values[inside]
    for seat in blueprint.seats:
        # A ball about the mount rules most samples out.
        away = np.linalg.norm(points - seat.T_design_motor[:3, 3], axis=-1) - mount_reach(mount)
        near = np.flatnonzero(away < depth)
        T = seat.T_design_motor
        cup = cylinder_distance(points[near], T, mount.holder_radius, mount.base_low, mount.connector_low)
        disc = cylinder_distance(points[near], T, mount.connector_radius, mount.connector_low, mount.connector_high)
        depth[near] = np.minimum(depth[near], np.minimum(cup, disc))
    values = bone.values.copy()
    values[inside] = depth
    return bone.with_values(values)


def _rims(T_design_motor: Array, mount: Mount, holds: bool) -> Array:
    """Points on the two rims of a holder or connector in the design frame [m], (n, 3)."""
    angle = np.arange(24) * (2 * np.pi / 24)
    radius = mount.holder_radius if holds else mount.connector_radius
    heights = (mount.base_low, mount.connector_low) if holds else (mount.connector_low, mount.connector_high)
    local = np.concatenate(
        [np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(24, z)]) for z in heights]
    )
    return local @ T_design_motor[:3, :3].T + T_design_motor[:3, 3]
