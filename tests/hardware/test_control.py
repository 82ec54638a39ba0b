from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hardware.control import drive, follow
from hardware.tick import Schedule, State, Tick

Make = Callable[..., Any]


class LateClock:
    """The simulated clock, but some periods take longer than they should."""

    def __init__(self, motors: Any, extra: dict[int, float]) -> None:
        self.motors, self.extra, self.calls = motors, extra, 0

    def now(self) -> float:
        return float(self.motors.now())

    def sleep_until(self, deadline: float) -> None:
        self.motors.sleep_until(deadline)

    def watch(self, tick: Tick) -> None:
        if tick.index in self.extra:
            self.motors.sleep_until(self.motors.now() + self.extra[tick.index])


def test_the_loop_keeps_its_deadlines_exactly(make_rig: Make) -> None:
    rig = make_rig()
    times: list[float] = []
    summary = drive(rig.robot, rig.motors, rig.motors.imu, watch=lambda _: times.append(rig.motors.now()))
    assert times == pytest.approx([i * 0.02 for i in range(len(times))], abs=1e-9)
    assert (summary.overruns, summary.worst_jitter, summary.worst_lateness) == (0, 0.0, 0.0)
    assert summary.ticks == len(times) == 5 + 1 + 100 + 25 + 50 + 50 + 1


def test_a_late_period_is_counted_and_does_not_shift_the_others(make_rig: Make) -> None:
    rig = make_rig()
    clock = LateClock(rig.motors, {50: 0.03, 60: 0.065})
    indices: list[int] = []

    def watch(tick: Tick) -> None:
        indices.append(tick.index)
        clock.watch(tick)

    summary = drive(rig.robot, clock, rig.motors.imu, watch=watch)
    assert summary.overruns == 2
    assert summary.worst_lateness == pytest.approx(0.045)
    assert {50, 51, 60, 63} <= set(indices)
    assert {61, 62}.isdisjoint(indices)  # left out: the policy's time stays true
    assert summary.trip is None
    assert indices[-1] == 231  # the run ends when it would have


def test_a_loop_that_is_always_late_is_stopped(make_rig: Make) -> None:
    rig = make_rig()
    clock = LateClock(rig.motors, dict.fromkeys(range(100, 400), 0.025))
    summary = drive(rig.robot, clock, rig.motors.imu, watch=clock.watch)
    assert summary.trip is not None
    assert (summary.trip.guard, summary.trip.value, summary.trip.bound) == ("overrun", 11.0, 10.0)
    assert summary.state is State.OFF


def test_without_an_imu_only_the_tilt_guard_is_lost(make_rig: Make) -> None:
    rig = make_rig(schedule=Schedule(policy=0.2))
    summary = drive(rig.robot, rig.motors)
    assert (summary.state, summary.trip) == (State.OFF, None)


def test_torque_figures_belong_to_the_policy(make_rig: Make) -> None:
    rig = make_rig()
    torques: list[Any] = []
    summary = drive(
        rig.robot,
        rig.motors,
        rig.motors.imu,
        watch=lambda tick: torques.append(abs(tick.torque).max()) if tick.state is State.POLICY else None,
    )
    assert summary.peak_torque == max(torques)
    assert 0.0 < summary.rms_torque < summary.peak_torque


@pytest.mark.parametrize("lag", [0, 1, 4])
def test_follow_finds_the_lag_and_what_is_left(lag: int) -> None:
    wave = np.sin(np.arange(200)[:, None] * 0.2 + np.array([0.0, 1.0]))
    found, left = follow(wave[lag:], wave[: len(wave) - lag] + 0.01)
    assert found == lag
    assert left == pytest.approx(0.01)


def test_follow_copes_with_a_single_period() -> None:
    assert follow(np.zeros((1, 2)), np.full((1, 2), 0.5)) == (0, 0.5)


def test_the_lag_of_a_run_is_what_its_gains_say(make_rig: Make) -> None:
    rig = make_rig(schedule=Schedule(policy=4.0))
    summary = drive(rig.robot, rig.motors, rig.motors.imu)
    assert summary.lag == pytest.approx(1.6 / 40.0, abs=0.021)  # kd / kp, to a period
    assert summary.aligned_rms is not None
    assert summary.tracking_rms is not None
    assert summary.aligned_rms < 0.3 * summary.tracking_rms
