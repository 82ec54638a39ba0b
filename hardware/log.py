"""The record of a run, and playing it back: every frame in candump's form, every period as one JSON line beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hardware import j60
from hardware.bundle import Bundle, BundleError, bundle_document, parse_bundle
from hardware.bus import Clock, Frame, MotorBus, Port
from hardware.robot import Robot
from hardware.safety import Limits
from hardware.tick import Imu, Schedule, Tick

LOG_VERSION = 1
CHANNEL = "can0"
_LINE = re.compile(r"\((\d+\.\d+)\) \S+ ([0-9A-F]{3})#((?:[0-9A-F]{2}){0,8}) ([RT])")


class LogError(ValueError):
    """A log cannot be read; the message names the file and the line."""


@dataclass(frozen=True, slots=True)
class LoggedFrame:
    """One line of the frame log."""

    time: float  # [s]
    frame: Frame
    sent: bool  # by us; False: received


@dataclass(frozen=True, eq=False, slots=True)
class LoggedTick:
    """What a period's JSON line says that playing it back needs."""

    index: int
    imu: Imu | None
    overruns: int
    frames: int  # in the log at the end of the period


@dataclass(frozen=True, eq=False, slots=True)
class Log:
    """A whole run."""

    bundle: Bundle
    limits: Limits
    schedule: Schedule
    bring_up: int  # frames before the first period
    ticks: tuple[LoggedTick, ...]
    frames: tuple[LoggedFrame, ...]


def states_path(path: Path) -> Path:
    """Where the periods of the frame log `path` are."""
    return path.with_name(path.name + ".jsonl")


class Journal:
    """Writes a run down while it happens; a context manager that is also the port through which the frames go."""

    def __init__(self, path: Path, port: Port, clock: Clock) -> None:
        """Open `path` and its companion for writing.

        Raises:
            OSError: They cannot be written.
        """
        self._port, self._clock = port, clock
        self._count = 0
        self._frames = path.open("w", encoding="ascii")
        try:
            self._states = states_path(path).open("w", encoding="ascii")
        except OSError:
            self._frames.close()
            raise

    def __enter__(self) -> Self:
        """Give itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close both files."""
        self.close()

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus, then write it down."""
        self._port.send(frame)
        self._write(frame, "T")

    def receive(self, timeout: float) -> Frame | None:
        """Receive a frame and write it down."""
        frame = self._port.receive(timeout)
        if frame is not None:
            self._write(frame, "R")
        return frame

    def close(self) -> None:
        """Close both files; the port stays open."""
        self._frames.close()
        self._states.close()

    def header(self, bundle: Bundle, limits: Limits, schedule: Schedule) -> None:
        """Write down what the run depends on, before it."""
        self._state(
            version=LOG_VERSION, bundle=bundle_document(bundle), limits=asdict(limits), schedule=asdict(schedule)
        )

    def brought_up(self) -> None:
        """Write down that the motors are up."""
        self._state(bring_up=self._count)

    def tick(self, tick: Tick, overruns: int) -> None:
        """Write a period down."""
        self._state(
            tick=tick.index,
            state=tick.state,
            overruns=overruns,
            frames=self._count,
            gravity=None if tick.imu is None else _numbers(tick.imu[0]),
            gyro=None if tick.imu is None else _numbers(tick.imu[1]),
            target=_numbers(tick.target),
            position=_numbers(tick.position),
            velocity=_numbers(tick.velocity),
            torque=_numbers(tick.torque),
            temperature=_numbers(tick.temperature),
            latched=None if tick.trip is None else tick.trip.as_json(),
        )

    def _write(self, frame: Frame, direction: str) -> None:
        self._count += 1
        self._frames.write(
            f"({self._clock.now():017.6f}) {CHANNEL} {frame.can_id:03X}#{frame.data.hex().upper()} {direction}\n"
        )

    def _state(self, **record: Any) -> None:
        self._states.write(json.dumps(record, allow_nan=False) + "\n")


def _numbers(values: NDArray[np.float64]) -> list[float | None]:
    """JSON has no NaN; a number that is missing is null."""
    return [float(value) if np.isfinite(value) else None for value in values]


def read_log(path: Path) -> Log:
    """Read a run back from its two files; a last line that was cut off by a crash is left out.

    Raises:
        LogError: A file is missing or is no log of ours.
    """
    frames = tuple(_frame(path, number, line) for number, line in enumerate(_lines(path), 1))
    records = []
    for number, line in enumerate(_lines(states_path(path)), 1):
        try:
            records.append(json.loads(line))
        except json.JSONDecodeError as error:
            raise LogError(f"{states_path(path)}, line {number} is not JSON: {error}.") from None
    try:
        header = records[0]
        if header["version"] != LOG_VERSION:
            raise LogError(f"{states_path(path)}: version must be {LOG_VERSION}, got {header['version']!r}.")
        return Log(
            bundle=parse_bundle(header["bundle"]),
            limits=Limits(**header["limits"]),
            schedule=Schedule(**header["schedule"]),
            bring_up=records[1]["bring_up"] if len(records) > 1 else 0,
            ticks=tuple(_tick(record) for record in records[2:]),
            frames=frames,
        )
    except (KeyError, TypeError, IndexError, BundleError) as error:
        raise LogError(f"{states_path(path)} is not the record of a run: {type(error).__name__} {error}.") from None


def _lines(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="ascii")
    except FileNotFoundError:
        raise LogError(f"{path} does not exist; a log is a frame file and a .jsonl file beside it.") from None
    except (UnicodeDecodeError, IsADirectoryError):
        raise LogError(f"{path} is not a text file; give the frame log that `deploy --log` wrote.") from None
    return text.split("\n")[:-1]


def _frame(path: Path, number: int, line: str) -> LoggedFrame:
    match = _LINE.fullmatch(line)
    if match is None:
        raise LogError(f"{path}, line {number} is not a frame: {line[:60]!r}.")
    frame = Frame(int(match[2], 16), bytes.fromhex(match[3]))
    return LoggedFrame(float(match[1]), frame, match[4] == "T")


def _tick(record: dict[str, Any]) -> LoggedTick:
    imu = None
    if record["gravity"] is not None:
        imu = (np.array(record["gravity"], dtype=np.float64), np.array(record["gyro"], dtype=np.float64))
    return LoggedTick(record["tick"], imu, record["overruns"], record["frames"])


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first frame that the program would now send differently."""

    tick: int  # -1 while the motors were brought up
    time: float  # [s]
    logged: Frame | None  # None: nothing was sent here
    recomputed: Frame

    def as_json(self, bundle: Bundle) -> dict[str, Any]:
        """Both frames, decoded where they are control frames, and the joint they are for."""
        names = {joint.can_id: joint.name for joint in bundle.joints}
        return {
            "tick": self.tick,
            "time": self.time,
            "joint": names.get(j60.split_id(self.recomputed.can_id)[2]),
            "logged": None if self.logged is None else _explain(self.logged),
            "recomputed": _explain(self.recomputed),
        }


def _explain(frame: Frame) -> dict[str, Any]:
    number, is_reply, _ = j60.split_id(frame.can_id)
    explained: dict[str, Any] = {"frame": f"{frame.can_id:03X}#{frame.data.hex().upper()}"}
    if number == j60.Code.CONTROL and not is_reply and len(frame.data) == j60.CONTROL_SIZE:
        explained |= asdict(j60.decode_command(frame.data))
    return explained


class _Diverged(Exception):
    def __init__(self, logged: LoggedFrame | None, recomputed: Frame, time: float) -> None:
        super().__init__(recomputed)
        self.logged, self.recomputed, self.time = logged, recomputed, time


class _PlayedPort:
    """Answers as the log says and compares what is sent with it."""

    def __init__(self, frames: Sequence[LoggedFrame]) -> None:
        self._frames = frames
        self.position = 0
        self.end = 0  # frames from here on belong to a later period

    def send(self, frame: Frame) -> None:
        logged = self._frames[self.position] if self.position < self.end else None
        if logged is None or not logged.sent or logged.frame != frame:
            time = self._frames[min(self.position, len(self._frames) - 1)].time if self._frames else 0.0
            raise _Diverged(logged if logged is not None and logged.sent else None, frame, time)
        self.position += 1

    def receive(self, timeout: float) -> Frame | None:  # noqa: ARG002 - what came in time is what the log has here.
        if self.position >= self.end or self._frames[self.position].sent:
            return None
        self.position += 1
        return self._frames[self.position - 1].frame

    def close(self) -> None:
        pass


class _StoppedClock:
    """Every deadline was kept or missed when the log was written."""

    def now(self) -> float:
        return 0.0

    def sleep_until(self, deadline: float) -> None:
        pass


def play_back(log: Log, bundle: Bundle | None = None) -> tuple[int, Divergence | None]:
    """Run the robot's program again on the logged replies and IMU readings.

    Args:
        log: What happened.
        bundle: Another bundle than the logged one, to see where it would have acted differently.

    Returns:
        How many frames agree, and the first that does not. Braking after an exception or an interrupt is not compared.
    """
    port, clock = _PlayedPort(log.frames), _StoppedClock()
    robot = Robot(MotorBus(port, clock), clock, bundle or log.bundle, log.limits, log.schedule)
    index = -1
    try:
        port.end = min(log.bring_up, len(log.frames))
        if port.end > 0:
            robot.bring_up()
        for tick in log.ticks:
            index, port.end = tick.index, min(tick.frames, len(log.frames))
            robot.tick(tick.index, tick.imu, tick.overruns)
    except _Diverged as diverged:
        logged = None if diverged.logged is None else diverged.logged.frame
        return port.position, Divergence(index, diverged.time, logged, diverged.recomputed)
    return port.position, None
