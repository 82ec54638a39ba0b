"""The robot as a state machine over its motors, one call per control period.

Passive (limp, measuring) -> Enable -> Ramp (from the measured pose to the default pose) -> Hold -> Policy -> Damping
(motors brake; there is no way back) -> Off. Any guard that trips leads to Damping; leaving the context, also by an
exception, leads through Damping to Off.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hardware import j60, safety
from hardware.bundle import Bundle, BundleError
from hardware.bus import Clock, MotorBus
from hardware.home import check_pose, measure_pose
from hardware.j60 import Code, Command, Reply
from hardware.power import disable, wake
from hardware.safety import DEFAULT_LIMITS, Limits, Sample, Trip
from hardware.tick import DEFAULT_SCHEDULE, Imu, Schedule, State, Tick
from sim.actor import Gait, Perceptron, low_pass, smooth_step
from sim.observation import in_link_axes

Array = NDArray[np.float64]

SILENT_PERIODS = 5  # after so many without a command, a motor stops itself
STATUS_TIMEOUT = 0.003  # of the status word that is read in passing, as in the vendor's driver [s]


class Robot:
    """Drives one robot by its bundle; use it as a context manager, so that its motors are off afterwards."""

    def __init__(
        self,
        bus: MotorBus,
        clock: Clock,
        bundle: Bundle,
        limits: Limits = DEFAULT_LIMITS,
        schedule: Schedule = DEFAULT_SCHEDULE,
    ) -> None:
        """Take a robot that is powered and not enabled.

        Raises:
            BundleError: A gain is not one that the wire can carry.
        """
        for joint in bundle.joints:
            if (joint.kp, joint.kd) != (carried := j60.quantise_gains(joint.kp, joint.kd)):
                raise BundleError(
                    f"Joint {joint.name!r}: the wire makes kp {joint.kp:g}, kd {joint.kd:g} into kp {carried[0]:g}, "
                    f"kd {carried[1]:g}; export the bundle with the gains that it was trained with after rounding."
                )
        n = len(bundle.joints)
        self.bundle, self.limits, self.schedule = bundle, limits, schedule
        self.state = State.PASSIVE
        self.trip: Trip | None = None
        self.unconfirmed: tuple[int, ...] = ()  # motors that did not confirm that they are off
        self._bus, self._clock = bus, clock
        self._seen: Array | None = None  # the observation that the policy acted on last
        self._ids = tuple(joint.can_id for joint in bundle.joints)
        self._sign = bundle.column("sign")
        self._entered = 0  # index of the tick that entered the state
        self._last_index = -1
        self._looked = -1  # index of the last tick that measured before it chose
        self._position = np.full(n, np.nan)
        self._velocity = np.full(n, np.nan)
        self._torque = np.full(n, np.nan)
        self._temperatures = np.full((n, 2), np.nan)  # driver, motor
        self._heard = np.full(n, -1)  # index of the tick of the last reply
        self._faults = np.zeros(n, dtype=np.int64)
        self._stall = np.zeros(n)
        self._start = np.zeros(n)  # pose from which the ramp starts
        self._target = bundle.column("default")
        self._upright: Array | None = None

    def __enter__(self) -> Self:
        """Bring the motors up; whatever fails on the way, they are told to be off."""
        try:
            self.bring_up()
        except BaseException:
            self.shut_down()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Brake, then switch off, whatever happened."""
        self.shut_down()

    def bring_up(self) -> None:
        """Find every motor, clear old faults, set its watchdog, and see that the robot stands as it can.

        Raises:
            MotorSilent: A motor does not answer.
            MotorFault: A motor has a fault that stays, or does not keep its setting.
            PoseError: A joint measures outside its range by more than the guards' margin.
        """
        timeout = min(255, max(20, round(SILENT_PERIODS * self.bundle.dt * 1e3)))
        wake(self._bus, self._ids, timeout)
        check_pose(measure_pose(self._bus, self.bundle), self.bundle, self.limits.position_margin)

    def tick(self, index: int, imu: Imu | None, overruns: int) -> Tick:
        """Run one control period: choose targets, command all motors, measure, look at the guards.

        Args:
            index: Number of this period since the start; a late loop leaves some out.
            imu: Gravity and angular velocity, None without an IMU.
            overruns: Late periods in a row so far.

        Raises:
            MotorError: The bus is gone, or a motor cannot be enabled.
        """
        self._move_on(index)
        state, previous = self.state, self._target
        periods = max(1, index - self._last_index)
        self._last_index = index
        if state is State.OFF:
            return self._report(index, state, previous, imu)
        if state in (State.RAMP, State.HOLD, State.POLICY):
            target, trip = self._choose(index, imu, periods)
            if trip is None:
                self._target = target
            else:
                self._latch(trip, index)
        self._measure(self._bus.sweep(self._commands(), self.bundle.dt / 2), index)
        self._read_status(index)
        if self.state is not State.DAMPING:
            measured_trip = self._check(index, imu, overruns, previous)
            if measured_trip is not None:
                self._latch(measured_trip, index)
                self._measure(self._bus.sweep(self._commands(), self.bundle.dt / 2), index)
        return self._report(index, state, previous, imu)

    def shut_down(self) -> None:
        """Brake for a while and switch off, sending again and again even if the bus fails; does nothing when off."""
        if self.state is State.OFF:
            return
        self.state = State.DAMPING
        start, periods = self._clock.now(), max(1, round(self.schedule.damping / self.bundle.dt))
        try:
            for period in range(periods):
                # A bus that is gone may come back; what matters is to keep telling the motors.
                with contextlib.suppress(OSError):
                    self._bus.sweep(self._commands(), self.bundle.dt / 2)
                self._clock.sleep_until(start + (period + 1) * self.bundle.dt)
        finally:
            self._switch_off()

    def _move_on(self, index: int) -> None:
        """Leave the state if its time has come."""
        seconds = (index - self._entered) * self.bundle.dt + 1e-9
        schedule = self.schedule
        match self.state:
            case State.PASSIVE if seconds >= schedule.passive and not np.isnan(self._position).any():
                for motor in self._ids:
                    self._bus.order(motor, Code.ENABLE)
                self._enter(State.ENABLE, index)
            case State.ENABLE:
                self._start = self._target = self._position.copy()
                self._enter(State.RAMP, index)
            case State.RAMP if seconds >= self._ramp_seconds():
                self._enter(State.HOLD, index)
            case State.HOLD if seconds >= schedule.hold:
                self._enter(State.POLICY, index)
            case State.POLICY if seconds >= schedule.policy:
                self._enter(State.DAMPING, index)
            case State.DAMPING if seconds >= schedule.damping:
                self._switch_off()

    def _enter(self, state: State, index: int) -> None:
        self.state = state
        self._entered = index
        self._stall = np.zeros(len(self._ids))

    def _latch(self, trip: Trip, index: int) -> None:
        self.trip = trip
        self._enter(State.DAMPING, index)

    def _ramp_seconds(self) -> float:
        # The smooth step is at its fastest, 15/8 of the mean speed, halfway.
        furthest = float(np.max(np.abs(self.bundle.column("default") - self._start)))
        return max(self.schedule.ramp, 15 / 8 * furthest / self.schedule.ramp_speed)

    def _choose(self, index: int, imu: Imu | None, periods: int) -> tuple[Array, Trip | None]:
        """Give the targets of this period and, if they are not acceptable, why."""
        default = self.bundle.column("default")
        seconds = (index - self._entered) * self.bundle.dt
        if self.state is State.RAMP:
            target = self._start + smooth_step(seconds / self._ramp_seconds()) * (default - self._start)
        elif self.state is State.HOLD:
            target = default
        else:
            if self._upright is None and imu is not None:
                self._upright = imu[0]
            if not isinstance(self.bundle.actor, Gait):
                # What it sees is measured now, by asking for the same once more, as it was when it was trained.
                self._measure(self._bus.sweep(self._commands(), self.bundle.dt / 4), index)
                self._looked = index
            action = self.bundle.actor.act(seconds, self._observe(imu))
            trip = safety.check_action(action, self.bundle.names)
            if trip is not None:
                return self._target, trip
            low, high = self.bundle.column("range").T
            weight = smooth_step(seconds / self.schedule.blend) if self.schedule.blend > 0.0 else np.ones(())
            wanted = default + weight * (np.clip(action, low, high) - default)
            target = low_pass(self._target, wanted, periods * self.bundle.dt, self.bundle.time_constant)
        return target, safety.check_step(target, self._target, self.bundle, periods * self.bundle.dt)

    def _observe(self, imu: Imu | None) -> Array:
        gravity, gyro = (np.full(3, np.nan), np.full(3, np.nan)) if imu is None else imu
        gravity, gyro = in_link_axes(self.bundle.R_link_imu, gravity, gyro)
        layout, command = self.bundle.actor.layout, None
        if isinstance(self.bundle.actor, Perceptron) and layout.commanded:
            command = self.bundle.actor.command
        frame = layout.pack(gravity, gyro, self._position, self._velocity, self._target, command)
        self._seen = layout.begin(frame) if self._seen is None else layout.push(self._seen, frame)
        return self._seen

    def _commands(self) -> Mapping[int, Command]:
        """Encode what the state asks of each motor, in the motor's own direction."""
        if self.state is State.DAMPING:
            return dict.fromkeys(self._ids, Command(kd=self.schedule.damping_gain))
        if self.state not in (State.RAMP, State.HOLD, State.POLICY):
            return dict.fromkeys(self._ids, Command())
        # Where the last replies came a period ago, a moving joint judged from there would be held back for no reason.
        ahead = 0.0 if self._looked == self._last_index else self.bundle.dt
        position = self._position + self._velocity * ahead
        safe = safety.within_torque(self._target, position, self._velocity, self.bundle)
        share = safety.derating(self._hottest(), self.limits)
        return {
            joint.can_id: Command(position=joint.sign * float(safe[i]), kp=joint.kp * float(share[i]), kd=joint.kd)
            for i, joint in enumerate(self.bundle.joints)
        }

    def _measure(self, replies: Mapping[int, Reply], index: int) -> None:
        for i, motor in enumerate(self._ids):
            reply = replies.get(motor)
            if reply is not None:
                self._position[i] = self._sign[i] * reply.position
                self._velocity[i] = self._sign[i] * reply.velocity
                self._torque[i] = self._sign[i] * reply.torque
                self._temperatures[i, int(reply.is_motor_sensor)] = reply.temperature
                self._heard[i] = index

    def _read_status(self, index: int) -> None:
        """Read one motor's status word, another one each period: control replies carry no faults."""
        i = index % len(self._ids)
        answer = self._bus.ask(self._ids[i], Code.STATUS_WORD, timeout=STATUS_TIMEOUT)
        if answer is not None:
            self._faults[i] = int(j60.decode_faults(answer))

    def _check(self, index: int, imu: Imu | None, overruns: int, previous: Array) -> Trip | None:
        measured = not np.isnan(self._position).any()
        sample = Sample(
            # Before the first reply only its absence can be judged.
            position=self._position if measured else self.bundle.column("default"),
            velocity=self._velocity if measured else np.zeros(len(self._ids)),
            torque=self._torque if measured else np.zeros(len(self._ids)),
            temperature=self._hottest(),
            age=(index - self._heard) * self.bundle.dt,
            faults=self._faults,
            overruns=overruns,
            tilt=self._tilt(imu),
        )
        trip = safety.check_sample(sample, self.bundle, self.limits)
        if trip is None and self.state in (State.RAMP, State.HOLD, State.POLICY):
            self._stall, trip = safety.check_stall(self._stall, previous, self._position, self.bundle, self.limits)
        return trip

    def _report(self, index: int, state: State, previous: Array, imu: Imu | None) -> Tick:
        return Tick(
            index=index,
            state=state,
            target=self._target,
            previous_target=previous,
            position=self._position.copy(),
            velocity=self._velocity.copy(),
            torque=self._torque.copy(),
            temperature=self._hottest(),
            imu=imu,
            trip=self.trip,
        )

    def _hottest(self) -> Array:
        """The hotter of each motor's sensors; cold until one has reported."""
        return np.asarray(np.fmax.reduce(self._temperatures, axis=1, initial=-20.0))

    def _tilt(self, imu: Imu | None) -> float | None:
        if imu is None or self._upright is None:
            return None
        return safety.angle_between(imu[0], self._upright)

    def _switch_off(self) -> None:
        """Overwrite the command that the motors remember, then disable them."""
        self.state = State.OFF
        with contextlib.suppress(OSError):
            self._bus.sweep(self._commands(), self.bundle.dt / 2)
        self.unconfirmed = disable(self._bus, self._ids)
