"""Rollouts of an actor that sees: the loop of the robot's computer around copies of its model."""

from __future__ import annotations

import time

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.actor import Actor, Gait, Perceptron, low_pass, smooth_step
from sim.herd import Herd
from sim.model import Model, default_pose, model_name
from sim.observation import ObservationLayout, in_link_axes
from sim.randomisation import Draws, apply, nominal, push, pushed
from sim.rollout import LEAD_IN, Rollouts, roll_out, root_quaternion, settle, turned

Array = NDArray[np.float64]


class Senses:
    """What the copies of a herd measure, packed as on the robot; it keeps the history and the previous targets."""

    def __init__(self, herd: Herd, layout: ObservationLayout, draws: Draws, command: ArrayLike | None = None) -> None:
        """Begin with every copy at rest on the targets that hold it there."""
        self.layout, self.draws, self.command = layout, draws, command
        self.previous = np.repeat(default_pose(herd.model)[None], herd.count, axis=0)
        self.observation = np.zeros((herd.count, layout.size))

    def frame(self, herd: Herd, rng: np.random.Generator | None = None) -> Array:
        """One frame of every copy, (count, layout.frame_size), as biased as its draw says; `rng` adds the noise.

        What is wrong with an IMU is wrong in its own frame; then its readings are turned into its link's axes.
        """
        gravity, gyro = herd.imu()
        draws = self.draws
        position, velocity = herd.positions + draws.encoder_offset, herd.velocities
        gravity = np.einsum("ijk,ik->ij", draws.imu_turn, gravity)
        gyro = np.einsum("ijk,ik->ij", draws.imu_turn, gyro) + draws.gyro_bias
        if rng is not None and draws.noise is not None:
            noise, n = draws.noise, position.shape[1]
            white = rng.standard_normal((herd.count, 6 + 2 * n))
            if draws.noise_level is not None:
                white *= draws.noise_level[:, None]
            gravity = gravity + noise.gravity * white[:, :3]
            gyro = gyro + noise.gyro * white[:, 3:6]
            position = position + noise.position * white[:, 6 : 6 + n]
            velocity = velocity + noise.velocity * white[:, 6 + n :]
        command = None
        if self.layout.commanded:
            command = np.broadcast_to(np.zeros(3) if self.command is None else self.command, (herd.count, 3))
        gravity, gyro = in_link_axes(herd.R_link_imu, gravity, gyro)
        return self.layout.pack(gravity, gyro, position, velocity, self.previous, command)

    def begin(self, herd: Herd, ids: NDArray[np.intp]) -> None:
        """Forget the past of copies that were placed anew."""
        self.previous[ids] = default_pose(herd.model)
        self.observation[ids] = self.layout.begin(self.frame(herd)[ids])

    def see(self, herd: Herd, rng: np.random.Generator | None = None) -> Array:
        """Measure all copies; gives the observations, (count, layout.size)."""
        self.observation = self.layout.push(self.observation, self.frame(herd, rng))
        return self.observation


def roll_out_actor(
    model: Model,
    actor: Actor,
    seconds: float,
    *,
    copies: int = 1,
    draws: Draws | None = None,
    rng: np.random.Generator | None = None,
    start: Array | None = None,
    nthread: int = 1,
    time_constant: float = 0.0,
) -> Rollouts:
    """Let an actor drive copies of a robot for `seconds` after the lead-in, in which it takes over as on the robot.

    A copy whose actor says what is no number has failed, because the robot's guard would have stopped it there.

    Args:
        model: of the robot; if `draws` change its latency, one of `sim.herd.with_latency_room`.
        actor: closed or open loop.
        seconds: what is measured.
        copies: how many; without draws they do the same.
        draws: one per copy; None for the model as it is.
        rng: of noise and pushes; None for none.
        start: settled state; found if it is not given.
        nthread: changes the time it takes only.
        time_constant: of the low-pass of the targets, as in a policy bundle, 0 for none [s].

    Raises:
        ValueError: if the actor drives another number of joints.
    """
    if actor.num_joints != model.nu:
        raise ValueError(f"the actor drives {actor.num_joints} joints, robot {model_name(model)} has {model.nu}")
    herd = Herd(model, copies, nthread=nthread)
    ids = np.arange(copies)
    start = settle(model) if start is None else start
    known = nominal(copies, model.nu) if draws is None else draws
    if draws is not None:
        apply(herd, ids, known)
    herd.place(ids, np.repeat(start[None], copies, axis=0))
    command = actor.command if isinstance(actor, Perceptron) else None
    senses = Senses(herd, actor.layout, known, command or None)
    senses.begin(herd, ids)
    default, (low, high) = default_pose(model), herd.drive.range.T
    lead, length = round(LEAD_IN / herd.period), max(1, round(seconds / herd.period))
    qpos = np.zeros((copies, length + 1, model.nq))
    com = np.zeros((copies, length + 1, 3))
    torques, speeds = np.zeros((2, copies, length + 1, model.nu))
    peak, square, work = np.zeros((copies, model.nu)), np.zeros((copies, model.nu)), np.zeros(copies)
    failed = np.zeros(copies, dtype=bool)
    before = time.process_time()
    for k in range(lead + length):
        if k == lead:
            qpos[:, 0], com[:, 0] = herd.qpos, herd.centre_of_mass
            torques[:, 0], speeds[:, 0] = herd.torques, herd.velocities
        observation = senses.observation if k == 0 else senses.see(herd, rng)
        said = actor.act(k * herd.period, observation)
        failed |= ~np.isfinite(said).all(axis=-1)
        wanted = np.clip(np.nan_to_num(said), low, high)
        weight = smooth_step(k * herd.period / LEAD_IN)
        wanted = np.broadcast_to(default + weight * (wanted - default), (copies, model.nu)).copy()
        senses.previous = low_pass(senses.previous, wanted, herd.period, time_constant)
        if rng is not None and known.push_speed is not None:
            push(herd, pushed(known, herd.period, rng), known.push_speed, rng)
        herd.command(senses.previous - known.encoder_offset)
        for _ in range(herd.substeps):
            herd.batch.step(nstep=1, stage=mujoco.mjtStage.mjSTAGE_VEL)
            if k >= lead:
                torque = herd.torques
                peak = np.maximum(peak, np.abs(torque))
                square += torque**2
                work += np.maximum(torque * herd.velocities, 0.0).sum(axis=1)
        failed |= herd.exploded()
        if k >= lead:
            row = k - lead + 1
            qpos[:, row], com[:, row] = herd.qpos, herd.centre_of_mass
            torques[:, row], speeds[:, row] = herd.torques, herd.velocities
    elapsed = max(time.process_time() - before, 1e-9)
    up, yaw = turned(start[root_quaternion(model)], qpos[:, :, 3:7])
    return Rollouts(
        qpos=qpos, com=com, up=up, yaw=yaw, peak_torque=peak, rms_torque=np.sqrt(square / (length * herd.substeps)),
        torque=torques, speed=speeds, work=work * model.opt.timestep, failed=failed,
        steps_per_s=copies * (lead + length) * herd.substeps / elapsed,
    )  # fmt: skip


def roll_out_policy(
    model: Model, actor: Actor, seconds: float, *, time_constant: float = 0.0, start: Array | None = None
) -> Rollouts:
    """One copy under an actor of any kind, by the quicker way for a gait: `roll_out` or `roll_out_actor`."""
    if isinstance(actor, Gait) and time_constant == 0.0:
        return roll_out(model, [actor], seconds, start)
    return roll_out_actor(model, actor, seconds, start=start, time_constant=time_constant)
