"""Solver: joint ranges as far as no body collides, and never below a stated minimum."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from mfg.blueprint import Blueprint, Body, Hinge
from mfg.miss import Miss
from mfg.motion import CylindricalPair, Reaches, carve, feasible, rounded
from mfg.mounts import motor_pose
from mfg.outcome import Failure, Reason, Stage


@dataclass(frozen=True)
class SearchMotionSolver:
    """Find how far every joint turns before any two bodies collide; carve only for the minimum.

    Differs from `MotionSolver` in three ways. All that a joint moves, the child and everything beyond it, is turned
    against all that stands, not only the child against its parent. The range ends where bodies begin to collide, not
    where a fixed share of a bone is in the way, so whole bones stay whole. And every joint gets the minimum: where
    bodies meet earlier, the heavier one is carved for just that much.

    Attributes:
        minimum: angle that every joint reaches both ways, or the design's own limit where that is narrower [rad].
        touch: share of the smaller bone that may overlap before two bodies count as colliding; what lies below is
            carved away with the rest.
        gap: room left between a carved bone and the sweep [m].
        max_loss: largest share of a bone that carving may leave floating.
        max_carved: largest share of a bone's volume that carving for one joint may take.
        angle_step, radial_step: resolution of the cylindrical grid [rad], [m].
        far_step: radial resolution for bodies that the joint does not join [m].
    """

    minimum: float = 0.26
    touch: float = 0.01
    gap: float = 1.5e-3
    max_loss: float = 0.15
    max_carved: float = 0.30
    angle_step: float = 2 * np.pi / 80
    radial_step: float = 5e-3
    far_step: float = 1e-2

    def solve(self, blueprint: Blueprint) -> Blueprint | Failure:
        """Return the blueprint with collision-free `hinges` and carved bones, or a motor failure."""
        bodies, hinges = list(blueprint.bodies), []
        volumes = [body.bone.volume() for body in bodies]
        moved, reaches = _moved(blueprint), Reaches()
        for k, hinge in enumerate(blueprint.hinges):
            least = np.clip(hinge.range, -self.minimum, self.minimum)
            low, high = (float(v) for v in hinge.range)
            contacts = []
            T = motor_pose(hinge.position, hinge.axis, 0.0)
            for standing, moving in itertools.product(range(len(bodies)), sorted(moved[k])):
                if standing in moved[k]:
                    continue
                joined = (standing, moving) == (hinge.parent, hinge.body)
                step = self.radial_step if joined else self.far_step
                bones = bodies[standing].bone, bodies[moving].bone
                pair = CylindricalPair.sample(*bones, T, self.angle_step, step, reaches)
                if pair is None:
                    continue
                allowed = self.touch * min(volumes[standing], volumes[moving])
                free = feasible(pair.interference(), hinge.range, allowed, pair.step)
                low, high = max(low, min(free[0], float(least[0]))), min(high, max(free[1], float(least[1])))
                if joined or free[0] > least[0] or free[1] < least[1]:
                    contacts.append((standing, moving, free, pair))
            for standing, moving, free, pair in contacts:
                joined = (standing, moving) == (hinge.parent, hinge.body)
                reach = (low, high) if joined else (float(least[0]), float(least[1]))
                # The heavier bone of the pair gives way: it has more to give.
                carved = standing if volumes[standing] >= volumes[moving] else moving
                swept = pair.swept(*reach, of_child=carved == standing)
                body, floating = carve(bodies[carved], pair, swept, hinge, self.gap)
                taken = 1 - body.bone.volume() / volumes[carved]
                if floating > self.max_loss or taken > self.max_carved:
                    return self._refused(hinge, bodies, (standing, moving, carved), free, max(floating, taken))
                bodies[carved] = body
            hinges.append(replace(hinge, range=np.array([low, high])))
        smooth = tuple(replace(b, bone=rounded(b.bone), skin=b.skin and rounded(b.skin)) for b in bodies)
        return replace(blueprint, bodies=smooth, hinges=tuple(hinges))

    def _refused(
        self, hinge: Hinge, bodies: list[Body], indices: tuple[int, int, int], free: tuple[float, float], lost: float
    ) -> Failure:
        standing, moving, carved = (bodies[index].name for index in indices)
        least = np.clip(hinge.range, -self.minimum, self.minimum)
        side = 0 if free[0] > least[0] else 1
        return Failure(
            Stage.MOTOR,
            Reason.NO_MOTION,
            f"{hinge.name} turns {free[side]:.2f} rad before {moving} meets {standing}, needs {least[side]:.2f} rad; "
            f"clearing the way would take {100 * lost:.0f} % of {carved}; more room between the two would mend it",
            Miss("range of motion", "rad", free[side], float(least[side]), (hinge.body - 1,), indices[:2]),
        )


def _moved(blueprint: Blueprint) -> list[set[int]]:
    """The bodies that each hinge moves: its child and all that hangs on it."""
    moved: list[set[int]] = []
    for hinge in blueprint.hinges:
        found = {hinge.body}
        for other in blueprint.hinges:  # a parent comes before its children
            if other.parent in found:
                found.add(other.body)
        moved.append(found)
    return moved
