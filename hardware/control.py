"""The fixed-rate loop: absolute deadlines, lateness counted, every period written down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.bus import Clock
from hardware.log import Journal
from hardware.robot import Robot
from hardware.safety import Trip
from hardware.tick import Imu, State, Tick

GREATEST_LAG = 15  # that `follow` looks for [periods]


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a run came to."""

    ticks: int
    overruns: int  # periods that ended after their deadline
    worst_lateness: float  # of a period's end, 0 if none was late [s]
    worst_jitter: float  # of a period's start after its due time [s]
    tracking_rms: float | None  # between targets and measurements while the policy ran, None if it never did [rad]
    lag: float | None  # by which the measurements follow the targets, to a period [s]
    aligned_rms: float | None  # tracking error that is left when that lag is taken out [rad]
    peak_torque: float  # greatest measured while the policy ran [N.m]
    rms_torque: float  # of the hardest-working joint while the policy ran [N.m]
    state: State
    trip: Trip | None
    unconfirmed: tuple[int, ...]  # motors that did not confirm that they are off


class Interrupted(KeyboardInterrupt):
    """The operator ended a run; the motors are off, and `summary` says what came of it until then."""

    def __init__(self, summary: RunSummary) -> None:
        """Carry what there is."""
        super().__init__()
        self.summary = summary


def drive(
    robot: Robot,
    clock: Clock,
    imu: Callable[[], Imu] | None = None,
    journal: Journal | None = None,
    watch: Callable[[Tick], None] | None = None,
) -> RunSummary:
    """Run a robot from bring-up to off, one period after another.

    A period that ends late by whole periods makes the loop leave those out, so that the policy's time stays true.

    Args:
        robot: Not yet entered.
        clock: Real or simulated.
        imu: Reads the IMU, None without one.
        journal: Where every period is written down.
        watch: Called after every period.

    Raises:
        Interrupted: A KeyboardInterrupt came; the robot has braked and is off.
        MotorError: The bus is gone, or a motor is silent or faulty at bring-up. The motors have been told to be off.
    """
    dt = robot.bundle.dt
    ticks = overruns = row = index = 0
    worst_lateness = worst_jitter = 0.0
    targets, positions, errors, torques = [], [], [], []
    if journal is not None:
        journal.header(robot.bundle, robot.limits, robot.schedule)
    interrupt: KeyboardInterrupt | None = None
    try:
        with robot:
            if journal is not None:
                journal.brought_up()
            start = clock.now()
            while robot.state is not State.OFF:
                worst_jitter = max(worst_jitter, clock.now() - (start + index * dt))
                tick = robot.tick(index, None if imu is None else imu(), row)
                if journal is not None:
                    journal.tick(tick, row)
                if watch is not None:
                    watch(tick)
                if tick.state is State.POLICY:
                    targets.append(tick.target)
                    positions.append(tick.position)
                    errors.append(tick.position - tick.previous_target)
                    torques.append(tick.torque)
                ticks += 1
                index += 1
                lateness = clock.now() - (start + index * dt)
                if lateness > 0.0:
                    overruns, row = overruns + 1, row + 1
                    worst_lateness = max(worst_lateness, lateness)
                    index += int(lateness / dt)
                else:
                    row = 0
                clock.sleep_until(start + index * dt)
    except KeyboardInterrupt as caught:
        interrupt = caught
    lag, aligned = follow(np.array(targets), np.array(positions)) if targets else (None, None)
    summary = RunSummary(
        ticks=ticks,
        overruns=overruns,
        worst_lateness=worst_lateness,
        worst_jitter=worst_jitter,
        tracking_rms=_rms(np.array(errors)) if errors else None,
        lag=None if lag is None else lag * dt,
        aligned_rms=aligned,
        peak_torque=float(np.max(np.abs(torques))) if torques else 0.0,
        rms_torque=float(np.max(np.sqrt(np.mean(np.square(torques), axis=0)))) if torques else 0.0,
        state=robot.state,
        trip=robot.trip,
        unconfirmed=robot.unconfirmed,
    )
    if interrupt is not None:
        raise Interrupted(summary) from interrupt
    return summary


def follow(targets: NDArray[np.float64], positions: NDArray[np.float64]) -> tuple[int, float]:
    """Find the lag with the least root mean square of positions[t] - targets[t - lag], both (k, n).

    A motor with damping follows a moving target late, kd / kp seconds where nothing loads it; that is not a defect.

    Returns:
        The lag in periods, and the root mean square that is left [rad].
    """
    lags = range(min(GREATEST_LAG, len(targets) - 1) + 1)
    left = [_rms(positions[lag:] - targets[: len(targets) - lag]) for lag in lags]
    best = int(np.argmin(left))
    return best, left[best]


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
