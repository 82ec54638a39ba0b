"""Simulated J60 motors on a CAN bus, with any plant behind them: the other end of a rehearsal.

In lock-step, the simulation's time passes only while the control loop waits, so a run is as fast as the computer
allows and the same every time. In real time, a thread of the caller runs `serve_forever`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hardware import j60
from hardware.bus import Clock, Frame, Port
from hardware.j60 import Code, Command, Config, Fault, Reply

Array = NDArray[np.float64]

FIRMWARE = b"\x01\x00"
ROOM_TEMPERATURE = 25.0  # [C]
_REQUEST_SIZES = {code.value: size for code, (size, _) in j60.SIZES.items()}
REAL_TIME_STEP = 0.002  # how often the plant catches up with the wall clock [s]


class Plant(Protocol):
    """What the motors move. Vectors have one entry per joint, in the order of the motors."""

    @property
    def joint_positions(self) -> Array:
        """Angles [rad], (n,)."""
        ...

    @property
    def joint_velocities(self) -> Array:
        """Speeds [rad/s], (n,)."""
        ...

    @property
    def joint_torques(self) -> Array:
        """What the motors give [N.m], (n,)."""
        ...

    def imu(self) -> tuple[Array, Array]:
        """Gravity's direction (unit, down) and angular velocity [rad/s], both (3,) in the IMU frame."""
        ...

    def step(self, position: Array, velocity: Array, kp: Array, kd: Array, torque: Array, dt: float) -> None:
        """Let `dt` [s] pass under torque + kp (position - q) + kd (velocity - qd), limited as the motors limit it."""
        ...


@dataclass(frozen=True, slots=True)
class Imperfection:
    """How the bus misbehaves."""

    drop: float = 0.0  # probability that a frame is lost, either way
    delay: float = 0.0  # of every answer [s]


@dataclass(slots=True)
class Node:
    """One motor's memory; tests may change it to provoke the guards."""

    motor: int
    sign: int
    latch: Command | None = None  # the last command: it outlives disabling, as in the real motor
    enabled: bool = False
    present: bool = True  # False: unplugged
    faults: int = 0  # of `Fault`
    can_timeout: int = 0  # 0: never [ms]
    heard: float = 0.0  # when the last control frame came [s]
    home: float = 0.0  # motor angle that counts as zero [rad]
    bandwidth: int = 1000
    current_limit: int = 0
    motor_temperature: float = ROOM_TEMPERATURE
    driver_temperature: float = ROOM_TEMPERATURE
    tells_motor_temperature: bool = False

    @property
    def expires(self) -> float:
        """When the motor's watchdog will stop it if it hears nothing more [s]."""
        return self.heard + self.can_timeout * 1e-3 if self.enabled and self.can_timeout else math.inf


@dataclass(order=True, slots=True)
class _Pending:
    due: float
    number: int
    frame: Frame = field(compare=False)


class VirtualMotors:
    """Motors that answer on `port` and drive `plant`; also the clock of a lock-step run.

    A motor's angle is sign * joint angle - home. A motor that is disabled, faulted or has heard nothing is limp.
    """

    def __init__(
        self,
        port: Port,
        plant: Plant,
        ids: Sequence[int],
        signs: Sequence[int] | None = None,
        imperfection: Imperfection = Imperfection(),
        rng: np.random.Generator | None = None,
    ) -> None:
        """Attach one motor per joint of the plant.

        Args:
            port: This side's end of the bus.
            plant: What they move.
            ids: Motor ids, in the plant's joint order.
            signs: +1 or -1 per joint; all +1 by default.
            imperfection: How the bus misbehaves.
            rng: Source of the drops, needed if there are any.

        Raises:
            ValueError: Sizes disagree, ids repeat, or drops are wanted without an `rng`.
        """
        signs = [1] * len(ids) if signs is None else signs
        if len(signs) != len(ids) or len(plant.joint_positions) != len(ids) or len(set(ids)) != len(ids):
            raise ValueError(f"{len(plant.joint_positions)} joints need as many distinct ids and signs, got {ids}.")
        if imperfection.drop > 0.0 and rng is None:
            raise ValueError(f"Dropping frames with probability {imperfection.drop} needs an rng.")
        self.nodes = [Node(motor, sign) for motor, sign in zip(ids, signs, strict=True)]
        self._by_id = {node.motor: index for index, node in enumerate(self.nodes)}
        self._port = port
        self._plant = plant
        self._imperfection = imperfection
        self._rng = rng
        self._time = 0.0
        self._pending: list[_Pending] = []
        self._answered = 0
        self._imu = plant.imu()

    def imu(self) -> tuple[Array, Array]:
        """Gravity's direction and angular velocity as of the last step."""
        return self._imu

    def now(self) -> float:
        """Give the simulated time [s]."""
        return self._time

    def sleep_until(self, deadline: float) -> None:
        """Let simulated time pass to `deadline` [s], motors watching for silence on the bus."""
        self.serve()
        while self._time < deadline:
            expiry = min(node.expires for node in self.nodes)
            target = min(deadline, max(expiry, self._time + 1e-3))
            self._plant.step(*self._commands(), target - self._time)
            self._time = target
            for node in self.nodes:
                if node.expires <= self._time:
                    node.faults |= Fault.CAN_TIMEOUT
                    node.enabled = False
            self._imu = self._plant.imu()
            self._deliver()

    def serve(self) -> None:
        """Answer every frame that waits on the bus."""
        frame = self._port.receive(0.0)
        while frame is not None:
            self._hear(frame)
            frame = self._port.receive(0.0)
        self._deliver()

    def serve_forever(self, stop: threading.Event, clock: Clock) -> None:
        """Answer frames as they come and step the plant in real time, until `stop` is set."""
        start = clock.now() - self._time
        while not stop.is_set():
            frame = self._port.receive(REAL_TIME_STEP)
            if frame is not None:
                self._hear(frame)
                self._deliver()
            if clock.now() - start - self._time >= REAL_TIME_STEP:
                self.sleep_until(clock.now() - start)

    @property
    def next_delivery(self) -> float:
        """When the next delayed answer will be on the bus [s]."""
        return self._pending[0].due if self._pending else math.inf

    def _commands(self) -> tuple[Array, Array, Array, Array, Array]:
        """Give what the plant shall do, joint by joint: position, velocity, kp, kd, torque."""
        rows = np.zeros((len(self.nodes), 5))
        for row, node in zip(rows, self.nodes, strict=True):
            command = node.latch
            if node.enabled and command is not None:
                row[0] = node.sign * (command.position + node.home)
                row[1] = node.sign * command.velocity
                row[2], row[3] = command.kp, command.kd
                row[4] = node.sign * command.torque
        position, velocity, kp, kd, torque = rows.T
        return position, velocity, kp, kd, torque

    def _hear(self, frame: Frame) -> None:
        number, is_reply, motor = j60.split_id(frame.can_id)
        index = self._by_id.get(motor)
        if is_reply or index is None or not self.nodes[index].present or self._is_lost():
            return
        answer = self._answer(index, number, frame.data)
        if answer is not None and not self._is_lost():
            self._answered += 1
            due = self._time + self._imperfection.delay
            self._pending.append(_Pending(due, self._answered, Frame(frame.can_id | j60.REPLY_BIT, answer)))

    def _deliver(self) -> None:
        # The delay is the same for all, so answers come due in the order in which they were made.
        while self._pending and self._pending[0].due <= self._time:
            self._port.send(self._pending.pop(0).frame)

    def _is_lost(self) -> bool:
        return self._rng is not None and self._rng.random() < self._imperfection.drop

    def _answer(self, index: int, number: int, data: bytes) -> bytes | None:
        """Do what a frame asks; None where a motor would not answer."""
        node = self.nodes[index]
        if _REQUEST_SIZES.get(number) != len(data):
            return None
        match Code(number):
            case Code.CONTROL:
                node.latch = j60.decode_command(data)
                node.heard = self._time
                return self._measure(index)
            case Code.ENABLE:
                if node.faults:
                    return b"\x01"
                node.enabled, node.heard = True, self._time
            case Code.DISABLE:
                node.enabled = False
            case Code.ERROR_RESET:
                node.faults = 0
            case Code.SET_HOME:
                node.home = node.sign * float(self._plant.joint_positions[index])
            case Code.SET_CAN_TIMEOUT:
                node.can_timeout = j60.decode_setting(data)
            case Code.SET_BANDWIDTH:
                node.bandwidth = j60.decode_setting(data)
            case Code.SET_CURRENT_LIMIT:
                node.current_limit = j60.decode_setting(data)
            case Code.SAVE_CONFIG:
                pass
            case Code.STATUS_WORD:
                return node.faults.to_bytes(2, "little") + bytes(3)
            case Code.CONFIG:
                return j60.encode_config(Config(node.motor, node.can_timeout, node.bandwidth, node.current_limit))
            case Code.FIRMWARE_VERSION:
                return FIRMWARE
            case _:
                return None
        return b"\x00"

    def _measure(self, index: int) -> bytes:
        node = self.nodes[index]
        node.tells_motor_temperature = not node.tells_motor_temperature
        temperature = node.motor_temperature if node.tells_motor_temperature else node.driver_temperature
        return j60.encode_reply(
            Reply(
                position=_on_wire(node.sign * float(self._plant.joint_positions[index]) - node.home),
                velocity=_on_wire(node.sign * float(self._plant.joint_velocities[index])),
                torque=_on_wire(node.sign * float(self._plant.joint_torques[index])),
                temperature=temperature,
                is_motor_sensor=node.tells_motor_temperature,
            )
        )


def _on_wire(value: float) -> float:
    """Saturate at the ends of the wire's range, as a motor's firmware must."""
    return min(max(value, -40.0), 40.0)


class LockStepPort:
    """The control loop's end of a lock-step bus: whoever waits here lets the motors answer and time pass."""

    def __init__(self, port: Port, motors: VirtualMotors) -> None:
        """Wait on `port`, whose other end the motors hold."""
        self._port = port
        self._motors = motors

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus."""
        self._port.send(frame)

    def receive(self, timeout: float) -> Frame | None:
        """Give the next frame, after at most `timeout` [s] of simulated time."""
        frame = self._port.receive(0.0)
        if frame is None:
            self._motors.serve()
            frame = self._port.receive(0.0)
        if frame is None and timeout > 0.0:
            deadline = self._motors.now() + timeout
            self._motors.sleep_until(min(deadline, self._motors.next_delivery))
            frame = self._port.receive(0.0)
        return frame

    def close(self) -> None:
        """Let the bus go."""
        self._port.close()
