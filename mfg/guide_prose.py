"""What every assembly guide says, whatever the robot: safety, set-up, first run. Plain text, not escaped.

Voltages, faults and timings are those of the J60 and of lithium packs; commands are those of `bodyplan deploy`.
"""

from __future__ import annotations

SAFETY = (
    "The battery is a lithium pack: charge it with a balancing charger only, outside the robot, never unattended, and "
    "do not use it swollen, punctured or wet.",
    "Put a fuse (30 A, the motor's greatest phase current) and a switch that you can reach into the battery's plus "
    "lead. The switch is your emergency stop: keep a hand on it in every first run.",
    "Stop at 19.8 V (3.3 V per cell), warn at 21.0 V (3.5 V per cell). At 18 V the motors report under-voltage and let "
    "go: the robot drops. Above 36 V they report over-voltage; braking feeds energy back, so never run from a bench "
    "supply that cannot take it. The motors' answers carry no voltage: watch the battery with an alarm of its own.",
    "The motors give {peak:.0f} N.m at their peak: fingers stay away from joints while the power is on. The bus "
    "protocol itself allows twice that torque; only the software limits it.",
    "A frame of eight zero bytes on a control id commands full reverse torque. Send nothing to the bus by hand but "
    "what this guide says.",
    "First runs: robot on a stand, feet in the air, then on the floor with a slack line. A hot motor (80 °C at the "
    "driver) loses stiffness before it stops at 110 °C.",
)

HARD = (
    "Before you print: on this body a hand or a tool does not get everywhere. Read the orange notes at step {steps}; "
    "each says what is in the way and what helps."
)
TORQUES = (
    "The torques are assumptions, no maker states them: they press the plastic under a head of 1.75 screw sizes with "
    "40 MPa, which PLA bears without creeping away; nut factor 0.2, friction 0.2. The last column is what the clamped "
    "face then carries before it slips; the motor's peak is {peak:.1f} N.m. No screw drawing of the motor is published "
    "either: check pattern, thread and depth on your motor before you print."
)
ENCODERS = (
    "Joint encoders are in the list, but this design has no seat for them: glue each where it sees its joint turn, or "
    "leave it out; the set-up below does without."
)
PLATES = (
    "Each picture shows a body as the print file lays it: grey is the plate. Bone (rigid) and skin (soft) of a body "
    "are printed together as one object."
)
CLEANING = (
    "Afterwards: take out all support, above all from motor cups, screw holes, box shafts and cable tunnels; try a "
    "motor in every cup and a wire in every tunnel before you begin."
)
LEGEND = (
    "Arrows show where things go; orange is what goes in, green are motors in place, yellow the cables (drawn through "
    "what hides them). The order has been checked: every way in is free of collision on the printed shapes unless a "
    "step says otherwise."
)
BUS = (
    "Each motor has a cable of its own, so the bus is a star with its centre in the controller box. Its two ends are "
    "the CAN adapter (jumper for 120 Ω on) and the motor with the longest cable (120 Ω across CAN H and CAN L); with "
    "the power off you measure 60 Ω between H and L. Other motors hang on branches and get no resistor; a branch over "
    "300 mm is marked, watch for bus errors there (rule of thumb at 1 Mbit/s). Lengths in the table are those of the "
    "tunnels; those to cut have 60 mm more at either end for plugs. Label both ends of every cable with name and id."
)
IDS = (
    "Motors leave the factory with id 1, so do this before they share a bus: connect one motor at a time to the CAN "
    "adapter and to 24 V, with the output free to turn."
)
BRING_UP = """ip link set can0 up type can bitrate 1000000 && ip link set can0 txqueuelen 128
candump can0        # in a second window: every command is answered by its id + 10 (hexadecimal)"""
NEW_ID = (
    "Stick the id on the motor. The frames follow the vendor's protocol file and have not been tried on a motor here; "
    "whether a new id holds at once or after a restart is not stated there: if nothing answers, switch the motor off "
    "and on and read back again."
)
ZERO = (
    "The zero of every joint is the pose in which the robot is drawn on the cover (and in assembly.glb). Before the "
    "screws of the outputs are tight, line each joint up in that pose and draw a zero mark with the paint marker "
    "across the rim of cup and disc."
)
SIGNS = (
    "A sign of -1 means that the motor's housing moves with the child, so that the motor turns against the joint; the "
    "software applies it, you change nothing. Software keeps every joint in its range: turn each by hand, without "
    "power, from end to end; nothing may touch, no cable may pull."
)
HOMING = (
    ("Robot on its stand; switch on, hold every joint on its zero mark, and keep holding.", ""),
    ("Store the zeros; the motors are limp meanwhile. BUNDLE is the folder of a policy for this robot, which "
     "bodyplan train or an evolution writes.", "bodyplan deploy BUNDLE --bus socketcan:can0 --set-home"),
    ("It prints what each joint measured before. If it refuses, a joint was not held still: repeat it.", ""),
)  # fmt: skip
FIRST_RUN = (
    ("Rehearse without hardware: simulated motors behind real frames.",
     "bodyplan deploy BUNDLE --bus virtual --dry-run"),
    ("Robot on its stand, feet in the air, hand on the switch; a few seconds only. With a serial adapter write --bus "
     "slcan:/dev/ttyACM0.", "bodyplan deploy BUNDLE --bus socketcan:can0 --seconds 3 --log first.log"),
    ("Does every joint move the way its picture shows? If one turns the other way, stop: its id or zero is wrong.", ""),
    ("Play the log back.", "bodyplan replay first.log"),
    ("On the floor, with a slack line, ten seconds.", "bodyplan deploy BUNDLE --bus socketcan:can0 --seconds 10"),
)  # fmt: skip
REFUSALS = (
    "It refuses to start if a joint measures outside its range: then a zero is not set. A policy that needs an IMU is "
    "refused on a real bus, because none is read there yet; a gait runs. Ctrl-C brakes, switches the motors off and "
    "still reports. If it says that a motor did not confirm that it is off, cut the power."
)
