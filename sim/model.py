"""A described robot as a MuJoCo model, the same builder for a bare design and for its blueprint twin."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from mfg.catalogue import Motor
from mfg.description import HULL_VERTICES, DescribedJoint, Description, SkinMaterial
from mfg.robot_files import CONTACT_TIME, FRICTION, STALL_OVER_PEAK
from sim.self_collision import let_links_touch
from sim.skin import Fidelity, apply, skin_name
from sim.skin_file import read_covers
from sim.skin_law import Cover

CONTINUOUS_OVER_PEAK = 1.0 / 3.0  # (assumed) for a model file that does not say
WIRE_STIFFNESS_STEP = 1.0  # the least change of kp on the wire [N.m/rad]
WIRE_DAMPING_STEP = 0.2  # the least change of kd on the wire [N.m.s/rad]
IMU = "imu"  # name of the site that carries the IMU
FLOOR = "floor"  # name of the ground plane

Model: TypeAlias = mujoco.MjModel

# Places in a dcmotor's gain parameters (MuJoCo 4.0).
RESISTANCE, MOTOR_CONSTANT, STIFFNESS, DAMPING, VOLTAGE = 0, 1, 4, 6, 7


class ModelError(ValueError):
    """A model file is unusable; the message names the file, what is wrong and what is expected."""


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """What drives the hinges of a model, one entry per actuator.

    Attributes:
        names: of the driven hinges.
        position: place of each hinge's angle in qpos, (n,).
        velocity: place of each hinge's speed in qvel, (n,).
        range: least and greatest angle [rad], (n, 2).
        continuous_torque: what a motor bears for long [N.m], (n,).
    """

    names: tuple[str, ...]
    position: NDArray[np.intp]
    velocity: NDArray[np.intp]
    range: NDArray[np.float64]
    continuous_torque: NDArray[np.float64]


def compile_model(
    description: Description, *, timestep: float | None = None, fidelity: Fidelity = Fidelity.COMPLIANT,
    self_collision: bool = False, contact_time: float | None = CONTACT_TIME,
) -> Model:  # fmt: skip
    """Build the model of a robot on a floor: x forward, y left, z up, the root above the origin.

    Each link has its described mass, centre and inertia and one massless convex hull, which touches the floor only.
    Each hinge has a `dcmotor` with the motor's peak torque, torque-speed line, gains as the wire quantises them,
    armature, dry friction and latency; its control is the target angle [rad].

    Args:
        description: of the robot.
        timestep: of the physics [s]; the fidelity's own by default.
        fidelity: how the soft skin is modelled.
        self_collision: whether links may touch one another, see `sim.self_collision`.
        contact_time: time constant of soft contacts [s]; None fits each to its skin (docs/fidelity.md).

    Raises:
        ValueError: if there is no joint, or a link's mass, inertia or hull is not that of a body, or links are to touch
            that are finite elements.
    """
    spec = make_spec(
        description, timestep=timestep, fidelity=fidelity, self_collision=self_collision, contact_time=contact_time
    )
    return _compiled(spec, description.name)


def make_spec(
    description: Description, *, timestep: float | None = None, fidelity: Fidelity = Fidelity.COMPLIANT,
    self_collision: bool = False, contact_time: float | None = CONTACT_TIME,
) -> mujoco.MjSpec:  # fmt: skip
    """The specification behind `compile_model`, which can still be edited."""
    if not description.joints:
        raise ValueError(f"robot {description.name} has no joint to drive; it needs at least one")
    timestep = fidelity.timestep if timestep is None else timestep
    _log_nothing()
    spec = mujoco.MjSpec()
    spec.modelname = description.name
    spec.compiler.degree = False
    spec.nuser_actuator = 1
    bodies: list[mujoco.MjsBody] = []
    hinges = {joint.link: joint for joint in description.joints}
    for index, link in enumerate(description.links):
        parent = bodies[link.parent] if link.parent >= 0 else spec.worldbody
        position = link.T if link.parent >= 0 else (0.0, 0.0, description.standing_height)
        body = parent.add_body(name=link.name, pos=position)
        body.mass, body.ipos, body.explicitinertial = link.mass, link.com, True
        I = link.inertia
        body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        if link.parent < 0:
            body.add_freejoint(name="base")
        elif index in hinges:
            _add_hinge(body, hinges[index])
        bodies.append(body)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ravel(description.T_link_imu[:3, :3]).astype(np.float64))
    bodies[description.imu_link].add_site(name=IMU, pos=description.T_link_imu[:3, 3], quat=quaternion)
    skeleton = _compiled(spec, description.name)  # without hulls, which are what takes time
    _set_world(spec, timestep)
    most = -1 if fidelity is Fidelity.HULL else HULL_VERTICES
    for link, body in zip(description.links, bodies, strict=True):
        spec.add_mesh(name=link.name, uservert=np.ravel(link.hull), maxhullvert=most)
        body.add_geom(
            name=link.name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=link.name, mass=0.0, contype=0, conaffinity=1,
            condim=3, friction=FRICTION, solref=(CONTACT_TIME, 1.0),
        )  # fmt: skip
    for joint in description.joints:
        add_motor(spec, joint.name, joint.motor, timestep)
    inner = {link.parent for link in description.links}
    covers = [
        Cover(link.name, link.skin_thickness, link.hull, link.mass, link.com, link.inertia, index not in inner,
              float(skeleton.body(link.name).invweight0[0]))
        for index, link in enumerate(description.links)
    ]  # fmt: skip
    parents = {link.name: description.links[link.parent].name for link in description.links if link.parent >= 0}
    _finish(spec, description.name, fidelity, covers, description.skin, parents, self_collision, contact_time)
    return spec


def load_model(
    path: Path | str, *, timestep: float | None = None, fidelity: Fidelity = Fidelity.COMPLIANT,
    self_collision: bool = False, contact_time: float | None = CONTACT_TIME,
) -> Model:  # fmt: skip
    """Read a robot from an MJCF file into the same world as `compile_model`: floor, contact law, skin and integrator.

    Raises:
        ModelError: if the file is no MJCF, or not a floating robot with driven hinges, or says nonsense of its skin.
        OSError: if it cannot be read.
    """
    spec = load_spec(
        path, timestep=timestep, fidelity=fidelity, self_collision=self_collision, contact_time=contact_time
    )
    try:
        return spec.compile()
    except ValueError as error:
        raise ModelError(f"{path}: {_first_line(error)}") from None


def load_spec(
    path: Path | str, *, timestep: float | None = None, fidelity: Fidelity = Fidelity.COMPLIANT,
    self_collision: bool = False, contact_time: float | None = CONTACT_TIME,
) -> mujoco.MjSpec:  # fmt: skip
    """Read an MJCF file as a specification that can still be edited; see `load_model`.

    The file's own numerics say what its skin is, see `sim.skin_file`.
    """
    path = Path(path)
    path.open("rb").close()  # a missing file is an OSError, not a parser's complaint
    timestep = fidelity.timestep if timestep is None else timestep
    _log_nothing()
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ModelError(f"{path}: not a readable MJCF file ({_first_line(error)})") from None
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        raise ModelError(f"{path}: {len(free)} free joints; a robot has one, at its root")
    if not spec.actuators:
        raise ModelError(f"{path}: no actuator; a robot needs one on each driven hinge")
    hinges = {joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE}
    for actuator in spec.actuators:
        if actuator.target not in hinges or actuator.gaintype != mujoco.mjtGain.mjGAIN_DCMOTOR:
            raise ModelError(f"{path}: actuator {actuator.name!r} is not a dcmotor on a hinge; write it as one")
        if actuator.delay > 0:
            actuator.nsample = _samples(actuator.delay, timestep)
    _set_world(spec, timestep)
    if fidelity is Fidelity.HULL:
        for mesh in spec.meshes:
            mesh.maxhullvert = -1
    try:
        material, covers, parents = read_covers(spec)
        _finish(spec, spec.modelname, fidelity, covers, material, parents, self_collision, contact_time)
    except ValueError as error:
        raise ModelError(f"{path}: {_first_line(error)}") from None
    return spec


def add_motor(spec: mujoco.MjSpec, joint: str, motor: Motor, timestep: float) -> None:
    """Drive a hinge by a motor: torque within the peak and within voltage (1 - speed / no-load speed) stall torque."""
    actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    stiffness = quantised(motor.stiffness, WIRE_STIFFNESS_STEP)
    damping = quantised(motor.damping, WIRE_DAMPING_STEP)
    actuator.set_to_dcmotor(
        motorconst=[0.0, 0.0], resistance=0.0,
        nominal=[motor.voltage, STALL_OVER_PEAK * motor.peak_torque, motor.max_speed],
        saturation=[motor.peak_torque, 0.0, 0.0],
        controller=[stiffness, 0.0, damping, 0.0, 0.0, motor.voltage],
        ctrlspec=mujoco.mjtCtrlInput.mjINPUT_POS,
    )  # fmt: skip
    actuator.userdata = [motor.continuous_torque]
    if motor.latency > 0:
        actuator.delay, actuator.nsample = motor.latency, _samples(motor.latency, timestep)


def quantised(value: float, step: float) -> float:
    """Round down to a multiple of `step`, as the wire format does."""
    return math.floor(value / step + 1e-9) * step


def drive_of(model: Model) -> Drive:
    """Find what drives a model; the order is that of its controls."""
    joints = model.actuator_trnid[:, 0]
    peak = model.actuator_forcerange[:, 1]
    continuous = model.actuator_user[:, 0] if model.nuser_actuator else np.zeros(model.nu)
    limited = model.jnt_limited[joints].astype(bool)
    return Drive(
        names=tuple(model.joint(int(j)).name for j in joints),
        position=model.jnt_qposadr[joints].astype(np.intp),
        velocity=model.jnt_dofadr[joints].astype(np.intp),
        range=np.where(limited[:, None], model.jnt_range[joints], (-np.pi, np.pi)),
        continuous_torque=np.where(continuous > 0, continuous, CONTINUOUS_OVER_PEAK * peak),
    )


def default_pose(model: Model) -> NDArray[np.float64]:
    """Targets that hold a robot as it was built, 0 or the nearest angle in range [rad], (n,)."""
    low, high = drive_of(model).range.T
    return np.clip(0.0, low, high)


def model_name(model: Model) -> str:
    """The name a model was compiled under."""
    return bytes(model.names).split(b"\0", 1)[0].decode()


def _finish(
    spec: mujoco.MjSpec, name: str, fidelity: Fidelity, covers: list[Cover], material: SkinMaterial,
    parents: dict[str, str], self_collision: bool, contact_time: float | None,
) -> None:  # fmt: skip
    """Put the skins on, and let links touch if they may."""
    if self_collision and fidelity.cells:
        raise ValueError(f"robot {name}: links of finite elements do not touch one another; use another fidelity")
    try:
        apply(spec, fidelity, covers, material, contact_time)
        if self_collision:
            pads = {c.name: skin_name(c.name) if c.is_soft and fidelity is Fidelity.SPRUNG else c.name for c in covers}
            kin = {pads[a]: pads[b] for a, b in parents.items() if a in pads and b in pads}
            let_links_touch(spec, list(pads.values()), kin)
    except ValueError as error:
        raise ValueError(f"robot {name} is no model: {_first_line(error)}") from None


def _compiled(spec: mujoco.MjSpec, name: str) -> Model:
    try:
        return spec.compile()
    except ValueError as error:
        raise ValueError(f"robot {name} is no model: {_first_line(error)}") from None


def _add_hinge(body: mujoco.MjsBody, joint: DescribedJoint) -> None:
    body.add_joint(
        name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, range=joint.range,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE, armature=joint.motor.armature, frictionloss=joint.motor.friction,
    )  # fmt: skip


def _set_world(spec: mujoco.MjSpec, timestep: float) -> None:
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # The pyramidal cone and the default impratio let feet creep by millimetres a second.
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
        spec.worldbody.add_geom(
            name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 1.0), contype=1, conaffinity=0,
            condim=3, friction=FRICTION, solref=(CONTACT_TIME, 1.0),
        )  # fmt: skip


def _samples(delay: float, timestep: float) -> int:
    """How many commands are on their way during a delay."""
    return math.ceil(delay / timestep - 1e-9)


def _log_nothing() -> None:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the user's folder: an explosion is a result, read from the data."""
    config = mujoco.MjLogConfig.get()
    config.logto_file = config.logto_console = False
    config.set()


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:160]
