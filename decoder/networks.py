"""The learned encoder and decoder as plain functions of named arrays: numpy where they are used, torch where trained.

A body is eight tokens, one per part, through a few transformer layers to 512 numbers and back. Those numbers follow a
law of their own; a flow carries N(0, I) to it, and back. `xp` is the module that made the arrays, numpy or torch;
nothing here imports either network library.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoder.genome import LATENT_DIM
from decoder.parts import MAX_PARTS, NODES, POSE

WIDTH, HEADS, HIDDEN = 256, 8, 768
ENCODER_LAYERS, DECODER_LAYERS = 3, 4
FLOW_WIDTH, FLOW_HIDDEN, FLOW_LAYERS, WAVES = 768, 1536, 3, 32
FLOW_STEPS = 8  # of the midpoint rule in time
_ROUNDS = 30  # at most, to invert a step
_SETTLED = 1e-6  # change of a coordinate at which the inverse is good enough
SEEN = 1 + MAX_PARTS + POSE + 3  # existence, carrier, pose, centre in the grid
SAID = 1 + MAX_PARTS + POSE  # existence, carrier, pose
LATTICES = 2 * NODES
_EPSILON = 1e-5
Arrays = Mapping[str, Any]


def shapes(about: Mapping[str, str]) -> dict[str, tuple[int, ...]]:
    """Shape of every array of the network by its name.

    Raises:
        ValueError: if the weights say that they are for another architecture.
    """
    if about.get("architecture", ARCHITECTURE) != ARCHITECTURE:
        raise ValueError(f"architecture is {about['architecture'][:40]!r}, this program has {ARCHITECTURE!r}")
    table: dict[str, tuple[int, ...]] = {
        "seen.lattices": (LATTICES, WIDTH), "seen.pose": (SEEN, WIDTH), "seen.place": (MAX_PARTS, WIDTH),
        "latent.in": (MAX_PARTS * WIDTH, 2 * LATENT_DIM), "latent.in_bias": (2 * LATENT_DIM,),
        "latent.out": (LATENT_DIM, MAX_PARTS * WIDTH), "said.place": (MAX_PARTS, WIDTH),
        "said.pose": (WIDTH, SAID), "said.pose_bias": (MAX_PARTS, SAID),
        "said.lattices": (WIDTH, LATTICES), "said.lattices_bias": (MAX_PARTS, LATTICES),
        "flow.pace": (WAVES,), "flow.in": (LATENT_DIM, FLOW_WIDTH), "flow.time": (2 * WAVES, FLOW_WIDTH),
        "flow.out": (FLOW_WIDTH, LATENT_DIM),
    }  # fmt: skip
    for i in range(FLOW_LAYERS):
        table |= {
            f"flow.{i}.gain": (FLOW_WIDTH,), f"flow.{i}.time": (2 * WAVES, FLOW_WIDTH),
            f"flow.{i}.up": (FLOW_WIDTH, FLOW_HIDDEN), f"flow.{i}.up_bias": (FLOW_HIDDEN,),
            f"flow.{i}.down": (FLOW_HIDDEN, FLOW_WIDTH),
        }  # fmt: skip
    for stack, layers in (("encoder", ENCODER_LAYERS), ("decoder", DECODER_LAYERS)):
        for i in range(layers):
            table |= {
                f"{stack}.{i}.gain1": (WIDTH,), f"{stack}.{i}.qkv": (WIDTH, 3 * WIDTH),
                f"{stack}.{i}.mix": (WIDTH, WIDTH), f"{stack}.{i}.gain2": (WIDTH,),
                f"{stack}.{i}.up": (WIDTH, HIDDEN), f"{stack}.{i}.up_bias": (HIDDEN,),
                f"{stack}.{i}.down": (HIDDEN, WIDTH),
            }  # fmt: skip
    return table


ARCHITECTURE = "part tokens, flow 1"


def initial(rng: np.random.Generator) -> dict[str, NDArray[np.float32]]:
    """Untrained weights."""
    arrays = {}
    depth = 2.0 * (ENCODER_LAYERS + DECODER_LAYERS)
    for name, shape in shapes({}).items():
        kind = name.rsplit(".", 1)[1]
        if kind.startswith("gain"):
            value = np.ones(shape)
        elif "bias" in kind or name == "flow.out":
            value = np.zeros(shape)
        elif kind == "pace":
            value = 0.5 * np.pi * np.arange(1.0, WAVES + 1)
        elif kind == "time":
            value = 0.1 * rng.standard_normal(shape)
        elif kind == "place":
            value = 0.3 * rng.standard_normal(shape)
        else:
            value = rng.standard_normal(shape) / np.sqrt(shape[0])
            if kind in ("mix", "down"):
                value /= np.sqrt(depth)
            if name in ("said.pose", "said.lattices"):
                value *= 0.3
        arrays[name] = value.astype(np.float32)
    arrays["latent.in"][:, LATENT_DIM:] *= 0.1  # Posterior widths start alike,
    arrays["latent.in_bias"][LATENT_DIM:] = -3.0  # and narrow.
    return arrays


def encode(w: Arrays, alive: Any, lattices: Any, pose: Any, xp: ModuleType) -> tuple[Any, Any]:
    """Mean and log variance (n, 512) of the raw latents of n bodies.

    Args:
        w: the network.
        alive: which parts exist, (n, 8).
        lattices: of the p existing parts, (p, 4608).
        pose: of all, (n, 8, SEEN).
        xp: numpy or torch.
    """
    tokens = pose @ w["seen.pose"] + w["seen.place"]
    tokens[alive] += lattices @ w["seen.lattices"]
    for i in range(ENCODER_LAYERS):
        tokens = _layer(w, f"encoder.{i}.", tokens, xp)
    both = tokens.reshape(len(tokens), MAX_PARTS * WIDTH) @ w["latent.in"] + w["latent.in_bias"]
    return both[:, :LATENT_DIM], both[:, LATENT_DIM:].clip(-12.0, 2.0)


def decode(w: Arrays, latent: Any, xp: ModuleType) -> tuple[Any, Any]:
    """What raw latents (n, 512) say of parts, (n, 8, SAID), and the tokens (n, 8, WIDTH) that `distances` reads."""
    tokens = (latent @ w["latent.out"]).reshape(len(latent), MAX_PARTS, WIDTH) + w["said.place"]
    for i in range(DECODER_LAYERS):
        tokens = _layer(w, f"decoder.{i}.", tokens, xp)
    return tokens @ w["said.pose"] + w["said.pose_bias"], tokens


def distances(w: Arrays, tokens: Any, alive: Any, xp: ModuleType) -> Any:
    """Distances over the truncation (p, 4608) in the p parts of `tokens` (n, 8, WIDTH) that `alive` (n, 8) names."""
    bias = xp.broadcast_to(w["said.lattices_bias"], (len(tokens), MAX_PARTS, LATTICES))
    return tokens[alive] @ w["said.lattices"] + bias[alive]


def _layer(w: Arrays, name: str, x: Any, xp: ModuleType) -> Any:
    """Attention among the eight tokens, then a perceptron on each; both added to what came in."""
    n = len(x)
    size = WIDTH // HEADS
    qkv = (_scaled(x, w[name + "gain1"]) @ w[name + "qkv"]).reshape(n, MAX_PARTS, 3, HEADS, size)
    q, k, v = (xp.swapaxes(qkv[:, :, i], 1, 2) for i in range(3))
    # Unit length keeps the scores within a range that the exponential bears without further care.
    scores = xp.exp(_scaled(q, 1.0) @ xp.swapaxes(_scaled(k, 1.0), 2, 3) * size**-0.5)
    mixed = (scores / scores.sum(-1)[..., None]) @ v
    x = x + xp.swapaxes(mixed, 1, 2).reshape(n, MAX_PARTS, WIDTH) @ w[name + "mix"]
    hidden = (_scaled(x, w[name + "gain2"]) @ w[name + "up"] + w[name + "up_bias"]).clip(0.0)
    return x + hidden @ w[name + "down"]


def _scaled(x: Any, gain: Any) -> Any:
    """Root mean square 1 along the last axis, times the gain."""
    return x * ((x * x).mean(-1)[..., None] + _EPSILON) ** -0.5 * gain


def velocity(w: Arrays, x: Any, t: Any, xp: ModuleType) -> Any:
    """Where the flow carries points x (n, 512) at times t (n, 1), 0 at N(0, I) and 1 at the raw latents of bodies."""
    angle = t * w["flow.pace"]
    clock = xp.concatenate([xp.cos(angle), xp.sin(angle)], -1)
    hidden = x @ w["flow.in"] + clock @ w["flow.time"]
    for i in range(FLOW_LAYERS):
        name = f"flow.{i}."
        seen = _scaled(hidden, w[name + "gain"]) + clock @ w[name + "time"]
        hidden = hidden + (seen @ w[name + "up"] + w[name + "up_bias"]).clip(0.0) @ w[name + "down"]
    return hidden @ w["flow.out"]


def carried(w: Arrays, z: NDArray[np.float32]) -> NDArray[np.float32]:
    """Raw latents of z (n, 512), which follows N(0, I): Euler's rule, with the velocity of the middle of each step."""
    for k in range(FLOW_STEPS):
        z = z + _step(w, z, k)
    return z


def carried_back(w: Arrays, x: NDArray[np.float32]) -> NDArray[np.float32]:
    """The z (n, 512) that `carried` takes to x, each step inverted by fixed-point iteration."""
    for k in reversed(range(FLOW_STEPS)):
        z = x
        for _ in range(_ROUNDS):
            z, before = x - _step(w, z, k), z
            if np.abs(z - before).max(initial=0.0) < _SETTLED:
                break
        x = z
    return x


def _step(w: Arrays, x: NDArray[np.float32], k: int) -> NDArray[np.float32]:
    move: NDArray[np.float32] = velocity(w, x, np.full_like(x[:, :1], (k + 0.5) / FLOW_STEPS), np) / FLOW_STEPS
    return move
