import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hardware import j60
from hardware.bus import CanPort, Frame, MotorBus, RealClock
from hardware.j60 import Code, Command, Fault
from hardware.virtual import Imperfection, VirtualMotors

PEAK = 19.94


def faults(rig: Any, motor: int) -> Fault:
    return j60.decode_faults(rig.bus.request(motor, Code.STATUS_WORD))


def test_a_command_outlives_disabling(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    rig.bus.sweep({3: Command(torque=5.0)})
    rig.motors.sleep_until(0.1)
    assert rig.plant.joint_torques[0] == 0.0  # not enabled: limp
    rig.bus.order(3, Code.ENABLE)
    rig.motors.sleep_until(0.11)
    assert rig.plant.joint_torques[0] == pytest.approx(5.0, abs=0.01)  # the kick that a soft start must prevent
    rig.bus.order(3, Code.DISABLE)
    rig.motors.sleep_until(0.12)
    assert rig.plant.joint_torques[0] == 0.0


def test_silence_on_the_bus_latches_the_timeout_fault(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    rig.bus.order(3, Code.SET_CAN_TIMEOUT, b"\x64")
    assert j60.decode_config(rig.bus.request(3, Code.CONFIG)).can_timeout == 100
    rig.bus.order(3, Code.ENABLE)
    rig.bus.sweep({3: Command(torque=0.5)})
    rig.motors.sleep_until(0.099)
    assert faults(rig, 3) == 0
    assert rig.plant.joint_torques[0] != 0.0
    rig.motors.sleep_until(0.13)
    assert faults(rig, 3) == Fault.CAN_TIMEOUT
    assert rig.plant.joint_torques[0] == 0.0
    rig.bus.sweep({3: Command(torque=0.5)})  # talking again does not bring it back
    assert rig.bus.request(3, Code.ENABLE) == b"\x01"
    rig.bus.order(3, Code.ERROR_RESET)
    rig.bus.order(3, Code.ENABLE)


def test_temperature_sensors_take_turns(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    rig.motors.nodes[0].motor_temperature = 90.0
    seen = [rig.bus.sweep({3: Command()})[3] for _ in range(4)]
    assert [reply.is_motor_sensor for reply in seen] == [True, False, True, False]
    for reply in seen:
        assert reply.temperature == pytest.approx(90.0 if reply.is_motor_sensor else 25.0, abs=1.8)


def test_signs_turn_the_motor_not_the_joint(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    reply = rig.bus.sweep({7: Command()})[7]
    assert reply.position == pytest.approx(0.6, abs=1e-4)  # the joint is at -0.6
    rig.bus.order(7, Code.ENABLE)
    rig.bus.sweep({7: Command(torque=2.0)})
    rig.motors.sleep_until(0.01)
    assert rig.plant.joint_torques[1] == pytest.approx(-2.0, abs=0.01)


def test_home_moves_zero_and_the_targets_with_it(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    rig.bus.order(7, Code.SET_HOME)
    assert rig.bus.sweep({7: Command()})[7].position == pytest.approx(0.0, abs=1e-3)
    rig.bus.order(7, Code.ENABLE)
    rig.bus.sweep({7: Command(position=0.0, kp=40, kd=2)})
    rig.motors.sleep_until(1.0)
    assert rig.plant.joint_positions[1] == pytest.approx(-0.6, abs=2e-3)


def test_all_zero_bytes_are_full_reverse_torque_for_the_simulated_motor_too(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    rig.bus.order(3, Code.ENABLE)
    rig.port.send(Frame(j60.request_id(Code.CONTROL, 3), bytes(8)))
    rig.motors.sleep_until(0.01)
    assert rig.plant.joint_torques[0] == -PEAK


@pytest.mark.parametrize("frame", [Frame(0x51, b""), Frame(18 << 5 | 3, b""), Frame(0x4F, b""), Frame(0x83, b"\x01")])
def test_frames_that_are_no_requests_get_no_answer(make_rig: Callable[..., Any], frame: Frame) -> None:
    rig = make_rig()
    rig.port.send(frame)
    assert rig.port.receive(0.1) is None
    assert rig.motors.now() == pytest.approx(0.1)


def test_delay_holds_answers_back_for_that_long(make_rig: Callable[..., Any]) -> None:
    rig = make_rig(imperfection=Imperfection(delay=0.004))
    assert rig.bus.sweep({3: Command()}, timeout=0.003) == {}
    assert list(rig.bus.sweep({3: Command()}, timeout=0.003)) == [3]  # the first answer, late
    assert rig.motors.now() == pytest.approx(0.004)


def test_drops_happen_at_the_asked_rate_and_the_same_way_again(
    ports: tuple[CanPort, CanPort], make_rig: Callable[..., Any]
) -> None:
    def answered(rig: Any) -> list[int]:
        return [len(rig.bus.sweep({3: Command(), 7: Command()}, timeout=0.001)) for _ in range(400)]

    first = answered(make_rig(imperfection=Imperfection(drop=0.2)))
    for port in ports:
        while port.receive(0.0) is not None:
            pass
    assert np.mean(first) == pytest.approx(2 * 0.8 * 0.8, abs=0.12)
    assert answered(make_rig(imperfection=Imperfection(drop=0.2))) == first


def test_bad_set_ups_are_refused(ports: tuple[CanPort, CanPort], springs: Callable[..., Any]) -> None:
    with pytest.raises(ValueError, match="distinct ids"):
        VirtualMotors(ports[1], springs(np.zeros(2)), [1, 1])
    with pytest.raises(ValueError, match="needs an rng"):
        VirtualMotors(ports[1], springs(np.zeros(1)), [1], imperfection=Imperfection(drop=0.1))


def test_in_real_time_a_thread_answers_and_moves_the_plant(
    ports: tuple[CanPort, CanPort], springs: Callable[..., Any]
) -> None:
    plant, stop, clock = springs(np.zeros(1)), threading.Event(), RealClock()
    motors = VirtualMotors(ports[1], plant, [1])
    thread = threading.Thread(target=motors.serve_forever, args=(stop, clock))
    thread.start()
    try:
        bus = MotorBus(ports[0], clock)
        assert bus.request(1, Code.ENABLE, timeout=5.0) == b"\x00"
        assert list(bus.sweep({1: Command(torque=1.0)}, timeout=5.0)) == [1]
        deadline = clock.now() + 20.0
        while plant.joint_positions[0] < 1e-4 and clock.now() < deadline:
            clock.sleep_until(clock.now() + 0.005)
    finally:
        stop.set()
        thread.join()
    assert plant.joint_positions[0] >= 1e-4
