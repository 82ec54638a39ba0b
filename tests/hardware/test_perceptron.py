"""A learned policy on the robot: it sees what the motors and the IMU say, and what it did plays back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policies import action_map, holding, oscillator, perceptron

from hardware.bundle import Bundle, load_bundle, save_bundle
from hardware.control import drive
from hardware.log import play_back, read_log
from hardware.tick import Schedule, State, Tick
from sim.actor import Policy

Make = Callable[..., Any]


def run(rig: Any, imu: bool = True) -> tuple[Any, list[Tick]]:
    ticks: list[Tick] = []
    journal = rig.journal
    if journal is None:
        return drive(rig.robot, rig.motors, rig.motors.imu if imu else None, watch=ticks.append), ticks
    with journal:
        return drive(rig.robot, rig.motors, rig.motors.imu, journal, ticks.append), ticks


def policy_of(ticks: list[Tick]) -> list[Tick]:
    return [tick for tick in ticks if tick.state is State.POLICY]


@pytest.mark.parametrize("actor", [holding(np.array([0.3, -0.3, 0.2])), oscillator(3)])
def test_a_bundle_that_was_saved_drives_and_plays_back(
    make_rig: Make, bundle: Bundle, tmp_path: Path, actor: Policy
) -> None:
    save_bundle(tmp_path / "policy", replace(bundle, actor=actor))
    rig = make_rig(load_bundle(tmp_path / "policy"), schedule=Schedule(policy=4.0), journal=tmp_path / "run.log")
    summary, ticks = run(rig)
    assert (summary.trip, summary.state) == (None, State.OFF)
    targets = np.array([tick.target for tick in policy_of(ticks)])
    if actor.layout.history == 1:
        np.testing.assert_allclose(targets[-1], [0.3, -0.3, 0.2], atol=1e-3)
        np.testing.assert_allclose(policy_of(ticks)[-1].position, [0.3, -0.3, 0.2], atol=0.02)
    else:
        assert np.ptp(targets[-75:], axis=0).min() > 0.15
    log = read_log(tmp_path / "run.log")
    assert play_back(log) == (len(log.frames), None)
    other = replace(log.bundle, actor=holding(np.zeros(3)))
    assert play_back(log, other)[1] is not None


def test_it_sees_exactly_what_the_ticks_say(make_rig: Make, bundle: Bundle) -> None:
    actor = perceptron(3, history=3, command=(0.2, 0.0, -0.1), actions=action_map(3, blend=0.4, step=0.05))
    seated = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])  # the IMU's x is the body's z
    _, ticks = run(make_rig(replace(bundle, actor=actor, R_link_imu=seated)))
    layout, seen, default = actor.layout, None, bundle.column("default")
    before = next(tick for tick in reversed(ticks) if tick.state is State.HOLD)
    low, high = bundle.column("range").T
    for tick in policy_of(ticks):
        assert tick.imu is not None
        gravity, gyro = tick.imu
        frame = layout.pack(seated @ gravity, seated @ gyro, tick.position, tick.velocity, before.target, actor.command)
        seen = layout.begin(frame) if seen is None else layout.push(seen, frame)
        seconds = (tick.index - policy_of(ticks)[0].index) * bundle.dt
        x = min(seconds / 0.5, 1.0)
        weight = x**3 * (10 - 15 * x + 6 * x * x)
        wanted = np.clip(actor.act(seconds, seen), low, high)
        np.testing.assert_allclose(tick.target, default + weight * (wanted - default), atol=1e-12)
        before = tick


def test_without_an_imu_it_is_stopped_before_it_says_anything(make_rig: Make, bundle: Bundle) -> None:
    summary, ticks = run(make_rig(replace(bundle, actor=oscillator(3))), imu=False)
    assert summary.trip is not None
    assert summary.trip.guard == "nan"
    np.testing.assert_array_equal(policy_of(ticks)[-1].target, bundle.column("default"))


def test_a_policy_that_overflows_is_stopped(make_rig: Make, bundle: Bundle) -> None:
    wide = perceptron(3, units=())
    size = wide.layout.size
    weight = 1e200 * np.resize([1.0, -1.0], size)[:, None] * np.ones(3)  # infinity less infinity
    wide = replace(wide, input_gain=np.full(size, 1e200), layers=((weight, np.zeros(3)),))
    summary, _ = run(make_rig(replace(bundle, actor=wide)))
    assert summary.trip is not None
    assert summary.trip.guard == "nan"
    assert summary.trip.as_json()["value"] is None


def test_a_policy_that_jumps_is_stopped_by_the_step_guard(make_rig: Make, bundle: Bundle) -> None:
    fast = perceptron(3, gain=50.0, actions=action_map(3, step=3.0, scale=np.full(3, 1.0), low=np.full(3, -1.0),
                                                       high=np.full(3, 1.0)))  # fmt: skip
    summary, _ = run(make_rig(replace(bundle, actor=fast), schedule=Schedule(policy=3.0)))
    assert summary.trip is not None
    assert summary.trip.guard in ("target_step", "velocity", "torque", "tracking")
