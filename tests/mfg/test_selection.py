"""The laws of choice: what is chosen meets the need, nothing lighter does, and more need never takes less."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfg.catalogue import Battery, Motor
from mfg.library import read_library
from mfg.parts import PAPER
from mfg.robot_files import STALL_OVER_PEAK
from mfg.selection import (
    EMPTY,
    FULL,
    JointNeed,
    Margins,
    Needs,
    Selection,
    Unmet,
    available_torque,
    choose_battery,
    choose_controller,
    choose_motor,
    choose_wire,
    energy_need,
    mean_power,
    peak_current,
    resistance,
    select,
    strain,
    unmet,
)

LIBRARY = read_library()
ANY = Margins(drivers="any")
joint_needs = st.builds(
    JointNeed, st.just("joint_1"), st.floats(0.0, 40.0), st.floats(0.0, 12.0), st.floats(0.0, 12.0),
    st.floats(0.0, 30.0), st.floats(0.0, 6.0),
)  # fmt: skip
all_needs = st.builds(
    Needs, st.lists(joint_needs, min_size=1, max_size=6).map(tuple), st.floats(1.0, 4000.0), st.floats(0.2, 1.0)
)
policies = st.sampled_from(["only", "prefer", "any"]).map(lambda drivers: Margins(drivers=drivers))


def meets(motor: Motor, need: JointNeed, margin: float) -> bool:
    """The need by its definition, apart from `strain`."""
    line = STALL_OVER_PEAK * motor.peak_torque * (1 - need.speed / motor.max_speed)
    return (
        margin * need.peak_torque <= max(0.0, min(motor.peak_torque, line)) * (1 + 1e-12)
        and need.rms_torque <= motor.continuous_torque * (1 + 1e-12)
        and need.top_speed <= motor.max_speed * (1 + 1e-12)
    )


@given(all_needs, policies)
def test_the_chosen_motor_is_the_lightest_that_meets_every_need(needs: Needs, margins: Margins):
    spoken = [m for m in LIBRARY.motors if m.driver != "none"]
    able = [m for m in LIBRARY.motors if all(meets(m, n, margins.torque) for n in needs.joints)]
    pool = {"only": [m for m in able if m in spoken], "any": able,
            "prefer": [m for m in able if m in spoken] or able}[margins.drivers]  # fmt: skip
    chosen = choose_motor(needs.joints, LIBRARY.motors, margins)
    if isinstance(chosen, Unmet):
        assert pool == []
    else:
        assert chosen == min(pool, key=lambda m: (m.mass, m.name))


@given(all_needs, st.floats(1.0, 3.0), st.integers(0, 5))
def test_more_torque_never_chooses_a_lighter_motor_and_never_one_too_weak(needs: Needs, factor: float, which: int):
    which %= len(needs.joints)
    joint = needs.joints[which]
    grown = replace(joint, peak_torque=factor * joint.peak_torque, rms_torque=factor * joint.rms_torque)
    more = [*needs.joints[:which], grown, *needs.joints[which + 1 :]]
    before, after = choose_motor(needs.joints, LIBRARY.motors, ANY), choose_motor(more, LIBRARY.motors, ANY)
    if isinstance(before, Unmet):
        assert isinstance(after, Unmet)
    elif isinstance(after, Motor):
        assert after.mass >= before.mass
        assert available_torque(after, grown.speed) >= grown.peak_torque * ANY.torque * (1 - 1e-12)


@given(st.sampled_from(LIBRARY.motors), st.floats(0.0, 100.0), st.floats(0.0, 100.0))
def test_torque_falls_with_speed_from_the_peak_to_nothing(motor: Motor, a: float, b: float):
    low, high = sorted((a, b))
    assert motor.peak_torque >= available_torque(motor, low) >= available_torque(motor, high) >= 0.0
    assert available_torque(motor, 0.0) == motor.peak_torque
    assert available_torque(motor, motor.max_speed) == 0.0
    assert available_torque(motor, -low) == available_torque(motor, low)


def test_strain_is_one_at_each_limit():
    motor = PAPER.motor
    still = JointNeed("j", 0.0, 0.0, 0.0, 0.0, 0.0)
    assert strain(motor, still, 1.25) == 0.0
    assert strain(motor, replace(still, peak_torque=motor.peak_torque / 1.25), 1.25) == pytest.approx(1.0)
    assert strain(motor, replace(still, rms_torque=motor.continuous_torque), 1.25) == pytest.approx(1.0)
    assert strain(motor, replace(still, top_speed=motor.max_speed), 1.25) == pytest.approx(1.0)
    assert strain(motor, replace(still, peak_torque=1.0, speed=motor.max_speed), 1.25) == float("inf")


def test_a_miss_names_the_closest_motor_and_the_numbers():
    need = JointNeed("joint_3", 40.0, 1.0, 3.0, 4.0, 1.0)
    found = choose_motor([need], LIBRARY.motors, ANY)
    assert isinstance(found, Unmet)
    assert found.what == "motor"
    assert "joint_3 needs 50.0 N.m at 1.0 rad/s" in found.detail
    assert "J60-10, gives 30.5 N.m" in found.detail
    assert isinstance(choose_motor([need], [m for m in LIBRARY.motors if m.driver == "none"], Margins(drivers="only")),
                      Unmet)  # fmt: skip


@given(all_needs, st.sampled_from(LIBRARY.motors))
def test_the_chosen_battery_is_the_lightest_that_holds_the_energy(needs: Needs, motor: Motor):
    margins = Margins()

    def able(battery: Battery) -> bool:
        low, high = motor.voltage_range or (0.0, 0.0)
        hours = mean_power(motor, needs, margins) * needs.duration / 3600 / margins.usable
        return (
            low <= battery.voltage * EMPTY and battery.voltage * FULL <= high
            and hours <= battery.voltage * battery.capacity * (1 + 1e-12)
            and (battery.max_current or 0.0) * (1 + 1e-12) >= peak_current(motor, needs)
        )  # fmt: skip

    chosen = choose_battery(motor, needs, LIBRARY.batteries, margins)
    fit = [battery for battery in LIBRARY.batteries if able(battery)]
    if isinstance(chosen, Unmet):
        assert fit == []
        assert chosen.what == "battery"
    else:
        assert chosen == min(fit, key=lambda b: (b.mass, b.name))
        assert chosen.energy >= energy_need(motor, needs, margins)


def test_a_battery_beyond_the_motors_voltages_is_no_choice():
    needs = Needs((JointNeed("j", 1.0, 0.0, 0.1, 1.0, 0.1),), 60.0)
    tall = [replace(battery, voltage=44.4) for battery in LIBRARY.batteries]
    found = choose_battery(PAPER.motor, needs, tall, Margins())
    assert isinstance(found, Unmet)
    assert "from full to empty" in found.detail
    long = choose_battery(PAPER.motor, replace(needs, duration=1e6), LIBRARY.batteries, Margins())
    assert isinstance(long, Unmet)
    assert "6S LiPo 5000 mAh" in long.detail


def test_power_is_work_and_heat():
    motor = PAPER.motor
    need = JointNeed("j", 5.0, 1.0, 2.0, 3.0, 1.5)
    heat = resistance(motor) * (2.0 / motor.torque_constant) ** 2
    margins = Margins(idle=0.0, idle_motor=0.0)
    assert mean_power(motor, Needs((need,)), margins) == pytest.approx(2.0 * 1.5 + heat)
    assert mean_power(motor, Needs((need,)), Margins()) == pytest.approx(3.0 + heat + 6.0)
    # At stall torque all of the voltage drops at the winding.
    stall = STALL_OVER_PEAK * motor.peak_torque / motor.torque_constant
    assert resistance(motor) * stall == pytest.approx(motor.voltage)


def test_controllers_by_ids_and_wires_by_current():
    most = max(c.max_joints for c in LIBRARY.controllers)
    for joints in (1, 15, most):
        chosen = choose_controller(joints, LIBRARY.controllers)
        assert not isinstance(chosen, Unmet)
        assert chosen.max_joints >= joints
    assert isinstance(choose_controller(most + 1, LIBRARY.controllers), Unmet)
    currents = []
    for torque in (1.0, 5.0, 10.0, 17.0):
        wire = choose_wire(PAPER.motor, Needs((JointNeed("j", torque, 0.0, 0.0, 0.0, 0.0),)), LIBRARY.wires)
        assert not isinstance(wire, Unmet)
        currents.append(wire.max_current or 0.0)
        assert currents[-1] >= torque / PAPER.motor.torque_constant
    assert currents == sorted(currents)
    assert currents[0] < currents[-1]
    assert isinstance(
        choose_wire(PAPER.motor, Needs((JointNeed("j", 19.9, 0.0, 0.0, 0.0, 0.0),)), LIBRARY.wires), Unmet
    )


@given(all_needs, policies)
def test_a_selection_meets_its_own_needs_and_keeps_the_rest(needs: Needs, margins: Margins):
    found = select(needs, LIBRARY, PAPER, margins)
    if isinstance(found, Unmet):
        return
    assert isinstance(found, Selection)
    assert unmet(found.catalogue, needs, margins) is None
    for name in ("rigid", "soft", "printer", "joint_encoder"):
        assert getattr(found.catalogue, name) == getattr(PAPER, name)
    assert found.catalogue.name == "auto"
    assert len(found.alone) == len(needs.joints)
    by_name = {m.name: m for m in LIBRARY.motors}
    if margins.drivers != "prefer":
        assert all(by_name[name].mass <= found.catalogue.motor.mass for name in found.alone)


def test_what_is_preferred_can_be_driven():
    light = Needs((JointNeed("j", 2.0, 1.0, 0.5, 3.0, 1.0),), 60.0)
    found = {drivers: select(light, LIBRARY, PAPER, Margins(drivers=drivers)) for drivers in ("only", "prefer", "any")}
    motors = {d: f.catalogue.motor for d, f in found.items() if isinstance(f, Selection)}
    assert motors["only"].driver == motors["prefer"].driver == "j60"
    assert motors["any"].mass < motors["only"].mass
