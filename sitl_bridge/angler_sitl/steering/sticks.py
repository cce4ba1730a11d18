"""Conversion of a twist to pilot sticks, by the meaning of the sticks in each firmware mode.

Where a mode takes a stick for a velocity (POSHOLD along all axes and in turning, ALT_HOLD up, down
and in turning), its dead zone is skipped and its scale is set by parameters, so that the robot
moves with that twist. Where a mode takes a stick for a fraction of full thrust, a fraction of the
vehicle's top speed is that fraction of the stick: half a stick gives less than half of the thrust
that the speed needs, or more; the pilot closes the loop by eye.
"""

import numpy as np

from angler_mjx.runs.session.interface import Floats, RobotInfo
from angler_sitl.firmware.parameters import CommandLevel

_LEVEL_ZONE, _TURN_ZONE = 0.25, 0.1
"""Dead zones, as fractions of the stick: THR_DZ = 100 and RC4_DZ = 40, of 400 us."""
_UP_ZONE, _MAX_DOWN = 0.1925, 0.925
"""Throttle zone and limit.

The throttle counts 0 to 1000 from 1130 to 1900 us (RC3_DZ = 30), with its middle at 1500 us and
THR_DZ = 100 on either side: its lower end is reached before that of the stick."""
_FULL_TURN_RADPS = np.radians(45.0 * 3.375)
"""Turn rate of full stick: 45 degrees, times ACRO_YAW_P, a second."""


def stick_parameters(level: CommandLevel, robot: RobotInfo) -> dict[str, float]:
    """Return the firmware's scales: full stick is the vehicle's top speed.

    Beyond the dead zone the firmware counts a level stick from there, but not up to 1.
    """
    if level not in ("poshold", "althold"):
        return {}
    level_mps, up_mps = float(np.max(robot.max_speed_mps[:2])), float(robot.max_speed_mps[2])
    return {
        "PILOT_SPEED": float(round(100.0 * level_mps / (1.0 - _LEVEL_ZONE))),
        "PILOT_SPEED_UP": float(round(100.0 * up_mps)),
        "PILOT_SPEED_DN": float(round(100.0 * up_mps)),
    }


def twist_to_sticks(level: CommandLevel, robot: RobotInfo, nu: Floats) -> Floats:
    """Return sticks [4] forward, left, up and turning left, -1 to 1.

    Args:
        level: poshold, althold or manual.
        robot: source of the top speeds.
        nu: [6] in F.
    """
    x, y, z = map(float, robot.max_speed_mps)
    full_scale, zone = np.array([x, y, z, robot.max_turn_radps]), np.zeros(4)
    if level in ("poshold", "althold"):
        full_scale[3], zone[2:] = _FULL_TURN_RADPS, (_UP_ZONE, _TURN_ZONE)
    if level == "poshold":
        full_scale[:2], zone[:2] = max(x, y), _LEVEL_ZONE
    fraction = np.asarray(nu, float)[[0, 1, 2, 5]] / full_scale
    end = np.where((zone == _UP_ZONE) & (fraction < 0.0), _MAX_DOWN, 1.0)
    deflection: Floats = np.sign(fraction) * (zone + (end - zone) * np.abs(fraction))
    return deflection
