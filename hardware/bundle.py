"""The policy bundle: all that a robot needs to run one policy (numpy and the standard library only)."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from sim.actor import Gait, Perceptron, Policy
from sim.observation import ActionMap

BUNDLE_VERSION = 1
BUNDLE_FILE = "bundle.json"
MODEL_FILE = "robot.xml"
MESH_FOLDER = "meshes"
NUM_CAN_IDS = 16  # a motor id has 4 bits on the wire

Array = NDArray[np.float64]


class BundleError(ValueError):
    """A policy bundle is unusable; the message names the field, the value and the bound."""


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
    def refuse(field: str, bound: str) -> BundleError:
        return BundleError(f"Joint {joint.name!r}: {field} must be {bound}, got {getattr(joint, field)!r}.")

    if not 0 <= joint.can_id < NUM_CAN_IDS:
        raise refuse("can_id", "in 0..15")
    if joint.sign not in (-1, 1):
        raise refuse("sign", "+1 or -1")
    low, high = joint.range
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise refuse("range", "finite and increasing")
    if not low <= joint.default <= high:
        raise refuse("default", f"in its range [{low:.4g}, {high:.4g}] rad")
    for field in ("kp", "kd"):
        if not (math.isfinite(getattr(joint, field)) and getattr(joint, field) >= 0.0):
            raise refuse(field, "finite and >= 0")
    for field in ("peak_torque", "continuous_torque", "max_speed"):
        if not (math.isfinite(getattr(joint, field)) and getattr(joint, field) > 0.0):
            raise refuse(field, "finite and > 0")
    if joint.continuous_torque > joint.peak_torque:
        raise refuse("continuous_torque", f"at most the peak torque {joint.peak_torque:.4g} N.m")


_TOP_FIELDS = ("version", "design", "config_hash", "dt", "time_constant", "order", "joints", "actor")
_JOINT_NUMBERS = ("default", "kp", "kd", "peak_torque", "continuous_torque", "max_speed")
_JOINT_FIELDS = ("can_id", "sign", "range", *_JOINT_NUMBERS)
_GAIT_FIELDS = ("kind", "frequency", "amplitude", "phase", "offset")
_MAP_VECTORS = ("centre", "scale", "low", "high")
_MAP_FIELDS = (*_MAP_VECTORS, "blend", "step")
_PERCEPTRON_FIELDS = ("kind", "history", "command", "input_centre", "input_gain", "layers", "actions")
_LAYER_FIELDS = ("weight", "bias")
MOST_HISTORY, MOST_UNITS = 64, 4096  # a bundle is read on a small computer


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
        "order": list(bundle.names),
        "joints": {
            joint.name: {field: getattr(joint, field) for field in _JOINT_FIELDS} | {"range": list(joint.range)}
            for joint in bundle.joints
        },
        "actor": _gait_document(bundle.actor) if isinstance(bundle.actor, Gait) else _perceptron_document(bundle.actor),
    }


def load_bundle(folder: Path) -> Bundle:
    """Read a bundle folder back; nothing is defaulted and nothing is ignored.

    Raises:
        BundleError: The file is missing or malformed; a field, joint or array is missing, unknown, of the wrong
            type or shape, out of bounds or not finite; or `robot.xml` beside it has other hinges.
    """
    path = folder / BUNDLE_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except FileNotFoundError:
        raise BundleError(f"{folder} has no {BUNDLE_FILE}; give the folder of a policy bundle.") from None
    except (json.JSONDecodeError, UnicodeDecodeError, NotADirectoryError, IsADirectoryError) as error:
        raise BundleError(f"{path} is not a JSON file: {error}.") from None
    except BundleError as error:
        raise BundleError(f"{path}: {error}") from None
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
        raise BundleError(f"version must be {BUNDLE_VERSION}, got {document['version']!r}; export the bundle again.")
    top = _record("fields", document, _TOP_FIELDS)
    order = top["order"]
    if not (isinstance(order, list) and all(isinstance(name, str) for name in order)):
        raise BundleError(f"order must be a list of joint names, got {order!r}.")
    if not isinstance(top["joints"], dict):
        raise BundleError(f"joints must be an object by name, got {top['joints']!r}.")
    _same_names("joints and order", set(top["joints"]), set(order))
    return Bundle(
        design=_text("design", top["design"]),
        joints=tuple(_joint(name, top["joints"][name]) for name in order),
        actor=_actor(top["actor"], len(order)),
        dt=_number("dt", top["dt"]),
        time_constant=_number("time_constant", top["time_constant"]),
        config_hash=_text("config_hash", top["config_hash"]),
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
    _same_names(f"{path}: hinges", hinges, set(bundle.names))


def _refuse_constant(text: str) -> float:
    raise BundleError(f"every number must be finite, got {text}.")


def _same_names(what: str, found: set[str], expected: set[str]) -> None:
    missing, unknown = sorted(expected - found), sorted(found - expected)
    if missing or unknown:
        raise BundleError(f"{what} disagree: missing {missing}, unknown {unknown}.")


def _joint(name: str, document: Any) -> JointSetup:
    entry = _record(f"joint {name!r}: fields", document, _JOINT_FIELDS)
    low, high = _numbers(f"joint {name!r}: range", entry["range"], 2)
    for field in ("can_id", "sign"):
        if type(entry[field]) is not int:
            raise BundleError(f"joint {name!r}: {field} must be a whole number, got {entry[field]!r}.")
    numbers = {field: _number(f"joint {name!r}: {field}", entry[field]) for field in _JOINT_NUMBERS}
    return JointSetup(name, entry["can_id"], entry["sign"], (low, high), **numbers)


def _actor(document: Any, num_joints: int) -> Policy:
    kind = document.get("kind") if isinstance(document, dict) else None
    if kind == "gait":
        return _gait(document, num_joints)
    if kind == "perceptron":
        return _perceptron(document, num_joints)
    raise BundleError(f"actor kind must be 'gait' or 'perceptron', got {kind!r}.")


def _gait_document(gait: Gait) -> dict[str, Any]:
    return {
        "kind": "gait",
        "frequency": gait.frequency,
        "amplitude": gait.amplitude.tolist(),
        "phase": gait.phase.tolist(),
        "offset": gait.offset.tolist(),
    }


def _gait(document: Any, num_joints: int) -> Gait:
    entry = _record("actor: fields", document, _GAIT_FIELDS)
    arrays = {name: _numbers(f"actor: {name}", entry[name], num_joints) for name in ("amplitude", "phase", "offset")}
    frequency = _number("actor: frequency", entry["frequency"])
    if frequency < 0.0:
        raise BundleError(f"actor: frequency must be >= 0 Hz, got {frequency}.")
    return Gait(frequency, *(np.array(arrays[name]) for name in ("amplitude", "phase", "offset")))


def _perceptron_document(policy: Perceptron) -> dict[str, Any]:
    actions = policy.actions
    return {
        "kind": "perceptron",
        "history": policy.history,
        "command": list(policy.command),
        "input_centre": policy.input_centre.tolist(),
        "input_gain": policy.input_gain.tolist(),
        "layers": [{"weight": W.tolist(), "bias": b.tolist()} for W, b in policy.layers],
        "actions": {name: getattr(actions, name).tolist() for name in _MAP_VECTORS}
        | {"blend": actions.blend, "step": actions.step},
    }


def _perceptron(document: Any, num_joints: int) -> Perceptron:
    entry = _record("actor: fields", document, _PERCEPTRON_FIELDS)
    history = entry["history"]
    if type(history) is not int or not 1 <= history <= MOST_HISTORY:
        raise BundleError(f"actor: history must be a whole number in 1..{MOST_HISTORY}, got {history!r}.")
    if not isinstance(entry["command"], list):
        raise BundleError(f"actor: command must be a list of numbers, got {entry['command']!r}.")
    command = tuple(_number("actor: command", value) for value in entry["command"])
    actions = _record("actor: actions: fields", entry["actions"], _MAP_FIELDS)
    vectors = {name: np.array(_numbers(f"actor: actions: {name}", actions[name], num_joints)) for name in _MAP_VECTORS}
    blend, step = (_number(f"actor: actions: {name}", actions[name]) for name in ("blend", "step"))
    if not isinstance(entry["layers"], list):
        raise BundleError(f"actor: layers must be a list, got {entry['layers']!r}.")
    inputs = {name: _array(f"actor: {name}", entry[name], 1) for name in ("input_centre", "input_gain")}
    layers = []
    for index, layer in enumerate(entry["layers"]):
        fields = _record(f"actor: layer {index}: fields", layer, _LAYER_FIELDS)
        layers.append((_array(f"actor: layer {index}: weight", fields["weight"], 2),
                       _array(f"actor: layer {index}: bias", fields["bias"], 1)))  # fmt: skip
    try:
        joints = ActionMap(**vectors, blend=blend, step=step)
        return Perceptron(tuple(layers), **inputs, actions=joints, history=history, command=command)
    except ValueError as error:
        raise BundleError(f"actor: {error}") from None


def _array(what: str, value: Any, axes: int) -> Array:
    """A rectangular list of lists of numbers."""
    rows = value if axes == 2 else [value]
    if not isinstance(rows, list) or not rows or not all(isinstance(row, list) for row in rows):
        raise BundleError(f"{what} must be {'a matrix' if axes == 2 else 'a list of numbers'}.")
    width = len(rows[0])
    if not 0 < width <= MOST_UNITS or len(rows) > MOST_UNITS or any(len(row) != width for row in rows):
        raise BundleError(f"{what} must be rectangular with 1 to {MOST_UNITS} numbers a side.")
    numbers = np.array([[_number(what, number) for number in row] for row in rows])
    return numbers if axes == 2 else numbers[0]


def _record(what: str, document: Any, fields: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise BundleError(f"{what} must be a JSON object, got {document!r}.")
    _same_names(what, set(document), set(fields))
    return document


def _text(what: str, value: Any) -> str:
    if not isinstance(value, str):
        raise BundleError(f"{what} must be text, got {value!r}.")
    return value


def _number(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise BundleError(f"{what} must be a finite number, got {value!r}.")
    return float(value)


def _numbers(what: str, value: Any, count: int) -> list[float]:
    if not isinstance(value, list) or len(value) != count:
        raise BundleError(f"{what} must be a list of {count} numbers, got {value!r}.")
    return [_number(what, item) for item in value]
