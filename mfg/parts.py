"""The components of the paper, derived and cited. A number marked (assumed) has no published source."""

from __future__ import annotations

from mfg.catalogue import Battery, Catalogue, Computer, Device, Filament, Motor, Printer, ScrewPattern, Wire

GEAR_RATIO = 6.0  # the 6 in J60-6
ROTOR_INERTIA = 1.4e-4  # (assumed) typical of a 70 mm outrunner rotor [kg.m2]

J60_6 = Motor(
    name="J60-6",
    diameter=0.0765,
    length=0.063,
    mass=0.480,
    peak_torque=19.94,
    continuous_torque=19.94 / 3,  # (assumed) no rating is published
    max_speed=24.18,
    voltage=24.0,
    torque_constant=0.898,
    armature=ROTOR_INERTIA * GEAR_RATIO**2,
    friction=0.1,  # (assumed)
    stiffness=40.0,  # a whole number: the wire quantises kp to 1.0
    damping=1.6,  # a multiple of 0.2: the wire quantises kd to 0.2
    latency=0.008,  # (assumed) one CAN sweep and the motor's own loop
    body_screws=ScrewPattern(6, 0.030, 0.0043, 0.0075, "M4x10"),  # (assumed) no drawing is published
    output_screws=ScrewPattern(6, 0.020, 0.0043, 0.0075, "M4x12"),  # (assumed)
    source="vendor page 'J60 joint' (Deep Robotics): size, mass, peak torque, speed, voltage, torque constant",
)

NANOPI_NEO_AIR = Device("NanoPi NEO Air", (0.040, 0.040, 0.012), 0.0097, "vendor wiki; height with headers (assumed)")
CANABLE_PRO = Device("Makerbase CANable Pro", (0.050, 0.016, 0.010), 0.010, "board drawing V1.0; mass (assumed)")
BNO086 = Device("BNO086 IMU breakout", (0.0254, 0.0305, 0.005), 0.003, "breakout size (assumed)")
RS485 = Device("USB-RS485 adapter", (0.045, 0.018, 0.008), 0.008, "(assumed)")
JOINT_ENCODER = Device(
    "RS485 positional encoder", (0.020, 0.020, 0.006), 0.008, "paper: RS485, one per joint; the rest (assumed)"
)
REGULATOR = Device("5 V 3 A buck regulator", (0.022, 0.017, 0.008), 0.005, "(assumed)")

PAPER_COMPUTER = Computer(
    name="controller box",
    size=(0.060, 0.048, 0.030),  # two decks: NEO Air over CANable and RS485, IMU between; wiring room included
    devices=(NANOPI_NEO_AIR, CANABLE_PRO, BNO086, RS485, REGULATOR),
    source="stack of the devices with 4 mm of wiring room (assumed)",
)

BATTERY_6S = Battery("6S LiPo 2200 mAh", (0.105, 0.034, 0.045), 0.350, 22.2, 2.2, "typical pack (unverified)")

CABLE = Wire("2x18 AWG + CAN pair, sleeved", 0.006, 0.045, 0.012, "(assumed) silicone wire")

PLA = Filament("PLA", 1240.0, 2.6e9, 3, 0.15, "gyroid", "#D9DCE1", "typical data sheet; infill and walls (assumed)")
TPU_90A = Filament("TPU 90A", 1210.0, 2.6e7, 1, 0.05, "gyroid", "#3E7CB1", "paper: 5 % gyroid, one wall")

H2D = Printer(
    name="Bambu Lab H2D, 0.6 mm nozzle",
    volume=(0.300, 0.320, 0.320),
    nozzle=0.0006,
    line_width=0.00062,
    layer_height=0.0003,
    interlock_depth=0.00063,
    source="BambuStudio machine profile: the volume that both nozzles reach; paper: interlock 0.63 mm",
)

PAPER = Catalogue("paper", J60_6, PAPER_COMPUTER, BATTERY_6S, CABLE, PLA, TPU_90A, H2D, JOINT_ENCODER)
