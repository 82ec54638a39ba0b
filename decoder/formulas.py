"""Bodies as formulas, in batches: the numbers that a part is made of, and how far points are from its surfaces."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from decoder.rasterise import COAT

BLOBS = 2  # balls blended into one bone
BLEND = 2.0  # over this width [voxels]
BONE_TERMS, SKIN_TERMS = 19, 9  # polynomials of degree 1-3 and 1-2
LIMIT = 2.0  # of a free-form displacement [voxels]
ODD_ACROSS = (0, 6, 7, 9, 14, 16, 18)  # terms of `_terms` odd in the first coordinate: a, ab, ac, a3, b2 a, c2 a, abc


@dataclass(frozen=True, eq=False)
class Bodies:
    """A batch of bodies of up to 8 parts. Lengths in voxels, positions in the grid, (n, 8, ...) each.

    Attributes:
        alive: which parts exist; part 0, the torso, always does.
        parent: index of the part that carries this one; 0 for the torso and for unused parts.
        position: a point on the hinge towards the parent, (n, 8, 3).
        axis: unit vector of that hinge, (n, 8, 3).
        range: least and greatest angle [rad], (n, 8, 2).
        start: near end of the bone's core line, (n, 8, 3).
        frame: its axes in the grid; columns across, across and along, (n, 8, 3, 3).
        length: of the core line; 0 for the torso.
        half: half widths across and across, and the length of the rounded ends, (n, 8, 3).
        exponent: of the superelliptic cross-section; 2 is round, 4 is boxy.
        taper: width at the far end over that at the near end.
        blobs: centre in the part's frame and radius of balls that melt into the bone, (n, 8, 2, 4).
        bone_form: coefficients of the rigid surface's free-form displacement, (n, 8, 19).
        skin_form: of the outer surface's, (n, 8, 9).
        thickness: of the soft tissue.
    """

    alive: Tensor
    parent: Tensor
    position: Tensor
    axis: Tensor
    range: Tensor
    start: Tensor
    frame: Tensor
    length: Tensor
    half: Tensor
    exponent: Tensor
    taper: Tensor
    blobs: Tensor
    bone_form: Tensor
    skin_form: Tensor
    thickness: Tensor

    def __len__(self) -> int:
        """Count the bodies."""
        return self.alive.shape[0]

    def take(self, index: Tensor) -> Bodies:
        """Parts in another order: `index` (n, 8) names, for each place, the part that goes there."""
        places = torch.argsort(index, dim=1)
        moved = {f.name: gathered(getattr(self, f.name), index) for f in fields(self)}
        moved["parent"] = torch.gather(places, 1, moved["parent"])
        return Bodies(**moved)

    def pick(self, *index: Tensor) -> Bodies:
        """Some bodies, or some parts by two indices; the parents of single parts are no longer meant."""
        return Bodies(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def gathered(values: Tensor, index: Tensor) -> Tensor:
    """Rows of (n, 8, ...) in the order of `index` (n, 8)."""
    return values[torch.arange(len(index), device=index.device)[:, None], index]


def boxes(bodies: Bodies, room: float) -> tuple[Tensor, Tensor]:
    """Lowest and highest corner of a box around every part with its skin and some room, (n, 8, 3) each [voxels]."""
    end = bodies.start + bodies.length[..., None] * bodies.frame[..., 2]
    wide = torch.cat([(bodies.half[..., :2] * bodies.taper.clamp(min=1.0)[..., None]), bodies.half[..., 2:]], 2)
    reach = torch.einsum("nkij,nkj->nki", bodies.frame.abs(), wide) + (bodies.thickness + room)[..., None]
    return torch.minimum(bodies.start, end) - reach, torch.maximum(bodies.start, end) + reach


def field(parts: Bodies, points: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distances to the bone's and to the skin's surface [voxels], about metric near them, negative inside.

    Args:
        parts: any selection of parts, leading shape (...).
        points: positions in the grid, (..., m, 3): those of a part are measured against that part.

    Returns:
        Bone and skin, (..., m) each.
    """
    local = parts.frame.mT @ (points - parts.start[..., None, :]).mT
    bone, skin = bone_and_skin(parts, *local.unbind(-2))
    return bone, skin


def bone_and_skin(parts: Bodies, x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """The same for coordinates (..., m) in the part's frame, from the near end of its core line."""
    base = _core(parts, x, y, z)
    terms = _terms(parts, x, y, z)
    swell = _displacement(terms, parts.bone_form)
    outer = torch.maximum(parts.thickness[..., None] + _displacement(terms, parts.skin_form), swell + COAT)
    return base - swell, base - outer


def bone_only(parts: Bodies, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """The first of both."""
    return _core(parts, x, y, z) - _displacement(_terms(parts, x, y, z), parts.bone_form)


def _core(parts: Bodies, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Distance to the tapered capsule with its balls."""
    a, b, c = (parts.half[..., i, None] for i in range(3))
    length = parts.length[..., None]
    core = torch.minimum(z.clamp(min=0), length)
    width = 1.0 + core * ((parts.taper[..., None] - 1.0) / length.clamp(min=1e-3))
    p = parts.exponent[..., None]
    # One Newton step of the implicit function: d = f / |grad f| with f the p-norm minus 1.
    u, v, w = (x.abs() / (width * a), y.abs() / (width * b), (z - core).abs() / c)
    up, vp, wp = (_power(t, p - 1) for t in (u, v, w))
    norm = _power(u * up + v * vp + w * wp, 1 / p).clamp(min=1e-3)
    slope = ((up / a).square() + (vp / b).square() + (wp / c).square()).sqrt() / _power(norm, p - 1)
    base = (norm - 1) / torch.maximum(slope, 1 / parts.half.amax(dim=-1, keepdim=True))
    for centre, radius in zip(parts.blobs[..., :3].unbind(-2), parts.blobs[..., 3].unbind(-1), strict=True):
        i, j, k = (t[..., None] for t in centre.unbind(-1))
        ball = ((x - i).square() + (y - j).square() + (z - k).square()).sqrt() - radius[..., None]
        ball = ball + 1e3 * (radius <= 0.5)[..., None]
        h = (BLEND - (base - ball).abs()).clamp(min=0)
        base = torch.minimum(base, ball) - h * h / (4 * BLEND)
    return base


def _power(base: Tensor, exponent: Tensor) -> Tensor:
    """Powers of numbers at least 1e-6; several times faster than the general power."""
    return (base.clamp(min=1e-6).log() * exponent).exp()


def _terms(parts: Bodies, x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, ...]:
    """Products of Legendre polynomials of place across, across and along: of total degree 1 to 2, then 3."""
    half, length = parts.half, parts.length[..., None]
    a, b = (t.div(half[..., i, None]).clamp_(-1.3, 1.3) for i, t in enumerate((x, y)))
    c = ((z - 0.5 * length) / (half[..., 2, None] + 0.5 * length)).clamp_(-1.3, 1.3)
    a2, b2, c2 = (1.5 * t * t - 0.5 for t in (a, b, c))
    ab, ac, bc = a * b, a * c, b * c
    return (a, b, c, a2, b2, c2, ab, ac, bc,
            a * (a2 * (5 / 3) - 2 / 3), b * (b2 * (5 / 3) - 2 / 3), c * (c2 * (5 / 3) - 2 / 3),
            a2 * b, a2 * c, b2 * a, b2 * c, c2 * a, c2 * b, ab * c)  # fmt: skip


def _displacement(terms: tuple[Tensor, ...], form: Tensor) -> Tensor:
    """Their sum with coefficients (..., t), t of them at most."""
    total = torch.zeros_like(terms[0])
    for term, factor in zip(terms, form.unbind(-1), strict=False):
        total.addcmul_(term, factor[..., None])
    return total.clamp_(-LIMIT, LIMIT)
