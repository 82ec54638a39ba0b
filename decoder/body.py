"""Genes to a body plan: a torso at the origin, limbs around it, hinges between them. z is up, lengths in voxels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import overload

import numpy as np
from numpy.typing import NDArray

from decoder.rasterise import Bone

MAX_SEGMENTS = 7
MAX_LIMBS = 5
MAX_PARTS = 3  # segments of one limb
_BODY_GENES = (
    "segments", "limbs", "symmetry", "phase", "girth", "bulk", "torso_x", "torso_y", "torso_z", "torso_exponent",
    "droop", "stance", "thickness", "range", "elevation", "hip_hinge", "hip_offset",
)  # fmt: skip
_LIMB_GENES = ("azimuth", "elevation", "droop", "yaw", "extend", "thickness")
_PART_GENES = ("length", "along", "across", "bend", "hinge", "range", "taper")
GENES = len(_BODY_GENES) + MAX_LIMBS * (len(_LIMB_GENES) + MAX_PARTS * len(_PART_GENES))
BLOBS = 20
BLOB_GENES = 4  # place along the bone, angle about it, radius, height above the core
LONGEST = 13.6  # half length of a torso with its skin; its free-form surface adds up to one voxel at either end
CAP = 3.0  # length of the rounded ends of a limb bone
_UP = np.array([0.0, 0.0, 1.0])
Vector = NDArray[np.float64]
Genes = Mapping[str, float]


@dataclass(frozen=True, eq=False, slots=True)
class PlannedHinge:
    """A hinge between two bones, by index.

    Attributes:
        position: a point on the axis, (3,).
        axis: unit vector, (3,).
        reach: it may turn by this much either way [rad].
        parent: index of the bone on the torso's side.
        child: index of the other bone.
    """

    position: Vector
    axis: Vector
    reach: float
    parent: int
    child: int


@dataclass(frozen=True, eq=False, slots=True)
class BodyPlan:
    """Bones (the torso first, parents before children), the hinges between them, and whether left mirrors right."""

    bones: list[Bone]
    hinges: list[PlannedHinge]
    symmetric: bool


@dataclass(frozen=True, slots=True)
class _Slot:
    """Where one limb goes: its angle about z, whose genes it follows, and whether it is that limb's mirror image."""

    azimuth: float
    source: int
    mirrored: bool


def grow(
    genes: NDArray[np.float64], blobs: NDArray[np.float64],
    *, bone_scale: float, torso_scale: float, length_scale: float,
) -> BodyPlan:  # fmt: skip
    """Grow the body plan of genes (GENES,) and blob genes (BLOBS, BLOB_GENES), all in (0, 1)."""
    body = dict(zip(_BODY_GENES, genes.tolist(), strict=False))
    rest = genes[len(_BODY_GENES) :].reshape(MAX_LIMBS, -1)
    limbs = [dict(zip(_LIMB_GENES, row.tolist(), strict=False)) for row in rest]
    parts = [
        [dict(zip(_PART_GENES, part.tolist(), strict=True)) for part in row[len(_LIMB_GENES) :].reshape(MAX_PARTS, -1)]
        for row in rest
    ]
    slots, counts, symmetric = _layout(body, limbs)
    torso = _torso(body, len(slots), torso_scale)
    bones, hinges = [torso], []
    for slot, count in zip(slots, counts, strict=True):
        first = len(bones)
        for index, (bone, hinge) in enumerate(
            _limb(body, limbs[slot.source], parts[slot.source][:count], slot, torso, bone_scale, length_scale)
        ):
            bones.append(bone)
            hinges.append(replace(hinge, parent=first + index - 1 if index else 0, child=first + index))
    return BodyPlan(_with_blobs(bones, blobs, slots, counts), hinges, symmetric)


def _layout(body: Genes, limbs: list[dict[str, float]]) -> tuple[list[_Slot], list[int], bool]:
    """Share the segments out among limbs and place the limbs around the torso."""
    segments = 3 + _step(body["segments"], (0.22, 0.24, 0.26, 0.18, 0.10))
    most = min(MAX_LIMBS, segments - 1)
    fewest = max(1, -(-(segments - 1) // MAX_PARTS))
    count = fewest + _step(body["limbs"], _LIMB_ODDS[most - fewest + 1])
    symmetric = body["symmetry"] < 0.5 and count > 1
    turn = 2 * math.pi / count
    if not symmetric:
        start = (body["phase"] - 0.5) * turn
        slots = [_Slot(start + turn * (k + 0.5 * (limbs[k]["azimuth"] - 0.5)), k, False) for k in range(count)]
    else:
        paired = count % 2 == 0 and body["phase"] < 0.65
        start = turn / 2 if paired else (0.0 if body["phase"] < 0.5 else math.pi)
        slots = []
        for k in range(count):
            twin = count - 1 - k if paired else -k % count
            source = min(k, twin)
            sway = 0.5 * turn * (limbs[source]["azimuth"] - 0.5) * (k != twin)
            slots.append(_Slot(start + turn * k + (sway if k == source else -sway), source, k != source))
    return slots, _part_counts(segments - 1 - count, slots, limbs), symmetric


_LIMB_ODDS = {
    1: (1.0,),
    2: (0.45, 0.55),
    3: (0.30, 0.40, 0.30),
    4: (0.15, 0.25, 0.30, 0.30),
    5: (0.08, 0.22, 0.25, 0.25, 0.20),
}  # by how many numbers of limbs are possible


def _part_counts(spare: int, slots: list[_Slot], limbs: list[dict[str, float]]) -> list[int]:
    """One segment per limb and the spare ones where the genes ask for them; mirror images stay equal."""
    counts = {slot.source: 1 for slot in slots}
    copies = {source: sum(slot.source == source for slot in slots) for source in counts}
    while True:
        open_limbs = [s for s in counts if counts[s] < MAX_PARTS and copies[s] <= spare]
        if not open_limbs:
            return [counts[slot.source] for slot in slots]
        best = max(open_limbs, key=lambda s: limbs[s]["extend"] / counts[s])
        counts[best] += 1
        spare -= copies[best]


def _torso(body: Genes, limbs: int, scale: float) -> Bone:
    bulk = scale * _between(body["bulk"], 0.88, 1.12)
    thickness = _between(body["thickness"], 1.0, 3.0)
    half = bulk * np.array([
        _between(body["torso_y"], 6.8, 8.8) + 0.5 * max(0, limbs - 3),
        _between(body["torso_z"], 4.4, 6.2),
        _between(body["torso_x"], 9.5, 14.0) + 0.4 * max(0, limbs - 3),
    ])  # fmt: skip
    half[2] = min(half[2], LONGEST - thickness)
    frame = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # u = y, v = z, w = x
    origin = np.zeros(3)
    return Bone(origin, origin, frame, half, _between(body["torso_exponent"], 2.3, 4.0), 1.0, np.zeros((0, 4)),
                thickness)  # fmt: skip


def _limb(
    body: Genes, limb: Genes, parts: list[dict[str, float]], slot: _Slot, torso: Bone, bone_scale: float,
    length_scale: float,
) -> list[tuple[Bone, PlannedHinge]]:  # fmt: skip
    """Bones and hinges from the torso outwards; the hinges' bone numbers are the caller's to fill in."""
    azimuth = -slot.azimuth if slot.mirrored else slot.azimuth  # A mirror image is grown on the other side first.
    level = np.clip(0.5 * (body["elevation"] + limb["elevation"]), 0.0, 1.0)
    position, outward = _on_torso(torso, azimuth, _between(float(level), -0.55, 0.15))
    yaw = math.atan2(outward[1], outward[0]) + math.radians(_between(limb["yaw"], -25.0, 25.0))
    level_direction = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    droop = math.radians(_between(0.75 * body["droop"] + 0.25 * limb["droop"], -5.0, 65.0))
    direction = math.cos(droop) * level_direction - math.sin(droop) * _UP
    side = np.cross(_UP, level_direction)
    away = _between(body["hip_offset"], 0.3, 1.5)
    position = position + away * outward
    overlap = away + 0.6
    girth = bone_scale * _between(body["girth"], 0.86, 1.16)
    thickness = _between(0.6 * body["thickness"] + 0.4 * limb["thickness"], 1.0, 4.0)
    grown = []
    for index, part in enumerate(parts):
        hinge_gene = 0.5 * (body["hip_hinge"] + part["hinge"]) if index == 0 else part["hinge"]
        axis = _hinge_axis(direction, side, hinge_gene)
        if index:
            bend = math.radians(_between(part["bend"], 15.0, 90.0))
            direction = _bent(direction, axis, bend, math.radians(_between(body["stance"], 15.0, 88.0)))
            side = _horizontal_side(direction, side)
        half = girth * np.array([_between(part["along"], 3.8, 5.7), _between(part["across"], 3.2, 4.6), CAP / girth])
        length = length_scale * (_between(part["length"], 11.5, 16.5) - (1.5 if index == len(parts) - 1 else 0.0))
        frame = np.stack([axis, np.cross(direction, axis), direction], axis=1)
        bone = Bone(position + (CAP - overlap) * direction, position + (length + 0.6 - CAP) * direction, frame, half,
                    _between(part["taper"], 2.2, 3.2), _between(part["taper"], 0.75, 1.15), np.zeros((0, 4)),
                    thickness)  # fmt: skip
        reach = _between(0.5 * (body["range"] + part["range"]), 0.5, 1.3)
        grown.append((bone, PlannedHinge(position, axis, reach, -1, -1)))
        position = position + length * direction
        overlap = 0.6
    return [_mirrored(bone, hinge) for bone, hinge in grown] if slot.mirrored else grown


def _on_torso(torso: Bone, azimuth: float, height: float) -> tuple[Vector, Vector]:
    """Point of the torso's surface at an angle about z and a height in half heights, and the level outward normal."""
    y, z, x = torso.half
    p = torso.exponent
    c, s = math.cos(azimuth), math.sin(azimuth)
    scale = ((1 - abs(height) ** p) / (abs(c) ** p + abs(s) ** p)) ** (1 / p)
    normal = np.array([math.copysign(abs(c) ** (p - 1), c) / x, math.copysign(abs(s) ** (p - 1), s) / y, 0.0])
    normal /= np.linalg.norm(normal)
    radial = np.array([x * c, y * s, 0.0])
    radial /= np.linalg.norm(radial)
    outward = normal + radial
    return np.array([x * c * scale, y * s * scale, z * height]), outward / np.linalg.norm(outward)


def _hinge_axis(direction: Vector, side: Vector, gene: float) -> Vector:
    """Axis across a limb: from sideways (the limb lifts) to upright (it sweeps), both preferred over the slant."""
    angle = math.pi * (gene - 0.5)
    angle -= 0.22 * math.sin(4 * angle)
    axis = math.cos(angle) * side + math.sin(angle) * np.cross(direction, side)
    return axis / np.linalg.norm(axis)


def _bent(direction: Vector, axis: Vector, angle: float, wanted_pitch: float) -> Vector:
    """The limb's direction beyond a joint: bent either way about the axis, whichever comes nearer the wanted pitch."""
    either = [math.cos(angle) * direction + sign * math.sin(angle) * np.cross(axis, direction) for sign in (1.0, -1.0)]
    miss = [abs(math.asin(np.clip(-d[2], -1.0, 1.0)) - wanted_pitch) for d in either]
    best = either[0] if miss[0] <= miss[1] + 0.05 else either[1]
    return best / np.linalg.norm(best)


def _horizontal_side(direction: Vector, before: Vector) -> Vector:
    """Level unit vector across a limb; for an upright limb, the one of the segment before."""
    side = np.cross(_UP, direction)
    length = float(np.linalg.norm(side))
    blended = side + max(0.0, 0.3 - length) * before
    blended -= (blended @ direction) * direction
    return blended / np.linalg.norm(blended)


def _mirrored(bone: Bone, hinge: PlannedHinge) -> tuple[Bone, PlannedHinge]:
    flip = np.array([1.0, -1.0, 1.0])
    mirrored = replace(bone, start=bone.start * flip, end=bone.end * flip, frame=bone.frame * flip[:, None])
    # A turn is mirrored by mirroring its axis and reversing it.
    return mirrored, replace(hinge, position=hinge.position * flip, axis=-hinge.axis * flip)


def _with_blobs(bones: list[Bone], genes: NDArray[np.float64], slots: list[_Slot], counts: list[int]) -> list[Bone]:
    """Blend balls into the bones, away from the joints; mirror images follow the limb they mirror."""
    first = np.concatenate([[1], 1 + np.cumsum(counts)])
    own = {first[k] + j: first[slot.source] + j for k, slot in enumerate(slots) for j in range(counts[k])}
    dressed = []
    for index, bone in enumerate(bones):
        mine = genes[own.get(index, index) :: MAX_SEGMENTS]
        along = _between(mine[:, 0], -0.55, 0.55)[:, None]
        angle = 2 * math.pi * mine[:, 1]
        radius = np.maximum(_between(mine[:, 2], -1.5, 3.4), 0.0)
        span = (bone.end - bone.start) if index else bone.frame[:, 2] * 2 * bone.half[2]
        middle = 0.5 * (bone.start + bone.end) + along * span * 0.5
        height = _between(mine[:, 3], 0.45, 0.85)
        offset = (np.cos(angle) * bone.half[0] * height)[:, None] * bone.frame[:, 0]
        offset += (np.sin(angle) * bone.half[1] * height)[:, None] * bone.frame[:, 1]
        dressed.append(replace(bone, blobs=np.column_stack([middle + offset, radius])))
    return dressed


@overload
def _between(gene: float, low: float, high: float) -> float: ...
@overload
def _between(gene: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]: ...
def _between(gene: float | NDArray[np.float64], low: float, high: float) -> float | NDArray[np.float64]:
    return low + (high - low) * gene


def _step(gene: float, odds: tuple[float, ...]) -> int:
    """Index of the interval of (0, 1), cut in the proportions `odds`, that holds the gene."""
    return int(np.searchsorted(np.cumsum(odds)[:-1], gene, side="right"))
