"""An actor in the form that a policy bundle stores, and back, every number exact."""

from __future__ import annotations

from typing import Any

import numpy as np

from hardware.document import BundleError, array, number, numbers, record, shown
from sim.actor import Gait, Perceptron, Policy
from sim.observation import ActionMap

MOST_HISTORY = 64  # frames

_GAIT_FIELDS = ("kind", "frequency", "amplitude", "phase", "offset")
_MAP_VECTORS = ("centre", "scale", "low", "high")
_MAP_FIELDS = (*_MAP_VECTORS, "blend", "step")
_PERCEPTRON_FIELDS = ("kind", "history", "command", "rhythm", "input_centre", "input_gain", "layers", "actions")
_LAYER_FIELDS = ("weight", "bias")


def actor_document(actor: Policy) -> dict[str, Any]:
    """Put an actor into its JSON document."""
    return _gait_document(actor) if isinstance(actor, Gait) else _perceptron_document(actor)


def parse_actor(document: Any, num_joints: int) -> Policy:
    """Read an actor for so many joints out of its JSON document, the inverse of `actor_document`.

    Raises:
        BundleError: A field is missing, unknown, of the wrong type or shape, or out of bounds.
    """
    kind = document.get("kind") if isinstance(document, dict) else None
    if kind == "gait":
        return _gait(document, num_joints)
    if kind == "perceptron":
        return _perceptron(document, num_joints)
    raise BundleError(f"actor kind must be 'gait' or 'perceptron', got {shown(kind)}.")


def _gait_document(gait: Gait) -> dict[str, Any]:
    return {
        "kind": "gait",
        "frequency": gait.frequency,
        "amplitude": gait.amplitude.tolist(),
        "phase": gait.phase.tolist(),
        "offset": gait.offset.tolist(),
    }


def _gait(document: Any, num_joints: int) -> Gait:
    entry = record("actor: fields", document, _GAIT_FIELDS)
    arrays = {name: numbers(f"actor: {name}", entry[name], num_joints) for name in ("amplitude", "phase", "offset")}
    frequency = number("actor: frequency", entry["frequency"])
    if frequency < 0.0:
        raise BundleError(f"actor: frequency must be >= 0 Hz, got {frequency}.")
    return Gait(frequency, *(np.array(arrays[name]) for name in ("amplitude", "phase", "offset")))


def _perceptron_document(policy: Perceptron) -> dict[str, Any]:
    actions = policy.actions
    return {
        "kind": "perceptron",
        "history": policy.history,
        "command": list(policy.command),
        "rhythm": None if policy.rhythm is None else _gait_document(policy.rhythm),
        "input_centre": policy.input_centre.tolist(),
        "input_gain": policy.input_gain.tolist(),
        "layers": [{"weight": W.tolist(), "bias": b.tolist()} for W, b in policy.layers],
        "actions": {name: getattr(actions, name).tolist() for name in _MAP_VECTORS}
        | {"blend": actions.blend, "step": actions.step},
    }


def _perceptron(document: Any, num_joints: int) -> Perceptron:
    entry = record("actor: fields", document, _PERCEPTRON_FIELDS)
    history = entry["history"]
    if type(history) is not int or not 1 <= history <= MOST_HISTORY:
        raise BundleError(f"actor: history must be a whole number in 1..{MOST_HISTORY}, got {shown(history)}.")
    if not isinstance(entry["command"], list):
        raise BundleError(f"actor: command must be a list of numbers, got {shown(entry['command'])}.")
    command = tuple(number("actor: command", value) for value in entry["command"])
    actions = record("actor: actions: fields", entry["actions"], _MAP_FIELDS)
    vectors = {name: np.array(numbers(f"actor: actions: {name}", actions[name], num_joints)) for name in _MAP_VECTORS}
    blend, step = (number(f"actor: actions: {name}", actions[name]) for name in ("blend", "step"))
    if not isinstance(entry["layers"], list):
        raise BundleError(f"actor: layers must be a list, got {shown(entry['layers'])}.")
    inputs = {name: array(f"actor: {name}", entry[name], 1) for name in ("input_centre", "input_gain")}
    layers = []
    for index, layer in enumerate(entry["layers"]):
        fields = record(f"actor: layer {index}: fields", layer, _LAYER_FIELDS)
        layers.append((array(f"actor: layer {index}: weight", fields["weight"], 2),
                       array(f"actor: layer {index}: bias", fields["bias"], 1)))  # fmt: skip
    try:
        joints = ActionMap(**vectors, blend=blend, step=step)
        return Perceptron(
            tuple(layers), **inputs, actions=joints, history=history, command=command,
            rhythm=None if entry["rhythm"] is None else _gait(entry["rhythm"], num_joints),
        )  # fmt: skip
    except ValueError as error:
        raise BundleError(f"actor: {error}") from None
