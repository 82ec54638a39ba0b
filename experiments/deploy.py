"""`bodyplan deploy`: run a policy bundle on motors, real ones or simulated ones behind real frames."""

from __future__ import annotations

import argparse
import contextlib
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from experiments.output import DONE, INFEASIBLE, BadInput, emit, progress, say

if TYPE_CHECKING:
    from hardware.bundle import Bundle
    from hardware.bus import Clock, Port
    from hardware.tick import Tick
    from hardware.virtual import VirtualMotors
    from mfg.description import Description
    from sim.actor import Policy
    from sim.plant import Plant

HELP = "run a policy bundle on a robot's motors, or rehearse it on simulated ones"
STORY = (
    "A robot is refused if a joint measures outside its range: then a motor's zero is not set. Ctrl-C brakes, switches "
    "off and still reports. Exit status: 0 the policy drove to its end (or the zeros are set), 1 a guard or Ctrl-C "
    "stopped it before, 2 bad input or a bus or motor that does not answer as it should. No run can be resumed."
)
VIRTUAL = "virtual"
BUSES = ("socketcan:can0", "slcan:/dev/ttyACM0")
CONTROL_PERIOD = 0.02  # [s]


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.description = f"{HELP}. {STORY}"
    parser.add_argument("bundle", metavar="BUNDLE", type=Path, help="folder of a policy bundle")
    parser.add_argument("--bus", default=VIRTUAL, help=f"{VIRTUAL} (default), {' or '.join(BUSES)}")
    parser.add_argument("--dry-run", action="store_true", help="rehearse in simulated time, as fast as possible")
    parser.add_argument("--seconds", type=_seconds, default=10.0, help="how long the policy drives (default 10)")
    parser.add_argument(
        "--set-home",
        action="store_true",
        help="drive nothing, make the present pose the zero of all joints: switch the power on, hold the robot "
        "in its painted pose (as in assembly.glb), and keep holding; the motors go limp and store the zero",
    )
    parser.add_argument("--log", type=Path, help="write all frames here (candump form), all periods to LOG.jsonl")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Run the robot, or set its zeros; exit status 1 if a guard or Ctrl-C stopped it."""
    if args.bus != VIRTUAL and args.bus.partition(":")[0] not in ("socketcan", "slcan"):
        raise BadInput(f"unknown bus {args.bus!r}; give {VIRTUAL}, {' or '.join(BUSES)}")
    if args.dry_run and args.bus != VIRTUAL:
        raise BadInput(f"--dry-run moves nothing real, so it needs --bus {VIRTUAL}, not {args.bus}")
    if args.set_home and args.log is not None:
        raise BadInput("--set-home drives nothing, so there is no run to --log; give one of the two")
    try:
        from hardware.bundle import load_bundle

        bundle = load_bundle(args.bundle)
        if args.bus != VIRTUAL and not args.set_home:
            _refuse_blind(bundle, args.bundle)
        with _stop_on_signals(), _line(args.bus, args.bundle, bundle, lock_step=args.dry_run) as line:
            if args.set_home:
                return _set_home(bundle, line, as_json=args.json)
            if args.bus != VIRTUAL:
                say("no IMU is connected: the tilt guard is off; keep a hand on the power switch")
            result = _run(bundle, args.seconds, args.log, line)
    except KeyboardInterrupt:
        left = "some zeros may be set and others not, repeat it" if args.set_home else "no motor was driven"
        say(f"bodyplan: interrupted; {left}")
        return INFEASIBLE
    if args.json:
        emit(result)
    else:
        _tell(result)
    return DONE if result["latched"] is None and not result["interrupted"] else INFEASIBLE


def dry_run(folder: Path, seconds: float = 10.0, log: Path | None = None) -> dict[str, Any]:
    """Rehearse a bundle on simulated motors in simulated time, always with the same result.

    Args:
        folder: Of the bundle, with its model.
        seconds: How long the policy drives.
        log: Where to write the frames, or None.

    Returns:
        What `bodyplan deploy --dry-run --json` prints.

    Raises:
        BundleError: The bundle is unusable.
        BadInput: Its model is missing or unusable.
    """
    from hardware.bundle import load_bundle

    bundle = load_bundle(folder)
    with _line(VIRTUAL, folder, bundle, lock_step=True) as line:
        result = _run(bundle, seconds, log, line)
    if result["interrupted"]:
        raise KeyboardInterrupt
    return result


def bundle_of(description: Description, actor: Policy, *, dt: float = CONTROL_PERIOD, config_hash: str = "") -> Bundle:
    """Make the policy bundle of a described robot: its motors' ids and signs, gains as the wire rounds them.

    Args:
        description: Of the robot.
        actor: Its joints in the description's order, which is that of the model's.
        dt: Control period [s].
        config_hash: Of the configuration that produced the actor.

    Raises:
        BundleError: The robot has more joints than one bus has ids, or the actor has another number of joints.
    """
    from hardware.bundle import Bundle, BundleError, JointSetup
    from hardware.j60 import quantise_gains

    joints = []
    for joint in description.joints:
        if joint.motor.driver == "none":
            raise BundleError(
                f"Joint {joint.name!r}: no driver speaks to a {joint.motor.name}; a bundle needs J60 motors."
            )
        low, high = float(joint.range[0]), float(joint.range[1])
        kp, kd = quantise_gains(joint.motor.stiffness, joint.motor.damping)
        joints.append(
            JointSetup(
                name=joint.name,
                can_id=joint.can_id,
                sign=joint.sign,
                range=(low, high),
                default=min(max(0.0, low), high),
                kp=kp,
                kd=kd,
                peak_torque=joint.motor.peak_torque,
                continuous_torque=joint.motor.continuous_torque,
                max_speed=joint.motor.max_speed,
            )
        )
    turn = description.T_link_imu[:3, :3]
    return Bundle(description.name, tuple(joints), actor, dt, config_hash=config_hash, R_link_imu=turn)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.1 <= value <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text} is out of bounds; it must lie in [0.1, 3600] s")
    return value


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[None]:
    """Make a polite kill end a run as Ctrl-C does: through damping, to off."""

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature is Python's.
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _refuse_blind(bundle: Bundle, folder: Path) -> None:
    """A policy that looks at gravity would say nothing but NaN without an IMU, and only after the robot stands."""
    from sim.actor import Gait

    if not isinstance(bundle.actor, Gait):
        raise BadInput(f"{folder} is a policy that needs an IMU, and none is connected here; rehearse it with "
                       f"--bus {VIRTUAL}, or give hardware.control.drive your IMU")  # fmt: skip


def _load_plant(folder: Path, bundle: Bundle) -> Plant:
    from hardware.bundle import MODEL_FILE
    from sim.model import ModelError
    from sim.plant import Plant

    if not (folder / MODEL_FILE).exists():
        raise BadInput(f"{folder} has no {MODEL_FILE} to rehearse with; export the bundle together with its model")
    try:
        return Plant.load(folder / MODEL_FILE, bundle.names)
    except ModelError as error:
        raise BadInput(f"{folder / MODEL_FILE}: {error}") from None


@dataclass(frozen=True)
class _Line:
    """Our end of a bus, and what a virtual one has at its other end."""

    port: Port
    clock: Clock
    motors: VirtualMotors | None = None
    plant: Plant | None = None


@contextlib.contextmanager
def _line(bus: str, folder: Path, bundle: Bundle, lock_step: bool) -> Iterator[_Line]:
    """Open a real bus, or a virtual one with simulated motors, in simulated or in real time."""
    import threading

    from hardware.bus import RealClock, open_port, open_virtual_pair
    from hardware.virtual import LockStepPort, VirtualMotors

    with contextlib.ExitStack() as stack:
        if bus != VIRTUAL:
            port = open_port(bus)
            stack.callback(port.close)
            yield _Line(port, RealClock())
            return
        plant = _load_plant(folder, bundle)
        ours, theirs = open_virtual_pair()
        ids, signs = [joint.can_id for joint in bundle.joints], [joint.sign for joint in bundle.joints]
        motors = VirtualMotors(theirs, plant, ids, signs)
        stack.callback(theirs.close)
        stack.callback(ours.close)
        if lock_step:
            yield _Line(LockStepPort(ours, motors), motors, motors, plant)
            return
        stop, clock = threading.Event(), RealClock()
        thread = threading.Thread(target=motors.serve_forever, args=(stop, clock), name="motors", daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(stop.set)
        yield _Line(ours, clock, motors, plant)


def _set_home(bundle: Bundle, line: _Line, as_json: bool) -> int:
    """Make the pose in which the robot is held the zero of its joints."""
    from hardware.bus import MotorBus
    from hardware.home import set_home

    before, after = set_home(MotorBus(line.port, line.clock), bundle)
    if as_json:
        emit({"joints": list(bundle.names), "before_rad": before.tolist(), "after_rad": after.tolist()})
    else:
        for name, was in zip(bundle.names, before, strict=True):
            print(f"{name}: zero set, it measured {was:.3f} rad there before")
    return DONE


def _run(bundle: Bundle, seconds: float, log: Path | None, line: _Line) -> dict[str, Any]:

    from hardware.bus import MotorBus
    from hardware.control import Interrupted, drive
    from hardware.log import Journal
    from hardware.robot import Robot
    from hardware.tick import Schedule, State

    schedule = Schedule(policy=seconds)
    length = schedule.passive + schedule.ramp + schedule.hold + schedule.policy + schedule.damping
    bar = progress(range(10**9), round(length / bundle.dt), "deploy")
    track: list[tuple[int, Any, Any]] = []

    def watch(tick: Tick) -> None:
        next(bar)
        if line.plant is not None and tick.state is State.POLICY:
            track.append((tick.index, line.plant.centre_of_mass, line.plant.base_quaternion))

    with contextlib.ExitStack() as stack:
        journal = None if log is None else stack.enter_context(Journal(log, line.port, line.clock))
        robot = Robot(MotorBus(journal or line.port, line.clock), line.clock, bundle, schedule=schedule)
        imu = None if line.motors is None else line.motors.imu
        interrupted = False
        try:
            summary = drive(robot, line.clock, imu, journal, watch)
        except Interrupted as stop:
            summary, interrupted = stop.summary, True
    if summary.unconfirmed:
        say(f"motors {list(summary.unconfirmed)} did not confirm that they are off: cut the power")
    speed, distance = _gone(track, schedule.blend, bundle.dt)
    return {
        "ticks": summary.ticks,
        "overruns": summary.overruns,
        "tracking_rms_rad": summary.tracking_rms,
        "speed_m_s": speed,
        "state": str(summary.state),
        "latched": None if summary.trip is None else summary.trip.as_json(),
        "tracking_lag_s": summary.lag,
        "tracking_rms_aligned_rad": summary.aligned_rms,
        "distance_m": distance,
        "worst_lateness_s": summary.worst_lateness,
        "worst_jitter_s": summary.worst_jitter,
        "peak_torque_Nm": summary.peak_torque,
        "rms_torque_Nm": summary.rms_torque,
        "interrupted": interrupted,
        "unconfirmed_off": list(summary.unconfirmed),
        "log": None if log is None else str(log),
    }


def _gone(track: list[tuple[int, Any, Any]], lead_in: float, dt: float) -> tuple[float | None, float | None]:
    """Speed along the best heading [m/s] and distance [m], by the law of a rollout; None if it was over too soon.

    Args:
        track: Index of the period, centre of mass and orientation of the root, while the policy ran.
        lead_in: How long the policy takes over; it is not measured [s].
        dt: Control period [s].
    """
    import numpy as np

    from sim.rollout import body_velocity, turned

    measured = [row for row in track if (row[0] - track[0][0]) * dt >= lead_in - 1e-9]
    if len(measured) < 2:
        return None, None
    com, turns = np.array([row[1] for row in measured]), np.array([row[2] for row in measured])
    _, yaw = turned(track[0][2], turns)
    # A loop that was late has left periods out.
    ticks = np.array([row[0] for row in measured])
    steps = np.arange(ticks[0], ticks[-1] + 1)
    com = np.stack([np.interp(steps, ticks, axis) for axis in com[:, :2].T], axis=-1)
    velocity = body_velocity(com, np.interp(steps, ticks, np.unwrap(yaw)), dt)
    return float(np.linalg.norm(velocity)), float(np.linalg.norm(com[-1] - com[0]))


def _tell(result: dict[str, Any]) -> None:
    print(f"{result['ticks']} periods, {result['overruns']} late, now {result['state']}")
    if result["tracking_rms_rad"] is not None:
        print(
            f"tracking error {result['tracking_rms_rad']:.4f} rad rms, torque up to {result['peak_torque_Nm']:.1f} N.m"
        )
    if result["speed_m_s"] is not None:
        print(f"speed {result['speed_m_s']:.3f} m/s")
    if result["interrupted"]:
        print("stopped by the operator")
    if result["latched"] is not None:
        trip = result["latched"]
        where = "" if trip["joint"] is None else f" of {trip['joint']}"
        print(f"stopped by the guard {trip['guard']}{where}: {trip['value']} beyond {trip['bound']}")
