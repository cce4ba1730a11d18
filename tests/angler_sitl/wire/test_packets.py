import math
import struct

import pytest

from angler_mjx.errors import RunError
from angler_sitl.wire import packets

PULSES = tuple(range(1500, 1516))


def test_servo_packets_of_16_and_32_channels():
    short = struct.pack("<HHI16H", 18458, 400, 70_000, *PULSES)
    long = struct.pack("<HHI32H", 29569, 400, 70_001, *PULSES, *[0] * 16)
    assert len(short) == 40
    assert len(long) == packets.MAX_SERVO_BYTES == 72
    assert packets.read_servo(short) == (70_000, PULSES)
    assert packets.read_servo(memoryview(bytearray(long))) == (70_001, PULSES)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x1a\x48",
        struct.pack("<HHI16H", 18459, 400, 1, *PULSES),
        struct.pack("<HHI16H", 29569, 400, 1, *PULSES),  # says 32, holds 16
        struct.pack("<HHI16H", 18458, 400, 1, *PULSES) + b"x",
        struct.pack(">HHI16H", 18458, 400, 1, *PULSES),
    ],
)
def test_what_is_no_servo_packet(data):
    assert packets.read_servo(data) is None


def test_state_byte_for_byte():
    numbers = [0.1, -0.2, 0.3, 0.0, 1e-12, -9.80665, 1.5, 2.5, -3.25, 1.0, 0.0, 0.0, 0.0, 4, 5, 6]
    assert packets.write_state("robot_0", 12.0025, numbers) == (
        b'\n{"timestamp":12.002500000,"imu":{"gyro":[0.100000000,-0.200000000,0.300000000],'
        b'"accel_body":[0.000000000,0.000000000,-9.806650000]},'
        b'"position":[1.500000000,2.500000000,-3.250000000],'
        b'"quaternion":[1.000000000,0.000000000,0.000000000,0.000000000],'
        b'"velocity":[4.000000000,5.000000000,6.000000000],"no_time_sync":1}\n'
    )


def test_no_key_is_found_in_another_before_it():
    # The parser takes the first place where the text of a key stands.
    text = packets.write_state("robot_0", 1.0, [0.0] * packets.STATE_NUMBERS)
    for key in (b"timestamp", b"imu", b"gyro", b"accel_body", b"position", b"quaternion"):
        assert text.count(key) == 1
    assert text.count(b"velocity") == 1
    assert b": " not in text


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(packets.STATE_NUMBERS))
def test_a_state_that_is_not_finite_is_not_sent(bad, place):
    numbers = [0.0] * packets.STATE_NUMBERS
    numbers[place] = bad
    with pytest.raises(RunError, match=r"robot_3: .*not finite at 2\.500 s"):
        packets.write_state("robot_3", 2.5, numbers)
