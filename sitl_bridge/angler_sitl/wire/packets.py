"""Bytes between ArduSub and its physics: servo packets in, state text out.

The servo packet is little endian: u16 magic, u16 frame_rate, u32 frame_count, then 16 or 32 x u16
pulse widths. The magic gives the number of channels; it can change at run time. The frame_rate is
advisory and is not read.

The reply looks like JSON, but the parser searches for the key text and reads the value behind it:
no space may stand after a colon, the line must end, and no key may hold the name of a later key.
A non-finite acceleration or rate ends the autopilot at once, so none is ever sent.
"""

import math
import struct
from collections.abc import Sequence

from angler_mjx.errors import RunError

MAX_SERVO_BYTES = 72
"""Length of the longest servo packet."""

_HEADER = struct.Struct("<HHI")
_PULSE_FORMATS = {
    18458: (40, struct.Struct("<16H")),
    29569: (
        MAX_SERVO_BYTES,
        struct.Struct("<16H"),
    ),  # 32 channels; no vehicle here has more than 16
}

STATE_NUMBERS = 16
"""Rates [3], specific force [3], position [3], quaternion [4] and velocity [3] of one vehicle."""

# Nanometres and nanoseconds: far below the resolution of the autopilot's float32.
_VECTOR = b"[%.9f,%.9f,%.9f]"
_STATE = (
    b'\n{"timestamp":%.9f,"imu":{"gyro":'
    + _VECTOR
    + b',"accel_body":'
    + _VECTOR
    + b'},"position":'
    + _VECTOR
    + b',"quaternion":[%.9f,%.9f,%.9f,%.9f],"velocity":'
    + _VECTOR
    # No own pace of the autopilot: the pace is kept here for all at once.
    + b',"no_time_sync":1}\n'
)


def read_servo(data: bytes | memoryview) -> tuple[int, tuple[int, ...]] | None:
    """Return frame number and the first 16 pulse widths, us; None unless a servo packet."""
    if len(data) < _HEADER.size:
        return None
    magic, _, frame = _HEADER.unpack_from(data)
    size, pulses = _PULSE_FORMATS.get(magic, (0, None))
    if pulses is None or len(data) != size:
        return None
    return frame, pulses.unpack_from(data, _HEADER.size)


def write_state(name: str, time_s: float, numbers: Sequence[float]) -> bytes:
    """Return the reply to one vehicle.

    Args:
        name: of the vehicle, for the message.
        time_s: the autopilot's clock from then on.
        numbers: `STATE_NUMBERS` in the order given there: rad/s and m/s^2 in body FRD, m in NED,
            FRD to NED with the scalar first, m/s in NED.

    Raises:
        RunError: a number is not finite.
    """
    # A sum is finite only if all terms are; no state comes near to overflowing it.
    if not math.isfinite(sum(numbers)):
        raise RunError(
            f"{name}: its simulated state is not finite at {time_s:.3f} s ({list(numbers)}); "
            "it was not sent, for it would end the autopilot"
        )
    return _STATE % (time_s, *numbers)
