from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hardware.bundle import Bundle, JointSetup
from hardware.bus import CanPort, MotorBus, Port, open_virtual_pair
from hardware.j60 import quantise_gains
from hardware.log import Journal
from hardware.robot import Robot
from hardware.safety import DEFAULT_LIMITS, Limits
from hardware.tick import Schedule
from hardware.virtual import Imperfection, LockStepPort, VirtualMotors
from sim.actor import Gait

PEAK = 19.94


@dataclass
class Springs:
    """A second-order plant: joints of constant inertia and friction, without gravity, solved by semi-implicit Euler."""

    joint_positions: NDArray[np.float64]
    inertia: float = 0.05
    joint_velocities: NDArray[np.float64] = field(init=False)
    joint_torques: NDArray[np.float64] = field(init=False)
    gravity: NDArray[np.float64] = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    jammed: bool = False

    def __post_init__(self) -> None:
        self.joint_velocities = np.zeros_like(self.joint_positions)
        self.joint_torques = np.zeros_like(self.joint_positions)

    def imu(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.gravity, np.zeros(3)

    def step(self, position: Any, velocity: Any, kp: Any, kd: Any, torque: Any, dt: float) -> None:
        steps = max(1, round(dt / 0.001))
        for _ in range(steps):
            wanted = torque + kp * (position - self.joint_positions) + kd * (velocity - self.joint_velocities)
            self.joint_torques = np.clip(wanted, -PEAK, PEAK)
            change = (self.joint_torques - 0.2 * self.joint_velocities) / self.inertia
            if not self.jammed:
                self.joint_velocities = self.joint_velocities + change * dt / steps
                self.joint_positions = self.joint_positions + self.joint_velocities * dt / steps


def joint(name: str, can_id: int, **changes: Any) -> JointSetup:
    kp, kd = quantise_gains(40.0, 1.6)
    return replace(JointSetup(name, can_id, 1, (-1.2, 1.2), 0.1, kp, kd, PEAK, PEAK / 3, 24.18), **changes)


def make_bundle(**changes: Any) -> Bundle:
    joints = (joint("hip", 3), joint("knee", 7, sign=-1, default=-0.2), joint("ankle", 1))
    gait = Gait(1.0, np.array([0.4, 0.3, 0.2]), np.array([0.0, 1.0, 2.0]), np.array([0.1, -0.2, 0.0]))
    return replace(Bundle("design", joints, gait, 0.02), **changes)


class Rig:
    """A robot on a lock-step virtual bus, with everything a test may want to break."""

    def __init__(
        self,
        ports: tuple[CanPort, CanPort],
        bundle: Bundle,
        imperfection: Imperfection | None = None,
        limits: Limits = DEFAULT_LIMITS,
        schedule: Schedule | None = None,
        journal: Any = None,
    ) -> None:
        ours, theirs = ports
        self.bundle = bundle
        self.plant = Springs(np.array([0.5, -0.6, 0.3])[: len(bundle.joints)])
        ids, signs = [j.can_id for j in bundle.joints], [j.sign for j in bundle.joints]
        self.motors = VirtualMotors(
            theirs, self.plant, ids, signs, imperfection or Imperfection(), np.random.default_rng(0)
        )
        self.port: Port = LockStepPort(ours, self.motors)
        self.journal = None if journal is None else Journal(journal, self.port, self.motors)
        self.bus = MotorBus(self.journal or self.port, self.motors)
        self.robot = Robot(self.bus, self.motors, bundle, limits, schedule or Schedule(policy=1.0))


@pytest.fixture
def ports() -> Iterator[tuple[CanPort, CanPort]]:
    pair = open_virtual_pair()
    yield pair
    for port in pair:
        port.close()


@pytest.fixture
def bundle() -> Bundle:
    """A bundle of three joints, one of them mounted the other way round."""
    return make_bundle()


@pytest.fixture
def springs() -> Callable[..., Springs]:
    return Springs


@pytest.fixture
def make_rig(ports: tuple[CanPort, CanPort]) -> Callable[..., Rig]:
    """Make a robot on a virtual bus; another bundle, imperfections, limits, schedule and journal may be given."""

    def make(bundle: Bundle | None = None, **options: Any) -> Rig:
        return Rig(ports, bundle or make_bundle(), **options)

    return make
