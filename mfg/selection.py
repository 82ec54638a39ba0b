"""Choose parts by need: motor by torque, battery by current and energy, controller by ids, wire by current. Pure laws.

One motor model serves all joints of a robot (`Catalogue.motor`), so it must meet the need of every one of them; what
each joint alone would take is reported beside it. The winding's resistance follows from the motor's torque-speed line
as the simulator has it: R = voltage / (stall torque / torque constant).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from mfg.catalogue import Battery, Catalogue, Computer, Motor, Wire
from mfg.library import Library
from mfg.robot_files import STALL_OVER_PEAK

FULL, EMPTY = 4.2 / 3.7, 3.3 / 3.7  # voltage of a lithium cell when charged and when to stop, over its nominal one
Drivers = Literal["only", "prefer", "any"]


@dataclass(frozen=True, slots=True)
class JointNeed:
    """What one joint asks of its motor while it works.

    Attributes:
        name: of the joint.
        peak_torque: [N.m].
        speed: at which the peak torque is needed [rad/s].
        rms_torque: root mean square over the work [N.m].
        top_speed: that must be reached, at whatever torque [rad/s].
        rms_speed: root mean square over the work [rad/s].
    """

    name: str
    peak_torque: float
    speed: float
    rms_torque: float
    top_speed: float
    rms_speed: float


@dataclass(frozen=True, slots=True)
class Needs:
    """What a robot's work asks of its hardware.

    Attributes:
        joints: one need per joint.
        duration: of the work [s].
        together: greatest sum of all joints' torques at one time over the sum of their peaks, in (0, 1].
    """

    joints: tuple[JointNeed, ...]
    duration: float = 900.0
    together: float = 1.0


@dataclass(frozen=True, slots=True)
class Margins:
    """How much more than the need the parts must give, and which motors may be taken.

    Attributes:
        torque: peak torque that a motor must have over the one needed.
        usable: share of a battery's energy that is used (assumed: the rest ages it).
        idle: power of the controller [W] (assumed).
        idle_motor: power of one motor's electronics [W] (assumed).
        drivers: "only" takes motors that `hardware` can drive; "prefer" takes another one only where none of those
            meets the need; "any" takes the lightest.
    """

    torque: float = 1.25
    usable: float = 0.8
    idle: float = 5.0
    idle_motor: float = 1.0
    drivers: Drivers = "prefer"


@dataclass(frozen=True, slots=True)
class Unmet:
    """No part meets the need: a value, never an exception.

    Attributes:
        what: kind of part.
        detail: the need, the closest miss and what would mend it.
    """

    what: Literal["motor", "battery", "controller", "wire"]
    detail: str

    def __str__(self) -> str:
        """One line for people."""
        return f"no {self.what} meets the need: {self.detail}"


@dataclass(frozen=True, slots=True)
class Selection:
    """The parts chosen for a need.

    Attributes:
        catalogue: the base catalogue with the chosen parts.
        alone: name of the lightest motor that each joint alone would take.
        current: peak that the battery must give [A].
        power: mean that it must give [W].
        energy: that it must hold, its unusable rest included [J].
    """

    catalogue: Catalogue
    alone: tuple[str, ...]
    current: float
    power: float
    energy: float


def available_torque(motor: Motor, speed: float) -> float:
    """Torque at a speed [N.m]: min(peak, stall (1 - speed / no-load speed)), not below 0; the simulator's own line."""
    line = STALL_OVER_PEAK * motor.peak_torque * (1.0 - abs(speed) / motor.max_speed)
    return max(0.0, min(motor.peak_torque, line))


def strain(motor: Motor, need: JointNeed, margin: float) -> float:
    """Greatest ratio of need to ability; the motor meets the need where it is at most 1.

    The three ratios: margin times peak torque over the torque available at its speed, rms over continuous torque, top
    speed over no-load speed.
    """
    peak, available = margin * need.peak_torque, available_torque(motor, need.speed)
    of_peak = 0.0 if peak <= 0.0 else peak / available if available > 0.0 else float("inf")
    return max(of_peak, need.rms_torque / motor.continuous_torque, need.top_speed / motor.max_speed)


def choose_motor(needs: Sequence[JointNeed], motors: Iterable[Motor], margins: Margins) -> Motor | Unmet:
    """The lightest motor that meets every one of the needs (of equals the first by name)."""
    spoken = [motor for motor in motors if motor.driver != "none"]
    others = [motor for motor in motors if motor.driver == "none"]
    pools = {"only": [spoken], "prefer": [spoken, others], "any": [spoken + others]}[margins.drivers]
    for pool in pools:
        for motor in sorted(pool, key=lambda m: (m.mass, m.name)):
            if all(strain(motor, need, margins.torque) <= 1.0 for need in needs):
                return motor
    tried = [motor for pool in pools for motor in pool]
    if not tried:
        return Unmet("motor", "there is no motor to choose from that this program can drive; allow others or add one")
    best = min(tried, key=lambda m: (max(strain(m, need, margins.torque) for need in needs), m.name))
    worst = max(needs, key=lambda need: strain(best, need, margins.torque))
    return Unmet(
        "motor",
        f"{worst.name} needs {margins.torque * worst.peak_torque:.1f} N.m at {worst.speed:.1f} rad/s, "
        f"{worst.rms_torque:.1f} N.m rms and {worst.top_speed:.1f} rad/s; the closest, {best.name}, gives "
        f"{available_torque(best, worst.speed):.1f} N.m, {best.continuous_torque:.1f} N.m and {best.max_speed:.1f} "
        "rad/s; a lighter robot, a gentler gait or a stronger motor would mend it",
    )


def resistance(motor: Motor) -> float:
    """Of the winding, from the torque-speed line [ohm]: voltage over the current at stall."""
    return motor.voltage * motor.torque_constant / (STALL_OVER_PEAK * motor.peak_torque)


def peak_current(motor: Motor, needs: Needs) -> float:
    """Peak that the battery must give [A]: together * sum over joints of peak torque / torque constant.

    The driver steps the battery's voltage down, so the battery gives no more than what flows in the winding.
    """
    return needs.together * sum(joint.peak_torque for joint in needs.joints) / motor.torque_constant


def mean_power(motor: Motor, needs: Needs, margins: Margins) -> float:
    """Mean that the battery must give [W], braking not recovered.

    Sum over joints of rms torque * rms speed (no mean of a product is greater) and R (rms torque / torque constant)^2,
    and what the electronics take.
    """
    k, R = motor.torque_constant, resistance(motor)
    work = sum(joint.rms_torque * joint.rms_speed + R * (joint.rms_torque / k) ** 2 for joint in needs.joints)
    return work + margins.idle + margins.idle_motor * len(needs.joints)


def energy_need(motor: Motor, needs: Needs, margins: Margins) -> float:
    """Energy that the battery must hold [J]: mean power * duration / usable share."""
    return mean_power(motor, needs, margins) * needs.duration / margins.usable


def choose_battery(motor: Motor, needs: Needs, batteries: Iterable[Battery], margins: Margins) -> Battery | Unmet:
    """The lightest battery within the motor's voltages, full and empty, that gives the current and holds the energy."""
    current, energy = peak_current(motor, needs), energy_need(motor, needs, margins)
    misses: list[tuple[float, Battery]] = []
    for battery in sorted(batteries, key=lambda b: (b.mass, b.name)):
        if not suits(battery, motor):
            continue
        lack = max(energy / battery.energy, current / battery.max_current if battery.max_current else 0.0)
        if lack <= 1.0:
            return battery
        misses.append((lack, battery))
    if not misses:
        low, high = motor.voltage_range or (motor.voltage, motor.voltage)
        return Unmet("battery", f"none stays within the {low:g} to {high:g} V of {motor.name} from full to empty")
    _, best = min(misses, key=lambda miss: (miss[0], miss[1].name))
    gives = "an unstated current" if best.max_current is None else f"{best.max_current:.0f} A"
    return Unmet(
        "battery",
        f"{current:.0f} A and {energy / 3600:.1f} W.h for {needs.duration:.0f} s; the closest, {best.name}, gives "
        f"{gives} and {best.energy / 3600:.1f} W.h; a shorter duration or a larger pack would mend it",
    )


def suits(battery: Battery, motor: Motor) -> bool:
    """Whether a battery stays within a motor's voltages from full to empty; a motor that states none takes 25 % off."""
    low, high = motor.voltage_range or (0.75 * motor.voltage, 1.25 * motor.voltage)
    return low <= EMPTY * battery.voltage and FULL * battery.voltage <= high


def choose_controller(joints: int, controllers: Iterable[Computer]) -> Computer | Unmet:
    """The lightest controller that can address so many motors."""
    able = controllers_for(joints, controllers)
    if able:
        return able[0]
    most = max((c.max_joints for c in controllers), default=0)
    return Unmet("controller", f"{joints} joints, the controllers address {most} at most")


def controllers_for(joints: int, controllers: Iterable[Computer]) -> list[Computer]:
    """All controllers that can address so many motors, lightest first."""
    return sorted((c for c in controllers if c.max_joints >= joints), key=lambda c: (c.mass, c.name))


def choose_wire(motor: Motor, needs: Needs, wires: Iterable[Wire]) -> Wire | Unmet:
    """The lightest wire that bears the peak current of every motor, one cable each; an unstated limit bears none."""
    current = max((joint.peak_torque for joint in needs.joints), default=0.0) / motor.torque_constant
    for wire in sorted(wires, key=lambda w: (w.mass_per_metre, w.name)):
        if wire.max_current is not None and wire.max_current >= current:
            return wire
    most = max((wire.max_current or 0.0 for wire in wires), default=0.0)
    return Unmet("wire", f"a motor takes {current:.1f} A, the wires bear {most:.1f} A at most; add a thicker one")


def select(needs: Needs, library: Library, base: Catalogue, margins: Margins | None = None) -> Selection | Unmet:
    """Choose motor, battery, controller and wire, in this order; filaments, printer and encoder stay the base's."""
    margins = margins or Margins()
    motor = choose_motor(needs.joints, library.motors, margins)
    if isinstance(motor, Unmet):
        return motor
    battery = choose_battery(motor, needs, library.batteries, margins)
    if isinstance(battery, Unmet):
        return battery
    controller = choose_controller(len(needs.joints), library.controllers)
    if isinstance(controller, Unmet):
        return controller
    wire = choose_wire(motor, needs, library.wires)
    if isinstance(wire, Unmet):
        return wire
    single = [choose_motor([need], library.motors, margins) for need in needs.joints]
    catalogue = replace(base, name="auto", motor=motor, battery=battery, computer=controller, wire=wire)
    return Selection(
        catalogue, tuple(m.name if isinstance(m, Motor) else "none" for m in single), peak_current(motor, needs),
        mean_power(motor, needs, margins), energy_need(motor, needs, margins),
    )  # fmt: skip


def unmet(catalogue: Catalogue, needs: Needs, margins: Margins | None = None) -> Unmet | None:
    """What need the parts of a catalogue do not meet, or None if they meet all."""
    margins = margins or Margins()
    own = Library((catalogue.motor,), (catalogue.computer,), (catalogue.battery,), (catalogue.wire,))
    found = select(needs, own, catalogue, replace(margins, drivers="any"))
    return found if isinstance(found, Unmet) else None
