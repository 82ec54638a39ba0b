"""The candidate seats of one joint: what each shares with its bones, and how strong it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Hinge, MotorSeat
from mfg.motors import MotorSolver
from mfg.mount_sections import CELL, Sections
from mfg.mounts import Mount, motor_pose, mount_of
from mfg.scores import mount_balance
from mfg.strength import Half, Plastic, span

Array = NDArray[np.float64]
FAR = 0.10  # beyond this distance a bone's depth field says only that it is far [m]


@dataclass(frozen=True, eq=False, slots=True)
class Candidates:
    """Everywhere one joint's motor may sit.

    Attributes:
        index: of the hinge.
        hinge: the hinge.
        mount: of its motor.
        seats: best score first, at every offset in every kind: assignment and direction.
        few: those of them that stand for their neighbours.
        nearest: the seat that holds best on its worse side, good enough or not.
        tried: every seat, if none of them is any good.
        sections: its two bodies' bones, sampled for the strength.
        known: safety factor and weaker body of the seats that were asked for.
    """

    index: int
    hinge: Hinge
    mount: Mount
    seats: list[MotorSeat]
    few: list[int]
    nearest: MotorSeat
    tried: list[MotorSeat]
    sections: dict[int, Sections]
    known: dict[int, tuple[float, int]] = field(default_factory=dict)

    @staticmethod
    def of(
        blueprint: Blueprint, index: int, scan: MotorSolver, step: float, spread: float, most: int, plastic: Plastic
    ) -> Candidates:
        """Scan the offsets of `scan` in both assignments and both directions.

        Args:
            blueprint: with motion solved.
            index: of the hinge.
            scan: reach, least shared volume and weights.
            step: between offsets [m].
            spread: the best seat of a kind stands for those nearer than this to it [m].
            most: of those that stand for their neighbours.
            plastic: what bones are printed of.
        """
        hinge = blueprint.hinges[index]
        mount = mount_of(blueprint.catalogue.motor)
        offsets = replace(scan, step=step).offsets()
        bones = {body: blueprint.bodies[body].bone for body in (hinge.parent, hinge.body)}
        rings = {body: scan.rings(bone, hinge, mount) for body, bone in bones.items()}
        found: list[MotorSeat] = []
        tried: list[MotorSeat] = []
        nearest: MotorSeat | None = None
        for flipped in (False, True):
            poses = np.tile(
                motor_pose(hinge.position, -hinge.axis if flipped else hinge.axis, 0.0), (len(offsets), 1, 1)
            )
            poses[:, :3, 3] += offsets[:, None] * hinge.axis
            for holder, connector in ((hinge.parent, hinge.body), (hinge.body, hinge.parent)):
                V_h = rings[holder].overlaps(offsets, "holder", flipped)
                V_c = rings[connector].overlaps(offsets, "connector", flipped)

                def seat(k: int, a: Array = V_h, b: Array = V_c, h: int = holder, c: int = connector,
                         poses: Array = poses) -> MotorSeat:  # fmt: skip
                    V_h, V_c = float(a[k]), float(b[k])
                    score = mount_balance(V_h, V_c, scan.alpha)
                    return MotorSeat(index, h, c, float(offsets[k]), poses[k], V_h, V_c, score)

                worse = np.minimum(V_h, V_c)
                # Among equals the one that at least one bone holds best, then the smaller offset.
                top = seat(int(np.lexsort((np.abs(offsets), -V_h - V_c, -worse))[0]))
                if nearest is None or _hold(top) > _hold(nearest):
                    nearest = top
                if not (worse > 0).any():
                    tried += [seat(k) for k in range(len(offsets))]
                found += [seat(k) for k in np.flatnonzero(worse >= scan.min_overlap).tolist()]
        assert nearest is not None
        found.sort(key=lambda s: (-s.score, abs(s.offset)))
        sections = {
            body: Sections.sample(bone, hinge.position, hinge.axis, mount, plastic, scan.scan)
            for body, bone in bones.items()
        }
        return Candidates(index, hinge, mount, found, _few(found, hinge, spread, most), nearest, tried, sections)

    def of_plastic(self, plastic: Plastic) -> Candidates:
        """The same seats in bones of another plastic."""
        sections = {body: replace(found, plastic=plastic) for body, found in self.sections.items()}
        return replace(self, sections=sections, known={})

    def safety(self, k: int, least: float = 0.0) -> float:
        """Safety factor of a seat's mount: of its weaker half, or of one that is known to stay below `least`."""
        if k not in self.known:
            self.known[k] = self.weaker(self.seats[k], least)
        return self.known[k][0]

    def weaker(self, seat: MotorSeat, least: float = 0.0) -> tuple[float, int]:
        """Safety factor of the weaker half of a mount, and the body that carries this half."""
        flipped = self.flipped(seat)
        worst = (np.inf, seat.connector)
        halves: tuple[tuple[Half, int], ...] = (("connector", seat.connector), ("holder", seat.holder))
        for half, body in halves:
            worst = min(worst, (self.sections[body].safety(seat.offset, half, flipped, least), body))
            if worst[0] < least:
                break
        return worst

    def flipped(self, seat: MotorSeat) -> bool:
        """Whether the motor's output points against the hinge axis."""
        return float(seat.T_design_motor[:3, 2] @ self.hinge.axis) < 0

    def turned(self, k: int) -> MotorSeat:
        """A seat with its safety factor, turned so that its x axis, its cable's side, points into the holder's bone."""
        seat = self.seats[k]
        sections = self.sections[seat.holder]
        outer, low, _ = span(self.mount, "holder")
        sign = -1.0 if self.flipped(seat) else 1.0
        ring = math.ceil((outer - self.mount.attach_radius) / CELL)
        level = int((seat.offset + sign * (low + CELL) - sections.low) / CELL)
        cover = np.clip(sections.depth[level, ring], 0.0, None).astype(np.float64)
        angle = (np.arange(len(cover)) + 0.5) * (2 * np.pi / len(cover))
        # The mean direction of the bone; a bone all around has none, and any turn is as good.
        along, across = float(cover @ np.cos(angle)), float(cover @ np.sin(angle))
        turn = 0.0 if math.hypot(along, across) < 1e-3 * cover.sum() + 1e-12 else sign * math.atan2(across, along)
        T = seat.T_design_motor.copy()
        T[:3, 0] = math.cos(turn) * seat.T_design_motor[:3, 0] + math.sin(turn) * seat.T_design_motor[:3, 1]
        T[:3, 1] = np.cross(T[:3, 2], T[:3, 0])
        return replace(seat, T_design_motor=T, turn=turn, safety=self.safety(k))

    def distance(self, seat: MotorSeat, half: Half) -> float:
        """How far the bone of one half stays away from it: 0 where they share volume [m]."""
        sections = self.sections[seat.holder if half == "holder" else seat.connector]
        outer, low, high = span(self.mount, half)
        sign = -1.0 if self.flipped(seat) else 1.0
        levels = sorted((seat.offset + sign * z - sections.low) / CELL for z in (low, high))
        rings = math.ceil((outer - self.mount.attach_radius) / CELL)
        near = sections.depth[int(levels[0]) : math.ceil(levels[1]), :rings]
        return min(FAR, max(0.0, -float(near.max())))

    def closest(self) -> MotorSeat:
        """The seat whose farther bone is nearest, of all offsets and kinds: what comes closest where none holds."""
        if min(_hold(self.nearest)) > 0:
            return self.nearest
        return min(
            self.tried,
            key=lambda seat: (max(self.distance(seat, "holder"), self.distance(seat, "connector")), abs(seat.offset)),
        )


def _hold(seat: MotorSeat) -> tuple[float, float]:
    """What a seat shares with its bones: on its worse side, and in all [m3]."""
    return min(seat.holder_volume, seat.connector_volume), seat.holder_volume + seat.connector_volume


def _few(seats: list[MotorSeat], hinge: Hinge, spread: float, most: int) -> list[int]:
    """The best seats of every kind that are at least `spread` apart [m], at most so many in all."""
    kept: dict[tuple[int, bool], list[float]] = {}
    few: list[int] = []
    along = (np.array([seat.T_design_motor[:3, 2] for seat in seats]).reshape(-1, 3) @ hinge.axis > 0).tolist()
    for k, seat in enumerate(seats):
        if len(few) == most:
            break
        others = kept.setdefault((seat.holder, along[k]), [])
        if all(abs(seat.offset - other) >= spread - 1e-9 for other in others):
            others.append(seat.offset)
            few.append(k)
    return few
