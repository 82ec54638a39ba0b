"""How synthetic bodies grow: a torso, limbs along a tree, free forms, and left mirrored to right."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from decoder.formulas import BLOBS, BONE_TERMS, ODD_ACROSS, SKIN_TERMS, Bodies, boxes, gathered
from decoder.parts import MAX_PARTS, MIDDLE
from decoder.trees import all_trees

ROOM = 58.0  # largest extent of a body [voxels]; the rest of the 64 is margin
CAP = 3.0  # length of the rounded ends of a limb bone [voxels]
BONE_ROUGHNESS, SKIN_ROUGHNESS = 0.55, 0.7  # standard deviation of one surface's free-form displacement [voxels]


def grown(n: int, rng: torch.Generator) -> Bodies:
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
    bulk = between(0.93, 1.17)
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
        copied[name] = gathered(getattr(bodies, name), source)
    # A turn is mirrored by mirroring its axis and reversing it, which `axis` already is.
    bone, skin, blobs = (copied[name].clone() for name in ("bone_form", "skin_form", "blobs"))
    flat = planar[..., None]
    odd = torch.zeros(BONE_TERMS, dtype=torch.bool, device=twin.device)
    odd[list(ODD_ACROSS)] = True
    bone = torch.where(flat & odd, 0.0, bone)
    skin = torch.where(flat & odd[:SKIN_TERMS], 0.0, skin)
    image = blobs[:, :, 0] * torch.tensor([-1.0, 1.0, 1.0, 1.0], device=twin.device)
    blobs[:, :, 1] = torch.where(flat, image, blobs[:, :, 1])
    return replace(bodies, **{**copied, "bone_form": bone, "skin_form": skin, "blobs": blobs})


def _placed(bodies: Bodies) -> Bodies:
    """Centre every body in the grid and shrink the ones that are too large for it."""
    low, high = boxes(bodies, 1.0)
    hidden = ~bodies.alive[..., None]
    low = low.masked_fill(hidden, math.inf).amin(1)
    high = high.masked_fill(hidden, -math.inf).amax(1)
    scale = (ROOM / (high - low).amax(1)).clamp(max=1.0)[:, None, None]
    shift = MIDDLE - scale * (0.5 * (low + high))[:, None]
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
