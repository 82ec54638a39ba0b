"""The learned decoder: 512 numbers in, a jointed body out, and back. On numpy alone; see `decoder.training`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decoder import networks
from decoder.compose import Window, centres, compose, window_of
from decoder.design import DEFAULT_PITCH, Joint, Material, VoxelDesign
from decoder.features import features
from decoder.genome import LATENT_DIM
from decoder.parts import (
    ATTACH,
    DIRECTION,
    DISTANCE,
    LATTICE,
    MAX_PARTS,
    MIDDLE,
    POSE,
    RANGE,
    REACH,
    SPREAD,
    TENSOR,
    TRUNCATION,
    axis_of,
    box_of,
    frames_along,
    torso_frame,
)
from decoder.rasterise import FAR
from decoder.weights import Weights, WeightsError

_GUESS = 0.15  # an axis of less confidence is read from the geometry instead
_LEAST_REACH = 0.1  # of a hinge either way [rad]
_GAP = 0.9  # between bones that meet at a hinge, at most [voxels]; they melt together over so much
_PUSHES = 4  # at most, until they do


@dataclass(frozen=True, eq=False)
class Part:
    """One part as the network says it; lengths in voxels, positions in the grid.

    Attributes:
        carrier: index of the part that carries this one.
        centre: (3,).
        frame: columns across, across and along, (3, 3).
        box: half sides, (3,).
        hinge: a point on the hinge towards the carrier, (3,).
        axis: unit vector of the hinge, (3,).
        confidence: in that axis, 0 to 1.
        range: least and greatest angle [rad], (2,).
        distance: of bone and skin at the nodes of its lattice, (2, 12, 12, 16).
    """

    carrier: int
    centre: NDArray[np.float64]
    frame: NDArray[np.float64]
    box: NDArray[np.float64]
    hinge: NDArray[np.float64]
    axis: NDArray[np.float64]
    confidence: float
    range: NDArray[np.float64]
    distance: NDArray[np.float32]


@dataclass(frozen=True)
class VaeDecoder:
    """Decode z in R^512 by the trained network, and encode designs.

    A flow carries z to the raw latent that the network reads, such that z ~ N(0, I) is the law of the bodies it was
    trained on and the one to search under. Parts exist where the network says so with
    odds above one half, in a tree by construction: each is carried by an earlier one. Whether the body can be built is
    for solvers to say.

    Attributes:
        weights: see `decoder.weights`.
        pitch: edge of a voxel [m].

    Raises:
        WeightsError: if the weights are of another architecture.
    """

    weights: Weights
    pitch: float = DEFAULT_PITCH

    def __post_init__(self) -> None:
        """Refuse weights of another shape."""
        found = {name: array.shape for name, array in self.weights.arrays.items()}
        for name, shape in networks.shapes({}).items():
            if found.get(name) != shape:
                raise WeightsError(f"array {name} has shape {found.get(name)}, this network needs {shape}")

    @cached_property
    def _arrays(self) -> dict[str, NDArray[np.float32]]:
        return dict(self.weights.arrays)

    def decode(self, latents: NDArray[np.floating]) -> list[VoxelDesign]:
        """Decode latents (n, 512) into n designs; each depends on its own row only.

        Raises:
            ValueError: if the latents have another shape or hold a number that is not finite.
        """
        latents = np.asarray(latents)
        if latents.ndim != 2 or latents.shape[1] != LATENT_DIM:
            raise ValueError(f"latents have shape {latents.shape}, expected (n, {LATENT_DIM})")
        if not np.isfinite(latents).all():
            raise ValueError("latents hold a number that is not finite")
        return [self._design(self.parts(z)) for z in latents]

    def encode(self, designs: Sequence[VoxelDesign]) -> NDArray[np.float32]:
        """Latents (n, 512) whose bodies are as near to the designs as the network can bring them.

        Orientation and place in the grid are kept. At most eight parts of a design, one tree, are seen.
        """
        w = self._arrays
        rows = []
        for design in designs:
            seen = features(design)
            mean, _ = networks.encode(w, seen.alive[None], seen.lattices, seen.pose[None], np)
            rows.append(networks.carried_back(w, mean)[0])
        return np.array(rows, np.float32).reshape(len(rows), LATENT_DIM)

    def parts(self, latent: NDArray[np.floating]) -> list[Part]:
        """What the network says of one latent (512,): its parts, carriers before those they carry."""
        w = self._arrays
        # Beyond some ten standard deviations the network was never looked at; it still has to answer with numbers.
        z = np.clip(latent.astype(np.float64), -30.0, 30.0).astype(np.float32)
        said, tokens = networks.decode(w, networks.carried(w, z[None]), np)
        # Rounded, so that the last bits of a sum, which differ from machine to machine, seldom reach a voxel.
        said = np.round(said[0].astype(np.float64), 5)
        carrier = {0: 0}
        for k in range(1, MAX_PARTS):
            before = int(np.argmax(said[k, 1 : 1 + k]))
            if said[k, 0] > 0.0 and before in carrier:  # What carries it exists, too.
                carrier[k] = before
        alive = np.zeros((1, MAX_PARTS), bool)
        alive[0, list(carrier)] = True
        distance = networks.distances(w, tokens, alive, np).reshape(-1, 2, *LATTICE)
        lattices = np.round(distance * np.float32(TRUNCATION), 4)
        place = {k: index for index, k in enumerate(carrier)}
        parts = [_torso(said[0, -POSE:], lattices[0])]
        for k, before in list(carrier.items())[1:]:
            carrying = parts[place[before]]
            parts.append(_seated(_part(said[k, -POSE:], lattices[place[k]], carrying, place[before]), carrying))
        return parts

    def _design(self, parts: list[Part]) -> VoxelDesign:
        windows = [_window(part) for part in parts]
        linked = {(part.carrier, k) for k, part in enumerate(parts) if k}
        material, segment, depth = compose(windows, linked)
        if not (material == Material.RIGID).any():
            return _speck(parts[0], self.pitch)
        present = set(np.unique(segment[material == Material.RIGID]).tolist())
        filled = np.argwhere(material > 0)
        low, high = filled.min(0), filled.max(0) + 1
        joints = []
        for k, part in enumerate(parts):
            if k and {k + 1, part.carrier + 1} <= present:
                axis, confidence = part.axis, part.confidence
                if confidence < _GUESS:
                    axis = _geometric_axis(part, parts[part.carrier])
                position = np.clip(part.hinge, low, high) * self.pitch
                joints.append(Joint(position, axis, part.range, part.carrier + 1, k + 1, confidence))
        return VoxelDesign(material, segment, self.pitch, tuple(joints), depth)


def _torso(pose: NDArray[np.float64], distance: NDArray[np.float32]) -> Part:
    """Put the part that nothing carries where its pose says."""
    centre = MIDDLE + REACH * np.clip(pose[ATTACH], -1.6, 1.6)
    return Part(0, centre, torso_frame().astype(np.float64), _box(pose), centre, np.array([0.0, 1.0, 0.0]), 1.0,
                np.array([-1.0, 1.0]), distance)  # fmt: skip


def _part(pose: NDArray[np.float64], distance: NDArray[np.float32], before: Part, carrier: int) -> Part:
    """Put one part where its pose says, on the part that carries it."""
    hinge = before.centre + before.frame @ (before.box * np.clip(pose[ATTACH], -1.2, 1.2))
    length = float(np.linalg.norm(pose[DIRECTION]))
    direction = pose[DIRECTION] / length if length > 1e-3 else np.array([0.0, 0.0, -1.0])
    frame = frames_along(direction, np)
    axis, confidence = axis_of(pose[TENSOR])
    centre = hinge + 8.0 * float(np.exp(np.clip(pose[DISTANCE][0], -2.0, 1.2))) * direction
    axis = frame @ axis
    reach = np.array([np.clip(pose[RANGE][0], -np.pi, -_LEAST_REACH), np.clip(pose[RANGE][1], _LEAST_REACH, np.pi)])
    return Part(carrier, centre, frame, _box(pose), hinge, axis / np.linalg.norm(axis), confidence, reach, distance)


def _box(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    return box_of(3.0 * np.exp(np.clip(pose[SPREAD], -1.5, 1.5)))


def _seated(part: Part, before: Part) -> Part:
    """Push a part, hinge and all, towards the one that carries it until their bones are at most `_GAP` apart.

    Bones meet at a hinge in every body that was learned from; a latent in between may leave a gap. It is measured on
    the way from centre to centre over the hinge, where it is narrowest.
    """
    for _ in range(_PUSHES):
        way = np.concatenate([_points_between(before.centre, part.hinge), _points_between(part.hinge, part.centre)])
        gap = 2.0 * float(np.maximum(_bone_at(before, way), _bone_at(part, way)).min())
        inwards = before.centre - part.hinge
        far = float(np.linalg.norm(inwards))
        if gap <= _GAP or far < 1.0:
            break
        push = min(gap - _GAP, far) / far * inwards
        part = replace(part, centre=part.centre + push, hinge=part.hinge + push)
    return part


def _points_between(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (24, 3) in equal steps from one to the other."""
    return start + np.linspace(0.0, 1.0, 24)[:, None] * (end - start)


def _bone_at(part: Part, points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Distances (m,) to a part's bone at points (m, 3) [voxels]; beyond the box, that of the nearest point in it."""
    at = _node((points - part.centre) @ part.frame / part.box)
    return ndimage.map_coordinates(part.distance[0], at.T, order=1, mode="nearest", prefilter=False)


def _node(local: NDArray[Any]) -> NDArray[Any]:
    """Places in the box [-1, 1]^3, (..., 3), in nodes of the lattice."""
    return (local + 1) * (0.5 * (np.array(LATTICE, local.dtype) - 1))


def _window(part: Part) -> Window:
    """Distances of a part at the voxels its box covers, by trilinear interpolation; far away beyond the box."""
    reach = np.abs(part.frame) @ part.box
    first, count = window_of(part.centre - reach, part.centre + reach)
    local = (centres(first, count) - part.centre.astype(np.float32)) @ (part.frame / part.box).astype(np.float32)
    at = np.moveaxis(_node(local), -1, 0)
    bone, skin = (
        ndimage.map_coordinates(layer, at, order=1, mode="constant", cval=FAR, prefilter=False)
        for layer in part.distance
    )
    return Window(first, bone, skin)


def _geometric_axis(part: Part, before: Part) -> NDArray[np.float64]:
    """Hinge axis across both parts, or level across the one when they are in line."""
    along = before.frame[:, 2]
    for other in (along, np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])):
        axis = np.cross(other, part.frame[:, 2])
        length = float(np.linalg.norm(axis))
        if length > 0.3:
            return axis / length
    return np.array([1.0, 0.0, 0.0])


def _speck(torso: Part, pitch: float) -> VoxelDesign:
    """The least body there is, where no bone came out: one rigid voxel in a coat."""
    i, j, k = np.clip(torso.centre.astype(int), 4, 59)
    material = np.zeros((64, 64, 64), np.uint8)
    material[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2] = Material.SOFT
    material[i, j, k] = Material.RIGID
    segment: NDArray[Any] = (material > 0).astype(np.int16)
    return VoxelDesign(material, segment, pitch)
