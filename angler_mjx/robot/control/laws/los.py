"""Line-of-sight path following in three dimensions: from way-points to a velocity over ground.

On the segment from a to b with tangent t, the error c of position across the path (its horizontal
part is the cross-track error, the rest the vertical one) and the lookahead D::

    v = U (D t - c - sigma y) / |D t - c - sigma y|,   y' = D c / (|c + sigma y|^2 + D^2)

In a plane that is Fossen's chi_d = pi_h - atan((e + sigma y) / D) with the integral of Borhaug,
Pavlov and Pettersen (CDC 2008; Fossen 2021, chapter 12): y steers against a current when
the velocity below is not held exactly. Vectors do without azimuth and elevation, so vertical
segments are no exception. Time does not count: U is the speed that the trajectory plans for the
segment, and a robot that is held up goes on from where it is. The last way-point is held.

A vehicle that flies by its fins keeps its speed, turns its bow to the course and its pitch to the
climb of v (Fossen 2021, section 12.4), and passes the last way-point. Where it has missed it, it
goes straight on until it has room to turn, and comes back.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_kernels.table import take_row
from angler_mjx.robot.control.commands import BodyTwist, Estimate
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.control.laws.model import wrap_angle
from angler_mjx.robot.vehicles.fins import flies_by_fins
from angler_mjx.robot.vehicles.params import VehicleParams

_MOVES_MPS = 0.05
"""Horizontally slower than this, the heading stays."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LosGains:
    """Gains of the guidance."""

    lookahead_m: float = 0.35
    """D: how far ahead on the path the robot aims. Bends of radius R are cut by about D^2 / (2 R);
    with the velocity loop's k the way back to the path has a damping of sqrt(k D / U) / 2, 0.66 at
    0.5 m/s with the default gains."""
    integral_per_s: float = 0.1
    """sigma: weight of the integral of the error; 0 for plain line of sight."""
    integral_limit_m: float = 5.0
    """Bound of each component of y."""
    switch_radius_m: float = 0.3
    """Distance along the path before a way-point at which the next segment begins."""
    position_per_s: float = 0.8
    """Velocity per metre to the last way-point."""
    attitude_per_s: float = 2.5
    """Angular velocity per radian."""
    yaw_rate_radps: float = 0.6
    """How fast the heading reference turns towards the course."""
    fin_lookahead_m: float = 8.0
    """D of vehicles that fly by their fins: more than the radius of their turn."""
    fin_switch_radius_m: float = 2.5
    """``switch_radius_m`` of these."""
    fin_return_m: float = 12.0
    """Distance from a missed last way-point at which these turn back to it."""
    fin_attitude_per_s: float = 0.8
    """``attitude_per_s`` of these."""
    fin_rate_radps: float = 0.15
    """Fastest turn and change of pitch of these: out of a harder turn a hull that is not stable in
    yaw comes by its rudder's whole moment."""
    fin_pitch_rad: float = 0.4
    """Steepest climb or dive of these."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LosCarry:
    """Memory of the guidance."""

    segment: jax.Array
    """int32 [] index of the way-point where the present segment begins."""
    integral: jax.Array
    """[3] y, across the path, in W."""
    yaw_rad: jax.Array
    """[] heading reference."""


def check(gains: LosGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    positive = ("lookahead_m", "position_per_s", "yaw_rate_radps")
    check_gains("los", gains, positive=(*positive, "fin_lookahead_m", "fin_rate_radps"))


def reset(estimate: Estimate) -> LosCarry:
    """Memory of a robot at the beginning of its path."""
    return LosCarry(
        segment=jnp.zeros((), jnp.int32),
        integral=jnp.zeros_like(estimate.p),
        yaw_rad=quaternion.yaw(estimate.q),
    )


def progress_s(carry: LosCarry, path: Trajectory) -> jax.Array:
    """Return the planned time [] s at the end of the segment that the robot is on."""
    return take_row(path.time_s, carry.segment + 1)


def step(
    gains: LosGains,
    vehicle: VehicleParams,
    carry: LosCarry,
    estimate: Estimate,
    command: Trajectory,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[LosCarry, BodyTwist]:
    """One control step.

    Args:
        gains: of the guidance.
        vehicle: of one robot.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the way-points; of their times only the speeds matter.
        dt: control period, s.
        density: of the water, kg/m^3; not used.
        gravity: m/s^2; not used.

    Returns:
        The new memory, and the velocity over ground to have.
    """
    lookahead_m: jax.Array | float = gains.lookahead_m
    switch_m: jax.Array | float = gains.switch_radius_m
    flies = None if vehicle.fins is None else flies_by_fins(vehicle)
    if flies is not None:
        lookahead_m = jnp.where(flies, gains.fin_lookahead_m, lookahead_m)
        switch_m = jnp.where(flies, gains.fin_switch_radius_m, switch_m)
    k = select_segment(switch_m, carry.segment, estimate.p, command)
    start, tangent, length, speed, last = segment_geometry(command, k)
    speed = jnp.minimum(speed, model.speed_limit(vehicle))
    offset = estimate.p - start
    along = jnp.sum(offset * tangent)
    across = offset - along * tangent
    # After a corner, what was along the new path does not count.
    held = carry.integral - jnp.sum(carry.integral * tangent) * tangent
    pull = across + gains.integral_per_s * held
    square = lookahead_m**2
    integral = held + dt * lookahead_m * across / (jnp.sum(pull**2) + square)
    aim = lookahead_m * tangent - pull
    velocity = speed * aim / jnp.sqrt(jnp.sum(pull**2) + square)
    arriving = last & ((length - along) * gains.position_per_s < speed + 1e-6)
    home = gains.position_per_s * (start + length * tangent - estimate.p)
    approach = jnp.where(arriving, model.limit_norm(home, jnp.maximum(speed, 0.1)), velocity)
    # Without sway the bow must point home as well.
    holds = arriving & (vehicle.terminal_speed_mps[1] > 0) if vehicle.steered else arriving
    if flies is not None:
        passed = last & (along >= length)
        onward = jnp.where(passed, _return_course(gains, estimate, home), velocity)
        approach, holds = jnp.where(flies, onward, approach), holds & ~flies
    max_rate: jax.Array | float = gains.yaw_rate_radps
    if flies is not None:
        max_rate = jnp.where(flies, gains.fin_rate_radps, max_rate)
    yaw, yaw_rate = _turn_heading(max_rate, carry.yaw_rad, approach, holds, dt)
    up = quaternion.world_up(estimate.q)
    turn = yaw_rate * up + gains.attitude_per_s * model.attitude_error(estimate.q, yaw)
    limit = gains.integral_limit_m
    carry = LosCarry(segment=k, integral=jnp.clip(integral, -limit, limit), yaw_rad=yaw)
    nu = jnp.concatenate([quaternion.rotate_inverse(estimate.q, approach), turn])
    if flies is not None:
        flown = _fly(gains, estimate, approach, yaw, yaw_rate, jnp.maximum(speed, _MOVES_MPS))
        nu = jnp.where(flies, flown, nu)
    return carry, BodyTwist(nu=nu)


def _return_course(gains: LosGains, estimate: Estimate, home: jax.Array) -> jax.Array:
    """Return the direction [3] in W of a vehicle that has passed the last way-point.

    Ahead until it has room to turn, then home.

    Args:
        gains: of the guidance.
        estimate: of the vehicle.
        home: [3] along the way to the last way-point, ``position_per_s`` times its length.
    """
    ahead = quaternion.rotate(estimate.q, jnp.array([1.0, 0.0, 0.0], home.dtype))
    near = jnp.sum(home**2) < (gains.position_per_s * gains.fin_return_m) ** 2
    level = ahead * jnp.array([1.0, 1.0, 0.0], home.dtype)
    return jnp.where((jnp.sum(ahead * home) < 0.0) & near, level, home)


def _fly(
    gains: LosGains,
    estimate: Estimate,
    velocity: jax.Array,
    yaw: jax.Array,
    yaw_rate: jax.Array,
    speed: jax.Array,
) -> jax.Array:
    """Return the twist [6] of a vehicle that goes where its bow points.

    Args:
        gains: of the guidance.
        estimate: of the vehicle.
        velocity: [3] over ground to have, in W; its direction counts.
        yaw: [] heading reference.
        yaw_rate: [] its rate.
        speed: [] m/s ahead.
    """
    level = jnp.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + 1e-12)
    climb = jnp.clip(jnp.arctan2(velocity[2], level), -gains.fin_pitch_rad, gains.fin_pitch_rad)
    # y is to the left, so that a positive turn about it lowers the bow.
    half = -0.5 * climb
    pitch = jnp.stack([jnp.cos(half), jnp.zeros_like(half), jnp.sin(half), jnp.zeros_like(half)])
    wanted = quaternion.multiply(quaternion.from_yaw(yaw), pitch)
    error = quaternion.multiply(quaternion.conjugate(estimate.q), wanted)
    error = 2.0 * jnp.where(error[0] < 0, -1.0, 1.0) * error[1:]
    limit = gains.fin_rate_radps
    turn = yaw_rate * quaternion.world_up(estimate.q)
    turn = jnp.clip(turn + gains.fin_attitude_per_s * error, -limit, limit)
    return jnp.concatenate([jnp.stack([speed, jnp.zeros_like(speed), jnp.zeros_like(speed)]), turn])


def select_segment(
    switch_m: jax.Array | float, k: jax.Array, p: jax.Array, path: Trajectory
) -> jax.Array:
    """Index [] of the segment to follow: the next one when this one is nearly done."""
    start, tangent, length, _, last = segment_geometry(path, k)
    done = jnp.sum((p - start) * tangent) > length - switch_m
    return jnp.where(done & ~last, k + 1, k)


def segment_geometry(
    path: Trajectory, k: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]:
    """Start [3], unit tangent [3], length [], planned speed [] and whether it is the last, of k."""
    n = path.time_s.shape[0]
    start, end = take_row(path.position_m, k), take_row(path.position_m, k + 1)
    begin, until = take_row(path.time_s, k), take_row(path.time_s, k + 1)
    length = jnp.sqrt(jnp.sum((end - start) ** 2))
    real = length > 1e-6
    tangent = (end - start) / jnp.where(real, length, 1.0)
    span = until - begin
    speed = jnp.where(span > 0, length / jnp.where(span > 0, span, 1.0), 0.0)
    after = take_row(path.time_s, jnp.minimum(k + 2, n - 1))
    return start, tangent, length, speed, after <= until


def _turn_heading(
    max_rate: jax.Array | float, yaw: jax.Array, velocity: jax.Array, holds: jax.Array, dt: float
) -> tuple[jax.Array, jax.Array]:
    """Heading reference [] rad that turns towards the course, and its rate [] rad/s."""
    moves = (velocity[0] ** 2 + velocity[1] ** 2 > _MOVES_MPS**2) & ~holds
    course = jnp.arctan2(jnp.where(moves, velocity[1], 0.0), jnp.where(moves, velocity[0], 1.0))
    rate = jnp.where(moves, jnp.clip(wrap_angle(course - yaw) / dt, -max_rate, max_rate), 0.0)
    return wrap_angle(yaw + rate * dt), rate
