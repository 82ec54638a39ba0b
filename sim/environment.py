"""Many episodes of one robot at once: what a learner sees of the simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim import hidden
from sim.actor import Gait, smooth_step
from sim.closed_loop import Senses
from sim.herd import Herd
from sim.model import MOTOR_CONSTANT, VOLTAGE, Model, default_pose, drive_of
from sim.observation import ActionMap, ObservationLayout
from sim.randomisation import Randomisation, apply, draw, nominal, push, pushed
from sim.rollout import CONTROL_PERIOD, FALL_TILT, GRAVITY, LEAD_IN, root_quaternion, settle, turned
from sim.surfaces import body_length
from sim.tasks import FAST, SCALE, Goal, Moment, Task, terms

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

MARGIN = 0.05  # share of a joint's range that is kept free at each end: slamming into a stop breaks prints
REACH = 0.6  # farthest that an action of 1 goes from the centre [rad]
BLEND = 0.6  # share of the way to a new target that is gone in one control period
STEP_SHARE = 0.9  # of what a motor can turn in a period: the robot's guard stops at 1
PACE_TIME = 0.5  # over which a robot's pace is averaged, by a first-order lag [s]
HEAT_TIME = 2.0  # and the square of what its motors are loaded [s]
MOST_EXPLOSIONS = 16  # states that are kept for a look


@dataclass(frozen=True, slots=True)
class Episode:
    """How episodes run.

    Attributes:
        seconds: until one is cut short (and its value goes on) [s].
        history: frames that the policy sees.
        start_joint: joints start within this much of the pose at rest [rad].
        start_speed: roots start within this speed along each axis [m/s].
    """

    seconds: float = 10.0
    history: int = 1
    start_joint: float = 0.1
    start_speed: float = 0.1


TEN_SECONDS = Episode()


@dataclass(frozen=True, eq=False, slots=True)
class Explosion:
    """The state in which the physics of a copy was lost, and what it was told.

    Attributes:
        state: full state before the period, (nstate,).
        control: what its motors were told in that period [rad], (n,).
        draws: how that copy differs from the model, its row of every array of `sim.randomisation.Draws` by name.
        reason: in words.
    """

    state: Array
    control: Array
    draws: Mapping[str, Array]
    reason: str


@dataclass(frozen=True, eq=False, slots=True)
class Step:
    """What one control period gave every copy.

    Attributes:
        observation: of the state after it, of a new episode where one ended, (k, size).
        reward: (k,).
        terminated: the robot fell or was lost, (k,).
        truncated: its time was up, (k,).
        last: observation with which the ended episodes ended, (number of those, size), in the order of copies.
        last_hidden: what only the simulator knew then, see `Environment.hidden`, (number of those, hidden_size).
        lengths: of the ended episodes [periods].
        returns: sums of reward of the ended episodes.
        parts: mean of every part of the reward over the copies.
    """

    observation: Array
    reward: Array
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    last: Array
    last_hidden: Array
    lengths: NDArray[np.int64]
    returns: Array
    parts: Mapping[str, float]


def action_map(model: Model, centre: ArrayLike | None = None, reach: float = REACH) -> ActionMap:
    """The actions of a robot about a posture [rad], the pose at rest by default; targets keep clear of the stops."""
    drive = drive_of(model)
    low, high = drive.range.T
    spare = MARGIN * (high - low)
    low, high = low + spare, high - spare
    middle = np.clip(default_pose(model) if centre is None else np.asarray(centre, dtype=np.float64), low, high)
    scale = np.minimum(np.maximum(middle - low, high - middle), reach)
    return ActionMap(middle, scale, low, high, BLEND, STEP_SHARE * float(no_load_speed(model).min()) * CONTROL_PERIOD)


def no_load_speed(model: Model) -> Array:
    """The speed at which each motor gives no torque any more, its voltage over its constant [rad/s], (n,)."""
    return np.asarray(model.actuator_gainprm[:, VOLTAGE] / model.actuator_gainprm[:, MOTOR_CONSTANT])


@dataclass(eq=False)
class Environment:
    """Copies of a robot that begin a new episode by themselves when one ends.

    Attributes:
        model: of the robot, made by `sim.herd.with_latency_room` if latency is drawn.
        count: of copies.
        task: what earns reward.
        actions: from what a policy says to joint targets.
        randomisation: what each episode draws; None for the model as it is.
        episode: how long, and how they start.
        rhythm: gait that the policy corrects, from the start of each episode; None for none.
        nthread: threads of the physics; it changes no result.
        explosions: the first states that were lost.
        lost: how many copies were lost in all.
        kind: which model of the robot it is, where there are several; only the critic knows.
    """

    model: Model
    count: int
    task: Task = FAST
    actions: ActionMap | None = None
    randomisation: Randomisation | None = None
    episode: Episode = TEN_SECONDS
    rhythm: Gait | None = None
    nthread: int = 1
    explosions: list[Explosion] = field(default_factory=list)
    lost: int = 0
    kind: int = 0

    def __post_init__(self) -> None:
        """Settle the robot."""
        self.map = action_map(self.model) if self.actions is None else self.actions
        if self.map.num_joints != self.model.nu:
            raise ValueError(f"the actions drive {self.map.num_joints} joints, the robot has {self.model.nu}")
        self.herd = Herd(self.model, self.count, nthread=self.nthread)
        self.layout = ObservationLayout(self.model.nu, self.episode.history, self.task.goal is Goal.COMMAND)
        self.length = max(1, round(self.episode.seconds / self.herd.period))
        self._start = settle(self.model)
        self._standing = self._start[root_quaternion(self.model)]
        self._weight = float(self.model.body_subtreemass[1]) * GRAVITY
        self._default = default_pose(self.model)
        self._size = body_length(self.model)
        self._rng = np.random.default_rng(0)
        self._senses = Senses(self.herd, self.layout, nominal(self.count, self.model.nu))
        self._age, self._born = np.zeros(self.count, dtype=np.int64), np.zeros(self.count, dtype=np.int64)
        self._yaw = np.zeros(self.count)
        self._pace, self._velocity = np.zeros((2, self.count, 2))
        self._turning, self._robot = np.zeros(self.count), np.zeros((self.count, hidden.ROBOT))
        self._return = np.zeros(self.count)
        self._said, self._heat = np.zeros((2, self.count, self.model.nu))
        self._commands = np.zeros((self.count, 3))
        self._senses.command = self._commands

    def reset(self, rng: np.random.Generator) -> Array:
        """Begin anew with every copy somewhere in its first episode; gives the observations, (count, size)."""
        self._rng = rng
        self._begin(np.arange(self.count))
        # Copies that end together would make each batch of experience all beginnings or all ends.
        if self.count > 1:
            self._age = rng.integers(0, self.length, self.count)
            self._born = self._age.copy()
        return self._senses.observation

    def step(self, said: ArrayLike) -> Step:
        """Let a control period pass under what the policy says, (count, n).

        A number that is not finite counts as a fall of that copy, as the robot's guard would stop it.
        """
        said = np.asarray(said, dtype=np.float64)
        if said.shape != (self.count, self.model.nu):
            raise ValueError(f"actions have shape {said.shape}, it must be {(self.count, self.model.nu)}")
        herd, senses = self.herd, self._senses
        mute = ~np.isfinite(said).all(axis=1)
        if mute.any():
            said = np.where(mute[:, None], 0.0, said)
        targets = self._targets(np.clip(said, -1.0, 1.0))
        before = herd.qpos[:, :3].copy()
        if senses.draws.push_speed is not None:
            push(herd, pushed(senses.draws, herd.period, self._rng), senses.draws.push_speed, self._rng)
        state = herd.batch.state.copy() if len(self.explosions) < MOST_EXPLOSIONS else None
        control = targets - senses.draws.encoder_offset
        gone = herd.advance(control)
        up, yaw = turned(self._standing, herd.qpos[:, 3:7])
        moment = self._moment(before, yaw, up[:, 2], np.clip(said, -1.0, 1.0))
        parts = terms(self.task, moment)
        reward = np.sum(list(parts.values()), axis=0)
        fallen = np.zeros(self.count, dtype=bool) if self.task.goal is Goal.RECOVER else up[:, 2] < np.cos(FALL_TILT)
        terminated = fallen | gone | mute
        reward = np.where(terminated, -SCALE * self.task.fall, reward)
        self._age += 1
        truncated = ~terminated & (self._age >= self.length)
        self._return += reward
        self._said = np.clip(said, -1.0, 1.0)
        self._note(gone, state, control)
        observation = senses.see(herd, self._rng)
        ended = np.flatnonzero(terminated | truncated)
        last, last_hidden = observation[ended].copy(), np.zeros((0, self.hidden_size))
        last[gone[ended]] = 0.0
        lengths, returns = (self._age - self._born)[ended], self._return[ended].copy()
        if len(ended):
            last_hidden = self.hidden()[ended]
            last_hidden[gone[ended]] = 0.0
            self._begin(ended)
            observation = senses.observation
        means = {name: float(np.nanmean(np.where(gone, 0.0, value))) for name, value in parts.items()}
        return Step(observation, reward, terminated, truncated, last, last_hidden, lengths, returns, means)

    @property
    def hidden_size(self) -> int:
        """How many numbers of a copy only the simulator knows."""
        return 1 + hidden.ROBOT + hidden.MOTION + (0 if self.rhythm is None else hidden.PHASE)

    def hidden(self) -> Array:
        """What only the simulator knows of every copy as it is now, (count, hidden_size); see `sim.hidden`."""
        task, time = self.task, (self._age - self._born) * self.herd.period
        height = (self.herd.qpos[:, 2] - self._start[3]) / self._size
        moving = hidden.motion(
            self._velocity, self._pace, self._turning, height, np.minimum(time / LEAD_IN, 1.0), task.heading,
            task.target_speed,
        )  # fmt: skip
        parts = [np.full((self.count, 1), float(self.kind)), self._robot, moving]
        if self.rhythm is not None:
            parts.append(hidden.phase(self.rhythm.frequency, np.asarray(time, dtype=np.float64)))
        return np.concatenate(parts, axis=1)

    def _targets(self, said: Array) -> Array:
        """Joint targets; the policy takes over from the pose at rest as on the robot."""
        time = (self._age - self._born) * self.herd.period
        centre = None if self.rhythm is None else self.rhythm.targets(time)
        wanted = self.map.targets(said, self._senses.previous, centre)
        fade = smooth_step(time / LEAD_IN)[:, None]
        self._senses.previous = self._default + fade * (wanted - self._default)
        return self._senses.previous

    def _moment(self, before: Array, yaw: Array, up: Array, said: Array) -> Moment:
        herd = self.herd
        moved = (herd.qpos[:, :2] - before[:, :2]) / herd.period
        c, s = np.cos(yaw), np.sin(yaw)
        velocity = np.stack([c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0]], axis=1)
        self._pace = self._pace + herd.period / PACE_TIME * (velocity - self._pace)
        torque, speed = herd.torques, herd.velocities
        load = np.square(torque / herd.drive.continuous_torque)
        self._heat = self._heat + herd.period / HEAT_TIME * (load - self._heat)
        turn = (yaw - self._yaw + np.pi) % (2 * np.pi) - np.pi
        self._yaw, self._velocity, self._turning = yaw, velocity, turn / herd.period
        return Moment(
            velocity, self._pace, self._turning, up, speed, said, self._said,
            self._heat, (torque * speed).sum(axis=1) / self._weight, self._commands,
        )  # fmt: skip

    def _note(self, gone: NDArray[np.bool_], state: Array | None, control: Array) -> None:
        self.lost += int(gone.sum())
        if state is None:
            return
        for index in np.flatnonzero(gone)[: MOST_EXPLOSIONS - len(self.explosions)]:
            counts = self.herd.batch.warning[index, :, 1]
            reason = f"{int(counts.sum())} warnings of the physics" if counts.any() else "a speed beyond every robot's"
            draws = self._senses.draws.row(int(index))
            self.explosions.append(Explosion(state[index], control[index].copy(), draws, reason))

    def _begin(self, ids: Ids) -> None:
        """New episodes for some copies."""
        rng, herd, model, n = self._rng, self.herd, self.model, self.model.nu
        if self.randomisation is not None:
            fresh = draw(self.randomisation, rng, len(ids), n, model.nbody - 1)
            apply(herd, ids, fresh)
            self._robot[ids] = hidden.robot(fresh)
            self._senses.draws = fresh if len(ids) == self.count else self._senses.draws.changed(ids, fresh)
        states = np.repeat(self._start[None], len(ids), axis=0)
        joints = 1 + herd.drive.position
        spread = self.episode.start_joint
        low, high = herd.drive.range.T
        states[:, joints] = np.clip(states[:, joints] + rng.uniform(-spread, spread, (len(ids), n)), low, high)
        first = 1 + model.nq
        states[:, first : first + 2] += rng.uniform(-1, 1, (len(ids), 2)) * self.episode.start_speed
        if self.task.goal is Goal.RECOVER:
            turn = rng.standard_normal((len(ids), 4))
            states[:, root_quaternion(model)] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
            states[:, 3] += 0.5 * self._size
        herd.place(ids, states)
        self._commands[ids] = rng.uniform(-1, 1, (len(ids), 3)) * self.task.commands
        self._senses.begin(herd, ids)
        self._yaw[ids] = turned(self._standing, herd.qpos[ids, 3:7])[1]
        self._age[ids] = self._born[ids] = 0
        self._return[ids], self._said[ids], self._pace[ids], self._velocity[ids] = 0.0, 0.0, 0.0, 0.0
        self._turning[ids], self._heat[ids] = 0.0, 0.0
