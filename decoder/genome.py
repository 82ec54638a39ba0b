"""The procedural decoder: a latent becomes a torso with limbs, drawn with free-form residuals. No training."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from decoder.body import BLOB_GENES, BLOBS, GENES, BodyPlan, grow
from decoder.design import DEFAULT_PITCH, Joint, VoxelDesign
from decoder.rasterise import fit, rasterise

LATENT_DIM = 512
BONE_NOISE = (6, 6, 5)  # spline coefficients of the rigid surface's displacement along x, y, z
SKIN_NOISE = (5, 5, 4)  # the same for the outer surface
_SIZES = (GENES, BLOBS * BLOB_GENES, int(np.prod(BONE_NOISE)), int(np.prod(SKIN_NOISE)))
_SATURATION = 1e-6  # genes stay this far from 0 and 1


@dataclass(frozen=True)
class GenomeDecoder:
    """Decode z in R^512 through y = Q z, with Q a fixed random orthonormal map.

    The first 152 numbers of y become genes in (0, 1) by the normal distribution function: how many segments, which
    tree, sizes, directions, hinges. The other 360 are free-form: blobs on the bones, and smooth random displacement
    fields of the rigid and of the outer surface. With z ~ N(0, I) all of them are independent and every gene is
    uniform. The map is continuous except where a count or a choice steps over a threshold. Nothing is rejected: some
    bodies cannot be built, and it is the solvers that say so.

    Attributes:
        seed: of the map Q.
        pitch: edge of a voxel [m].
        bone_scale: multiplies every width of the limbs.
        torso_scale: multiplies every width of the torso.
        length_scale: multiplies every limb length.
        bone_roughness: standard deviation of the rigid surface's displacement [voxels].
        skin_roughness: standard deviation of the outer surface's displacement [voxels].
        blend: width over which linked bones and blobs melt together [voxels].
        gap: width of the cleft between the soft tissues of unlinked bones [voxels].
        signed: whether designs carry the depths that they were drawn from (they are other designs then).
    """

    seed: int = 512
    pitch: float = DEFAULT_PITCH
    bone_scale: float = 1.0
    torso_scale: float = 1.0
    length_scale: float = 1.0
    bone_roughness: float = 0.5
    skin_roughness: float = 0.9
    blend: float = 2.0
    gap: float = 2.5
    signed: bool = False

    @cached_property
    def map(self) -> NDArray[np.float64]:
        """Q, (512, 512), Q Q^T = I."""
        normal = np.random.default_rng(self.seed).standard_normal((LATENT_DIM, LATENT_DIM))
        q, r = np.linalg.qr(normal)
        q = q * np.sign(np.diag(r))  # Makes Q unique, so that every LAPACK agrees on it.
        q.setflags(write=False)
        return q

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
        return [self._decode_one(z) for z in latents.astype(np.float64)]

    def plan(self, latent: NDArray[np.floating]) -> BodyPlan:
        """Bones and hinges of one latent (512,) before they are placed in the grid; lengths in voxels."""
        genes, blobs, _, _ = self._genes(np.asarray(latent, np.float64))
        return grow(
            genes, blobs, bone_scale=self.bone_scale, torso_scale=self.torso_scale, length_scale=self.length_scale
        )

    def _genes(self, z: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        # A sum over rows instead of a matrix product: its rounding depends on neither batch nor threads.
        y = (self.map * z).sum(axis=1)
        parts = np.split(y, np.cumsum(_SIZES)[:-1])
        genes, blobs = (np.clip(ndtr(part), _SATURATION, 1 - _SATURATION) for part in parts[:2])
        return genes, blobs.reshape(BLOBS, BLOB_GENES), parts[2].reshape(BONE_NOISE), parts[3].reshape(SKIN_NOISE)

    def _decode_one(self, z: NDArray[np.float64]) -> VoxelDesign:
        _, _, bone_noise, skin_noise = self._genes(z)
        plan = self.plan(z)
        if plan.symmetric:
            bone_noise, skin_noise = _even(bone_noise), _even(skin_noise)
        limit = 2.0 * max(self.bone_roughness, self.skin_roughness)
        shift, scale = fit(plan.bones, limit)
        material, segment, depth = rasterise(
            [bone.moved(shift, scale) for bone in plan.bones],
            {(hinge.parent, hinge.child) for hinge in plan.hinges},
            bone_noise * self.bone_roughness,
            skin_noise * self.skin_roughness,
            blend=self.blend,
            gap=self.gap,
            limit=limit,
            signed=self.signed,
        )
        return VoxelDesign(material, segment, self.pitch, tuple(self._joints(plan, shift, scale)), depth)

    def _joints(self, plan: BodyPlan, shift: NDArray[np.float64], scale: float) -> Iterator[Joint]:
        for hinge in plan.hinges:
            position = (hinge.position * scale + shift) * self.pitch
            yield Joint(position, hinge.axis, np.array([-hinge.reach, hinge.reach]), hinge.parent + 1, hinge.child + 1)


def _even(coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mirror-symmetric part in y, scaled so that the variance off the mirror plane stays 1."""
    return (coefficients + coefficients[:, ::-1]) / np.sqrt(2.0)
