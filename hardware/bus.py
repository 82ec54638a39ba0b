"""The CAN bus: opening it, and asking motors with a deadline. The only importer of python-can."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import can

from hardware import j60
from hardware.j60 import Code, Command, Reply

SWEEP_TIMEOUT = 0.010  # for all replies of one control sweep, 15 motors take at most 4.3 ms on the wire [s]
REQUEST_TIMEOUT = 0.020  # for one answer through a USB adapter [s]
ATTEMPTS = 3  # a lost frame is asked for again; a motor that misses three is silent

_channels = itertools.count()


class MotorError(OSError):
    """The bus or a motor did not do its part."""


class BusUnavailable(MotorError, ConnectionError):
    """The bus cannot be opened, or has gone."""


class MotorSilent(MotorError, TimeoutError):
    """A motor gave no reply in time."""


class MotorFault(MotorError):
    """A motor refused a command or reports a fault."""


class Clock(Protocol):
    """Time as the control loop knows it, real or simulated."""

    def now(self) -> float:
        """Give the time, which never goes back [s]."""
        ...

    def sleep_until(self, deadline: float) -> None:
        """Return at `deadline`, at once if it has passed."""
        ...


class RealClock:
    """The computer's monotonic clock."""

    def now(self) -> float:
        """Give the time since some fixed moment [s]."""
        return time.monotonic()

    def sleep_until(self, deadline: float) -> None:
        """Sleep to an absolute deadline, so that periods do not drift."""
        remaining = deadline - time.monotonic()
        if remaining > 0.0:
            time.sleep(remaining)


@dataclass(frozen=True, slots=True)
class Frame:
    """One CAN frame with an 11-bit id."""

    can_id: int
    data: bytes


class Port(Protocol):
    """One end of a bus."""

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus.

        Raises:
            BusUnavailable: The bus does not take it.
        """
        ...

    def receive(self, timeout: float) -> Frame | None:
        """Give the next frame from others, or None if `timeout` [s] passes without one."""
        ...

    def close(self) -> None:
        """Let the bus go."""
        ...


class CanPort:
    """A bus of python-can."""

    def __init__(self, bus: can.BusABC, name: str) -> None:
        """Take over an open bus; `name` is how messages call it."""
        self._bus = bus
        self._name = name

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus."""
        try:
            self._bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
        except (can.CanError, OSError) as error:
            raise BusUnavailable(
                f"{self._name} did not take a frame: {_brief(error)}; check the adapter, and `ip link set "
                "DEVICE txqueuelen 128` if its buffer is full."
            ) from error

    def receive(self, timeout: float) -> Frame | None:
        """Give the next data frame with an 11-bit id; others are not for us."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                message = self._bus.recv(max(0.0, deadline - time.monotonic()))
            except (can.CanError, OSError) as error:
                raise BusUnavailable(f"{self._name} is gone: {_brief(error)}; check the adapter.") from error
            if message is None:
                return None
            if not (message.is_extended_id or message.is_error_frame or message.is_remote_frame):
                return Frame(message.arbitration_id, bytes(message.data))

    def close(self) -> None:
        """Shut the bus down."""
        self._bus.shutdown()


def open_port(address: str) -> CanPort:
    """Open one end of a bus at 1 Mbit/s.

    Args:
        address: `socketcan:can0`, `slcan:/dev/ttyACM0`, or `virtual:NAME` (in this process only).

    Raises:
        BusUnavailable: It cannot be opened; the message says what to do.
    """
    kind, _, channel = address.partition(":")
    if not channel or kind not in ("virtual", "socketcan", "slcan"):
        raise BusUnavailable(f"Unknown bus {address!r}; give virtual, socketcan:can0 or slcan:/dev/ttyACM0.")
    remedy = {
        "virtual": "use another name",
        "socketcan": f"`ip link set {channel} up type can bitrate {j60.BITRATE} && ip link set {channel} "
        "txqueuelen 128` brings it up",
        "slcan": "check that the adapter is plugged in and that you may use its serial port",
    }[kind]
    try:
        bus = can.Bus(interface=kind, channel=channel, bitrate=j60.BITRATE)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise BusUnavailable(f"Cannot open {address}: {_brief(error)}; {remedy}.") from error
    return CanPort(bus, address)


def open_virtual_pair() -> tuple[CanPort, CanPort]:
    """Open both ends of a fresh virtual bus; no other caller ever gets the same one."""
    address = f"virtual:bodyplan-{next(_channels)}"
    return open_port(address), open_port(address)


def _brief(error: BaseException) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


class MotorBus:
    """Requests to motors, each answered by the frame whose id is the request's with the reply bit set."""

    def __init__(self, port: Port, clock: Clock) -> None:
        """Speak through `port`; deadlines are kept by `clock`."""
        self._port = port
        self._clock = clock

    def sweep(self, commands: Mapping[int, Command], timeout: float = SWEEP_TIMEOUT) -> dict[int, Reply]:
        """Command motors by id and collect what they measure.

        A motor that says nothing in time is simply absent: whether that matters is for the guards to decide. A control
        reply that comes late counts in the next sweep, the newest one of each motor wins.

        Raises:
            BusUnavailable: The bus is gone.
            ForbiddenFrame: A command's bytes are all zero.
        """
        replies: dict[int, Reply] = {}
        pending = self._port.receive(0.0)
        while pending is not None:
            self._keep(pending, commands, replies)
            pending = self._port.receive(0.0)
        for motor, command in commands.items():
            self._send(Frame(j60.request_id(Code.CONTROL, motor), j60.encode_command(command)))
        deadline = self._clock.now() + timeout
        awaited = set(commands)
        while awaited:
            frame = self._port.receive(max(0.0, deadline - self._clock.now()))
            if frame is None:
                break
            awaited.discard(self._keep(frame, commands, replies))
        return replies

    def request(self, motor: int, code: Code, data: bytes = b"", timeout: float = REQUEST_TIMEOUT) -> bytes:
        """Ask one motor until it answers, at most `ATTEMPTS` times, and return the answer's bytes.

        Raises:
            MotorSilent: It never answered.
            BusUnavailable: The bus is gone.
        """
        for _ in range(ATTEMPTS):
            answer = self.ask(motor, code, data, timeout)
            if answer is not None:
                return answer
        raise MotorSilent(
            f"Motor {motor} gave no reply to {code.name} within {timeout * 1e3:.0f} ms, {ATTEMPTS} times; "
            "check 24 V supply and CAN wiring."
        )

    def ask(self, motor: int, code: Code, data: bytes = b"", timeout: float = REQUEST_TIMEOUT) -> bytes | None:
        """Ask one motor once; None if it does not answer in time."""
        self._send(Frame(j60.request_id(code, motor), data))
        expected = j60.reply_id(code, motor)
        deadline = self._clock.now() + timeout
        while True:
            frame = self._port.receive(max(0.0, deadline - self._clock.now()))
            if frame is None:
                return None
            if frame.can_id == expected and len(frame.data) == j60.SIZES[code][1]:
                return frame.data

    def order(self, motor: int, code: Code, data: bytes = b"") -> None:
        """Ask one motor to do something and make sure that it says yes.

        Raises:
            MotorFault: It refuses.
            MotorSilent: It never answered.
            BusUnavailable: The bus is gone.
        """
        answer = self.request(motor, code, data)
        if answer[0] != 0:
            raise MotorFault(f"Motor {motor} refused {code.name} with code {answer[0]}; read its status word.")

    def _send(self, frame: Frame) -> None:
        j60.check_request(frame.can_id, frame.data)
        self._port.send(frame)

    @staticmethod
    def _keep(frame: Frame, commands: Mapping[int, Command], replies: dict[int, Reply]) -> int:
        """Store a control reply of a commanded motor; returns its id, or -1 for any other frame."""
        number, is_reply, motor = j60.split_id(frame.can_id)
        if number != Code.CONTROL or not is_reply or motor not in commands or len(frame.data) != 8:
            return -1
        replies[motor] = j60.decode_reply(frame.data)
        return motor
