"""What a simulated robot may differ in from the real one: pure samplers of ranges that are published or measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.herd import Herd
from sim.model import DAMPING, STIFFNESS, VOLTAGE

Array = NDArray[np.float64]
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of one reading, standard deviations (the figures of legged_gym and MuJoCo Playground).

    The gyro's is that of a moving legged robot, not of a chip at rest; the speed is differentiated by the motor.
    """

    gravity: float = 0.03  # of the direction's components
    gyro: float = 0.15  # [rad/s]
    position: float = 0.01  # [rad]
    velocity: float = 0.75  # [rad/s]


WHITE = Noise()


@dataclass(frozen=True, slots=True)
class Randomisation:
    """Ranges from which every episode draws its robot; a factor multiplies what the model has."""

    latency: Range = (0.0, 0.04)  # command to torque [s]; CAN at 1 Mbit/s and a 50 Hz loop measure 10 to 30 ms
    stiffness: Range = (0.7, 1.3)  # factor on kp; rotors, gears and wire round it (legged_gym 0.8 to 1.2, here wider)
    damping: Range = (0.7, 1.3)  # factor on kd
    voltage: Range = (0.85, 1.05)  # factor: a 6S pack from 25.2 V full to 20.4 V under load, 24 V nominal
    friction: Range = (0.4, 1.2)  # sliding, absolute: TPU on tiles to TPU on rubber (legged_gym 0.5 to 1.25)
    contact_time: Range = (0.4, 1.6)  # factor on the skin's contact time constant: 0.4 to 6 times as stiff, k ~ 1 / T^2
    mass: Range = (
        0.85,
        1.15,
    )  # factor on each link's mass and inertia: infill, glue (legged_gym 0.9 to 1.1)
    skin: Range = (0.5, 1.5)  # factor on the stiffness of sprung pads: the patch that the floor presses is (assumed)
    gyro_bias: float = 0.03  # each axis within this much [rad/s], a BNO08x after its calibration has less
    imu_turn: float = 0.04  # mounting error about each axis within this much [rad]
    encoder_offset: float = 0.03  # of each joint within this much [rad]: homing by hand against a printed mark
    push_speed: float = 0.3  # horizontal kick of the root [m/s] ...
    push_every: float = 4.0  # ... about so often [s]
    noise: Noise | None = WHITE
    noise_level: Range = (1.0, 1.0)  # factor on all of the noise

    def __post_init__(self) -> None:
        """Check the bounds."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                low, high = value
                # All but these are drawn in their logarithm.
                least, sign = (
                    (0.0, "<=") if field.name in ("latency", "noise_level") else (np.finfo(np.float64).tiny, "<")
                )
                if not (np.isfinite(value).all() and least <= low <= high):
                    raise ValueError(
                        f"randomisation: {field.name} is {value}; it must be a range with 0 {sign} low <= high"
                    )
            elif isinstance(value, int | float) and not 0.0 <= value < np.inf:
                raise ValueError(f"randomisation: {field.name} is {value}; it must be finite and not negative")
        if not self.push_every > 0.0:
            raise ValueError(f"randomisation: push_every is {self.push_every}; it must be above 0 s")


RANDOMISED = Randomisation()
# What is learned from: where a policy is to keep its speed at the ends of a range, training goes beyond them. Some
# robots have little noise: a policy that has always moved by it stands still, or otherwise, without it.
WIDE = replace(
    RANDOMISED, friction=(0.35, 1.4), contact_time=(0.3, 2.5), skin=(0.25, 1.5), noise_level=(0.0, 1.0)
)  # fmt: skip
EXACT = Randomisation(
    latency=(0.008, 0.008), stiffness=(1.0, 1.0), damping=(1.0, 1.0), voltage=(1.0, 1.0), friction=(0.8, 0.8),
    contact_time=(1.0, 1.0), mass=(1.0, 1.0), skin=(1.0, 1.0), gyro_bias=0.0, imu_turn=0.0, encoder_offset=0.0,
    push_speed=0.0, noise=None,
)  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Draws:
    """One robot for each of k copies; None means as in the model.

    Attributes:
        latency: [s], (k,).
        stiffness: factor on kp, (k, n).
        damping: factor on kd, (k, n).
        voltage: factor, (k,).
        friction: sliding, (k,).
        contact_time: factor, (k,).
        mass: factor on each body but the world, (k, nbody - 1).
        skin: factor on the stiffness of sprung pads, (k,).
        gyro_bias: [rad/s], (k, 3).
        imu_turn: rotation from the IMU's true frame to where it believes to be, (k, 3, 3).
        encoder_offset: what a joint reads above its angle [rad], (k, n).
        push_speed: [m/s]; None for no pushes.
        push_every: [s].
        noise: of every reading; None for none.
        noise_level: factor on it, (k,); None for 1.
    """

    latency: Array | None
    stiffness: Array | None
    damping: Array | None
    voltage: Array | None
    friction: Array | None
    contact_time: Array | None
    mass: Array | None
    skin: Array | None
    gyro_bias: Array
    imu_turn: Array
    encoder_offset: Array
    push_speed: float | None = None
    push_every: float = 4.0
    noise: Noise | None = None
    noise_level: Array | None = None

    def row(self, index: int) -> dict[str, Array]:
        """What one copy drew, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: np.array(value[index]) for name, value in values.items() if isinstance(value, np.ndarray)}

    def changed(self, ids: NDArray[np.intp], other: Draws) -> Draws:
        """The same with the rows `ids` taken from `other`, which has one row for each of them."""
        found: dict[str, Any] = {}
        for field in fields(self):
            mine, theirs = getattr(self, field.name), getattr(other, field.name)
            if isinstance(mine, np.ndarray):
                mine = mine.copy()
                mine[ids] = theirs
                found[field.name] = mine
        return replace(self, **found)


def nominal(count: int, num_joints: int) -> Draws:
    """Robots as in the model, with perfect sensors."""
    turn = np.repeat(np.eye(3)[None], count, axis=0)
    return Draws(
        None, None, None, None, None, None, None, None, np.zeros((count, 3)), turn, np.zeros((count, num_joints))
    )  # fmt: skip


def draw(ranges: Randomisation, rng: np.random.Generator, count: int, num_joints: int, num_bodies: int) -> Draws:
    """Draw robots; uniform in each range, factors in their logarithm."""

    def uniform(bounds: Range, *shape: int) -> Array:
        return rng.uniform(*bounds, (count, *shape))

    def factor(bounds: Range, *shape: int) -> Array:
        return np.exp(uniform((np.log(bounds[0]), np.log(bounds[1])), *shape))

    def within(bound: float, *shape: int) -> Array:
        return uniform((-bound, bound), *shape)

    return Draws(
        latency=uniform(ranges.latency), stiffness=factor(ranges.stiffness, 1) * np.ones(num_joints),
        damping=factor(ranges.damping, 1) * np.ones(num_joints), voltage=factor(ranges.voltage),
        friction=factor(ranges.friction), contact_time=factor(ranges.contact_time),
        mass=factor(ranges.mass, num_bodies), skin=factor(ranges.skin), gyro_bias=within(ranges.gyro_bias, 3),
        imu_turn=_turns(within(ranges.imu_turn, 3)), encoder_offset=within(ranges.encoder_offset, num_joints),
        push_speed=ranges.push_speed if ranges.push_speed > 0 else None, push_every=ranges.push_every,
        noise=ranges.noise, noise_level=uniform(ranges.noise_level),
    )  # fmt: skip


def at_end(ranges: Randomisation, end: int, *names: str) -> Randomisation:
    """The robot as it is, but for some things that are at the low (0) or the high end (1) of their ranges."""
    changes: dict[str, Any] = {name: (getattr(ranges, name)[end],) * 2 for name in names}
    return replace(EXACT, **changes)


def corners(ranges: Randomisation) -> tuple[Randomisation, ...]:
    """The robot as it is, then with one thing at a time at an end of its range; both gains are one thing.

    Less latency and more voltage than the model has would make the robot better, so those ends are left out.
    """
    both = (("stiffness", "damping"), ("friction",), ("contact_time",), ("mass",))
    each = (at_end(ranges, end, *names) for names in both for end in (0, 1))
    return (EXACT, at_end(ranges, 1, "latency"), at_end(ranges, 0, "voltage"), *each)


def joined(parts: Sequence[Draws]) -> Draws:
    """The rows of several draws, all with or all without each of their arrays; noise and pushes are those of the first.

    Raises:
        ValueError: if one has an array that another lacks.
    """
    found: dict[str, Any] = {}
    for name in (field.name for field in fields(parts[0])):
        rows = [getattr(part, name) for part in parts]
        arrays = [row for row in rows if isinstance(row, np.ndarray)]
        if arrays and len(arrays) < len(rows):
            raise ValueError(f"only some of the draws have {name}")
        if arrays:
            found[name] = np.concatenate(arrays)
    return replace(parts[0], **found)


def apply(herd: Herd, ids: NDArray[np.intp], draws: Draws) -> None:
    """Make copies into the robots that were drawn, one row of `draws` for each of `ids`, which rise.

    Place them afterwards.

    Raises:
        ValueError: if a latency is longer than the model's buffer; compile it with `sim.herd.with_latency_room`.
    """
    model, many = herd.model, herd.batch
    if draws.latency is not None:
        room = model.actuator_history[:, 0].min() * model.opt.timestep
        if draws.latency.max(initial=0.0) > room + 1e-9:
            raise ValueError(
                f"a latency of {draws.latency.max():g} s is beyond the {room:g} s that the model has room for"
            )
        # Less than one step cannot be: a command acts from the next step on.
        many.expand("actuator_delay")[ids] = np.maximum(draws.latency, model.opt.timestep)[:, None]
    gains = model.actuator_gainprm
    if draws.stiffness is not None:
        many.expand("actuator_gainprm")[ids, :, STIFFNESS] = gains[:, STIFFNESS] * draws.stiffness
    if draws.damping is not None:
        many.expand("actuator_gainprm")[ids, :, DAMPING] = gains[:, DAMPING] * draws.damping
    if draws.voltage is not None:
        many.expand("actuator_gainprm")[ids, :, VOLTAGE] = gains[:, VOLTAGE] * draws.voltage[:, None]
    if draws.friction is not None:
        # Of two things that touch the greater friction counts, so all get the same.
        for field in ("geom_friction", "flex_friction")[: 2 if model.nflex else 1]:
            many.expand(field)[ids, :, 0] = draws.friction[:, None]
    if draws.contact_time is not None:
        for field in ("geom_solref", "flex_solref")[: 2 if model.nflex else 1]:
            many.expand(field)[ids, :, 0] = getattr(model, field)[:, 0] * draws.contact_time[:, None]
    if draws.skin is not None and has_pads(model):
        slides = _slides(model)
        for field, which in (("jnt_stiffness", slides), ("dof_damping", slides[model.dof_jntid])):
            many.expand(field)[ids] = getattr(model, field) * np.where(which, draws.skin[:, None], 1.0)
    if draws.mass is not None:
        many.expand("body_mass")[ids, 1:] = model.body_mass[1:] * draws.mass
        many.expand("body_inertia")[ids, 1:] = model.body_inertia[1:] * draws.mass[..., None]
        many.set_const(ids)


def has_pads(model: mujoco.MjModel) -> bool:
    """Whether its links stand on sprung pads."""
    return bool(_slides(model).any()) and model.nflex == 0


def push(herd: Herd, ids: NDArray[np.intp], speed: float, rng: np.random.Generator) -> None:
    """Kick the roots of copies to and fro on the floor, each by up to `speed` [m/s] along each axis."""
    if len(ids):
        herd.qvel[ids, :2] += rng.uniform(-speed, speed, (len(ids), 2))


def pushed(draws: Draws, period: float, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which copies are pushed in a control period [s]: each with probability period / push_every."""
    count = len(draws.gyro_bias)
    return np.flatnonzero(rng.random(count) < period / draws.push_every)


def _slides(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which joints are the slides of pads, or of the nodes of a block, which have no springs."""
    return np.asarray(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)


def _turns(vectors: Array) -> Array:
    """Rotation matrices (k, 3, 3) of small rotation vectors (k, 3)."""
    found = np.zeros((len(vectors), 9))
    for row, vector in zip(found, vectors, strict=True):
        quaternion = np.zeros(4)
        angle = float(np.linalg.norm(vector))
        mujoco.mju_axisAngle2Quat(quaternion, vector / angle if angle > 0 else np.array([1.0, 0, 0]), angle)
        mujoco.mju_quat2Mat(row, quaternion)
    return found.reshape(-1, 3, 3)
