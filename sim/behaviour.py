"""What a behaviour asks of the motors and of the ground, and whether the real motors could give it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.model import MOTOR_CONSTANT, RESISTANCE, VOLTAGE, Model, drive_of
from sim.rollout import Rollouts

Array = NDArray[np.float64]

AT_LIMIT = 0.98  # of what a motor can give; simulated torque ends at the limit itself
OFTEN = 0.05  # share of the time at the limit from which a motor is too weak for its targets


@dataclass(frozen=True, slots=True)
class MotorLimits:
    """What one motor can give: up to its peak and to stall (1 - speed / no_load), the speed counted along the torque.

    Attributes:
        joint: name of the hinge it drives.
        peak: greatest torque of its driver [N.m].
        continuous: torque that it bears for long [N.m].
        stall: where its torque-speed line meets standstill, usually beyond the peak [N.m].
        no_load: speed at which it gives no torque any more [rad/s].
    """

    joint: str
    peak: float
    continuous: float
    stall: float
    no_load: float

    def available(self, speed: ArrayLike) -> Array:
        """Greatest torque [N.m] at speeds along it [rad/s] of any shape; negative speeds brake."""
        line = self.stall * (1.0 - np.asarray(speed, dtype=np.float64) / self.no_load)
        return np.asarray(np.clip(line, 0.0, self.peak))


@dataclass(frozen=True, slots=True)
class MotorUse:
    """What one motor did in an episode.

    Attributes:
        joint: name of the hinge.
        peak_torque: greatest [N.m], over all physics steps.
        peak_share: of the motor's peak.
        rms_torque: root mean square [N.m], over all physics steps; the winding's heat goes with its square.
        rms_share: of what the motor bears for long.
        peak_speed: greatest at a control step [rad/s].
        speed_share: of the no-load speed.
        at_limit: share of the control steps at which it gave all that it could at that speed.
    """

    joint: str
    peak_torque: float
    peak_share: float
    rms_torque: float
    rms_share: float
    peak_speed: float
    speed_share: float
    at_limit: float

    def to_json(self) -> dict[str, float | str]:
        """The record under the names that scripts rely on."""
        units = {"peak_torque": "peak_torque_Nm", "rms_torque": "rms_torque_Nm", "peak_speed": "peak_speed_rad_s"}
        return {units.get(name, name): value for name, value in asdict(self).items()}


@dataclass(frozen=True, eq=False, slots=True)
class Stance:
    """Which links touch the ground.

    Attributes:
        links: their names, the root first.
        touching: at each control step, (k, links).
    """

    links: tuple[str, ...]
    touching: NDArray[np.bool_]


def motor_limits(model: Model) -> tuple[MotorLimits, ...]:
    """The limits of a model's motors, in the order of its controls."""
    drive, gain = drive_of(model), model.actuator_gainprm
    volts, constant = gain[:, VOLTAGE], gain[:, MOTOR_CONSTANT]
    peak = model.actuator_forcerange[:, 1]
    stall = constant * volts / gain[:, RESISTANCE]
    rows = zip(drive.names, peak, drive.continuous_torque, stall, volts / constant, strict=True)
    return tuple(MotorLimits(name, *(float(v) for v in values)) for name, *values in rows)


def motor_uses(model: Model, rollouts: Rollouts, index: int = 0) -> tuple[MotorUse, ...]:
    """What every motor did in one rollout that did not fail, in the order of the model's controls."""
    found = []
    for j, limits in enumerate(motor_limits(model)):
        torque, speed = rollouts.torque[index, :, j], rollouts.speed[index, :, j]
        available = limits.available(speed * np.sign(torque))
        peak, rms = float(rollouts.peak_torque[index, j]), float(rollouts.rms_torque[index, j])
        fastest = float(np.abs(speed).max())
        found.append(MotorUse(
            joint=limits.joint, peak_torque=peak, peak_share=peak / limits.peak, rms_torque=rms,
            rms_share=rms / limits.continuous, peak_speed=fastest, speed_share=fastest / limits.no_load,
            at_limit=float((np.abs(torque) >= AT_LIMIT * available).mean()),
        ))  # fmt: skip
    return tuple(found)


def motor_warnings(limits: Sequence[MotorLimits], uses: Sequence[MotorUse]) -> tuple[str, ...]:
    """What the real motors could not do, a sentence each; none where they could do it all."""
    said = []
    for limit, use in zip(limits, uses, strict=True):
        if use.rms_share > 1.0:
            said.append(
                f"{use.joint} needs {use.rms_torque:.1f} N.m rms, its motor bears {limit.continuous:.1f} N.m for long: "
                "it would overheat"
            )
        if use.at_limit > OFTEN:
            said.append(
                f"{use.joint} gives all that its motor can ({limit.peak:.1f} N.m, less at speed) for "
                f"{use.at_limit:.0%} of the time: it cannot follow its targets"
            )
        if use.speed_share > 1.0:
            said.append(
                f"{use.joint} turns at up to {use.peak_speed:.1f} rad/s, its motor without load at "
                f"{limit.no_load:.1f} rad/s: it is dragged along"
            )
    return tuple(said)


def stance(model: Model, rollouts: Rollouts, index: int = 0) -> Stance:
    """Look for contacts between links and whatever stands still in the world, at each control step of one rollout.

    What is no link by itself (a pad of skin, a corner of a finite element) counts as the link that carries it.
    """
    links = [body for body in range(1, model.nbody) if _is_link(model, body)]
    of = np.zeros(model.nbody, dtype=np.intp)  # body -> place of its link + 1, 0 for what stands still
    for body in range(1, model.nbody):
        of[body] = links.index(body) + 1 if body in links else of[model.body_parentid[body]]
    data = mujoco.MjData(model)
    touching = np.zeros((rollouts.qpos.shape[1], len(links)), dtype=np.bool_)
    for row, qpos in zip(touching, rollouts.qpos[index], strict=True):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        for contact in data.contact:
            if contact.dist > 0.0:
                continue
            sides = {int(of[_body(model, contact, side)]) for side in (0, 1)}
            if 0 in sides:
                row[[side - 1 for side in sides if side > 0]] = True
    return Stance(tuple(model.body(body).name for body in links), touching)


def _is_link(model: Model, body: int) -> bool:
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    kinds = model.jnt_type[first : first + count] if count else np.zeros(0)
    return bool(np.isin(kinds, (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_HINGE)).any())


def _body(model: Model, contact: mujoco.MjContact, side: int) -> int:
    """The body on one side of a contact; of a flex, one of those that carry it."""
    geom = int(contact.geom[side])
    if geom >= 0:
        return int(model.geom_bodyid[geom])
    flex = int(contact.flex[side])
    if model.flex_nodenum[flex]:
        return int(model.flex_nodebodyid[model.flex_nodeadr[flex]])
    return int(model.flex_vertbodyid[model.flex_vertadr[flex]])
