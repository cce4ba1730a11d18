"""What robots did, on the host, and numbers that tell it: rise, settling, swings, errors."""

import math
from dataclasses import dataclass

import numpy as np

from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.engines.free_flight import FreeFlight
from angler_mjx.sim.state import SimSpec

BAND = 0.02
"""Share of the step within which it has settled."""
SWING_M, SWING_RAD = 0.02, math.radians(1.0)
"""Swings below these are rest."""


@dataclass(frozen=True, kw_only=True)
class FlightTrack:
    """What n robots did, on the host."""

    time_s: FloatArray
    """[t]."""
    position_m: FloatArray
    """[n, t, 3] in W."""
    yaw_rad: FloatArray
    """[n, t] heading, unwrapped along t."""
    tilt_rad: FloatArray
    """[n, t] angle between the vehicle's up and W's."""
    rate_radps: FloatArray
    """[n, t] magnitude of the angular velocity."""


def build_track(spec: SimSpec, flight: FreeFlight) -> FlightTrack:
    """A flight [n] on the host, in words of attitude that people use."""
    q = np.asarray(flight.q, float)
    w, x, y, z = np.moveaxis(q, -1, 0)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return FlightTrack(
        time_s=spec.control_dt_s * np.arange(q.shape[1], dtype=np.float64),
        position_m=np.asarray(flight.p, float),
        yaw_rad=np.unwrap(yaw, axis=1),
        tilt_rad=2 * np.arcsin(np.minimum(np.hypot(x, y), 1.0)),
        rate_radps=np.linalg.norm(np.asarray(flight.nu, float)[..., 3:], axis=-1),
    )


def is_oscillating(pose: FloatArray, last: int) -> bool:
    """Whether a pose [t, 4] oscillates without end.

    It does where any coordinate swings by more than ``SWING_M`` or ``SWING_RAD`` over its last
    rows, and by more than half of its swing in as many rows before.

    Args:
        pose: x, y, z, m, and heading, rad.
        last: minus the number of its last rows.
    """
    now, before = np.ptp(pose[last:], axis=0), np.ptp(pose[2 * last : last], axis=0)
    thresholds = np.array([SWING_M] * 3 + [SWING_RAD])
    return bool(np.any((now > thresholds) & (now > 0.5 * before)))


def pose_error(pose: FloatArray, goal: FloatArray) -> FloatArray:
    """Errors of poses [t, 4] from a goal [4]; a full turn is none."""
    error = pose - goal
    error[:, 3] = np.mod(error[:, 3] + math.pi, 2 * math.pi) - math.pi
    return error


def rise_of(time_s: FloatArray, response: FloatArray) -> float:
    """From 10 % to 90 % of a step [t]; nan if it never came there."""
    if response.max() < 0.9:
        return math.nan
    begin, end = (float(time_s[np.argmax(response >= fraction)]) for fraction in (0.1, 0.9))
    return end - begin


def settling_of(time_s: FloatArray, response: FloatArray) -> float:
    """When a step [t] came within ``BAND`` for good; inf if never."""
    out = np.flatnonzero(np.abs(response - 1.0) > BAND)
    after = out[-1] + 1 if out.size else 0
    return float(time_s[after]) if after < len(time_s) else math.inf


def rms(errors: FloatArray) -> float:
    """Root of the mean square length of errors [t, 3]."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def find_nearest_points(position: FloatArray, path: FloatArray) -> FloatArray:
    """Points [t, 3] of a path [n, 3] nearest to positions [t, 3], on the lines between its rows."""
    start, step = path[:-1], np.diff(path, axis=0)
    long = np.maximum(np.sum(step**2, axis=1), 1e-12)
    from_start = position[:, None, :] - start
    fraction = np.clip(np.sum(from_start * step, axis=2) / long, 0.0, 1.0)
    points = start + fraction[..., None] * step
    best = np.argmin(np.sum((position[:, None, :] - points) ** 2, axis=2), axis=1)
    nearest_points: FloatArray = points[np.arange(len(position)), best]
    return nearest_points
