"""The bodies that the learned decoder learns from: drawn without end, in batches, on the CPU or on a GPU."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decoder.compose import Window, centres, compose, window_of
from decoder.design import DEFAULT_PITCH, Joint, VoxelDesign
from decoder.trees import MAX_PARTS, all_trees

GRID_MIDDLE = 32.0
ROOM = 58.0  # largest extent of a body [voxels]; the rest of the 64 is margin
CAP = 3.0  # length of the rounded ends of a limb bone [voxels]
COAT = 0.7  # least soft tissue over a bone [voxels]
BLOBS = 2  # balls blended into one bone
BLEND = 2.0  # over this width [voxels]
BONE_TERMS, SKIN_TERMS = 19, 9  # polynomials of degree 1-3 and 1-2
BONE_ROUGHNESS, SKIN_ROUGHNESS = 0.55, 0.7  # standard deviation of one surface's free-form displacement [voxels]
LIMIT = 2.0  # of that displacement


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
        moved = {f.name: _gather(getattr(self, f.name), index) for f in fields(self)}
        moved["parent"] = torch.gather(places, 1, moved["parent"])
        return Bodies(**moved)

    def pick(self, *index: Tensor) -> Bodies:
        """Some parts by a mask or by indices; their parents are no longer meant."""
        return Bodies(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def sample_bodies(n: int, rng: torch.Generator) -> Bodies:
    """Draw n bodies on the generator's device.

    A torso carries one to five limbs, chains or forks of up to four parts, bent by 15 to 90 degrees at every joint;
    half of the bodies are their own mirror image where their tree allows it. Bones are tapered superelliptic
    capsules with balls melted in and a free-form displacement; the skin over them has one of its own. Widths suit
    the motors and boxes of the catalogue often, not always: what cannot be built is for solvers to say.
    """
    device = rng.device
    trees = all_trees()
    odds = torch.as_tensor(trees.odds, device=device)
    row = torch.multinomial(odds, n, replacement=True, generator=rng)
    tree = {
        f: torch.as_tensor(getattr(trees, f), device=device)[row]
        for f in ("parent", "count", "azimuth", "sway", "side", "twin", "planar", "symmetric")
    }

    def draw(*shape: int) -> Tensor:
        return torch.rand((n, *shape), generator=rng, device=device)

    def between(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * draw(*shape)

    alive = torch.arange(MAX_PARTS, device=device) < tree["count"][:, None]
    symmetric = tree["symmetric"]
    planar = tree["planar"] & symmetric[:, None]
    limbs = ((tree["parent"] == 0) & alive).sum(1)
    # Traits of the whole body.
    girth, stance = between(0.86, 1.16), between(15.0, 88.0) * math.pi / 180
    droop_body, elevation, hip_hinge, away = draw(), draw(), draw(), between(0.3, 1.5)
    flesh, reach_body = draw(), draw()
    # The torso is wider for more limbs; its core line has no length and its axes are those of the grid.
    half = torch.zeros(n, MAX_PARTS, 3, device=device)
    extra = (limbs - 3).clamp(min=0)
    bulk = between(0.88, 1.12)
    half[:, 0] = bulk[:, None] * torch.stack(
        [between(6.8, 8.8) + 0.5 * extra, between(4.4, 6.2), between(9.5, 14.0) + 0.4 * extra], 1
    )
    thickness = 1.0 + 3.0 * (0.6 * flesh[:, None] + 0.4 * draw(MAX_PARTS))
    thickness[:, 0] = 1.0 + 2.0 * flesh
    half[:, 0, 2] = torch.minimum(half[:, 0, 2], 13.6 - thickness[:, 0])
    half[:, 1:, 0] = girth[:, None] * between(3.8, 5.7, MAX_PARTS - 1)
    half[:, 1:, 1] = girth[:, None] * between(3.2, 4.6, MAX_PARTS - 1)
    half[:, 1:, 2] = CAP
    exponent = between(2.2, 3.2, MAX_PARTS)
    exponent[:, 0] = between(2.3, 4.0)
    taper = between(0.75, 1.15, MAX_PARTS)
    taper[:, 0] = 1.0
    last = torch.ones_like(alive)
    last.scatter_(1, tree["parent"].clamp(min=0), False)
    span = between(11.5, 16.5, MAX_PARTS) - 1.5 * last
    low, high = (0.5 + 0.8 * (0.5 * reach_body[:, None] + 0.5 * draw(MAX_PARTS)) for _ in range(2))
    angle_range = torch.stack([-low, torch.where(planar, low, high)], 2)

    # Grow outwards, part by part; every body at once.
    zeros = torch.zeros(n, 3, device=device)
    eye = torch.eye(3, device=device)
    position, start, end, tip = ([zeros] for _ in range(4))
    axis, side, direction = [eye[1].expand(n, 3)], [eye[1].expand(n, 3)], [eye[0].expand(n, 3)]
    frame = [torch.stack([eye[1], eye[2], eye[0]], 1).expand(n, 3, 3)]  # across = y, across = z, along = x
    up = eye[2].expand(n, 3)
    azimuth = tree["azimuth"].float() + tree["sway"].float() * (2 * draw(MAX_PARTS) - 1)
    turn = 2 * math.pi / limbs.clamp(min=1)
    azimuth = azimuth + torch.where(symmetric, 0.0, (draw() - 0.5) * turn)[:, None]
    for k in range(1, MAX_PARTS):
        before = tree["parent"][:, k].clamp(min=0)
        at_torso = (before == 0)[:, None]
        flat = planar[:, k]
        # A hip: on the torso's surface, pointing outwards and down.
        height = -0.55 + 0.7 * 0.5 * (elevation + draw())
        hip, outward = _on_torso(half[:, 0], exponent[:, 0], azimuth[:, k], height)
        swing = torch.where(flat, 0.0, between(-25.0, 25.0) * math.pi / 180)
        yaw = torch.atan2(outward[:, 1], outward[:, 0]) + swing
        level = torch.stack([yaw.cos(), yaw.sin(), torch.zeros_like(yaw)], 1)
        droop = (-5.0 + 70.0 * (0.75 * droop_body + 0.25 * draw())) * math.pi / 180
        hip_direction = droop.cos()[:, None] * level - droop.sin()[:, None] * up
        hip_side = torch.linalg.cross(up, level)
        # A joint further out: at the tip of the part before, beside it on a fork.
        d = _pick(direction, before)
        s = _pick(side, before)
        branch = tree["side"][:, k, None].to(d.dtype)
        spread = (branch[:, 0] * between(30.0, 60.0) * math.pi / 180)[:, None]
        base = torch.where(at_torso, hip_direction, spread.cos() * d + spread.sin() * s)
        across = torch.where(at_torso, hip_side, _level_side(base, s))
        joint = torch.where(at_torso, hip + away[:, None] * outward, _pick(tip, before) + 3.2 * branch * s)
        gene = draw()
        gene = torch.where(at_torso[:, 0], 0.5 * (hip_hinge + gene), gene)
        a = _hinge_axis(base, across, torch.where(flat, 0.5, gene))
        # Beyond the hips a limb is bent by 15 to 90 degrees, towards its stance; forks spread instead.
        bend = between(15.0, 90.0) * math.pi / 180
        straight = at_torso[:, 0] | (branch[:, 0] != 0)
        w = torch.where(straight[:, None], base, _bent(base, a, bend, stance))
        across = torch.where(straight[:, None], across, _level_side(w, across))
        a = a - (a * w).sum(1, keepdim=True) * w
        a = a / a.norm(dim=1, keepdim=True).clamp(min=1e-6)
        overlap = torch.where(at_torso[:, 0], away + 0.6, 0.6)[:, None]
        begin = joint + (CAP - overlap) * w
        finish = joint + (span[:, k, None] + 0.6 - CAP) * w
        axes = torch.stack([a, torch.linalg.cross(w, a), w], 2)
        # A mirror image takes all of it from its twin.
        twin = tree["twin"][:, k].clamp(min=0)
        image = (tree["twin"][:, k] >= 0)[:, None]
        flip = torch.tensor([1.0, -1.0, 1.0], device=device)
        for values, own, sign in (
            (position, joint, 1.0), (axis, a, -1.0), (start, begin, 1.0), (end, finish, 1.0),
            (direction, w, 1.0), (side, across, -1.0), (tip, joint + span[:, k, None] * w, 1.0),
        ):  # fmt: skip
            values.append(torch.where(image, sign * flip * _pick(values, twin), own))
        mirrored = torch.stack(frame, 1)[torch.arange(n, device=device), twin] * flip[:, None]
        frame.append(torch.where(image[:, :, None], mirrored, axes))
    blobs, bone_form, skin_form = _free_form(half, span, rng)
    bodies = Bodies(
        alive=alive,
        parent=tree["parent"].clamp(min=0),
        position=torch.stack(position, 1),
        axis=torch.stack(axis, 1),
        range=angle_range,
        start=torch.stack(start, 1),
        frame=torch.stack(frame, 1),
        length=(torch.stack(end, 1) - torch.stack(start, 1)).norm(dim=2),
        half=half,
        exponent=exponent,
        taper=taper,
        blobs=blobs,
        bone_form=bone_form,
        skin_form=skin_form,
        thickness=thickness,
    )
    return _placed(_symmetrised(bodies, tree["twin"], planar))


def field(parts: Bodies, points: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distances to the bone's and to the skin's surface [voxels], about metric near them, negative inside.

    Args:
        parts: any selection of parts, leading shape (...).
        points: positions in the grid, (..., m, 3): those of a part are measured against that part.

    Returns:
        Bone and skin, (..., m) each.
    """
    local = (points - parts.start[..., None, :]) @ parts.frame
    x, y, z = local.unbind(-1)
    a, b, c = (parts.half[..., i, None] for i in range(3))
    length = parts.length[..., None]
    core = torch.minimum(z.clamp(min=0), length)
    width = 1.0 + core * ((parts.taper[..., None] - 1.0) / length.clamp(min=1e-3))
    p = parts.exponent[..., None]
    # One Newton step of the implicit function: d = f / |grad f| with f the p-norm minus 1.
    u, v, w = (x.abs() / (width * a), y.abs() / (width * b), (z - core).abs() / c)
    up, vp, wp = (t.clamp(min=1e-6) ** (p - 1) for t in (u, v, w))
    norm = ((u * up + v * vp + w * wp).clamp(min=1e-6) ** (1 / p)).clamp(min=1e-3)
    slope = ((up / a) ** 2 + (vp / b) ** 2 + (wp / c) ** 2).sqrt() / norm ** (p - 1)
    base = (norm - 1) / torch.maximum(slope, 1 / parts.half.amax(dim=-1, keepdim=True))
    for centre, radius in zip(parts.blobs[..., :3].unbind(-2), parts.blobs[..., 3].unbind(-1), strict=True):
        ball = (local - centre[..., None, :]).norm(dim=-1) - radius[..., None]
        ball = ball + 1e3 * (radius <= 0.5)[..., None]
        h = (BLEND - (base - ball).abs()).clamp(min=0)
        base = torch.minimum(base, ball) - h * h / (4 * BLEND)
    swell, flesh = _displacements(parts, (x / a).clamp(-1.3, 1.3), (y / b).clamp(-1.3, 1.3),
                                  ((z - 0.5 * length) / (c + 0.5 * length)).clamp(-1.3, 1.3))  # fmt: skip
    outer = torch.maximum(parts.thickness[..., None] + flesh, swell + COAT)
    return base - swell, base - outer


def _displacements(parts: Bodies, a: Tensor, b: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
    """Sums over products of Legendre polynomials of a, b, c: of total degree 1 to 3 for bones, 1 to 2 for skins."""
    a2, b2, c2 = (1.5 * t * t - 0.5 for t in (a, b, c))
    ab, ac, bc = a * b, a * c, b * c
    terms = [a, b, c, a2, b2, c2, ab, ac, bc]
    more = [a * (a2 * (5 / 3) - 2 / 3), b * (b2 * (5 / 3) - 2 / 3), c * (c2 * (5 / 3) - 2 / 3),
            a2 * b, a2 * c, b2 * a, b2 * c, c2 * a, c2 * b, ab * c]  # fmt: skip
    swell, flesh = torch.zeros_like(a), torch.zeros_like(a)
    for i, term in enumerate([*terms, *more]):
        swell.addcmul_(term, parts.bone_form[..., i, None])
        if i < SKIN_TERMS:
            flesh.addcmul_(term, parts.skin_form[..., i, None])
    return swell.clamp_(-LIMIT, LIMIT), flesh.clamp_(-LIMIT, LIMIT)


_ODD_ACROSS = (0, 6, 7, 9, 14, 16, 18)
"""Positions of the terms that are odd in the first coordinate: a, ab, ac, a3, b2 a, c2 a, abc."""


def _free_form(half: Tensor, span: Tensor, rng: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Balls on the bones, and coefficients of the two displacements."""
    n, device = len(half), half.device
    bone_form = torch.randn((n, MAX_PARTS, BONE_TERMS), generator=rng, device=device)
    skin_form = torch.randn((n, MAX_PARTS, SKIN_TERMS), generator=rng, device=device)
    bone_form = bone_form * (BONE_ROUGHNESS / math.sqrt(2.8))  # The mean squares of the terms add up to 2.8,
    skin_form = skin_form * (SKIN_ROUGHNESS / math.sqrt(1.9))  # those of the first nine to 1.9.
    r = torch.rand((n, MAX_PARTS, BLOBS, 4), generator=rng, device=device)
    angle = 2 * math.pi * r[..., 1]
    height = 0.45 + 0.4 * r[..., 3]
    x = angle.cos() * height * half[:, :, None, 0]
    y = angle.sin() * height * half[:, :, None, 1]
    middle = 0.5 * (span - 2 * CAP + 0.6)
    middle[:, 0] = 0.0
    stretch = 0.5 * span
    stretch[:, 0] = half[:, 0, 2]
    z = middle[..., None] + (-0.55 + 1.1 * r[..., 0]) * stretch[..., None]
    radius = (-1.5 + 4.9 * r[..., 2]).clamp(min=0.0)
    radius[:, 0] *= 1.4
    return torch.stack([x, y, z, radius], -1), bone_form, skin_form


def _symmetrised(bodies: Bodies, twin: Tensor, planar: Tensor) -> Bodies:
    """Give mirror images the forms of their twins, and make parts in the mirror plane even across it."""
    index = torch.arange(MAX_PARTS, device=twin.device).expand_as(twin)
    source = torch.where(twin >= 0, twin, index)
    copied = {}
    for name in ("range", "length", "half", "exponent", "taper", "blobs", "bone_form", "skin_form", "thickness"):
        copied[name] = _gather(getattr(bodies, name), source)
    # A turn is mirrored by mirroring its axis and reversing it, which `axis` already is.
    bone, skin, blobs = (copied[name].clone() for name in ("bone_form", "skin_form", "blobs"))
    flat = planar[..., None]
    odd = torch.zeros(BONE_TERMS, dtype=torch.bool, device=twin.device)
    odd[list(_ODD_ACROSS)] = True
    bone = torch.where(flat & odd, 0.0, bone)
    skin = torch.where(flat & odd[:SKIN_TERMS], 0.0, skin)
    image = blobs[:, :, 0] * torch.tensor([-1.0, 1.0, 1.0, 1.0], device=twin.device)
    blobs[:, :, 1] = torch.where(flat, image, blobs[:, :, 1])
    return replace(bodies, **{**copied, "bone_form": bone, "skin_form": skin, "blobs": blobs})


def _placed(bodies: Bodies) -> Bodies:
    """Centre every body in the grid and shrink the ones that are too large for it."""
    end = bodies.start + bodies.length[..., None] * bodies.frame[..., 2]
    wide = torch.cat([(bodies.half[..., :2] * bodies.taper.clamp(min=1.0)[..., None]), bodies.half[..., 2:]], 2)
    reach = torch.einsum("nkij,nkj->nki", bodies.frame.abs(), wide) + (bodies.thickness + 1.0)[..., None]
    hidden = ~bodies.alive[..., None]
    low = torch.minimum(bodies.start, end) - reach
    high = torch.maximum(bodies.start, end) + reach
    low = low.masked_fill(hidden, math.inf).amin(1)
    high = high.masked_fill(hidden, -math.inf).amax(1)
    scale = (ROOM / (high - low).amax(1)).clamp(max=1.0)[:, None, None]
    shift = GRID_MIDDLE - scale * (0.5 * (low + high))[:, None]
    return replace(
        bodies,
        position=bodies.position * scale + shift,
        start=bodies.start * scale + shift,
        length=bodies.length * scale[..., 0],
        half=bodies.half * scale,
        blobs=bodies.blobs * scale[..., None],
    )


def _on_torso(half: Tensor, exponent: Tensor, azimuth: Tensor, height: Tensor) -> tuple[Tensor, Tensor]:
    """Point of the torso's surface at an angle about z and a height in half heights, and the level outward normal."""
    y, z, x = half.unbind(1)
    c, s = azimuth.cos(), azimuth.sin()
    scale = ((1 - height.abs() ** exponent) / (c.abs() ** exponent + s.abs() ** exponent)) ** (1 / exponent)
    zero = torch.zeros_like(c)
    normal = torch.stack([c.sign() * c.abs() ** (exponent - 1) / x, s.sign() * s.abs() ** (exponent - 1) / y, zero], 1)
    radial = torch.stack([x * c, y * s, zero], 1)
    outward = normal / normal.norm(dim=1, keepdim=True) + radial / radial.norm(dim=1, keepdim=True)
    return torch.stack([x * c * scale, y * s * scale, z * height], 1), outward / outward.norm(dim=1, keepdim=True)


def _hinge_axis(direction: Tensor, side: Tensor, gene: Tensor) -> Tensor:
    """Axis across a limb: from sideways (the limb lifts) to upright (it sweeps), both preferred over the slant."""
    angle = math.pi * (gene - 0.5)
    angle = (angle - 0.22 * (4 * angle).sin())[:, None]
    axis = angle.cos() * side + angle.sin() * torch.linalg.cross(direction, side)
    return axis / axis.norm(dim=1, keepdim=True).clamp(min=1e-6)


def _bent(direction: Tensor, axis: Tensor, angle: Tensor, wanted_pitch: Tensor) -> Tensor:
    """The limb's direction beyond a joint: bent either way about the axis, whichever comes nearer the wanted pitch."""
    c, s = angle.cos()[:, None] * direction, angle.sin()[:, None] * torch.linalg.cross(axis, direction)
    one, other = c + s, c - s
    miss = [((-d[:, 2]).clamp(-1, 1).asin() - wanted_pitch).abs() for d in (one, other)]
    best = torch.where((miss[0] <= miss[1] + 0.05)[:, None], one, other)
    return best / best.norm(dim=1, keepdim=True).clamp(min=1e-6)


def _level_side(direction: Tensor, before: Tensor) -> Tensor:
    """Level unit vector across a limb; for an upright limb, the one of the segment before."""
    up = torch.zeros_like(direction)
    up[:, 2] = 1.0
    side = torch.linalg.cross(up, direction)
    blended = side + (0.3 - side.norm(dim=1, keepdim=True)).clamp(min=0) * before
    blended = blended - (blended * direction).sum(1, keepdim=True) * direction
    return blended / blended.norm(dim=1, keepdim=True).clamp(min=1e-6)


def _pick(values: list[Tensor], index: Tensor) -> Tensor:
    """Row `index` of a list of (n, 3) that grows part by part."""
    return torch.stack(values, 1)[torch.arange(len(index), device=index.device), index.clamp(max=len(values) - 1)]


def _gather(values: Tensor, index: Tensor) -> Tensor:
    """Rows of (n, 8, ...) in the order of `index` (n, 8)."""
    return values[torch.arange(len(index), device=index.device)[:, None], index]


def generator(seed: int, index: int, device: str = "cpu") -> torch.Generator:
    """The random stream number `index` of a seed."""
    rng = torch.Generator(device)
    rng.manual_seed(int(np.random.SeedSequence([seed, index]).generate_state(1, np.uint64)[0] >> 1))
    return rng


def sample_designs(n: int, seed: int) -> list[VoxelDesign]:
    """Draw n voxel designs; number k depends on the seed and on k only."""
    return [_design(sample_bodies(1, generator(seed, k))) for k in range(n)]


def _design(bodies: Bodies) -> VoxelDesign:
    count = int(bodies.alive[0].sum())
    wide = torch.cat([(bodies.half[..., :2] * bodies.taper.clamp(min=1.0)[..., None]), bodies.half[..., 2:]], 2)
    reach = torch.einsum("nkij,nkj->nki", bodies.frame.abs(), wide) + (bodies.thickness + 2 * LIMIT + 1)[..., None]
    end = bodies.start + bodies.length[..., None] * bodies.frame[..., 2]
    low, high = torch.minimum(bodies.start, end) - reach, torch.maximum(bodies.start, end) + reach
    windows = []
    for k in range(count):
        first, size = window_of(low[0, k].numpy(), high[0, k].numpy())
        points = torch.from_numpy(centres(first, size).reshape(-1, 3))
        bone, skin = field(bodies.pick(torch.tensor([0]), torch.tensor([k])), points[None])
        windows.append(Window(first, bone[0].numpy().reshape(size), skin[0].numpy().reshape(size)))
    parent = bodies.parent[0].tolist()
    material, segment, depth = compose(windows, {(min(parent[k], k), max(parent[k], k)) for k in range(1, count)})
    joints = [
        Joint(bodies.position[0, k].double().numpy() * DEFAULT_PITCH, _unit(bodies.axis[0, k]),
              bodies.range[0, k].double().numpy(), parent[k] + 1, k + 1)
        for k in range(1, count)
    ]  # fmt: skip
    return VoxelDesign(material, segment, DEFAULT_PITCH, tuple(joints), depth)


def _unit(vector: Tensor) -> NDArray[np.float64]:
    exact = vector.double().numpy()
    return np.asarray(exact / np.linalg.norm(exact))
