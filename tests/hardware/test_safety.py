import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware import safety
from hardware.bundle import Bundle, JointSetup
from hardware.safety import DEFAULT_LIMITS, Sample
from sim.actor import Gait

PEAK = 19.94
BUNDLE = Bundle(
    "design",
    tuple(
        JointSetup(name, i, 1, (-1.2, 1.2), 0.0, 40.0, 1.6, PEAK, PEAK / 3, 24.18)
        for i, name in enumerate(("hip", "knee", "ankle"))
    ),
    Gait(1.0, np.zeros(3), np.zeros(3), np.zeros(3)),
    0.02,
)
finite = st.floats(-30.0, 30.0)


def calm(**changes: Any) -> Sample:
    zero = np.zeros(3)
    sample = Sample(zero, zero, zero, np.full(3, 30.0), zero, np.zeros(3, dtype=np.int64), 0, 0.1)
    return replace(sample, **changes)


def at(index: int, value: float, n: int = 3) -> Any:
    vector = np.zeros(n)
    vector[index] = value
    return vector


def test_calm_trips_nothing() -> None:
    assert safety.check_sample(calm(), BUNDLE, DEFAULT_LIMITS) is None
    assert safety.check_sample(calm(tilt=None), BUNDLE, DEFAULT_LIMITS) is None


@pytest.mark.parametrize(
    ("changes", "guard", "joint", "value", "bound"),
    [
        ({"position": at(1, 1.4)}, "position", "knee", 1.4, 1.35),
        ({"position": at(1, -1.4)}, "position", "knee", -1.4, -1.35),
        ({"velocity": at(2, -27.0)}, "velocity", "ankle", 27.0, 1.1 * 24.18),
        ({"torque": at(0, -25.0)}, "torque", "hip", 25.0, 1.1 * PEAK),
        ({"temperature": at(1, 111.0)}, "temperature", "knee", 111.0, 110.0),
        ({"age": at(0, 0.12)}, "reply_age", "hip", 0.12, 0.1),
        ({"faults": at(2, 32).astype(int)}, "fault", "ankle", 32.0, 0.0),
        ({"tilt": 1.5}, "tilt", None, 1.5, 1.4),
        ({"overruns": 11}, "overrun", None, 11.0, 10.0),
    ],
)
def test_each_guard_names_joint_value_and_bound(
    changes: dict[str, Any], guard: str, joint: str | None, value: float, bound: float
) -> None:
    trip = safety.check_sample(calm(**changes), BUNDLE, DEFAULT_LIMITS)
    assert trip is not None
    assert (trip.guard, trip.joint) == (guard, joint)
    assert (trip.value, trip.bound) == pytest.approx((value, bound))
    assert set(trip.as_json()) == {"guard", "joint", "value", "bound"}


@pytest.mark.parametrize(
    ("name", "just"),
    [("position", 1.349), ("velocity", 26.5), ("torque", 21.9), ("temperature", 109.9), ("age", 0.1)],
)
def test_guards_hold_still_up_to_their_bound(name: str, just: float) -> None:
    assert safety.check_sample(calm(**{name: at(0, just)}), BUNDLE, DEFAULT_LIMITS) is None


@pytest.mark.parametrize("name", ["position", "velocity", "torque", "temperature", "age"])
def test_nan_trips_every_guard_and_is_valid_json(name: str) -> None:
    trip = safety.check_sample(calm(**{name: at(1, np.nan)}), BUNDLE, DEFAULT_LIMITS)
    assert trip is not None
    assert trip.joint == "knee"
    assert json.dumps(trip.as_json(), allow_nan=False)


def test_nan_tilt_and_nan_actions_trip() -> None:
    trip = safety.check_sample(calm(tilt=np.nan), BUNDLE, DEFAULT_LIMITS)
    assert trip is not None
    assert trip.guard == "tilt"
    action = safety.check_action(np.array([0.0, np.inf, 0.0]), BUNDLE.names)
    assert action is not None
    assert (action.guard, action.joint) == ("nan", "knee")
    assert safety.check_action(np.zeros(3), BUNDLE.names) is None


def test_a_target_may_not_outrun_the_motor() -> None:
    bound = 24.18 * 0.02
    assert safety.check_step(at(0, 0.99 * bound), np.zeros(3), BUNDLE, 0.02) is None
    trip = safety.check_step(at(0, -1.01 * bound), np.zeros(3), BUNDLE, 0.02)
    assert trip is not None
    assert (trip.guard, trip.joint) == ("target_step", "hip")
    assert safety.check_step(at(0, 1.01 * bound), np.zeros(3), BUNDLE, 0.04) is None


def test_only_an_unbroken_error_is_a_stall() -> None:
    seconds = np.zeros(3)
    target = at(2, 0.7)
    for period in range(24):
        position = target if period == 12 else np.zeros(3)
        seconds, trip = safety.check_stall(seconds, target, position, BUNDLE, DEFAULT_LIMITS)
        assert trip is None
    trips = []
    for _ in range(15):
        seconds, trip = safety.check_stall(seconds, target, np.zeros(3), BUNDLE, DEFAULT_LIMITS)
        trips.append(trip)
    assert trips.index(next(t for t in trips if t)) == 13  # 11 + 14 periods of 20 ms are 0.5 s
    assert trips[-1] is not None
    assert (trips[-1].guard, trips[-1].joint, trips[-1].value) == ("tracking", "ankle", pytest.approx(0.7))


def test_stiffness_fades_between_the_two_temperatures() -> None:
    share = safety.derating(np.array([20.0, 80.0, 95.0, 110.0, 130.0]), DEFAULT_LIMITS)
    np.testing.assert_allclose(share, [1, 1, 0.5, 0, 0])


@given(st.lists(finite, min_size=3, max_size=3), st.lists(finite, min_size=3, max_size=3), finite)
def test_no_command_asks_for_more_than_peak_torque_and_none_is_reversed(
    target: list[float], position: list[float], speed: float
) -> None:
    want, q, qd = np.array(target), np.array(position), np.full(3, speed)
    safe = safety.within_torque(want, q, qd, BUNDLE)
    asked = 40.0 * (safe - q) - 1.6 * qd
    assert (np.abs(asked) <= PEAK + 1e-9).all()
    wanted = 40.0 * (want - q) - 1.6 * qd
    np.testing.assert_allclose(asked, np.clip(wanted, -PEAK, PEAK), atol=1e-9)


def test_angle_between_directions() -> None:
    down = np.array([0.0, 0.0, -1.0])
    assert safety.angle_between(down, down) == 0.0
    assert safety.angle_between(down, -down) == pytest.approx(np.pi)
    assert safety.angle_between(down, np.array([1.0, 0.0, 0.0])) == pytest.approx(np.pi / 2)
    assert np.isnan(safety.angle_between(down, np.zeros(3)))
    assert np.isnan(safety.angle_between(down, np.array([np.nan, 0, 0])))
