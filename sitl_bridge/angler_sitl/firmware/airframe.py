"""Match of a vehicle's thrusters to the motors of an ArduSub frame."""

from collections.abc import Sequence

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.config import Thruster, VehicleConfig

_LEVEL = ((0, 0, 1, 0, -1, 1), (0, 0, -1, 0, -1, -1), (0, 0, -1, 0, 1, 1), (0, 0, 1, 0, 1, -1))
MIXER_FACTORS: dict[str, tuple[tuple[int, ...], ...]] = {
    "vectored": (*_LEVEL, (1, 0, 0, -1, 0, 0), (-1, 0, 0, -1, 0, 0)),
    "vectored_6dof": (
        *_LEVEL,
        (1, -1, 0, -1, 0, 0),
        (-1, -1, 0, -1, 0, 0),
        (1, 1, 0, -1, 0, 0),
        (-1, 1, 0, -1, 0, 0),
    ),
}
"""Mixer of each frame, a row per motor: roll right, pitch up, yaw right, up, forward, right."""

FRAME_CONFIGS = {"vectored": 1, "vectored_6dof": 2}
"""Value of FRAME_CONFIG."""

_AXES = ("roll", "pitch", "yaw", "throttle", "forward", "lateral")


def find_frame(vehicle: VehicleConfig) -> str:
    """Return the name of a vehicle's frame.

    Raises:
        ConfigError: the file names no frame, or its thrusters are not the motors of that frame.
    """
    if vehicle.ardusub is None:
        raise ConfigError(
            f"vehicle {vehicle.name!r} names no ArduSub frame, so no real ArduSub can steer it; "
            f"add a table [ardusub] with frame = one of {', '.join(MIXER_FACTORS)} to its file"
        )
    frame = vehicle.ardusub.frame
    layout, rows = vehicle.thrusters.layout, MIXER_FACTORS[frame]
    if len(layout) != len(rows):
        raise ConfigError(
            f"vehicle {vehicle.name!r}: {len(layout)} thrusters, but the ArduSub frame {frame!r} "
            f"has {len(rows)} motors; correct [ardusub] frame or [thrusters] layout"
        )
    centre = vehicle.base.center_of_mass_m
    for number, (thruster, row) in enumerate(zip(layout, rows, strict=True), start=1):
        wrong = _mismatched_axes(thruster, centre, row)
        if wrong:
            raise ConfigError(
                f"vehicle {vehicle.name!r}: thruster {thruster.name!r} does not act as motor "
                f"{number} of the ArduSub frame {frame!r} in {', '.join(wrong)}; correct the order "
                "or the directions of [thrusters] layout, or [ardusub] frame"
            )
    return frame


def _mismatched_axes(
    thruster: Thruster, centre: Sequence[float], row: tuple[int, ...]
) -> list[str]:
    """Return the axes in which the mixer would push the wrong way.

    A torque that the mixer does not use (the pitch of a vertical thruster off the middle, for
    example) is no fault: the vehicle has to handle it.
    """
    force = np.asarray(thruster.direction)
    torque = np.cross(np.asarray(thruster.position_m) - np.asarray(centre), force)
    # Axes of F are forward, left, up: ArduSub's pitch, yaw and lateral count the other way.
    effects = [torque[0], -torque[1], -torque[2], force[2], force[0], -force[1]]
    return [
        axis
        for axis, effect, sign in zip(_AXES, effects, row, strict=True)
        if sign and effect * sign <= 0
    ]
