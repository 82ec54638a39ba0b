"""The J60 joint motor's CAN protocol: bytes to SI and back, pure functions.

Every frame has a standard 11-bit id, `command << 5 | reply << 4 | motor`. Values travel as unsigned integers,
u = trunc((x - low) (2^bits - 1) / (high - low)), packed little-endian from the least significant bit. The wire spans
+-40 N.m and +-40 rad/s, more than the motor can bear: the caller clamps to the motor's own limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag

BITRATE = 1_000_000  # [bit/s]
REPLY_BIT = 0x10
MAX_MOTOR_ID = 15
CONTROL_SIZE = 8

# An integer that went to floating point and back may fall short by some 1e-11 counts; without this it would lose one.
_COUNT_TOLERANCE = 1e-6


class ForbiddenFrame(ValueError):
    """A frame that must never reach a motor."""


class Code(IntEnum):
    """Commands of the motor; firmware writing (18 to 21) is left out on purpose."""

    DISABLE = 1
    ENABLE = 2
    CALIBRATE = 3
    CONTROL = 4
    RESET = 5
    SET_HOME = 6
    SET_GEAR = 7
    SET_ID = 8
    SET_CAN_TIMEOUT = 9
    SET_BANDWIDTH = 10
    SET_CURRENT_LIMIT = 11
    SET_UNDER_VOLTAGE = 12
    SET_OVER_VOLTAGE = 13
    SET_MOTOR_TEMPERATURE = 14
    SET_DRIVE_TEMPERATURE = 15
    SAVE_CONFIG = 16
    ERROR_RESET = 17
    FIRMWARE_VERSION = 22
    STATUS_WORD = 23
    CONFIG = 24
    CALIBRATION_REPORT = 31


# Bytes sent and bytes answered, where documented.
SIZES: dict[Code, tuple[int, int]] = {
    Code.DISABLE: (0, 1),
    Code.ENABLE: (0, 1),
    Code.CALIBRATE: (0, 1),
    Code.CONTROL: (CONTROL_SIZE, 8),
    Code.RESET: (0, 1),
    Code.SET_HOME: (0, 1),
    Code.SET_GEAR: (2, 1),
    Code.SET_ID: (1, 1),
    Code.SET_CAN_TIMEOUT: (1, 1),
    Code.SET_BANDWIDTH: (2, 1),
    Code.SET_CURRENT_LIMIT: (2, 1),
    Code.SET_UNDER_VOLTAGE: (2, 1),
    Code.SET_OVER_VOLTAGE: (2, 1),
    Code.SET_MOTOR_TEMPERATURE: (2, 1),
    Code.SET_DRIVE_TEMPERATURE: (2, 1),
    Code.SAVE_CONFIG: (0, 1),
    Code.ERROR_RESET: (0, 1),
    Code.FIRMWARE_VERSION: (0, 2),
    Code.STATUS_WORD: (0, 5),
    Code.CONFIG: (0, 8),
}


class Fault(IntFlag):
    """Bits of the status word."""

    OVER_VOLTAGE = 1
    UNDER_VOLTAGE = 2
    OVER_CURRENT = 4
    MOTOR_TEMPERATURE = 8
    DRIVER_TEMPERATURE = 16
    CAN_TIMEOUT = 32
    TEMPERATURE_SENSOR = 64


@dataclass(frozen=True, slots=True)
class _Field:
    low: float
    high: float
    bits: int
    shift: int

    @property
    def top(self) -> int:
        return (1 << self.bits) - 1

    def pack(self, name: str, value: float) -> int:
        if not self.low <= value <= self.high:
            raise ValueError(f"{name} must lie in [{self.low:g}, {self.high:g}] on the wire, got {value}.")
        count = math.floor((value - self.low) * self.top / (self.high - self.low) + _COUNT_TOLERANCE)
        return min(count, self.top) << self.shift

    def unpack(self, word: int) -> float:
        count = word >> self.shift & self.top
        return count * (self.high - self.low) / self.top + self.low

    @property
    def resolution(self) -> float:
        return (self.high - self.low) / self.top


_COMMAND = {
    "position": _Field(-40.0, 40.0, 16, 0),
    "velocity": _Field(-40.0, 40.0, 14, 16),
    "kp": _Field(0.0, 1023.0, 10, 30),
    "kd": _Field(0.0, 51.0, 8, 40),
    "torque": _Field(-40.0, 40.0, 16, 48),
}
_REPLY = {
    "position": _Field(-40.0, 40.0, 20, 0),
    "velocity": _Field(-40.0, 40.0, 20, 20),
    "torque": _Field(-40.0, 40.0, 16, 40),
    "temperature": _Field(-20.0, 200.0, 7, 57),
}
_MOTOR_SENSOR_BIT = 56

COMMAND_RESOLUTION = {name: field.resolution for name, field in _COMMAND.items()}
REPLY_RESOLUTION = {name: field.resolution for name, field in _REPLY.items()}


@dataclass(frozen=True, slots=True)
class Command:
    """What a motor shall do: torque + kp (position - q) + kd (velocity - qd)."""

    position: float = 0.0  # [rad]
    velocity: float = 0.0  # [rad/s]
    kp: float = 0.0  # [N.m/rad]
    kd: float = 0.0  # [N.m.s/rad]
    torque: float = 0.0  # [N.m]


@dataclass(frozen=True, slots=True)
class Reply:
    """What a motor measures; successive replies alternate between its two temperature sensors."""

    position: float  # [rad]
    velocity: float  # [rad/s]
    torque: float  # [N.m]
    temperature: float  # [C]
    is_motor_sensor: bool  # False: the temperature is the driver's


@dataclass(frozen=True, slots=True)
class Config:
    """A motor's settings as it reports them."""

    motor: int
    can_timeout: int  # [ms]
    bandwidth: int  # [Hz]
    current_limit: int  # unit not documented


def request_id(code: Code, motor: int) -> int:
    """Give the id of a frame to a motor.

    Raises:
        ValueError: The motor id does not fit its 4 bits.
    """
    if not 0 <= motor <= MAX_MOTOR_ID:
        raise ValueError(f"Motor id must lie in [0, {MAX_MOTOR_ID}], got {motor}.")
    return code << 5 | motor


def reply_id(code: Code, motor: int) -> int:
    """Give the id of the motor's answer: the request's with bit 4 set."""
    return request_id(code, motor) | REPLY_BIT


def split_id(can_id: int) -> tuple[int, bool, int]:
    """Take an id apart into (command number, is it a reply, motor)."""
    return can_id >> 5, bool(can_id & REPLY_BIT), can_id & MAX_MOTOR_ID


def check_request(can_id: int, data: bytes) -> None:
    """Refuse what must not be sent to a motor.

    All-zero bytes on a control id do not mean "rest": they decode to -40 rad, -40 rad/s and -40 N.m, full reverse.

    Raises:
        ForbiddenFrame: The id is a reply's or a firmware command's, the size is wrong, or control bytes are all zero.
    """
    number, is_reply, motor = split_id(can_id)
    if is_reply or number not in SIZES:
        raise ForbiddenFrame(f"Frame {can_id:03X} is not a request that this program may send.")
    code = Code(number)
    if len(data) != SIZES[code][0]:
        raise ForbiddenFrame(f"{code.name} to motor {motor} takes {SIZES[code][0]} bytes, got {len(data)}.")
    if code is Code.CONTROL and not any(data):
        raise ForbiddenFrame(f"All-zero control bytes to motor {motor} would mean -40 N.m; encode a command instead.")


def encode_command(command: Command) -> bytes:
    """Pack a control command into 8 bytes.

    Raises:
        ValueError: A value is NaN or beyond the wire's range.
        ForbiddenFrame: The bytes are all zero.
    """
    word = 0
    for name, field in _COMMAND.items():
        word |= field.pack(name, getattr(command, name))
    if word == 0:
        raise ForbiddenFrame("A command of all-zero bytes asks for -40 rad, -40 rad/s and -40 N.m; it is never meant.")
    return word.to_bytes(8, "little")


def decode_command(data: bytes) -> Command:
    """Unpack 8 control bytes, as a motor does."""
    word = _word(data)
    return Command(**{name: field.unpack(word) for name, field in _COMMAND.items()})


def encode_reply(reply: Reply) -> bytes:
    """Pack a control reply into 8 bytes, as a motor does.

    Raises:
        ValueError: A value is NaN or beyond the wire's range.
    """
    word = int(reply.is_motor_sensor) << _MOTOR_SENSOR_BIT
    for name, field in _REPLY.items():
        word |= field.pack(name, getattr(reply, name))
    return word.to_bytes(8, "little")


def decode_reply(data: bytes) -> Reply:
    """Unpack the 8 bytes of a control reply."""
    word = _word(data)
    values = {name: field.unpack(word) for name, field in _REPLY.items()}
    return Reply(**values, is_motor_sensor=bool(word >> _MOTOR_SENSOR_BIT & 1))


def quantise_gains(kp: float, kd: float) -> tuple[float, float]:
    """Give the gains that the motor will use when asked for these: kp in steps of 1, kd in steps of 0.2.

    Raises:
        ValueError: A gain is NaN or beyond the wire's range.
    """
    back = decode_command(encode_command(Command(kp=kp, kd=kd)))
    return back.kp, round(back.kd, 10)


def encode_setting(code: Code, value: int) -> bytes:
    """Pack the argument of a SET command, little-endian in the size that the command takes.

    Raises:
        ValueError: The command takes no argument, or the value does not fit.
    """
    size = SIZES[code][0]
    if code is Code.CONTROL or size == 0:
        raise ValueError(f"{code.name} takes no setting.")
    if not 0 <= value < 1 << 8 * size:
        raise ValueError(f"{code.name} must lie in [0, {(1 << 8 * size) - 1}], got {value}.")
    return value.to_bytes(size, "little")


def decode_setting(data: bytes) -> int:
    """Unpack the argument of a SET command."""
    return int.from_bytes(data, "little")


def encode_config(config: Config) -> bytes:
    """Pack the answer to CONFIG, as a motor does: two bytes of its own, then the settings."""
    return (
        bytes((0, 0, config.motor, config.can_timeout))
        + config.bandwidth.to_bytes(2, "little")
        + config.current_limit.to_bytes(2, "little")
    )


def decode_config(data: bytes) -> Config:
    """Unpack the 8 bytes that answer CONFIG.

    Raises:
        ValueError: There are not 8 bytes.
    """
    _word(data)
    return Config(data[2], data[3], int.from_bytes(data[4:6], "little"), int.from_bytes(data[6:8], "little"))


def decode_faults(data: bytes) -> Fault:
    """Read the fault bits out of a status word.

    Public drivers disagree on which of the first two bytes is the low one. All known bits fit one byte, so the union
    of the two is right either way.

    Raises:
        ValueError: There are fewer than 2 bytes.
    """
    if len(data) < 2:
        raise ValueError(f"A status word has at least 2 bytes, got {len(data)}.")
    return Fault(data[0] | data[1])


def _word(data: bytes) -> int:
    if len(data) != 8:
        raise ValueError(f"Expected 8 bytes, got {len(data)}: {data.hex(' ')}.")
    return int.from_bytes(data, "little")
