"""The learned decoder: 512 numbers in, a jointed body out, and back. On numpy alone; see `decoder.training`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoder import networks
from decoder.compose import compose
from decoder.design import DEFAULT_PITCH, Joint, Material, VoxelDesign
from decoder.features import features
from decoder.genome import LATENT_DIM
from decoder.parts import LATTICE, MAX_PARTS, POSE, TRUNCATION
from decoder.placing import Part, geometric_axis, hung, torso, window
from decoder.weights import Weights, WeightsError

# What interpolating between nodes, and predicting the mean of what is unknown, take off round surfaces [voxels]: of
# bones and of skins, chosen such that reconstructions keep the volume of bodies.
_SWELL = np.array([0.15, 0.22], np.float32)[:, None, None, None]
_GUESS = 0.15  # an axis of less confidence is read from the geometry instead


@dataclass(frozen=True)
class VaeDecoder:
    """Decode z in R^512 by the trained network, and encode designs.

    A flow carries z to the raw latent that the network reads, such that z ~ N(0, I) is the law of the bodies it was
    trained on and the one to search under. Parts exist where the network says so with odds above one half, in a tree by
    construction: each is carried by an earlier one, and their bones are made to meet. Whether the body can be built is
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
        lattices = np.round(distance * np.float32(TRUNCATION) - _SWELL, 4)
        place = {k: index for index, k in enumerate(carrier)}
        parts = [torso(said[0, -POSE:], lattices[0])]
        for k, before in list(carrier.items())[1:]:
            parts.append(hung(said[k, -POSE:], lattices[place[k]], parts, place[before]))
        return parts

    def _design(self, parts: list[Part]) -> VoxelDesign:
        windows = [window(part) for part in parts]
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
                    axis = geometric_axis(part, parts[part.carrier])
                position = np.clip(part.hinge, low, high) * self.pitch
                joints.append(Joint(position, axis, part.range, part.carrier + 1, k + 1, confidence))
        return VoxelDesign(material, segment, self.pitch, tuple(joints), depth)


def _speck(torso: Part, pitch: float) -> VoxelDesign:
    """The least body there is, where no bone came out: one rigid voxel in a coat."""
    i, j, k = np.clip(torso.centre.astype(int), 4, 59)
    material = np.zeros((64, 64, 64), np.uint8)
    material[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2] = Material.SOFT
    material[i, j, k] = Material.RIGID
    segment: NDArray[Any] = (material > 0).astype(np.int16)
    return VoxelDesign(material, segment, pitch)
