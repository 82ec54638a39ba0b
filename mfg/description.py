"""The robot as a simulator sees it: the one source of URDF, MJCF and the model builder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mfg.addresses import can_address, turn_sign
from mfg.blueprint import Blueprint, Transform
from mfg.catalogue import Filament, Motor
from mfg.fields import Field
from mfg.hulls import thinned
from mfg.masses import body_masses, outlines
from mfg.outline import outline
from mfg.parts import PAPER

HULL_VERTICES = 128  # at most, per link
FULL_HULL = 10**6  # more vertices than any hull has
_DEPTH_KNOWN = 0.03  # from a bone's surface, at least so far out [m]


@dataclass(frozen=True, slots=True)
class SkinMaterial:
    """The printed soft material as its mechanics need it.

    Attributes:
        youngs_modulus: of the solid filament [Pa].
        wall: thickness of the perimeters, walls times line width [m].
        infill: share of the inside that is filled, 0 to 1.
        density: of the solid filament [kg/m3].
    """

    youngs_modulus: float
    wall: float
    infill: float
    density: float


def skin_material(filament: Filament, line_width: float) -> SkinMaterial:
    """What a filament's record and the printer's line width [m] say about a skin."""
    return SkinMaterial(filament.youngs_modulus, filament.walls * line_width, filament.infill, filament.density)


PAPER_SKIN = skin_material(PAPER.soft, PAPER.printer.line_width)


@dataclass(frozen=True, eq=False, slots=True)
class Link:
    """One rigid body; its frame has the design's axes (z up) and its origin at its hinge, the root's at its own com.

    Attributes:
        name: body name.
        parent: index of the parent link, -1 for the root. A parent always comes before its children.
        T: position of this link's origin relative to the parent's origin [m], (3,); the root's in the design frame.
        mass: [kg], with everything mounted in it.
        com: centre of mass in the link frame [m], (3,).
        inertia: about the centre of mass, in link axes [kg.m2], (3, 3).
        hull: vertices of a convex hull of bone and skin in the link frame [m], (n, 3); at most 128 unless more were
            asked for.
        skin_thickness: of the soft skin between bone and hull, the mean over the hull's vertices [m]; 0 is bare bone.
    """

    name: str
    parent: int
    T: NDArray[np.float64]
    mass: float
    com: NDArray[np.float64]
    inertia: NDArray[np.float64]
    hull: NDArray[np.float64]
    skin_thickness: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class DescribedJoint:
    """One driven hinge, through the origin of the link that it moves.

    Attributes:
        name: joint name.
        link: index of the moved link.
        axis: unit vector in the link frame, (3,); the link turns about it by the right-hand rule.
        range: least and greatest angle [rad], (2,); 0 is the pose at rest.
        motor: what drives it.
        can_id: of that motor on its bus, 1 to 15.
        sign: +1, or -1 where the motor turns against the joint because the moved link carries its housing.
    """

    name: str
    link: int
    axis: NDArray[np.float64]
    range: NDArray[np.float64]
    motor: Motor
    can_id: int
    sign: int


@dataclass(frozen=True, eq=False, slots=True)
class Description:
    """A whole robot.

    Attributes:
        name: the design's key.
        links: root first.
        joints: in the order of `blueprint.hinges`.
        imu_link: index of the link that carries the IMU.
        T_link_imu: pose of the IMU in that link's frame, (4, 4).
        source: "blueprint" where motors and electronics have their seats, "design" before.
        standing_height: height of the root link's origin above the ground when the lowest hull vertex touches it [m].
        skin: the material of every link's skin.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[DescribedJoint, ...]
    imu_link: int
    T_link_imu: Transform
    source: Literal["design", "blueprint"]
    standing_height: float
    skin: SkinMaterial = PAPER_SKIN

    @property
    def mass(self) -> float:
        """Of the whole robot [kg]."""
        return sum(link.mass for link in self.links)

    def origins(self) -> NDArray[np.float64]:
        """Origin of every link in the design frame at rest [m], (n, 3)."""
        origins: list[NDArray[np.float64]] = []
        for link in self.links:
            origins.append(link.T if link.parent < 0 else origins[link.parent] + link.T)
        return np.array(origins)


def describe(blueprint: Blueprint, *, hull_vertices: int = HULL_VERTICES) -> Description:
    """Describe a blueprint that has bodies and hinges, whatever stages have run since.

    Args:
        blueprint: the robot.
        hull_vertices: at most so many corners of each hull are kept; FULL_HULL keeps all.

    Raises:
        ValueError: if the blueprint has no bodies yet.
    """
    if not blueprint.bodies:
        raise ValueError(f"design {blueprint.design.key} has no bodies yet; run the skeleton and bone solvers first")
    shapes = None if blueprint.parts else outlines(blueprint)
    masses = blueprint.masses or body_masses(blueprint, shapes)
    origins = [masses[0].com, *(hinge.position for hinge in blueprint.hinges)]
    parents = [-1, *(hinge.parent for hinge in blueprint.hinges)]
    links = []
    for index, body in enumerate(blueprint.bodies):
        origin, parent = np.asarray(origins[index], np.float64), parents[index]
        properties = masses[index]
        if shapes is None:
            points = np.concatenate([part.solid.vertices for part in blueprint.parts if part.body == index])
        else:
            shape = shapes[index][1] or shapes[index][0]  # a skin holds its bone
            points = shape.sparse() if hull_vertices <= HULL_VERTICES else shape.points
        hull, thickness = thinned(points, hull_vertices), 0.0
        if body.skin is not None:
            bare = shapes[index][0] if shapes else outline(body.bone)
            thickness = _mean_cover(body.bone, hull, bare.sparse())
        links.append(Link(
            name=body.name, parent=parent, T=origin if parent < 0 else origin - origins[parent], mass=properties.mass,
            com=properties.com - origin, inertia=properties.inertia,
            hull=hull - origin, skin_thickness=thickness,
        ))  # fmt: skip
    joints = tuple(
        DescribedJoint(
            hinge.name, hinge.body, hinge.axis, hinge.range, blueprint.catalogue.motor, can_address(index)[1],
            turn_sign(blueprint, blueprint.seats[index]) if blueprint.seats else 1,
        )
        for index, hinge in enumerate(blueprint.hinges)
    )  # fmt: skip
    imu_link, T_link_imu = 0, np.eye(4)
    if blueprint.boxes:
        seat = blueprint.box("controller")
        imu_link, T_link_imu = seat.body, seat.T_design_box.copy()
        T_link_imu[:3, 3] -= origins[imu_link]
    lowest = min(float((link.hull[:, 2] + origins[i][2]).min()) for i, link in enumerate(links))
    return Description(
        name=blueprint.design.key, links=tuple(links), joints=joints, imu_link=imu_link, T_link_imu=T_link_imu,
        source="blueprint" if blueprint.seats else "design", standing_height=float(origins[0][2]) - lowest,
        skin=skin_material(blueprint.catalogue.soft, blueprint.catalogue.printer.line_width),
    )  # fmt: skip


def _mean_cover(bone: Field, points: NDArray[np.float64], at_surface: NDArray[np.float64]) -> float:
    """Mean distance of points (n, 3) on the skin from the bone [m]; a point inside the bone counts as 0.

    The bone is given by its depth and by points on its surface, (m, 3).
    """
    distance = -bone.sample(points).astype(np.float64)
    far = distance > _DEPTH_KNOWN
    if far.any():  # a bone's depth is kept near it only
        distance[far] = cKDTree(at_surface).query(points[far])[0]
    return float(np.maximum(distance, 0.0).mean())
