"""URDF and MJCF of a described robot, SI units, with meshes beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from mfg.blueprint import Transform
from mfg.catalogue import Motor
from mfg.description import HULL_VERTICES, Description, Link
from mfg.stl import stl_bytes

MESHES = "meshes"  # folder beside the robot files
FRICTION = (0.8, 0.005, 0.0001)  # sliding of TPU on a floor (assumed), torsion [m], rolling [m]
STALL_OVER_PEAK = 2.0  # (assumed) what the winding would give at stall over what the driver allows
TIMESTEP = 0.004  # [s]
CONTACT_TIME = 0.02  # time constant of the soft skin's contact [s]
SKIN_MATERIAL = "skin_material"  # numeric of an MJCF: solid modulus [Pa], wall [m], infill, solid density [kg/m3]
SKIN_THICKNESS = "skin_thickness:"  # and, with a link's name behind it, how thick its skin is [m]
_GREY = "#D9DCE1"


@dataclass(frozen=True, eq=False, slots=True)
class Visual:
    """A mesh to look at.

    Attributes:
        name: file name without suffix.
        link: index of the link that it moves with.
        vertices: in the link's frame [m], (n, 3).
        triangles: (m, 3).
        colour: #RRGGBB.
        alpha: 1 is opaque.
    """

    name: str
    link: int
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    colour: str = _GREY
    alpha: float = 1.0


def mesh_files(description: Description, visuals: Sequence[Visual]) -> dict[str, bytes]:
    """The STL files [m] that both robot files refer to, by their path."""
    files = {f"{MESHES}/{v.name}.stl": stl_bytes(v.vertices, v.triangles, v.name) for v in visuals}
    for link in description.links:
        files[f"{MESHES}/{hull_name(link)}.stl"] = stl_bytes(link.hull, hull_triangles(link.hull), hull_name(link))
    return files


def hull_name(link: Link) -> str:
    """File name of a link's collision hull, without suffix."""
    return f"{link.name}_hull"


def hull_triangles(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Outward-facing triangles (m, 3) of the convex hull of points (n, 3)."""
    hull = ConvexHull(points)
    triangles = hull.simplices.astype(np.int64)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, [0, 2, 1]]
    return triangles


def urdf(description: Description, visuals: Sequence[Visual] = ()) -> str:
    """The robot as URDF; the root link floats freely."""
    robot = ET.Element("robot", name=f"bodyplan_{description.name}")
    # For MuJoCo's own reader only; everyone else skips this element.
    extension = ET.SubElement(robot, "mujoco")
    ET.SubElement(extension, "compiler", strippath="false", balanceinertia="false", discardvisual="false",
                  fusestatic="false")  # fmt: skip
    for index, link in enumerate(description.links):
        element = ET.SubElement(robot, "link", name=link.name)
        inertial = ET.SubElement(element, "inertial")
        ET.SubElement(inertial, "origin", xyz=_numbers(link.com), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_number(link.mass))
        I = link.inertia
        ET.SubElement(inertial, "inertia", ixx=_number(I[0, 0]), iyy=_number(I[1, 1]), izz=_number(I[2, 2]),
                      ixy=_number(I[0, 1]), ixz=_number(I[0, 2]), iyz=_number(I[1, 2]))  # fmt: skip
        for visual in visuals:
            if visual.link == index:
                shown = ET.SubElement(element, "visual", name=visual.name)
                _urdf_mesh(shown, visual.name)
                material = ET.SubElement(shown, "material", name=visual.name)
                ET.SubElement(material, "color", rgba=_rgba(visual.colour, visual.alpha))
        _urdf_mesh(ET.SubElement(element, "collision", name=link.name), hull_name(link))
    for joint in description.joints:
        link = description.links[joint.link]
        element = ET.SubElement(robot, "joint", name=joint.name, type="revolute")
        ET.SubElement(element, "parent", link=description.links[link.parent].name)
        ET.SubElement(element, "child", link=link.name)
        ET.SubElement(element, "origin", xyz=_numbers(link.T), rpy="0 0 0")
        ET.SubElement(element, "axis", xyz=_numbers(joint.axis))
        low, high = joint.range
        ET.SubElement(element, "limit", lower=_number(low), upper=_number(high),
                      effort=_number(joint.motor.peak_torque), velocity=_number(joint.motor.max_speed))  # fmt: skip
        ET.SubElement(element, "dynamics", damping="0", friction=_number(joint.motor.friction))
    imu = ET.SubElement(robot, "link", name="imu")
    ET.SubElement(imu, "inertial").extend(
        [ET.Element("mass", value="1e-6"), ET.Element("inertia", ixx="1e-9", iyy="1e-9", izz="1e-9", ixy="0", ixz="0",
                                                      iyz="0")]
    )  # fmt: skip
    fixed = ET.SubElement(robot, "joint", name="imu", type="fixed")
    ET.SubElement(fixed, "parent", link=description.links[description.imu_link].name)
    ET.SubElement(fixed, "child", link="imu")
    T = description.T_link_imu
    ET.SubElement(fixed, "origin", xyz=_numbers(T[:3, 3]), rpy=_numbers(_roll_pitch_yaw(T)))
    return _text(robot)


def mjcf(description: Description, visuals: Sequence[Visual] = ()) -> str:
    """The robot as MJCF on a floor: described masses, massless hulls that touch the floor only, one motor per hinge."""
    root = ET.Element("mujoco", model=description.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", meshdir=MESHES)
    ET.SubElement(root, "option", timestep=_number(TIMESTEP), integrator="implicitfast", cone="elliptic", impratio="10")
    ET.SubElement(root, "size", nuser_actuator="1")
    custom = ET.SubElement(root, "custom")
    skin = description.skin
    material = (skin.youngs_modulus, skin.wall, skin.infill, skin.density)
    ET.SubElement(custom, "numeric", name=SKIN_MATERIAL, data=_numbers(material))
    for link in description.links:
        ET.SubElement(custom, "numeric", name=SKIN_THICKNESS + link.name, data=_number(link.skin_thickness))
    default = ET.SubElement(root, "default")
    seen = ET.SubElement(default, "default", {"class": "visual"})
    ET.SubElement(seen, "geom", type="mesh", mass="0", contype="0", conaffinity="0", group="2")
    felt = ET.SubElement(default, "default", {"class": "collision"})
    ET.SubElement(felt, "geom", type="mesh", mass="0", contype="0", conaffinity="1", group="3", condim="3",
                  friction=_numbers(FRICTION), solref=f"{CONTACT_TIME} 1")  # fmt: skip
    asset = ET.SubElement(root, "asset")
    for visual in visuals:
        # A visual mesh has no mass, so that its volume does not matter: thin and hollow parts load too.
        ET.SubElement(asset, "mesh", name=visual.name, file=f"{visual.name}.stl", inertia="shell")
    for link in description.links:
        name = hull_name(link)
        ET.SubElement(asset, "mesh", name=name, file=f"{name}.stl", maxhullvert=str(HULL_VERTICES))
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 3", dir="0 0 -1", directional="true")
    ET.SubElement(world, "geom", name="floor", type="plane", size="0 0 1", contype="1", conaffinity="0", condim="3",
                  friction=_numbers(FRICTION), solref=f"{CONTACT_TIME} 1", rgba="0.85 0.87 0.9 1")  # fmt: skip
    bodies: list[ET.Element] = []
    hinges = {joint.link: joint for joint in description.joints}
    for index, link in enumerate(description.links):
        parent = bodies[link.parent] if link.parent >= 0 else world
        place = link.T if link.parent >= 0 else np.array([0.0, 0.0, description.standing_height])
        body = ET.SubElement(parent, "body", name=link.name, pos=_numbers(place))
        I = link.inertia
        ET.SubElement(body, "inertial", pos=_numbers(link.com), mass=_number(link.mass),
                      fullinertia=_numbers([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]))  # fmt: skip
        if link.parent < 0:
            ET.SubElement(body, "freejoint", name="base")
        elif index in hinges:
            joint = hinges[index]
            ET.SubElement(body, "joint", name=joint.name, type="hinge", axis=_numbers(joint.axis),
                          range=_numbers(joint.range), armature=_number(joint.motor.armature),
                          frictionloss=_number(joint.motor.friction))  # fmt: skip
        ET.SubElement(body, "geom", {"class": "collision", "name": link.name, "mesh": hull_name(link)})
        for visual in visuals:
            if visual.link == index:
                ET.SubElement(body, "geom", {"class": "visual", "mesh": visual.name,
                                             "rgba": _rgba(visual.colour, visual.alpha)})  # fmt: skip
        if index == description.imu_link:
            T = description.T_link_imu
            ET.SubElement(body, "site", name="imu", pos=_numbers(T[:3, 3]), xyaxes=_numbers([*T[:3, 0], *T[:3, 1]]))
        bodies.append(body)
    actuator = ET.SubElement(root, "actuator")
    for joint in description.joints:
        _dcmotor(actuator, joint.name, joint.motor)
    sensor = ET.SubElement(root, "sensor")
    ET.SubElement(sensor, "framequat", name="orientation", objtype="site", objname="imu")
    ET.SubElement(sensor, "gyro", name="gyro", site="imu")
    ET.SubElement(sensor, "accelerometer", name="accelerometer", site="imu")
    return _text(root)


def _dcmotor(actuator: ET.Element, name: str, motor: Motor) -> None:
    """Position control within the peak torque and the torque-speed line; kp and kd as the wire sends them."""
    stall = STALL_OVER_PEAK * motor.peak_torque
    ET.SubElement(
        actuator, "dcmotor", name=name, joint=name, nominal=_numbers([motor.voltage, stall, motor.max_speed]),
        saturation=_numbers([motor.peak_torque, 0, 0]),
        controller=_numbers([motor.stiffness, 0, motor.damping, 0, 0, motor.voltage]), input="pos",
        user=_number(motor.continuous_torque), delay=_number(motor.latency),
        nsample=str(math.ceil(motor.latency / TIMESTEP - 1e-9)),
    )  # fmt: skip


def _urdf_mesh(parent: ET.Element, name: str) -> None:
    ET.SubElement(parent, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(ET.SubElement(parent, "geometry"), "mesh", filename=f"{MESHES}/{name}.stl")


def _roll_pitch_yaw(T: Transform) -> list[float]:
    """Fixed-axis angles of a rotation, R = Rz(yaw) Ry(pitch) Rx(roll) [rad]."""
    R = T[:3, :3]
    pitch = math.asin(max(-1.0, min(1.0, -R[2, 0])))
    if abs(R[2, 0]) > 1 - 1e-9:  # Looking straight up or down: all of the turn goes into roll.
        return [math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0]
    return [math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])]


def _rgba(colour: str, alpha: float) -> str:
    return _numbers([*(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)), alpha])


def _numbers(values: Sequence[float] | NDArray[np.float64]) -> str:
    return " ".join(_number(float(v)) for v in values)


def _number(value: float) -> str:
    return f"{value:.10g}"


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
