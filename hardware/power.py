"""Motors before and after a run: found and without faults, later off."""

from __future__ import annotations

from collections.abc import Sequence

from hardware import j60
from hardware.bus import MotorBus, MotorFault
from hardware.j60 import Code


def wake(bus: MotorBus, motors: Sequence[int], timeout: int) -> None:
    """Find every motor, clear old faults, and have it stop by itself after a silence of `timeout` [ms].

    Raises:
        MotorSilent: A motor does not answer.
        MotorFault: A motor has a fault that stays, or does not keep its setting.
    """
    for motor in motors:
        if j60.decode_faults(bus.request(motor, Code.STATUS_WORD)):
            bus.order(motor, Code.ERROR_RESET)
            faults = j60.decode_faults(bus.request(motor, Code.STATUS_WORD))
            if faults:
                raise MotorFault(f"Motor {motor} reports {faults!r} and does not clear it; see to the cause.")
        bus.order(motor, Code.SET_CAN_TIMEOUT, j60.encode_setting(Code.SET_CAN_TIMEOUT, timeout))
        kept = j60.decode_config(bus.request(motor, Code.CONFIG)).can_timeout
        if kept != timeout:
            raise MotorFault(f"Motor {motor} keeps a CAN timeout of {kept} ms, told {timeout} ms; do not run it.")


def disable(bus: MotorBus, motors: Sequence[int]) -> tuple[int, ...]:
    """Switch motors off one by one, each whatever the others do; gives those that did not confirm it."""
    unconfirmed = []
    for motor in motors:
        try:
            bus.order(motor, Code.DISABLE)
        except OSError:
            unconfirmed.append(motor)
    return tuple(unconfirmed)
