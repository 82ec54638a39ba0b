"""Solver: how far each joint can turn, and the interference near its limits carved away."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Body, Hinge
from mfg.bones import largest_piece
from mfg.fields import OUTSIDE, Field, Window, about_axis, coverage, interpolated
from mfg.miss import Miss
from mfg.mounts import motor_pose
from mfg.outcome import Failure, Reason, Stage
from mfg.voxel_fields import bounding_window

CARVED = 3.0  # samples further outside of a body than this are not carved [samples]


@dataclass(frozen=True)
class MotionSolver:
    """Find feasible joint ranges and carve the mutual intersection of each jointed pair.

    Both bones are sampled on one cylindrical grid about the hinge axis, where turning is a shift along the angle:
    the interference at every angle is one circular correlation, and the region swept by the child is a running
    maximum.

    Attributes:
        max_interference: share of the smaller bone that may interfere at any angle; the range ends before more does.
        min_range: least total range of a joint that is worth a motor [rad].
        gap: room left between the carved bone and the sweep [m].
        max_loss: largest share of a bone that carving may leave floating.
        angle_step, radial_step: resolution of the cylindrical grid [rad], [m].
    """

    max_interference: float = 0.06
    min_range: float = 0.35
    gap: float = 1.5e-3
    max_loss: float = 0.15
    angle_step: float = 2 * np.pi / 80
    radial_step: float = 5e-3

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with narrowed `hinges` and carved bones, or a motor failure."""
        bodies, hinges = list(blueprint.bodies), []
        volumes = [body.bone.volume() for body in bodies]
        for index, hinge in enumerate(blueprint.hinges):
            bones = bodies[hinge.parent].bone, bodies[hinge.body].bone
            T = motor_pose(hinge.position, hinge.axis, 0.0)
            pair = CylindricalPair.sample(*bones, T, self.angle_step, self.radial_step)
            allowed = self.max_interference * min(volumes[hinge.parent], volumes[hinge.body])
            low, high = (float(v) for v in hinge.range)
            if pair is not None:
                low, high = feasible(pair.interference(), hinge.range, allowed, pair.step)
            if high - low < self.min_range:
                return Failure(
                    Stage.MOTOR,
                    Reason.NO_MOTION,
                    f"{hinge.name} can turn {high - low:.2f} rad before {100 * self.max_interference:.0f} % of a bone "
                    f"is in the way, needs {self.min_range:.2f} rad",
                    Miss("range of motion", "rad", high - low, self.min_range, (index,)),
                )
            hinges.append(replace(hinge, range=np.array([low, high])))
            if pair is None:  # The two bones share no circle about the axis: nothing can ever touch.
                continue
            # The heavier bone of the pair gives way: it has more to give.
            carved = hinge.parent if volumes[hinge.parent] >= volumes[hinge.body] else hinge.body
            swept = pair.swept(low, high, of_child=carved == hinge.parent)
            bodies[carved], lost = carve(bodies[carved], pair, swept, hinge, self.gap)
            if lost > self.max_loss:
                return Failure(
                    Stage.MOTOR,
                    Reason.BONE_SEVERED,
                    f"clearing the sweep of {hinge.name} cuts {100 * lost:.0f} % off {bodies[carved].name}",
                    Miss("share of a bone that is kept", "1", 1 - lost, 1 - self.max_loss, (index,), (carved,)),
                )
        bodies = [
            replace(body, bone=rounded(body.bone), skin=None if body.skin is None else rounded(body.skin))
            for body in bodies
        ]
        return replace(blueprint, bodies=tuple(bodies), hinges=tuple(hinges))


def rounded(field: Field) -> Field:
    """Take the sharp convex edges off that cutting left, thinner than the lattice can carry; add nothing."""
    blurred = field.values
    for axis in range(3):  # (1 4 6 4 1) / 16, by sums of neighbours: a blur as wide as one sample
        line = np.moveaxis(blurred, axis, 0)
        for _ in range(4):
            line = line[1:] + line[:-1]
        blurred = np.moveaxis(line, 0, axis)
    values = field.values.copy()
    inner = values[2:-2, 2:-2, 2:-2]  # nothing of a body lies further out
    # On a smooth surface the blur recedes by far less than a quarter of a sample.
    np.minimum(inner, blurred * np.float32(1 / 16**3) + np.float32(0.25 * field.spacing), out=inner)
    return field.with_values(values)


@dataclass(frozen=True, eq=False, slots=True)
class Reaches:
    """How far bones reach about axes, each worked out once. A field stands for its bone: carving makes a new one.

    Attributes:
        points: of every bone, its samples inside and just outside of it in the design frame [m], (3, n).
        known: by bone and axis, least and greatest distance from the axis, least and greatest height along it [m].
    """

    points: dict[Field, NDArray[np.float32]] = field(default_factory=dict)
    known: dict[tuple[Field, bytes], tuple[float, float, float, float]] = field(default_factory=dict)

    def of(
        self, bone: Field, centre: NDArray[np.float64], frame: NDArray[np.float64]
    ) -> tuple[float, float, float, float]:
        """Reach of a bone about the third row of a frame (3, 3) through a point [m]."""
        key = bone, centre.tobytes() + frame.tobytes()
        if key not in self.known:
            if bone not in self.points:
                near = np.nonzero(bone.values > -bone.spacing)
                axes = [a.ravel()[index] for a, index in zip(bone.axes(), near, strict=True)]
                self.points[bone] = np.stack(axes)
            x, y, height = frame.astype(np.float32) @ (self.points[bone] - centre.astype(np.float32)[:, None])
            radius = np.sqrt(x * x + y * y)
            self.known[key] = float(radius.min()), float(radius.max()), float(height.min()), float(height.max())
        return self.known[key]


@dataclass(frozen=True, eq=False, slots=True)
class CylindricalPair:
    """Depths of two bones on a common (radius, angle, height) grid about a hinge axis."""

    parent: NDArray[np.float32]
    child: NDArray[np.float32]
    frame: NDArray[np.float64]  # rows: x, y, axis
    radius: NDArray[np.float64]
    height: NDArray[np.float64]
    step: float

    @staticmethod
    def sample(
        parent: Field, child: Field, T_design_hinge: NDArray[np.float64], angle_step: float, radial_step: float,
        reaches: Reaches | None = None,
    ) -> CylindricalPair | None:  # fmt: skip
        """Sample two bones about the z axis of a frame, or give None where no circle about the axis meets both.

        What is found about the reach of a bone is looked up in `reaches` and left there.
        """
        position, frame = T_design_hinge[:3, 3], T_design_hinge[:3, :3].T
        reaches = reaches or Reaches()
        reach = [reaches.of(bone, position, frame) for bone in (parent, child)]
        r_low, r_high = max(r[0] for r in reach), min(r[1] for r in reach)
        z_low, z_high = max(r[2] for r in reach), min(r[3] for r in reach)
        step = radial_step
        if r_high - r_low < step or z_high - z_low < step:
            return None
        radius = np.arange(max(r_low - step, step / 2), r_high + step, step)
        height = np.arange(z_low - step, z_high + step, step)
        count = round(2 * np.pi / angle_step)
        angle = np.arange(count) * (2 * np.pi / count)
        points = about_axis(T_design_hinge, radius[:, None, None], angle[:, None], height)
        depths = parent.sample_at(*points), child.sample_at(*points)
        return CylindricalPair(*depths, frame, radius, height, 2 * np.pi / count)

    def window(self, field: Field, position: NDArray[np.float64]) -> Window | None:
        """The samples of a field around the grid, or None where there are none; `position` is the hinge's [m]."""
        axis, radius = self.frame[2], self.radius[-1]
        half = (self.height[-1] - self.height[0]) / 2
        reach = np.abs(axis) * half + np.sqrt(np.maximum(1 - axis * axis, 0)) * radius + field.spacing
        return field.window(position + (self.height[0] + half) * axis, reach)

    def depth_of(
        self, values: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """What values on the grid are at points x, y, z from the hinge [m], (n,); `OUTSIDE` beyond the grid."""
        u, v, height = (x * np.float32(e[0]) + y * np.float32(e[1]) + z * np.float32(e[2]) for e in self.frame)
        ring = (np.hypot(u, v) - np.float32(self.radius[0])) / np.float32(self.radius[1] - self.radius[0])
        level = (height - np.float32(self.height[0])) / np.float32(self.height[1] - self.height[0])
        angle = np.arctan2(v, u)
        angle += np.float32(2 * np.pi) * (angle < 0)
        wrapped = np.concatenate([values, values[:, :1]], axis=1)
        return interpolated(wrapped, ring, np.minimum(angle / np.float32(self.step), values.shape[1]), level)

    def interference(self) -> NDArray[np.float64]:
        """Overlap volume of the bones with the child turned by k steps, for every k [m3]."""
        width = float(self.radius[1] - self.radius[0])
        cell = self.radius * width * self.step * float(self.height[1] - self.height[0])
        a = np.fft.rfft(coverage(self.parent, width), axis=1)
        b = np.fft.rfft(coverage(self.child, width), axis=1)
        turned = np.fft.irfft((a * np.conj(b)).sum(axis=2) * cell[:, None], n=self.parent.shape[1], axis=1)
        return np.maximum(turned.sum(axis=0), 0.0)

    def swept(self, low: float, high: float, of_child: bool) -> NDArray[np.float32]:
        """Depth of the region that one bone passes over while the child turns from low to high, seen by the other."""
        moving = self.child if of_child else self.parent
        ahead = int(np.ceil((high if of_child else -low) / self.step))
        behind = int(np.ceil((-low if of_child else high) / self.step))
        # Sample k of the result is the greatest depth over samples k - ahead ... k + behind of the moving bone.
        return _running_maximum(moving, ahead, behind)


def _running_maximum(values: NDArray[np.float32], ahead: int, behind: int) -> NDArray[np.float32]:
    """Greatest value over [k - ahead, k + behind] along the (circular) second axis."""
    count, size = values.shape[1], ahead + behind + 1
    if size >= count:
        return np.broadcast_to(values.max(axis=1, keepdims=True), values.shape)
    window = np.concatenate([values[:, count - ahead :], values, values[:, :behind]], axis=1)
    width = 1
    while 2 * width <= size:  # Windows of doubling width.
        window = np.maximum(window[:, :-width], window[:, width:])
        width *= 2
    last = size - width
    return np.maximum(window[:, :count], window[:, last : last + count])


def _common(one: Window, other: Window | None) -> Window | None:
    """What two windows share, or None."""
    if other is None:
        return None
    x, y, z = (slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return (x, y, z) if x.start < x.stop and y.start < y.stop and z.start < z.stop else None


def feasible(
    interference: NDArray[np.float64], wanted: NDArray[np.float64], allowed: float, step: float
) -> tuple[float, float]:
    """Widest range around 0 within `wanted` in which the interference stays below `allowed`."""
    limits = []
    for sign, bound in ((-1, -wanted[0]), (1, wanted[1])):
        reached = 0.0
        for k in range(1, len(interference) // 2 + 1):
            if interference[sign * k] > allowed or reached >= bound:
                break
            reached = min(k * step, float(bound))
        limits.append(sign * reached)
    return limits[0], limits[1]


def carve(
    body: Body, pair: CylindricalPair, swept: NDArray[np.float32], hinge: Hinge, gap: float
) -> tuple[Body, float]:
    """The body without a swept region, and the share of its bone that this leaves floating, which is dropped."""
    field = body.bone
    solid = field.values > -2 * field.spacing
    if not solid.any():
        return body, 1.0
    window = _common(bounding_window(solid)[1], pair.window(field, hinge.position))
    if window is None:
        bone, lost = largest_piece(field)
        return replace(body, bone=bone), lost
    skin = body.skin
    here = field.values[window]
    # What lies clearly outside of the bone and its skin can lose nothing.
    near = here > -CARVED * field.spacing
    if skin is not None:
        near |= skin.on_lattice_of(field)[window] > -CARVED * field.spacing
    met = np.nonzero(near)
    place = [a.ravel()[m] - np.float32(c) for a, m, c in zip(field.axes(window), met, hinge.position, strict=True)]
    inside = np.full(here.shape, OUTSIDE, np.float32)
    inside[met] = pair.depth_of(swept, *place)
    values = field.values.copy()
    values[window] = np.minimum(here, -inside - np.float32(gap))
    # A bone that lost nothing is as whole as it was.
    cut = bool(((here > 0) & (values[window] <= 0)).any())
    bone, lost = largest_piece(field.with_values(values)) if cut else (field.with_values(values), 0.0)
    if skin is not None:
        # The skin must not grow into the room that the bone gave up.
        given = np.full(field.values.shape, OUTSIDE, np.float32)
        given[window] = inside
        room = field.with_values(given).on_lattice_of(skin)
        skin = skin.with_values(np.minimum(skin.values, -room - np.float32(gap)))
    return replace(body, bone=bone, skin=skin), lost
