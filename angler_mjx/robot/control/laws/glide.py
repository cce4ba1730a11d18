"""Gliding along a path: a sawtooth in depth by ballast and pitch, and line of sight by roll.

A glider sinks with its tanks full and its bow down, rises with them empty and its bow up, and
changes over at a band above and below the path (Graver, PhD thesis, Princeton 2005, chapter 1).
Towards the last way-point the band narrows, so that it is passed at its depth. With theta_d the
pitch of the glide and m z_b the static moment of the hull, the moving mass makes the moment::

    h_x = -m z_b (tan theta_d + k_p (theta_d - theta) + y),   y' = k_i (theta_d - theta)

kg m ahead of the middle. The course is that of line of sight on the path seen from above (Fossen
2021, section 12.4). A mass to the left lowers the left side, where weight pulls the hull while it
sinks, at v > 0. Weight and buoyancy have no moment about the vertical: in a steady turn about it
those of the slip v and of damping balance, so that the sense of the turn is that of::

    b = (K_uv sin theta_d + N_b cos theta_d) sign(v),   N_b = N_uv - (Y_A - X_A)

with the lift of the hull and the Munk moment in N_b, and sign(v) = -sign(theta_d). Then::

    h_y = h_max sign(b) k_c (chi_d - chi)

Fins are left out of b. A last way-point that was missed is met again as by `los`.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_kernels.cross_damping import PRODUCT_PAIRS
from angler_kernels.table import take_row
from angler_mjx.robot.control.commands import Estimate, ThrusterPwm
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.control.laws.los import segment_geometry, select_segment
from angler_mjx.robot.control.laws.model import wrap_angle
from angler_mjx.robot.vehicles.fins import HALF_RANGE_US, NEUTRAL_US
from angler_mjx.robot.vehicles.params import VehicleParams

_UV = PRODUCT_PAIRS.index((0, 1))
_MOVES_MPS = 0.1
"""Horizontally slower than this, the bow counts in place of the course."""
_INTEGRAL_LIMIT = 0.5
"""Bound of y."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GlideGains:
    """Gains of gliding."""

    pitch_rad: float = 0.6
    """theta_d: bow down while sinking, up while rising."""
    band_m: float = 8.0
    """Height above and depth below the path that the sawtooth has."""
    lead_s: float = 10.0
    """Time ahead of the ends of the band at which it changes over: about half a stroke of the pump,
    in which it goes on."""
    narrowing: float = 0.3
    """Greatest band as a fraction of the way to the last way-point."""
    min_band_m: float = 1.0
    """Least band, at the last way-point."""
    surface_m: float = 6.0
    """Depth above which it does not rise on purpose."""
    pitch_gain: float = 2.0
    """k_p."""
    pitch_integral_per_s: float = 0.05
    """k_i."""
    lookahead_m: float = 80.0
    """How far ahead on the path it aims: more than the radius of its turn is steady."""
    course_per_rad: float = 4.0
    """k_c: the mass to the side is at its end at an error of one over this."""
    switch_radius_m: float = 15.0
    """Distance along the path before a way-point at which the next segment begins."""
    return_m: float = 150.0
    """Distance from a missed last way-point at which it turns back to it."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GlideCarry:
    """Memory of gliding."""

    segment: jax.Array
    """int32 [] index of the way-point where the present segment begins."""
    sinks: jax.Array
    """bool [] whether it is to sink."""
    integral: jax.Array
    """[] y."""


def check(gains: GlideGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("glide", gains, positive=("pitch_rad", "band_m", "lookahead_m", "min_band_m"))


def reset(estimate: Estimate) -> GlideCarry:
    """Memory of a robot at the beginning of its path."""
    return GlideCarry(
        segment=jnp.zeros((), jnp.int32),
        sinks=jnp.ones((), bool),
        integral=jnp.zeros_like(estimate.p[0]),
    )


def progress_s(carry: GlideCarry, path: Trajectory) -> jax.Array:
    """Return the planned time [] s at the end of the segment that the robot is on."""
    return take_row(path.time_s, carry.segment + 1)


def step(
    gains: GlideGains,
    vehicle: VehicleParams,
    carry: GlideCarry,
    estimate: Estimate,
    command: Trajectory,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[GlideCarry, ThrusterPwm]:
    """One control step.

    Args:
        gains: of gliding.
        vehicle: of one robot, with tanks and moving masses.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the way-points; their times do not matter.
        dt: control period, s.
        density: of the water, kg/m^3; not used.
        gravity: m/s^2; not used.

    Returns:
        The new memory, and the signals of all actuators.

    Raises:
        ValueError: no vehicle of the fleet has ballast or moving masses.
    """
    trim = vehicle.trim
    if trim is None:
        raise ValueError("the law glide needs ballast and moving masses")
    k = select_segment(gains.switch_radius_m, carry.segment, estimate.p, command)
    start, tangent, length, _, last = segment_geometry(command, k)
    offset = estimate.p - start
    along = jnp.sum(offset * tangent)
    end = start + length * tangent
    velocity = quaternion.rotate(estimate.q, estimate.nu[:3])
    height = estimate.p[2] + gains.lead_s * velocity[2]
    left_m = jnp.sqrt(jnp.sum((end - estimate.p)[:2] ** 2))
    sinks = _change_over(gains, carry.sinks, height, start[2] + along * tangent[2], left_m)
    half = jnp.where(sinks, -gains.pitch_rad, gains.pitch_rad)
    ahead = quaternion.rotate(estimate.q, jnp.array([1.0, 0.0, 0.0], estimate.p.dtype))
    error = half - jnp.arcsin(jnp.clip(ahead[2], -1.0, 1.0))
    integral = carry.integral + dt * gains.pitch_integral_per_s * error
    integral = jnp.clip(integral, -_INTEGRAL_LIMIT, _INTEGRAL_LIMIT)
    righting = vehicle.mass_kg * vehicle.p_cb_m[2]
    forward_kgm = -righting * (jnp.tan(half) + gains.pitch_gain * error + integral)
    wanted = _wanted_course(gains, offset, along, tangent, length, last, ahead)
    moves = velocity[0] ** 2 + velocity[1] ** 2 > _MOVES_MPS**2
    course = jnp.where(moves, _bearing(velocity[0], velocity[1]), _bearing(ahead[0], ahead[1]))
    turn = jnp.clip(gains.course_per_rad * wrap_angle(wanted - course), -1.0, 1.0)
    turn = turn * _turn_sense(vehicle, half)
    return (
        GlideCarry(segment=k, sinks=sinks, integral=integral),
        _to_signals(vehicle, jnp.where(sinks, 1.0, -1.0), forward_kgm, turn),
    )


def _change_over(
    gains: GlideGains,
    sinks: jax.Array,
    height_m: jax.Array,
    path_m: jax.Array,
    left_m: jax.Array,
) -> jax.Array:
    """Return whether a robot is to sink.

    Args:
        gains: of gliding.
        sinks: bool [] whether it was to.
        height_m: [] of it, soon, in W.
        path_m: [] of the nearest point of its path, in W.
        left_m: [] way to the last way-point, seen from above.
    """
    band = jnp.clip(gains.narrowing * left_m, gains.min_band_m, gains.band_m)
    top = jnp.minimum(path_m + band, -gains.surface_m)
    return jnp.where(sinks, height_m > path_m - band, height_m > top)


def _wanted_course(
    gains: GlideGains,
    offset: jax.Array,
    along: jax.Array,
    tangent: jax.Array,
    length: jax.Array,
    last: jax.Array,
    ahead: jax.Array,
) -> jax.Array:
    """Return the course [] rad by line of sight, or home past a missed last way-point."""
    aim = gains.lookahead_m * tangent - (offset - along * tangent)
    home = length * tangent - offset
    away = jnp.sum(home[:2] ** 2) < gains.return_m**2
    back = jnp.where((jnp.sum(ahead[:2] * home[:2]) < 0.0) & away, ahead, home)
    to = jnp.where(last & (along >= length), back, aim)
    return _bearing(to[0], to[1])


def _bearing(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return the direction [] rad of x and y [], 0 where both are."""
    is_none = (x == 0.0) & (y == 0.0)
    return jnp.arctan2(y, jnp.where(is_none, 1.0, x))


def _turn_sense(vehicle: VehicleParams, pitch: jax.Array) -> jax.Array:
    """Return [] 1 where a mass to the left turns a vehicle at a pitch [] to the left, or -1."""
    yaw = vehicle.M_A[0, 0] - vehicle.M_A[1, 1]
    roll = jnp.zeros_like(yaw)
    if vehicle.cross_damping is not None:
        products = vehicle.cross_damping.products
        yaw, roll = yaw + products[5, _UV], products[3, _UV]
    moment = roll * jnp.sin(pitch) + yaw * jnp.cos(pitch)
    return jnp.where(moment * pitch > 0.0, -1.0, 1.0)


def _to_signals(
    vehicle: VehicleParams, heavy: jax.Array, forward_kgm: jax.Array, side: jax.Array
) -> ThrusterPwm:
    """Return signals of all actuators.

    Args:
        vehicle: of one robot.
        heavy: [] of tanks: 1 full, -1 empty.
        forward_kgm: [] moment of the masses along x, kg m.
        side: [] of the masses along y, as a fraction of their way.
    """
    trim = vehicle.trim
    if trim is None:
        raise ValueError("the law glide needs ballast and moving masses")
    x, y = trim.axis[:, 0], trim.axis[:, 1]
    reach = trim.mass_kg * trim.limit * x * x
    full_kgm = jnp.maximum(jnp.sum(reach), 1e-6)
    travel = trim.takes_water * heavy + x * forward_kgm / full_kgm + y * side
    return ThrusterPwm(pwm_us=NEUTRAL_US + HALF_RANGE_US * jnp.clip(travel, -1.0, 1.0))
