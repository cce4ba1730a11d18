"""Commands in W and F as MAVLink messages in NED and FRD."""

import math

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.frames import vector_enu_to_ned
from angler_mjx.runs.session.interface import Floats
from angler_sitl.wire.link import MavlinkMessage

_N_OVERRIDE_CHANNELS = 18
"""Number of channels of an override; those that are 0 stay as they are."""
_ACCELERATION_IGNORED = 0x1C0
"""Type mask of a position target: the firmware accepts none with accelerations."""
_YAW_RATE_IGNORED = 0x800
_DIAGONAL = [0, 6, 11, 15, 18, 20]
"""Diagonal indices of a matrix [6, 6], in the rows of its upper triangle."""
_STICK, _UP_NEUTRAL, _UP = 1000, 500, 500
"""Full deflections of the sticks; up and down has the range 0 to 1000."""


def build_override(sysid: int, pwm_us: Floats) -> MavlinkMessage:
    """Build thruster signals as radio channels, which the firmware passes through to its outputs.

    Args:
        sysid: of the autopilot.
        pwm_us: [n_thruster].
    """
    signals = np.rint(pwm_us).astype(int).tolist()
    channels = [*signals, *[0] * (_N_OVERRIDE_CHANNELS - len(signals))]
    return dialect.MAVLink_rc_channels_override_message(sysid, 1, *channels)


def build_position_target(
    sysid: int,
    time_s: float,
    position_m: Floats,
    velocity_mps: Floats,
    yaw_rad: float,
    origin_ned_m: Floats | None = None,
) -> MavlinkMessage:
    """Build a position target with its velocity and heading.

    Args:
        sysid: of the autopilot.
        time_s: its clock.
        position_m: [3] in W.
        velocity_mps: [3] in W.
        yaw_rad: about z up, 0 = east.
        origin_ned_m: [3] origin of the autopilot's filter in NED from W's origin; W's if left out.
    """
    position, velocity = (
        vector_enu_to_ned(np.asarray(v, float)) for v in (position_m, velocity_mps)
    )
    if origin_ned_m is not None:
        position = position - origin_ned_m
    return dialect.MAVLink_set_position_target_local_ned_message(
        round(time_s * 1e3),
        sysid,
        1,
        dialect.MAV_FRAME_LOCAL_NED,
        _ACCELERATION_IGNORED | _YAW_RATE_IGNORED,
        *position.tolist(),
        *velocity.tolist(),
        *(0.0, 0.0, 0.0),
        heading_to_ned(yaw_rad),
        0.0,
    )


def build_home(sysid: int, latitude_deg: float, longitude_deg: float) -> MavlinkMessage:
    """Build the command that puts home at the surface, at altitude 0."""
    return dialect.MAVLink_command_int_message(
        sysid,
        1,
        dialect.MAV_FRAME_GLOBAL,
        dialect.MAV_CMD_DO_SET_HOME,
        *(0, 0),
        *(0.0, 0.0, 0.0, 0.0),
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        0.0,
    )


def build_manual_control(sysid: int, deflection: Floats) -> MavlinkMessage:
    """Build the message of a pilot's sticks.

    Args:
        sysid: of the autopilot.
        deflection: [4] forward, left, up and turning left, each -1 to 1.
    """
    forward, left, up, turn = np.clip(deflection, -1.0, 1.0)
    x, y, r = (round(_STICK * fraction) for fraction in (forward, -left, -turn))
    return dialect.MAVLink_manual_control_message(sysid, x, y, _UP_NEUTRAL + round(_UP * up), r, 0)


def vision_position(
    time_s: float, p: Floats, q: Floats, position_std_m: Floats, attitude_std_rad: Floats
) -> MavlinkMessage:
    """Build a pose of external navigation.

    Args:
        time_s: the autopilot's clock.
        p: [3] NED.
        q: [4] FRD to NED.
        position_std_m: [3] north, east, down.
        attitude_std_rad: [3] about these axes.
    """
    covariance = np.zeros(21)
    covariance[_DIAGONAL] = np.square([*position_std_m, *attitude_std_rad])
    return dialect.MAVLink_vision_position_estimate_message(
        round(time_s * 1e6), *p.tolist(), *quaternion_to_euler(q), covariance.tolist()
    )


def vision_speed(time_s: float, velocity_mps: Floats, std_mps: Floats) -> MavlinkMessage:
    """Build a velocity [3] over ground, NED, of external navigation."""
    covariance = np.diag(np.square(std_mps)).ravel()
    return dialect.MAVLink_vision_speed_estimate_message(
        round(time_s * 1e6), *velocity_mps.tolist(), covariance.tolist()
    )


def quaternion_to_euler(q: NDArray[np.floating]) -> tuple[float, float, float]:
    """Return roll, pitch, yaw, rad, of an attitude FRD to NED (Fossen 2021, eq. 2.28 to 2.30)."""
    w, x, y, z = map(float, q)
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z))))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def heading_to_ned(yaw_rad: float) -> float:
    """Return the heading clockwise from north of one counter-clockwise from east; in [-pi, pi]."""
    return math.remainder(0.5 * math.pi - float(yaw_rad), math.tau)
