import pytest

from hardware import j60
from hardware.bus import BusUnavailable, CanPort, Frame, MotorBus, MotorFault, MotorSilent, RealClock, open_port
from hardware.j60 import Code, Command, ForbiddenFrame, Reply


def drain(port: CanPort) -> list[Frame]:
    frames = []
    while (frame := port.receive(0.0)) is not None:
        frames.append(frame)
    return frames


def measured(position: float) -> bytes:
    return j60.encode_reply(Reply(position, 0.0, 0.0, 25.0, True))


def test_a_reply_is_matched_by_its_id_and_strangers_are_passed_over(ports: tuple[CanPort, CanPort]) -> None:
    """A public driver takes whatever frame comes next for its answer."""
    ours, theirs = ports
    theirs.send(Frame(j60.reply_id(Code.ENABLE, 2), b"\x00"))  # another motor's
    theirs.send(Frame(j60.reply_id(Code.DISABLE, 1), b"\x01"))  # the same motor, another command's
    theirs.send(Frame(j60.request_id(Code.ENABLE, 1), b""))  # an echo of the request
    theirs.send(Frame(j60.reply_id(Code.ENABLE, 1), b"\x00\x00"))  # the wrong size
    theirs.send(Frame(j60.reply_id(Code.ENABLE, 1), b"\x07"))
    assert MotorBus(ours, RealClock()).request(1, Code.ENABLE, timeout=1.0) == b"\x07"
    assert drain(theirs) == [Frame(0x41, b"")]


def test_a_silent_motor_is_asked_three_times_and_then_named(ports: tuple[CanPort, CanPort]) -> None:
    ours, theirs = ports
    with pytest.raises(MotorSilent, match=r"Motor 5 gave no reply to ENABLE within 1 ms.*24 V supply and CAN wiring"):
        MotorBus(ours, RealClock()).request(5, Code.ENABLE, timeout=0.001)
    assert len(drain(theirs)) == 3
    assert issubclass(MotorSilent, TimeoutError)


def test_a_refusal_is_an_error(ports: tuple[CanPort, CanPort]) -> None:
    ours, theirs = ports
    theirs.send(Frame(j60.reply_id(Code.ENABLE, 1), b"\x02"))
    with pytest.raises(MotorFault, match="Motor 1 refused ENABLE with code 2"):
        MotorBus(ours, RealClock()).order(1, Code.ENABLE)


def test_a_sweep_takes_the_newest_reply_of_each_motor_and_leaves_out_the_silent(
    ports: tuple[CanPort, CanPort],
) -> None:
    ours, theirs = ports
    for position in (0.1, 0.2):  # both late, from sweeps before
        theirs.send(Frame(j60.reply_id(Code.CONTROL, 1), measured(position)))
    theirs.send(Frame(j60.reply_id(Code.CONTROL, 9), measured(9.0)))  # nobody asked it
    replies = MotorBus(ours, RealClock()).sweep({1: Command(), 2: Command()}, timeout=0.001)
    assert list(replies) == [1]
    assert replies[1].position == pytest.approx(0.2, abs=1e-4)
    assert [frame.can_id for frame in drain(theirs)] == [0x81, 0x82]


def test_nothing_forbidden_reaches_the_bus(ports: tuple[CanPort, CanPort]) -> None:
    ours, theirs = ports
    bus = MotorBus(ours, RealClock())
    with pytest.raises(ForbiddenFrame):
        bus.sweep({1: Command(-40.0, -40.0, 0.0, 0.0, -40.0)})
    with pytest.raises(ForbiddenFrame):
        bus.ask(1, Code.CONTROL, bytes(8))
    with pytest.raises(ForbiddenFrame):
        bus.ask(1, Code.SET_CAN_TIMEOUT)
    assert drain(theirs) == []


def test_virtual_buses_never_meet(ports: tuple[CanPort, CanPort]) -> None:
    other = open_port("virtual:elsewhere")
    other.send(Frame(0x41, b""))
    other.close()
    assert drain(ports[0]) == []


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("socketcan:nosuchcan9", "Cannot open socketcan:nosuchcan9: .*ip link set nosuchcan9 up"),
        ("slcan:/dev/nosuchtty", "Cannot open slcan:/dev/nosuchtty: .*adapter is plugged in"),
        ("canopen:can0", "Unknown bus 'canopen:can0'; give virtual, socketcan:can0"),
        ("socketcan", "Unknown bus 'socketcan'"),
        ("", "Unknown bus ''"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_one_clear_line(address: str, message: str) -> None:
    with pytest.raises(BusUnavailable, match=message) as caught:
        open_port(address)
    assert "\n" not in str(caught.value)


def test_a_closed_bus_is_unavailable() -> None:
    port = open_port("virtual:closed")
    port.close()
    with pytest.raises(BusUnavailable, match="did not take a frame"):
        port.send(Frame(0x41, b""))
    with pytest.raises(BusUnavailable, match="is gone"):
        port.receive(0.0)
