"""Solver: one motor per joint, at the offset along the hinge axis that holds both bodies best (paper Eq. 2-3)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Hinge, MotorSeat
from mfg.fields import Field, about_axis, coverage
from mfg.miss import Miss
from mfg.mounts import MIN_OVERLAP, Mount, envelope_depth, motor_pose, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.scores import body_install_score, body_overlap, motor_score, mount_balance

SAMPLING_MARGIN = 1.05  # sampled volumes are within 4 % of the exact ones


@dataclass(frozen=True)
class MotorSolver:
    """Scan offsets and both assignments of holder and connector; seat the best motor of every hinge.

    Attributes:
        min_overlap: tau, least volume that holder and connector must each share with their body [m3]; asked of the
            sampled volumes with a margin, so that the exact ones keep it.
        alpha: weight of the total volume against the balanced one in g(delta).
        scan: offsets reach from -scan to +scan along the axis [m].
        step: between offsets, and height of a slice of the sampled rings [m].
        gap: least distance between the envelopes of two motors [m].
        ring_steps, angle_steps: samples across and around the ring in which mount and bone overlap.
    """

    min_overlap: float = SAMPLING_MARGIN * MIN_OVERLAP
    alpha: float = 0.25
    scan: float = 0.040
    step: float = 2.0e-3
    gap: float = 2.0e-3
    ring_steps: int = 3
    angle_steps: int = 60

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `seats` and the motor and body-installation scores, or a motor failure."""
        mount = mount_of(blueprint.catalogue.motor)
        seats: list[MotorSeat] = []
        for index, hinge in enumerate(blueprint.hinges):
            seat = self._seat(blueprint, index, hinge, mount, seats)
            if isinstance(seat, Failure):
                return seat
            seats.append(seat)
        return with_seats(blueprint, tuple(seats), self.alpha)

    def _seat(
        self, blueprint: Blueprint, index: int, hinge: Hinge, mount: Mount, seats: list[MotorSeat]
    ) -> MotorSeat | Failure:
        offsets = self.offsets()
        rings = {b: self.rings(blueprint.bodies[b].bone, hinge, mount) for b in (hinge.parent, hinge.body)}
        best: MotorSeat | None = None
        nearest, hit = (0.0, 0.0), False
        for holder, connector in ((hinge.parent, hinge.body), (hinge.body, hinge.parent)):
            # The housing points its output along the axis in both assignments.
            V_h, V_c = rings[holder].overlaps(offsets, "holder"), rings[connector].overlaps(offsets, "connector")
            nearest = max(nearest, max(zip(V_h.tolist(), V_c.tolist(), strict=True), key=min), key=min)
            scores = [self.objective(float(h), float(c)) for h, c in zip(V_h, V_c, strict=True)]
            # Best score first; among equals the smaller offset.
            for k in np.lexsort((np.abs(offsets), -np.array(scores))).tolist():
                score = scores[k]
                if score <= 0.0 or (best is not None and score <= best.score):
                    break
                T = motor_pose(hinge.position, hinge.axis, float(offsets[k]))
                if any(envelopes_meet(T, seat.T_design_motor, mount, self.gap) for seat in seats):
                    hit = True
                    continue
                best = MotorSeat(index, holder, connector, float(offsets[k]), T, float(V_h[k]), float(V_c[k]), score)
                break
        if best is not None:
            return best
        if hit:
            return Failure(
                Stage.MOTOR,
                Reason.MOTOR_COLLISION,
                f"{hinge.name}: every offset with enough hold runs into a motor already seated",
                Miss("gap between motors", "m", None, self.gap, (index,), remedy="move_joints_apart"),
            )
        return Failure(
            Stage.MOTOR,
            Reason.NO_OVERLAP,
            f"{hinge.name}: the best offset shares {1e6 * nearest[0]:.1f} cm3 with the holder's body and "
            f"{1e6 * nearest[1]:.1f} cm3 with the connector's, each needs {1e6 * self.min_overlap:.1f} cm3",
            Miss("shared volume", "m3", min(nearest), self.min_overlap, (index,), remedy="grow_near_joint"),
        )

    def offsets(self) -> NDArray[np.float64]:
        """The candidate offsets delta, symmetric about 0 [m]."""
        count = math.floor(self.scan / self.step)
        return np.arange(-count, count + 1, dtype=np.float64) * self.step

    def objective(self, V_h: float, V_c: float) -> float:
        """S(delta) = 1[V_h >= tau, V_c >= tau] g(delta) (paper Eq. 2)."""
        if V_h < self.min_overlap or V_c < self.min_overlap:
            return 0.0
        return mount_balance(V_h, V_c, self.alpha)

    def rings(self, bone: Field, hinge: Hinge, mount: Mount) -> Rings:
        """Sample one bone around a hinge axis, slice by slice, as far as any offset reaches."""
        reach = self.scan + max(-mount.base_low, mount.connector_high) + self.step
        edges: NDArray[np.float64] = np.arange(-reach, reach + self.step, self.step, dtype=np.float64)
        width = (mount.connector_radius - mount.attach_radius) / self.ring_steps
        radius: NDArray[np.float64] = mount.attach_radius + (np.arange(self.ring_steps, dtype=np.float64) + 0.5) * width
        angle = (np.arange(self.angle_steps) + 0.5) * (2 * np.pi / self.angle_steps)
        T = motor_pose(hinge.position, hinge.axis, 0.0)
        middles = edges[:-1] + self.step / 2
        depth = bone.sample_at(*about_axis(T, radius[:, None], angle, middles[:, None, None]))  # (height, ring, angle)
        share = coverage(depth, width).mean(axis=2, dtype=np.float64)
        below = np.concatenate([np.zeros((1, self.ring_steps)), np.cumsum(share * self.step, axis=0)])
        return Rings(mount, edges, radius, width, below)


def with_seats(blueprint: Blueprint, seats: tuple[MotorSeat, ...], alpha: float) -> Blueprint:
    """The blueprint with these seats and the motor and body-installation scores that follow from them."""
    seated = replace(blueprint, seats=seats)
    return seated.scored(
        motor=motor_score([seat.score for seat in seats], mount_of(blueprint.catalogue.motor), alpha),
        body_install=body_install_score(body_overlap(seated)),
    )


@dataclass(frozen=True, eq=False, slots=True)
class Rings:
    """How much of one bone lies in rings about a hinge axis, below every height.

    Holder and connector are rings in every slice across the axis (inside the attach radius the bone is cut away), so
    the bone is sampled once and the overlap at any offset is a difference of two heights.

    Attributes:
        mount: the mount whose radii the rings span.
        edges: heights along the axis [m], (k,).
        radius: of the middle of each ring [m].
        width: of each ring [m].
        below: filled height below each edge, per ring [m], (k, rings).
    """

    mount: Mount
    edges: NDArray[np.float64]
    radius: NDArray[np.float64]
    width: float
    below: NDArray[np.float64]

    def overlaps(
        self, offsets: NDArray[np.float64], part: Literal["holder", "connector"], flipped: bool = False
    ) -> NDArray[np.float64]:
        """V(delta): volume that one half of the mount shares with the bone, for every offset [m3].

        Where it is `flipped`, the motor's output points against the hinge axis.
        """
        m = self.mount
        outer, low, high = (
            (m.holder_radius, m.base_low, m.holder_top)
            if part == "holder"
            else (m.connector_radius, m.connector_low, m.connector_high)
        )
        if flipped:
            low, high = -high, -low
        # A ring that the part's rim passes through counts by the share of its area inside the rim.
        inside, edge = self.radius - self.width / 2, np.minimum(self.radius + self.width / 2, outer)
        area = np.pi * np.maximum(edge**2 - inside**2, 0.0)
        filled = self.below @ area
        below = np.interp(np.concatenate([offsets + low, offsets + high]), self.edges, filled)
        volumes: NDArray[np.float64] = below[len(offsets) :] - below[: len(offsets)]
        return volumes


def envelopes_meet(T_a: NDArray[np.float64], T_b: NDArray[np.float64], mount: Mount, gap: float) -> bool:
    """Whether two mounts come nearer to each other than `gap` [m] (sampled on the surface of one, both ways)."""
    reach = math.hypot(mount.envelope_radius, mount.connector_high) * 2 + gap
    if float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])) > reach:
        return False
    local = _surface_points(mount)
    for T, other in ((T_a, T_b), (T_b, T_a)):
        points = local @ T[:3, :3].T + T[:3, 3]
        if (envelope_depth(points, other, mount, gap) > 0).any():
            return True
    return False


@lru_cache(maxsize=8)
def _surface_points(mount: Mount) -> NDArray[np.float64]:
    """Points all over the envelope, rims and faces included, about 4 mm apart: (n, 3), motor frame."""
    angle = np.arange(72) * (2 * np.pi / 72)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings: list[tuple[float, float]] = []
    rings += [(mount.holder_radius, z) for z in np.linspace(mount.base_low, mount.connector_low, 18)]
    rings += [(mount.connector_radius, z) for z in np.linspace(mount.connector_low, mount.connector_high, 5)]
    for z, radius in ((mount.base_low, mount.holder_radius), (mount.connector_high, mount.connector_radius)):
        rings += [(r, z) for r in np.linspace(0.0, radius, 12)]
    return np.concatenate([np.column_stack([r * circle, np.full(len(circle), z)]) for r, z in rings])
