"""Component types: what a robot is made of, in SI units.

The paper's components are in `mfg.parts`, those to choose from in `mfg/components/*.toml` (see `mfg.library`).
A field with a default came later; a manifest leaves it out where it is at its default, so that older ones still hold.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mfg.component_looks import Looks

Range = tuple[float, float]  # least and greatest
Size = tuple[float, float, float]  # full extents along the component's own x, y, z [m]


@dataclass(frozen=True, slots=True)
class ScrewPattern:
    """Equal holes on a circle about the motor axis."""

    count: int
    circle_radius: float  # from the axis to the hole centres [m]
    hole_diameter: float  # clearance hole [m]
    head_diameter: float  # screw head and driver access [m]
    screw: str  # for the bill of materials, e.g. "M4x10"


@dataclass(frozen=True, slots=True)
class Motor:
    """A geared joint motor: a cylinder about its axis (z), output face on top, mounting face at the bottom."""

    name: str
    diameter: float  # [m]
    length: float  # along the axis [m]
    mass: float  # [kg]
    peak_torque: float  # [N.m]
    continuous_torque: float  # [N.m]
    max_speed: float  # no-load output speed [rad/s]
    voltage: float  # nominal [V]
    torque_constant: float  # at the output [N.m/A]
    armature: float  # rotor inertia seen at the output [kg.m2]
    friction: float  # dry friction at the output [N.m]
    stiffness: float  # kp that the wire sends [N.m/rad]
    damping: float  # kd that the wire sends [N.m.s/rad]
    latency: float  # command to torque [s]
    body_screws: ScrewPattern
    output_screws: ScrewPattern
    source: str
    voltage_range: Range | None = None  # that it runs on [V]; None: not stated
    driver: str = "j60"  # wire format that `hardware` must speak to drive it; "none": this program does not speak it
    looks: Looks | None = field(default=None, compare=False, repr=False)  # for pictures, in the motor's frame


@dataclass(frozen=True, slots=True)
class Device:
    """An electronic part that shares the controller box."""

    name: str
    size: Size
    mass: float  # [kg]
    source: str


@dataclass(frozen=True, slots=True)
class Computer:
    """The controller box: one printed-in cavity that holds the devices; the IMU sits at its centre."""

    name: str
    size: Size
    devices: tuple[Device, ...]
    source: str
    max_joints: int = 15  # motors that its bus can address
    looks: Looks | None = field(default=None, compare=False, repr=False)  # for pictures, centred on the box

    @property
    def mass(self) -> float:
        """Sum over the devices [kg]."""
        return sum(device.mass for device in self.devices)


@dataclass(frozen=True, slots=True)
class Battery:
    """A rechargeable pack."""

    name: str
    size: Size
    mass: float  # [kg]
    voltage: float  # nominal [V]
    capacity: float  # [A.h]
    source: str
    max_current: float | None = None  # that it gives for long [A]; None: not stated
    looks: Looks | None = field(default=None, compare=False, repr=False)  # for pictures, centred on the box

    @property
    def energy(self) -> float:
        """Nominal voltage times capacity [J]."""
        return self.voltage * self.capacity * 3600.0


@dataclass(frozen=True, slots=True)
class Wire:
    """A cable as routed: power pair and CAN pair in one sleeve."""

    name: str
    diameter: float  # of the sleeve [m]
    mass_per_metre: float  # [kg/m]
    bend_radius: float  # least [m]
    source: str
    max_current: float | None = None  # through its power pair for long [A]; None: not stated


@dataclass(frozen=True, slots=True)
class Filament:
    """A printed material with the settings that give it its role."""

    name: str
    density: float  # solid [kg/m3]
    youngs_modulus: float  # solid [Pa]
    walls: int  # perimeters
    infill: float  # share of the inside that is filled, 0 to 1
    infill_pattern: str
    colour: str  # #RRGGBB
    source: str


@dataclass(frozen=True, slots=True)
class Printer:
    """What one printed part must fit."""

    name: str
    volume: Size  # that both nozzles reach [m]
    nozzle: float  # [m]
    line_width: float  # [m]
    layer_height: float  # [m]
    interlock_depth: float  # of rigid into soft at their boundary [m]
    source: str


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The components one pipeline run may use."""

    name: str
    motor: Motor
    computer: Computer
    battery: Battery
    wire: Wire
    rigid: Filament
    soft: Filament
    printer: Printer
    joint_encoder: Device  # measures a joint's angle on the output side, one per joint
