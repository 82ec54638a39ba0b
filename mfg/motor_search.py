"""Solver: motors where their mounts are strong enough, searched for all joints together."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Blueprint, Body, MotorSeat
from mfg.bones import cut_cylinder, largest_piece
from mfg.catalogue import Catalogue
from mfg.exact import ACCESS, LIFT
from mfg.fields import Field
from mfg.miss import Miss
from mfg.motor_candidates import Candidates
from mfg.motor_choice import Clearance, Stuck, choose
from mfg.motors import MotorSolver, envelopes_meet, with_seats
from mfg.mounts import Mount, mount_of
from mfg.outcome import Failure, Reason, Stage
from mfg.strength import BENDING_SHARE, LAYER_STRENGTH, Half, Plastic
from mfg.tool_access import reach, shortfall

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FUSED = 5.0e-7  # what the exact solids of a mount and its bone must share to be one part: a cube of 8 mm [m3]
CLOSE_PAIRS = 200  # pairs of seats among which the one that is nearest to being got at is sought
ROWS = 16  # seats of a joint that are compared with those of another in one go
CLOSE_LOOKS = 6  # seats of a hopeless joint among which the strongest is sought


@dataclass(frozen=True)
class SearchMotorSolver:
    """Seat all motors at once where their mounts stand the peak torque, by the paper's score S(delta).

    Every joint has candidates over a wide range of offsets, both assignments of holder and connector and both ways for
    the output to point. Among the combinations in which no two motors meet, a hand with a key gets at each (see
    `mfg.tool_access`) and every mount reaches the safety factor (see `mfg.strength`), the one with the greatest sum of
    S wins. Each motor is then turned about its axis so that its
    cable leaves where the holder's bone is thickest (by the motor frame's x axis; the mount's screws repeat all around
    and need no bone).

    Attributes:
        min_safety: least strength over stress of both halves of a mount under the peak torque, in place of tau.
        min_overlap: least sampled volume that each half shares with its bone, twice what fuses the solids [m3].
        strength: of the printed plastic [Pa].
        most_walls: bones are printed with the fewest walls that make the mounts strong, from those that the catalogue
            states to so many; `catalogue.rigid` of the blueprint returned says how many.
        alpha: weight of the total volume against the balanced one in g(delta).
        scan: offsets reach from -scan to +scan along the axis [m].
        step: between offsets [m].
        slice: height of a slice of the sampled rings [m].
        spread: a seat stands for those of its kind that are nearer than this, where that is enough [m].
        gap: least distance between the envelopes of two motors [m].
        candidates: most of the seats of one joint that stand for others.
        steps: most seats tried in the joint search.
        cut_half_length: half length of the bone processor's cylinder about a joint [m].
        max_loss: largest share of a bone that the longer cylinder of a far offset may cut off.
    """

    min_safety: float = 2.0
    min_overlap: float = 2 * FUSED
    strength: float = LAYER_STRENGTH
    most_walls: int = 8
    alpha: float = MotorSolver.alpha
    scan: float = 0.080
    step: float = 2.0e-3
    slice: float = 4.0e-3
    spread: float = 6.0e-3
    gap: float = MotorSolver.gap
    candidates: int = 48
    steps: int = 6000
    cut_half_length: float = 0.080
    max_loss: float = 0.10

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with `seats`, their bones cut for far offsets, and scores; or a motor failure."""
        catalogue = blueprint.catalogue
        most = max(self.most_walls, catalogue.rigid.walls)
        scan = MotorSolver(self.min_overlap, self.alpha, self.scan, self.slice)
        joints = []
        for index in range(len(blueprint.hinges)):
            joint = Candidates.of(
                blueprint, index, scan, self.step, self.spread, self.candidates, self.plastic(catalogue, most)
            )
            if not joint.seats:
                return self._too_far(blueprint, joint)
            joints.append(joint)
        # A few seats for each joint first: nearly always enough, and much faster than all of them.
        answer = self._choice(blueprint, joints, every=False)
        if isinstance(answer, Stuck):
            answer = self._choice(blueprint, joints, every=True)
        if isinstance(answer, Stuck):
            return self._stuck(blueprint, joints, answer)
        most, joints = self._thinnest(catalogue, most, joints, answer)
        if most > catalogue.rigid.walls:
            stronger = replace(catalogue, rigid=replace(catalogue.rigid, walls=most))
            blueprint = replace(blueprint, catalogue=stronger).noted(
                f"bones are printed with {most} walls instead of {catalogue.rigid.walls}: the mounts need it"
            )
        mount = mount_of(catalogue.motor)
        seats = tuple(joint.turned(k) for joint, k in zip(joints, answer, strict=True))
        whole = list(blueprint.bodies)
        for seat in seats:
            for index in (seat.holder, seat.connector):
                cut = self._cut(whole[index], blueprint, seat, index, mount)
                whole[index] = cut or whole[index]  # Two cuts that pass alone may sever together: finish will tell.
        return with_seats(replace(blueprint, bodies=tuple(whole)), seats, self.alpha)

    def _thinnest(
        self, catalogue: Catalogue, most: int, joints: list[Candidates], seats: list[int]
    ) -> tuple[int, list[Candidates]]:
        """The fewest walls, up to those that are strong enough, that make every mount so, and the joints with them.

        More walls are never weaker, so a mount that was strong enough need not be looked at again.
        """
        thinner = {walls: [joint.of_plastic(self.plastic(catalogue, walls)) for joint in joints]
                   for walls in range(catalogue.rigid.walls, most)}  # fmt: skip
        walls = catalogue.rigid.walls
        # The weakest mount decides nearly always, so that the others are looked at once.
        for index in sorted(range(len(joints)), key=lambda index: joints[index].safety(seats[index])):
            while walls < most and thinner[walls][index].safety(seats[index], self.min_safety) < self.min_safety:
                walls += 1
        return walls, thinner.get(walls, joints)

    def plastic(self, catalogue: Catalogue, walls: int) -> Plastic:
        """What bones with so many walls are made of, as this solver reckons with it."""
        return Plastic.of(replace(catalogue.rigid, walls=walls), catalogue.printer, self.strength)

    def _choice(self, blueprint: Blueprint, joints: list[Candidates], *, every: bool) -> list[int] | Stuck:
        """The best combination of the joints' seats, or where the search got stuck.

        Out of a few of them, and such that motors are clearly apart, or out of `every` seat, told apart exactly.
        """
        open_seats = [list(range(len(joint.seats))) if every else joint.few for joint in joints]
        steps = self.steps if every else self.steps // 4
        mount = mount_of(blueprint.catalogue.motor)
        far = reach(mount)
        seats = [[joint.seats[k] for k in some] for joint, some in zip(joints, open_seats, strict=True)]
        poses = [np.array([seat.T_design_motor for seat in some]) for some in seats]

        @cache
        def known(i: int, block: int, j: int) -> Clearance:
            return Clearance.of(poses[i][block * ROWS : (block + 1) * ROWS], poses[j], mount)

        def possible(i: int, a: int, j: int) -> Mask:
            return ~known(i, a // ROWS, j).meet[a % ROWS]

        def clear(i: int, a: int, j: int, b: int) -> bool:
            apart = float(known(i, a // ROWS, j).distance[a % ROWS, b])
            # The exact test grows the rim of an envelope by the gap both ways.
            if apart < math.sqrt(2) * self.gap and not (
                every and not envelopes_meet(poses[i][a], poses[j][b], mount, self.gap)
            ):
                return False
            return apart >= far or shortfall(seats[i][a], seats[j][b], mount) <= 0.0

        def accept(i: int, a: int) -> bool:
            if joints[i].safety(open_seats[i][a], self.min_safety) < self.min_safety:
                return False
            seat = seats[i][a]
            return all(self._cut(blueprint.bodies[b], blueprint, seat, b, mount) for b in (seat.holder, seat.connector))

        answer = choose([np.array([s.score for s in some]) for some in seats], possible, clear, accept, steps)
        if isinstance(answer, Stuck):
            return answer
        return [some[k] for some, k in zip(open_seats, answer, strict=True)]

    def _cut(self, body: Body, blueprint: Blueprint, seat: MotorSeat, index: int, mount: Mount) -> Body | None:
        """The body with the way to the motor and to its screws cut as far as it leads, or None where that severs it.

        The bone processor cut what a motor near the joint needs; a motor at a far offset needs the rest of its way.
        """
        low, high = mount.base_low - ACCESS, mount.connector_high + ACCESS
        if index == seat.holder:
            high = max(high, mount.holder_top + mount.motor.length + LIFT)
        hinge, pointing = blueprint.hinges[seat.hinge], blueprint.pointing(seat)
        low, high = sorted((seat.offset + pointing * low, seat.offset + pointing * high))
        bone, skin = body.bone, body.skin
        for start, end in ((low, -self.cut_half_length), (self.cut_half_length, high)):
            if end <= start or not _fills(bone, hinge.position, hinge.axis, mount.attach_radius, start, end):
                continue
            middle = hinge.position + (start + end) / 2 * hinge.axis
            bone = cut_cylinder(bone, middle, hinge.axis, mount.attach_radius, (end - start) / 2)
            if skin is not None:  # Where the bone was, the skin must not fill in.
                skin = cut_cylinder(skin, middle, hinge.axis, mount.attach_radius, (end - start) / 2)
        if bone is body.bone:
            return body
        kept, lost = largest_piece(bone)
        return None if lost > self.max_loss else replace(body, bone=kept, skin=skin)

    def _too_far(self, blueprint: Blueprint, joint: Candidates) -> Failure:
        """No offset at which both halves would even fuse with their bones."""
        seat = joint.closest()
        lacking: dict[Half, tuple[float, float]] = {
            "holder": (seat.holder_volume, -joint.distance(seat, "holder")),
            "connector": (seat.connector_volume, -joint.distance(seat, "connector")),
        }
        half = min(lacking, key=lambda h: lacking[h])
        body = seat.holder if half == "holder" else seat.connector
        shared = min(seat.holder_volume, seat.connector_volume)
        away = joint.distance(seat, half)
        name, segment = blueprint.bodies[body].name, blueprint.bodies[body].segment
        voxels = max(1, math.ceil(away / blueprint.design.pitch))
        return Failure(
            Stage.MOTOR,
            Reason.NO_OVERLAP,
            f"{joint.hinge.name}: the best offset, {1e3 * seat.offset:+.0f} mm, shares "
            f"{1e6 * seat.holder_volume:.1f} cm3 with the holder's {blueprint.bodies[seat.holder].name} and "
            f"{1e6 * seat.connector_volume:.1f} cm3 with the connector's {blueprint.bodies[seat.connector].name}, each "
            f"needs {1e6 * self.min_overlap:.1f} cm3; {name} lacks material"
            f"{f' by {1e3 * away:.0f} mm' if away > 0 else ''}: grow segment {segment} by {_voxels(voxels)} near the "
            "joint",
            Miss("shared volume", "m3", shared, self.min_overlap, (joint.index,), (body,), grow=max(away, 0.0),
                 remedy="grow_near_joint"),
        )  # fmt: skip

    def _stuck(self, blueprint: Blueprint, joints: list[Candidates], stuck: Stuck) -> Failure:
        joint = joints[stuck.joint]
        strong = [k for k, (safety, _) in joint.known.items() if safety >= self.min_safety]
        if stuck.other is None and not strong:
            return self._too_weak(blueprint, joint)
        if stuck.other is None:
            return Failure(
                Stage.MOTOR,
                Reason.BONE_SEVERED,
                f"{joint.hinge.name}: wherever its mount is strong enough, the way to the motor cuts more than "
                f"{100 * self.max_loss:.0f} % off a body; grow both segments by 1 voxel near the joint",
                Miss(
                    "share of a bone that is kept",
                    "1",
                    None,
                    1 - self.max_loss,
                    (joint.index,),
                    remedy="grow_near_joint",
                ),
            )
        return self._in_the_way(blueprint, joint, joints[stuck.other])

    def _in_the_way(self, blueprint: Blueprint, joint: Candidates, other: Candidates) -> Failure:
        """Two joints whose motors, where they are strong enough, meet or hide each other's screws."""
        mount = mount_of(blueprint.catalogue.motor)
        names = f"{joint.hinge.name} and {other.hinge.name}"
        fit = [self._not_weak(j) for j in (joint, other)]
        poses = [np.array([seat.T_design_motor for seat in some]).reshape(-1, 4, 4) for some in fit]
        distance = Clearance.of(poses[0], poses[1], mount).distance
        short = self.gap - float(distance.max(initial=-np.inf))
        hidden = self._hidden(fit, distance, mount) if short <= 0 else 0.0
        need = max(short, hidden, 0.0)
        if hidden > 0:
            reason = Reason.NO_ACCESS
            how = f"and apart, one is in the way of the other's screws or of its motor by {1e3 * need:.0f} mm at least"
        else:
            reason = Reason.MOTOR_COLLISION
            meet = f"by {1e3 * need:.0f} mm at least" if need > 0 else "or a third one"
            how = f"their motors run into each other {meet}"
        return Failure(
            Stage.MOTOR,
            reason,
            f"{names}: wherever their mounts are strong enough {how}; move the two joints apart by "
            f"{1e3 * max(need, blueprint.design.pitch):.0f} mm",
            Miss(
                "way of a tool and of a motor" if hidden > 0 else "gap between motors",
                "m",
                self.gap - need if reason is Reason.MOTOR_COLLISION and need > 0 else None,
                self.gap if reason is Reason.MOTOR_COLLISION else None,
                (joint.index, other.index),
                grow=need,
                remedy="move_joints_apart",
            ),
        )

    def _not_weak(self, joint: Candidates) -> list[MotorSeat]:
        """A joint's seats but for those that were found too weak."""
        weak = {k for k, (safety, _) in joint.known.items() if safety < self.min_safety}
        return [seat for k, seat in enumerate(joint.seats) if k not in weak]

    def _hidden(self, seats: list[list[MotorSeat]], distance: Array, mount: Mount) -> float:
        """Least by which two joints' motors that keep apart are in each other's way (farthest pairs first) [m]."""
        pairs = np.argwhere(distance >= self.gap)
        pairs = pairs[np.argsort(-distance[tuple(pairs.T)], kind="stable")][:CLOSE_PAIRS]
        return min((shortfall(seats[0][a], seats[1][b], mount) for a, b in pairs.tolist()), default=0.0)

    def _too_weak(self, blueprint: Blueprint, joint: Candidates) -> Failure:
        """Mounts that fuse, but would break."""
        # What is known of a weak seat is at most as bad as it is: look closely at the most promising ones.
        promising = sorted(joint.known, key=lambda k: (-joint.known[k][0], k))[:CLOSE_LOOKS]
        closely = {k: joint.weaker(joint.seats[k]) for k in promising}
        best = max(promising, key=lambda k: (closely[k][0], -k))
        seat, (safety, body) = joint.seats[best], closely[best]
        torque = blueprint.catalogue.motor.peak_torque
        name, segment = blueprint.bodies[body].name, blueprint.bodies[body].segment
        voxels = 1 if safety >= self.min_safety / 2 else 2
        return Failure(
            Stage.MOTOR,
            Reason.WEAK_MOUNT,
            f"{joint.hinge.name}: the strongest mount, at {1e3 * seat.offset:+.0f} mm with "
            f"{1e6 * seat.holder_volume:.1f} and {1e6 * seat.connector_volume:.1f} cm3 shared, has safety factor "
            f"{safety:.2f} under {torque:.1f} N.m and {BENDING_SHARE * torque:.1f} N.m across, needs "
            f"{self.min_safety:.2f}; {name} is the weak side: thicken segment {segment} by {_voxels(voxels)} near the "
            "joint",
            Miss("safety factor", "1", safety, self.min_safety, (joint.index,), (body,),
                 grow=voxels * blueprint.design.pitch, remedy="thicken_near_joint"),
        )  # fmt: skip


def _fills(bone: Field, position: Array, axis: Array, radius: float, low: float, high: float) -> bool:
    """Whether any of a bone lies in a cylinder about an axis."""
    window = bone.window(position + (low + high) / 2 * axis, float(np.hypot(radius, (high - low) / 2)))
    if window is None:
        return False
    x, y, z = (a - np.float32(c) for a, c in zip(bone.axes(window), position, strict=True))
    along = x * np.float32(axis[0]) + y * np.float32(axis[1]) + z * np.float32(axis[2])
    inside = (along > low) & (along < high) & (x * x + y * y + z * z - along * along < radius**2)
    return bool((bone.values[window][inside] > 0).any())


def _voxels(count: int) -> str:
    return f"{count} voxel{'s' if count > 1 else ''}"
