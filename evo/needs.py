"""What a gait asks of a robot's hardware, measured on the simulated robot."""

from __future__ import annotations

import numpy as np

from mfg.selection import JointNeed, Needs
from sim.actor import Gait
from sim.model import Model
from sim.rollout import roll_out

WORK = 10.0  # length of the rollout in which needs are measured [s]
SHARE = 0.99  # quantile over time that counts as a peak: what is above it lasts a hundredth of the time, as impacts do


def needs_of(model: Model, gait: Gait, duration: float, seconds: float = WORK) -> Needs:
    """What a gait asks of every joint: peaks are the `SHARE` quantile over control steps, rms is over all steps.

    The speed at the peak is the greatest one at which at least nine tenths of the peak torque drove the joint.
    """
    rollout = roll_out(model, [gait], seconds)
    torque, speed = rollout.torque[0], rollout.speed[0]
    peak = np.quantile(np.abs(torque), SHARE, axis=0)
    top = np.quantile(np.abs(speed), SHARE, axis=0)
    joints = []
    for k in range(model.nu):
        driving = (np.abs(torque[:, k]) >= 0.9 * peak[k]) & (torque[:, k] * speed[:, k] > 0)
        at_peak = min(float(np.abs(speed[driving, k]).max(initial=0.0)), float(top[k]))
        joints.append(JointNeed(
            model.actuator(k).name, float(peak[k]), at_peak, float(rollout.rms_torque[0, k]), float(top[k]),
            float(np.sqrt(np.square(speed[:, k]).mean())),
        ))  # fmt: skip
    sum_of_peaks = float(np.abs(torque).max(axis=0).sum())
    together = float(np.abs(torque).sum(axis=1).max()) / sum_of_peaks if sum_of_peaks > 0 else 1.0
    return Needs(tuple(joints), duration, together)
