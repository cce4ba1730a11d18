"""What a flight is judged by: pure functions of one flight, with derivatives."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.engines.free_flight import FreeFlight
from angler_mjx.sim.robot import thrust_and_power
from angler_mjx.studies.flights.courses import FlightCourse

TILT_RAD = math.radians(60.0)
"""Attitude is bounded if the vehicle never leans more than this; level is 0."""
RATE_RADPS = 10.0
"""Rates are bounded if they never pass this: about twice the fastest turn that the laws ask for
(2.5 1/s times an error of 2, the most that their measure of attitude gives)."""
LEVER_M = 0.3
"""A radian of attitude counts as this many metres."""
LAST_S = 10.0
"""The end of a flight, where a vehicle that is to stand still should."""
TRACK_PERIOD_S = 0.25
"""Between the positions that are kept for figures."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ReferenceMotion:
    """Where a vehicle is to be at the beginning of each control step."""

    pose: jax.Array
    """[n, 4] x, y, z in W, m, and heading, rad."""
    still: jax.Array
    """[] 1 if it is to stand still at the end, else 0."""
    heading: jax.Array
    """[] 1 if its heading counts, else 0."""
    length_m: jax.Array
    """[] length of the way, at least 1 m: what energy is counted by."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FlightMeasures:
    """Of one flight; [n] leads in batches."""

    ise_m2s: jax.Array
    """Integral of the squared error of pose."""
    energy_jpm: jax.Array
    """Electrical energy of the thrusters by metre of way."""
    swing_m: jax.Array
    """RMS motion about its mean over the last ``LAST_S`` of a vehicle that is to stand still."""
    jitter_us: jax.Array
    """RMS change of the thrusters' signals from one control step to the next over ``LAST_S``."""
    rms_m: jax.Array
    """RMS error of position over the flight."""
    end_m: jax.Array
    """Greatest error of position over ``LAST_S``."""
    failed: jax.Array
    """bool: not a number, leans more than 60 degrees, or turns faster than 10 rad/s."""
    position_m: jax.Array
    """[k, 3] in W, every ``TRACK_PERIOD_S``."""


def build_reference(courses: Sequence[FlightCourse], *, heading: bool) -> ReferenceMotion:
    """Where n vehicles are to be, on the host; [n] leads.

    Args:
        courses: of each.
        heading: whether headings count.
    """
    # Arrays of the host stand where those of JAX will.
    arrays: dict[str, Any] = {
        "pose": np.array([course.pose for course in courses]),
        "still": np.array([course.still for course in courses], float),
        "heading": np.full(len(courses), float(heading)),
        "length_m": np.maximum([course.length_m for course in courses], 1.0),
    }
    return ReferenceMotion(**arrays)


def measure_flight(
    flight: FreeFlight, reference: ReferenceMotion, vehicle: VehicleParams, control_dt_s: float
) -> FlightMeasures:
    """Measures of one flight.

    ISE = int (|p - p_d|^2 + l^2 a^2) dt with the squared angle a^2 = 2 (1 - cos tilt) +
    2 (1 - cos(heading error)), which is bounded and has derivatives everywhere.

    Args:
        flight: [n] leads.
        reference: for the same steps.
        vehicle: that flew.
        control_dt_s: control period, s.
    """
    dt = control_dt_s
    off = flight.p - reference.pose[:, :3]
    square = jnp.sum(off**2, axis=1)
    up = jax.vmap(quaternion.world_up)(flight.q)
    yaw = jax.vmap(quaternion.yaw)(flight.q)
    turned = 2.0 * (1.0 - jnp.cos(yaw - reference.pose[:, 3])) * reference.heading
    angle = 2.0 * (1.0 - up[:, 2]) + turned
    _, power = jax.vmap(lambda pwm: thrust_and_power(vehicle, ThrusterPwm(pwm_us=pwm)))(
        flight.pwm_us
    )
    last = round(LAST_S / dt)
    nose = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=1) * reference.heading
    swing = _variance(flight.p[-last:]) + LEVER_M**2 * (
        _variance(up[-last:]) + _variance(nose[-last:])
    )
    change = jnp.diff(flight.pwm_us[-last:], axis=0) * vehicle.thruster_exists
    rate = jnp.sum(flight.nu[:, 3:] ** 2, axis=1)
    bounded = (jnp.min(up[:, 2]) > math.cos(TILT_RAD)) & (jnp.max(rate) < RATE_RADPS**2)
    return FlightMeasures(
        ise_m2s=dt * jnp.sum(square + LEVER_M**2 * angle),
        energy_jpm=dt * jnp.sum(power) / reference.length_m,
        swing_m=reference.still * _smooth_sqrt(swing),
        jitter_us=_smooth_sqrt(
            jnp.sum(change**2) / (change.shape[0] * jnp.sum(vehicle.thruster_exists))
        ),
        rms_m=_smooth_sqrt(jnp.mean(square)),
        end_m=_smooth_sqrt(jnp.max(square[-last:])),
        # Comparisons with what is not a number are false.
        failed=~(bounded & jnp.isfinite(jnp.sum(square))),
        position_m=flight.p[:: round(TRACK_PERIOD_S / dt)],
    )


def _variance(rows: jax.Array) -> jax.Array:
    """[] mean squared distance of rows [n, k] from their mean."""
    return jnp.mean(jnp.sum((rows - jnp.mean(rows, axis=0)) ** 2, axis=1))


def _smooth_sqrt(square: jax.Array) -> jax.Array:
    """Square root with a derivative at 0."""
    return jnp.sqrt(square + 1e-12)
