import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware import j60
from hardware.j60 import Code, Command, Fault, ForbiddenFrame, Reply

GOLDEN_COMMANDS = [
    (Command(torque=0.5), "ff 7f ff 1f 00 00 99 81"),  # the vendor's own example
    (Command(), "ff 7f ff 1f 00 00 ff 7f"),
    (Command(position=0.7, kp=30, kd=1), "3c 82 ff 9f 07 05 ff 7f"),
    (Command(position=-0.25, velocity=1.5, kp=20, kd=0.5, torque=-2), "32 7f 32 21 05 02 99 79"),
]
GOLDEN_REPLIES = [
    ((24, 111, 207, 224, 127, 3, 128, 57), (37.16987, -0.03811, 0.00427, 28.50), True),
    ((140, 36, 120, 135, 129, 243, 127, 66), (0.713845, 0.477868, -0.01526, 37.17), False),
]

commands = st.builds(
    Command,
    position=st.floats(-40, 40),
    velocity=st.floats(-40, 40),
    kp=st.floats(0, 1023),
    kd=st.floats(0, 51),
    torque=st.floats(-40, 40),
)
replies = st.builds(
    Reply,
    position=st.floats(-40, 40),
    velocity=st.floats(-40, 40),
    torque=st.floats(-40, 40),
    temperature=st.floats(-20, 200),
    is_motor_sensor=st.booleans(),
)


@pytest.mark.parametrize(("command", "expected"), GOLDEN_COMMANDS)
def test_golden_commands(command: Command, expected: str) -> None:
    assert j60.encode_command(command).hex(" ") == expected


@pytest.mark.parametrize(("data", "values", "is_motor_sensor"), GOLDEN_REPLIES)
def test_golden_replies(data: tuple[int, ...], values: tuple[float, ...], is_motor_sensor: bool) -> None:
    reply = j60.decode_reply(bytes(data))
    measured = (reply.position, reply.velocity, reply.torque, reply.temperature)
    assert measured == pytest.approx(values, abs=6e-6, rel=3e-4)
    assert reply.is_motor_sensor is is_motor_sensor


def test_velocity_uses_the_high_nibble_of_its_first_byte() -> None:
    """A public driver takes `d[2] & 0xF0` for `d[2] >> 4` and is off by up to 0.017 rad/s."""
    data = bytes(GOLDEN_REPLIES[1][0])
    wrong = ((data[2] & 0xF0) | data[3] << 4 | data[4] << 12) * 80 / (2**20 - 1) - 40
    assert j60.decode_reply(data).velocity == pytest.approx(0.477868, abs=1e-6)
    assert abs(wrong - 0.477868) > 5e-4


@given(commands)
def test_a_command_survives_the_wire_truncated_by_less_than_one_count(command: Command) -> None:
    try:
        data = j60.encode_command(command)
    except ForbiddenFrame:
        assert command.torque < -39.99
        assert command.position < -39.99
        return
    back = j60.decode_command(data)
    for name, resolution in j60.COMMAND_RESOLUTION.items():
        lost = getattr(command, name) - getattr(back, name)
        assert -2e-6 * resolution - 1e-12 <= lost < resolution  # truncation only ever goes down
    assert j60.encode_command(back) == data  # once quantised, a value stays


@given(replies)
def test_a_reply_survives_the_wire(reply: Reply) -> None:
    data = j60.encode_reply(reply)
    back = j60.decode_reply(data)
    assert back.is_motor_sensor == reply.is_motor_sensor
    for name, resolution in j60.REPLY_RESOLUTION.items():
        assert abs(getattr(reply, name) - getattr(back, name)) < resolution * (1 + 1e-5)
    assert j60.encode_reply(back) == data


@given(st.binary(min_size=8, max_size=8).filter(any))
def test_every_payload_but_zero_is_some_command(data: bytes) -> None:
    assert j60.encode_command(j60.decode_command(data)) == data


def test_truncation_biases_zero_downwards() -> None:
    back = j60.decode_command(j60.encode_command(Command()))
    assert back.position == pytest.approx(-0.61e-3, abs=1e-5)
    assert back.velocity == pytest.approx(-2.44e-3, abs=1e-5)
    assert back.torque == pytest.approx(-0.61e-3, abs=1e-5)


def test_all_zero_control_bytes_are_full_reverse_torque_and_refused() -> None:
    """A public driver sends all-zero bytes as its damping mode."""
    meant = j60.decode_command(bytes(8))
    assert (meant.position, meant.velocity, meant.torque) == (-40.0, -40.0, -40.0)
    with pytest.raises(ForbiddenFrame, match="all-zero"):
        j60.encode_command(Command(position=-40.0, velocity=-40.0, torque=-40.0))
    for motor in range(16):
        with pytest.raises(ForbiddenFrame, match=f"motor {motor} would mean -40 N.m"):
            j60.check_request(j60.request_id(Code.CONTROL, motor), bytes(8))


@given(st.sampled_from([c for c in Code if c in j60.SIZES]), st.integers(0, 15))
def test_ids_come_apart_again_and_replies_differ_by_bit_4(code: Code, motor: int) -> None:
    request, reply = j60.request_id(code, motor), j60.reply_id(code, motor)
    assert j60.split_id(request) == (code, False, motor)
    assert j60.split_id(reply) == (code, True, motor)
    assert request ^ reply == 0x10
    assert reply < 2**11


def test_documented_ids_and_numbers() -> None:
    """A public driver uses 26 and 25 for zeroing and calibrating."""
    assert j60.request_id(Code.ENABLE, 1) == 0x41
    assert j60.reply_id(Code.ENABLE, 1) == 0x51
    assert j60.request_id(Code.DISABLE, 1) == 0x21
    assert j60.request_id(Code.CONTROL, 1) == 0x81
    assert (Code.SET_HOME, Code.CALIBRATE, Code.ERROR_RESET, Code.CONFIG) == (6, 3, 17, 24)


@pytest.mark.parametrize(
    ("can_id", "data", "message"),
    [
        (0x91, bytes(8), "not a request"),  # a reply id
        (18 << 5 | 1, b"", "not a request"),  # firmware
        (21 << 5 | 1, b"", "not a request"),
        (26 << 5 | 1, b"", "not a request"),
        (0x81, b"\x01", "CONTROL to motor 1 takes 8 bytes, got 1"),
        (0x41, b"\x00", "ENABLE to motor 1 takes 0 bytes, got 1"),
    ],
)
def test_lint_refuses_what_must_not_be_sent(can_id: int, data: bytes, message: str) -> None:
    with pytest.raises(ForbiddenFrame, match=message):
        j60.check_request(can_id, data)


@pytest.mark.parametrize("value", [math.nan, math.inf, 40.1, -41.0])
@pytest.mark.parametrize("name", ["position", "velocity", "torque"])
def test_values_beyond_the_wire_are_refused_not_wrapped(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        j60.encode_command(dataclasses.replace(Command(), **{name: value}))


def test_gains_are_quantised_downwards_to_whole_kp_and_fifths_of_kd() -> None:
    assert j60.quantise_gains(30.9, 0.5) == (30.0, 0.4)
    for step in range(256):  # what is on the grid must stay
        assert j60.quantise_gains(40.0, step / 5) == (40.0, step / 5)
    with pytest.raises(ValueError, match="kd"):
        j60.quantise_gains(10.0, 52.0)


@pytest.mark.parametrize("data", [bytes((32, 0, 0, 0, 0)), bytes((0, 32, 0, 0, 0))])
def test_faults_are_seen_whichever_byte_is_low(data: bytes) -> None:
    assert j60.decode_faults(data) == Fault.CAN_TIMEOUT
    assert not j60.decode_faults(bytes(5))
    with pytest.raises(ValueError, match="at least 2"):
        j60.decode_faults(b"\x00")


@given(st.integers(0, 15), st.integers(0, 255), st.integers(0, 65535), st.integers(0, 65535))
def test_config_round_trip(motor: int, can_timeout: int, bandwidth: int, current: int) -> None:
    config = j60.Config(motor, can_timeout, bandwidth, current)
    data = j60.encode_config(config)
    assert j60.decode_config(data) == config
    assert data[3] == can_timeout
    assert data[4:6] == bandwidth.to_bytes(2, "little")


def test_settings_have_the_size_of_their_command() -> None:
    assert j60.encode_setting(Code.SET_CAN_TIMEOUT, 100) == b"\x64"
    assert j60.encode_setting(Code.SET_BANDWIDTH, 1000) == b"\xe8\x03"
    assert j60.decode_setting(b"\xe8\x03") == 1000
    with pytest.raises(ValueError, match=r"SET_CAN_TIMEOUT must lie in \[0, 255\], got 256"):
        j60.encode_setting(Code.SET_CAN_TIMEOUT, 256)
    with pytest.raises(ValueError, match="ENABLE takes no setting"):
        j60.encode_setting(Code.ENABLE, 1)


def test_short_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="Expected 8 bytes, got 7"):
        j60.decode_reply(bytes(7))
    with pytest.raises(ValueError, match="Motor id"):
        j60.request_id(Code.ENABLE, 16)
