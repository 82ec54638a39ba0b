"""The policy bundle: all that a robot needs to run one policy (numpy and the standard library only)."""

from __future__ import annotations

import json
import math
import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hardware.actor_document import actor_document, parse_actor
from hardware.document import BundleError as BundleError
from hardware.document import array, number, numbers, read_json, record, same_names, shown, text
from sim.actor import Policy

BUNDLE_VERSION = 2
BUNDLE_FILE = "bundle.json"
MODEL_FILE = "robot.xml"
MESH_FOLDER = "meshes"
TURN_ERROR = 1e-6  # of the products of a rotation's columns
NUM_CAN_IDS = 16  # a motor id has 4 bits on the wire

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class JointSetup:
    """One driven joint as the robot needs it: where its motor is on the bus, and what it may do."""

    name: str
    can_id: int  # 0 to 15
    sign: int  # +1, or -1 where the motor turns against the joint
    range: tuple[float, float]  # of the joint [rad]
    default: float  # pose before the policy takes over [rad]
    kp: float  # as the wire quantises it [N.m/rad]
    kd: float  # as the wire quantises it [N.m.s/rad]
    peak_torque: float  # [N.m]
    continuous_torque: float  # [N.m]
    max_speed: float  # [rad/s]


@dataclass(frozen=True, eq=False, slots=True)
class Bundle:
    """All that a robot needs to run one policy; the order of `joints` is the order of every joint vector.

    Raises:
        BundleError: A field is out of bounds, or the actor and the joints disagree.
    """

    design: str  # key of the design it was made for
    joints: tuple[JointSetup, ...]
    actor: Policy
    dt: float  # control period [s]
    time_constant: float = 0.0  # of the action low-pass, 0 for none [s]
    config_hash: str = ""  # of the configuration that produced it
    R_link_imu: Array = field(default_factory=lambda: np.eye(3))  # the IMU's axes in those of its link, (3, 3)

    def __post_init__(self) -> None:
        if not self.joints:
            raise BundleError("A bundle needs at least one joint.")
        if self.actor.num_joints != len(self.joints):
            raise BundleError(f"The actor drives {self.actor.num_joints} joints, the bundle has {len(self.joints)}.")
        for what, values in (
            ("name", [joint.name for joint in self.joints]),
            ("can_id", [joint.can_id for joint in self.joints]),
        ):
            if len(set(values)) != len(values):
                raise BundleError(f"Joints must not share a {what}, got {values}.")
        if not (math.isfinite(self.dt) and 0.0 < self.dt <= 1.0):
            raise BundleError(f"Control period dt must lie in (0, 1] s, got {self.dt}.")
        if not (math.isfinite(self.time_constant) and self.time_constant >= 0.0):
            raise BundleError(f"Low-pass time_constant must be finite and >= 0 s, got {self.time_constant}.")
        R = np.array(self.R_link_imu, dtype=np.float64)
        if R.shape != (3, 3) or not (np.abs(R.T @ R - np.eye(3)) <= TURN_ERROR).all() or np.linalg.det(R) < 0:
            raise BundleError(f"R_link_imu must be a rotation matrix (3, 3), got {shown(R.tolist())}.")
        R.setflags(write=False)
        object.__setattr__(self, "R_link_imu", R)
        for joint in self.joints:
            _check_joint(joint)

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names in order."""
        return tuple(joint.name for joint in self.joints)

    def column(self, field: str) -> Array:
        """Collect one numeric field of all joints, (n,) or (n, 2) for `range`."""
        return np.array([getattr(joint, field) for joint in self.joints], dtype=np.float64)


def _check_joint(joint: JointSetup) -> None:
    def refuse(what: str, bound: str) -> BundleError:
        return BundleError(f"Joint {joint.name!r}: {what} must be {bound}, got {getattr(joint, what)!r}.")

    if not 0 <= joint.can_id < NUM_CAN_IDS:
        raise refuse("can_id", "in 0..15")
    if joint.sign not in (-1, 1):
        raise refuse("sign", "+1 or -1")
    low, high = joint.range
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise refuse("range", "finite and increasing")
    if not low <= joint.default <= high:
        raise refuse("default", f"in its range [{low:.4g}, {high:.4g}] rad")
    for what in ("kp", "kd"):
        if not (math.isfinite(getattr(joint, what)) and getattr(joint, what) >= 0.0):
            raise refuse(what, "finite and >= 0")
    for what in ("peak_torque", "continuous_torque", "max_speed"):
        if not (math.isfinite(getattr(joint, what)) and getattr(joint, what) > 0.0):
            raise refuse(what, "finite and > 0")
    if joint.continuous_torque > joint.peak_torque:
        raise refuse("continuous_torque", f"at most the peak torque {joint.peak_torque:.4g} N.m")


_TOP_FIELDS = ("version", "design", "config_hash", "dt", "time_constant", "R_link_imu", "order", "joints", "actor")
_JOINT_NUMBERS = ("default", "kp", "kd", "peak_torque", "continuous_torque", "max_speed")
_JOINT_FIELDS = ("can_id", "sign", "range", *_JOINT_NUMBERS)


def save_bundle(folder: Path, bundle: Bundle, model_folder: Path | None = None) -> None:
    """Write `bundle.json` at full float precision, and the model so that a dry run can simulate the robot.

    Args:
        folder: Made if missing; the bundle file comes last, so a folder that has it is complete.
        bundle: What to write.
        model_folder: A blueprint folder with `robot.xml` and `meshes/` to copy in; None writes no model.

    Raises:
        BundleError: The model's hinges are not the bundle's joints.
        OSError: The folder cannot be written, or the model cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if model_folder is not None:
        check_model(model_folder / MODEL_FILE, bundle)
        shutil.copyfile(model_folder / MODEL_FILE, folder / MODEL_FILE)
        if (model_folder / MESH_FOLDER).is_dir():
            shutil.copytree(model_folder / MESH_FOLDER, folder / MESH_FOLDER, dirs_exist_ok=True)
    partial = folder / (BUNDLE_FILE + ".partial")
    partial.write_text(json.dumps(bundle_document(bundle), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, folder / BUNDLE_FILE)


def bundle_document(bundle: Bundle) -> dict[str, Any]:
    """Put a bundle into the form that `bundle.json` stores, with every number exact."""
    return {
        "version": BUNDLE_VERSION,
        "design": bundle.design,
        "config_hash": bundle.config_hash,
        "dt": bundle.dt,
        "time_constant": bundle.time_constant,
        "R_link_imu": bundle.R_link_imu.tolist(),
        "order": list(bundle.names),
        "joints": {
            joint.name: {field: getattr(joint, field) for field in _JOINT_FIELDS} | {"range": list(joint.range)}
            for joint in bundle.joints
        },
        "actor": actor_document(bundle.actor),
    }


def load_bundle(folder: Path) -> Bundle:
    """Read a bundle folder back; nothing is defaulted and nothing is ignored.

    Raises:
        BundleError: The file is missing or malformed; a field, joint or array is missing, unknown, of the wrong
            type or shape, out of bounds or not finite; or `robot.xml` beside it has other hinges.
    """
    path = folder / BUNDLE_FILE
    try:
        document = read_json(path)
    except FileNotFoundError:
        raise BundleError(f"{folder} has no {BUNDLE_FILE}; give the folder of a policy bundle.") from None
    try:
        bundle = parse_bundle(document)
    except BundleError as error:
        raise BundleError(f"{path}: {error}") from None
    if (folder / MODEL_FILE).exists():
        check_model(folder / MODEL_FILE, bundle)
    return bundle


def parse_bundle(document: Any) -> Bundle:
    """Read a bundle out of its JSON document, the inverse of `bundle_document`.

    Raises:
        BundleError: A field, joint or array is missing, unknown, of the wrong type or shape, or out of bounds.
    """
    if isinstance(document, dict) and document.get("version", BUNDLE_VERSION) != BUNDLE_VERSION:
        raise BundleError(
            f"version must be {BUNDLE_VERSION}, got {shown(document['version'])}; export the bundle again."
        )
    top = record("fields", document, _TOP_FIELDS)
    order = top["order"]
    if not (isinstance(order, list) and all(isinstance(name, str) for name in order)):
        raise BundleError(f"order must be a list of joint names, got {shown(order)}.")
    if not isinstance(top["joints"], dict):
        raise BundleError(f"joints must be an object by name, got {shown(top['joints'])}.")
    same_names("joints and order", set(top["joints"]), set(order))
    return Bundle(
        design=text("design", top["design"]),
        joints=tuple(_joint(name, top["joints"][name]) for name in order),
        actor=parse_actor(top["actor"], len(order)),
        dt=number("dt", top["dt"]),
        time_constant=number("time_constant", top["time_constant"]),
        config_hash=text("config_hash", top["config_hash"]),
        R_link_imu=array("R_link_imu", top["R_link_imu"], 2),
    )


def check_model(path: Path, bundle: Bundle) -> None:
    """Refuse an MJCF whose hinges are not exactly the bundle's joints.

    Raises:
        BundleError: Hinges are missing or unknown, or the file is not XML.
    """
    try:
        world = ElementTree.parse(path).getroot().find("worldbody")
    except ElementTree.ParseError as error:
        raise BundleError(f"{path} is not an MJCF file: {error}.") from None
    nodes = [] if world is None else world.iter("joint")
    hinges = {node.get("name", "") for node in nodes if node.get("type", "hinge") == "hinge"}
    same_names(f"{path}: hinges", hinges, set(bundle.names))


def _joint(name: str, document: Any) -> JointSetup:
    entry = record(f"joint {name!r}: fields", document, _JOINT_FIELDS)
    low, high = numbers(f"joint {name!r}: range", entry["range"], 2)
    for what in ("can_id", "sign"):
        if type(entry[what]) is not int:
            raise BundleError(f"joint {name!r}: {what} must be a whole number, got {shown(entry[what])}.")
    values = {field: number(f"joint {name!r}: {field}", entry[field]) for field in _JOINT_NUMBERS}
    return JointSetup(name, entry["can_id"], entry["sign"], (low, high), **values)
