from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware import j60
from hardware.bundle import Bundle, BundleError
from hardware.bus import BusUnavailable, Frame, MotorFault, MotorSilent
from hardware.control import drive
from hardware.j60 import Code
from hardware.tick import Schedule, State, Tick
from hardware.virtual import Imperfection
from sim.actor import smooth_step
from sim.observation import ObservationLayout

Make = Callable[..., Any]


class Broken:
    """An actor that gives up after a while, in the way that it is told."""

    num_joints = 3
    layout = ObservationLayout(3)

    def __init__(self, after: float, outcome: Any) -> None:
        self.after, self.outcome = after, outcome

    def act(self, time: float, observation: Any) -> Any:  # noqa: ARG002
        if time < self.after:
            return np.array([0.1, -0.2, 0.1])
        if isinstance(self.outcome, BaseException):
            raise self.outcome
        return self.outcome


def broken(bundle: Bundle, after: float, outcome: Any) -> Bundle:
    return replace(bundle, actor=Broken(after, outcome))


def limp(rig: Any) -> bool:
    return not any(node.enabled for node in rig.motors.nodes)


def run(rig: Any, before_tick: Callable[[Tick], None] | None = None) -> tuple[Any, list[Tick]]:
    ticks: list[Tick] = []

    def watch(tick: Tick) -> None:
        ticks.append(tick)
        if before_tick is not None:
            before_tick(tick)

    return drive(rig.robot, rig.motors, rig.motors.imu, watch=watch), ticks


def test_a_whole_run_goes_down_the_one_way_road(make_rig: Make) -> None:
    rig = make_rig()
    summary, ticks = run(rig)
    road = [tick.state for i, tick in enumerate(ticks) if i == 0 or tick.state is not ticks[i - 1].state]
    assert road == list(State)
    assert (summary.state, summary.trip, summary.overruns, summary.unconfirmed) == (State.OFF, None, 0, ())
    assert sum(tick.state is State.POLICY for tick in ticks) == 50
    assert limp(rig)
    assert rig.motors.nodes[0].can_timeout == 100  # five periods


def test_the_ramp_starts_where_the_joints_are_without_a_kick(make_rig: Make) -> None:
    rig = make_rig()
    _, ticks = run(rig)
    ramp = [tick for tick in ticks if tick.state is State.RAMP]
    np.testing.assert_allclose(ramp[0].target, [0.5, -0.6, 0.3], atol=1e-3)
    assert np.abs([tick.torque for tick in ramp[:3]]).max() < 0.3
    speeds = np.abs(np.diff([tick.target for tick in ramp], axis=0)) / 0.02
    assert speeds.max() < 1.0
    hold = [tick for tick in ticks if tick.state is State.HOLD]
    np.testing.assert_allclose(hold[-1].position, [0.1, -0.2, 0.1], atol=0.01)


def test_a_far_pose_makes_the_ramp_longer_not_faster(make_rig: Make, bundle: Bundle) -> None:
    wide = tuple(replace(j, range=(-6.0, 6.0), default=5.0 if j.name == "hip" else j.default) for j in bundle.joints)
    rig = make_rig(replace(bundle, joints=wide))
    _, ticks = run(rig)
    ramp = [tick.target for tick in ticks if tick.state is State.RAMP]
    speeds = np.abs(np.diff(ramp, axis=0)) / 0.02
    assert 0.95 < speeds.max() <= 1.0


def test_joints_follow_the_gait_within_range_through_the_wire(make_rig: Make, bundle: Bundle) -> None:
    rig = make_rig(schedule=Schedule(policy=3.0))
    summary, ticks = run(rig)
    policy = [tick for tick in ticks if tick.state is State.POLICY]
    assert summary.tracking_rms < 0.08
    after_blend = policy[30]
    expected = bundle.actor.targets((after_blend.index - policy[0].index) * 0.02)
    np.testing.assert_allclose(after_blend.target, expected, rtol=1e-12)
    assert np.abs([tick.target for tick in policy]).max() <= 1.2
    assert np.std([tick.position[1] for tick in policy]) > 0.1  # it did move


def test_targets_stay_in_range_and_pass_the_low_pass(make_rig: Make, bundle: Bundle) -> None:
    narrow = tuple(replace(joint, range=(-0.3, 0.55)) for joint in bundle.joints)
    rig = make_rig(replace(bundle, joints=narrow, time_constant=0.1))
    rig.plant.joint_positions = np.array([0.5, -0.2, 0.3])
    summary, ticks = run(rig)
    targets = np.array([tick.target for tick in ticks if tick.state is State.POLICY])
    assert summary.trip is None
    assert targets.min() >= -0.3
    assert targets.max() <= 0.55
    steps = np.abs(np.diff(targets, axis=0)).max()
    assert steps <= (1 - np.exp(-0.02 / 0.1)) * 0.85


def test_gains_off_the_wires_grid_are_refused(make_rig: Make, bundle: Bundle) -> None:
    joints = (replace(bundle.joints[0], kd=0.5), *bundle.joints[1:])
    with pytest.raises(BundleError, match=r"'hip': the wire makes kp 40, kd 0\.5 into kp 40, kd 0\.4"):
        make_rig(replace(bundle, joints=joints))


def test_a_missing_motor_stops_the_bring_up_and_leaves_all_off(make_rig: Make) -> None:
    rig = make_rig()
    rig.motors.nodes[1].present = False
    with pytest.raises(MotorSilent, match="Motor 7 gave no reply to STATUS_WORD"):
        run(rig)
    assert limp(rig)
    assert rig.robot.state is State.OFF
    assert rig.robot.unconfirmed == (7,)


def test_old_faults_are_cleared_and_lasting_ones_refused(make_rig: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = make_rig()
    rig.motors.nodes[0].faults = j60.Fault.CAN_TIMEOUT
    assert run(rig)[0].trip is None
    again = make_rig()
    again.motors.nodes[2].faults = j60.Fault.UNDER_VOLTAGE
    answer = again.motors._answer
    monkeypatch.setattr(again.motors, "_answer", lambda i, n, d: b"\x00" if n == Code.ERROR_RESET else answer(i, n, d))
    with pytest.raises(MotorFault, match=r"Motor 1 reports .*UNDER_VOLTAGE"):
        run(again)


def test_a_watchdog_that_is_not_kept_is_refused(make_rig: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Public drivers trust the factory setting, which nobody has published."""
    rig = make_rig()
    answer = rig.motors._answer
    monkeypatch.setattr(
        rig.motors, "_answer", lambda i, n, d: b"\x00" if n == Code.SET_CAN_TIMEOUT else answer(i, n, d)
    )
    with pytest.raises(MotorFault, match="keeps a CAN timeout of 0 ms, told 100 ms"):
        run(rig)


def test_scattered_drops_are_survived(make_rig: Make) -> None:
    rig = make_rig(imperfection=Imperfection(drop=0.03))
    summary, _ = run(rig)
    assert (summary.state, summary.trip) == (State.OFF, None)


def test_a_cut_wire_latches_the_reply_age_and_the_rest_brakes(make_rig: Make) -> None:
    """A public driver goes on with the last state it heard, for ever."""
    rig = make_rig()

    def cut(tick: Tick) -> None:
        if tick.state is State.POLICY:
            rig.motors.nodes[1].present = False

    summary, ticks = run(rig, cut)
    assert (summary.trip.guard, summary.trip.joint, summary.trip.bound) == ("reply_age", "knee", 0.1)
    assert summary.trip.value == pytest.approx(0.12)
    assert ticks[-1].state is State.OFF
    assert sum(tick.state is State.DAMPING for tick in ticks) == 49  # after the period that latched
    assert summary.unconfirmed == (7,)
    assert not rig.motors.nodes[0].enabled
    # The one that heard nothing more stopped itself.
    assert rig.motors.nodes[1].faults == j60.Fault.CAN_TIMEOUT


def test_a_latched_guard_stays_latched_when_its_cause_goes(make_rig: Make) -> None:
    rig = make_rig()

    def heat(tick: Tick) -> None:
        rig.motors.nodes[2].motor_temperature = 120.0 if tick.index in (150, 151) else 30.0

    summary, ticks = run(rig, heat)
    assert (summary.trip.guard, summary.trip.joint) == ("temperature", "ankle")
    assert {tick.state for tick in ticks if tick.index > 152} == {State.DAMPING, State.OFF}


def test_a_motor_fault_is_noticed_in_the_status_word(make_rig: Make) -> None:
    rig = make_rig()

    def fail(tick: Tick) -> None:
        if tick.index == 140:
            rig.motors.nodes[0].faults = j60.Fault.OVER_CURRENT

    summary, ticks = run(rig, fail)
    assert (summary.trip.guard, summary.trip.joint, summary.trip.value) == ("fault", "hip", 4.0)
    assert next(tick.index for tick in ticks if tick.trip) <= 143


def test_a_jammed_joint_is_a_stall(make_rig: Make, bundle: Bundle) -> None:
    rig = make_rig(broken(bundle, 0.2, np.array([1.1, -0.2, 0.1])), schedule=Schedule(policy=3.0))

    def jam(tick: Tick) -> None:
        if tick.state is State.HOLD:
            rig.plant.jammed = True
            rig.plant.joint_velocities = np.zeros(3)

    summary, _ = run(rig, jam)
    assert (summary.trip.guard, summary.trip.joint) == ("tracking", "hip")
    assert summary.peak_torque <= 19.95  # and it never asked for more than the motor has


def test_a_hot_motor_is_stiff_no_more_and_goes_on(make_rig: Make) -> None:
    rig = make_rig()
    stiffness: list[float] = []

    def heat(tick: Tick) -> None:
        rig.motors.nodes[2].motor_temperature = 95.0
        if tick.state is State.POLICY:
            stiffness.extend(node.latch.kp for node in rig.motors.nodes)

    summary, _ = run(rig, heat)
    assert summary.trip is None
    assert {*stiffness[0::3], *stiffness[1::3]} == {40.0}
    assert all(18.0 <= kp <= 22.0 for kp in stiffness[2::3])  # halfway between the two temperatures


def test_falling_over_latches_the_tilt(make_rig: Make) -> None:
    rig = make_rig()

    def fall(tick: Tick) -> None:
        if tick.index == 160:
            rig.plant.gravity = np.array([1.0, 0.0, 0.0])

    summary, _ = run(rig, fall)
    assert (summary.trip.guard, summary.trip.joint) == ("tilt", None)
    assert summary.trip.value == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("outcome", "guard"), [(np.array([0.0, np.nan, 0.0]), "nan"), (np.array([-1.2, -0.2, 0.1]), "target_step")]
)
def test_a_bad_action_is_never_sent(make_rig: Make, bundle: Bundle, outcome: Any, guard: str) -> None:
    rig = make_rig(broken(bundle, 0.7, outcome))
    summary, ticks = run(rig)
    assert summary.trip.guard == guard
    assert np.isfinite([tick.target for tick in ticks]).all()
    assert np.abs(ticks[-1].target - [0.1, -0.2, 0.1]).max() < 0.01
    assert limp(rig)


@pytest.mark.parametrize("error", [ZeroDivisionError("policy"), KeyboardInterrupt(), SystemExit(1)])
def test_an_exception_in_the_policy_brakes_repeatedly_and_switches_off(
    make_rig: Make, bundle: Bundle, error: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A public stack sends damping once, and not at all on an exception."""
    rig = make_rig(broken(bundle, 0.5, error))
    sent: list[Frame] = []
    send = rig.port.send
    monkeypatch.setattr(rig.port, "send", lambda frame: (sent.append(frame), send(frame))[1])
    with pytest.raises(type(error)):
        run(rig)
    assert limp(rig)
    assert rig.robot.state is State.OFF
    hip = [frame for frame in sent if frame.can_id == j60.request_id(Code.CONTROL, 3)]
    last = [j60.decode_command(frame.data) for frame in hip[-51:]]
    assert {(c.kp, c.kd) for c in last[:50]} == {(0.0, 2.0)}  # a second of braking
    assert (last[50].kp, last[50].kd) == (0.0, 0.0)  # what the motor remembers is harmless
    assert [f.can_id for f in sent[-3:]] == [j60.request_id(Code.DISABLE, motor) for motor in (3, 7, 1)]
    assert all(any(frame.data) for frame in hip)  # never all-zero bytes


def test_a_bus_that_dies_and_comes_back_still_gets_the_motors_off(
    make_rig: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    send, dead = rig.port.send, [False]

    def flaky(frame: Frame) -> None:
        if dead[0] and rig.motors.now() < 3.5:
            raise BusUnavailable("adapter unplugged")
        send(frame)

    monkeypatch.setattr(rig.port, "send", flaky)

    def unplug(tick: Tick) -> None:
        dead[0] = tick.state is State.POLICY

    with pytest.raises(BusUnavailable, match="unplugged"):
        run(rig, unplug)
    assert limp(rig)
    assert rig.robot.unconfirmed == ()


def test_shutting_down_twice_is_shutting_down_once(make_rig: Make) -> None:
    rig = make_rig()
    run(rig)
    time = rig.motors.now()
    rig.robot.shut_down()
    assert rig.motors.now() == time


def test_smooth_step_is_smooth_and_monotonic() -> None:
    x = np.linspace(-0.5, 1.5, 401)
    y = np.array([smooth_step(float(v)) for v in x])
    assert (y[x <= 0] == 0.0).all()
    assert (y[x >= 1] == 1.0).all()
    assert (np.diff(y) >= 0).all()
    assert np.abs(np.diff(y)).max() <= 15 / 8 * (x[1] - x[0]) + 1e-12
