"""What the laws share: errors of a pose, bounded velocities, and the vehicle's own dynamics."""

import jax
import jax.numpy as jnp

from angler_kernels import quaternion, rigid_body
from angler_kernels.rigid_body import matrix_times
from angler_mjx.robot.control.commands import Estimate, TrackingTarget
from angler_mjx.robot.vehicles.damping import damping_wrench
from angler_mjx.robot.vehicles.params import VehicleParams

SPEED_FRACTION = 0.9
"""No law asks for more than this share of the vehicle's slowest terminal speed."""
TURN_RAD = 0.5
"""A vehicle without sway turns towards where it must go as if that were no farther off its bow."""
MOVES_MPS = 0.05
"""Told to go slower than this over the ground, it keeps the heading that it was asked for."""


def per_axis(linear: float, angular: float, like: jax.Array) -> jax.Array:
    """Vector [6] of one number for the three linear axes and one for the three angular ones."""
    return jnp.array([linear] * 3 + [angular] * 3, like.dtype)


def attitude_error(q: jax.Array, yaw: jax.Array) -> jax.Array:
    """Rotation [3] rad, in F, that leads from attitude q [4] to level with heading yaw [].

    Twice the vector part of the error quaternion, the short way round: exact to third order.
    """
    error = quaternion.multiply(quaternion.conjugate(q), quaternion.from_yaw(yaw))
    return 2.0 * jnp.where(error[0] < 0, -1.0, 1.0) * error[1:]


def limit_norm(vector: jax.Array, limit: jax.Array) -> jax.Array:
    """The vector [3], shortened to a length of ``limit`` [] where it is longer."""
    length = jnp.sqrt(jnp.sum(vector**2) + 1e-12)
    return vector * jnp.minimum(1.0, limit / length)


def speed_limit(vehicle: VehicleParams) -> jax.Array:
    """Speed [] m/s up to which a vehicle can be told to go, any way in which it can be driven."""
    speed = vehicle.terminal_speed_mps
    if vehicle.steered:
        speed = jnp.where(speed > 0, speed, jnp.max(speed))
    return SPEED_FRACTION * jnp.min(speed)


def choose_heading(
    vehicle: VehicleParams, estimate: Estimate, velocity: jax.Array, yaw: jax.Array
) -> jax.Array:
    """Heading [] rad to hold while going at ``velocity`` [3] over ground, in W.

    ``yaw`` [] is the one asked for. A vehicle without sway turns its bow to where it must go, by
    `TURN_RAD` at a time; nearly at rest it does as asked.
    """
    if not vehicle.steered:
        return yaw
    moves = velocity[0] ** 2 + velocity[1] ** 2 > MOVES_MPS**2
    course = jnp.arctan2(jnp.where(moves, velocity[1], 0.0), jnp.where(moves, velocity[0], 1.0))
    now = quaternion.yaw(estimate.q)
    turned = now + jnp.clip(wrap_angle(course - now), -TURN_RAD, TURN_RAD)
    return jnp.where(moves & (vehicle.terminal_speed_mps[1] <= 0), turned, yaw)


def velocity_reference(
    vehicle: VehicleParams,
    estimate: Estimate,
    target: TrackingTarget,
    position_per_s: float,
    attitude_per_s: float,
) -> jax.Array:
    """Velocity over ground [6], in F, that closes the errors of pose and moves with the target.

    v = v_d + k_p (p_d - p), bounded by `speed_limit`; omega = omega_d + k_a (attitude error),
    of the heading that `choose_heading` gives.
    """
    velocity = target.velocity_mps + position_per_s * (target.position_m - estimate.p)
    velocity = limit_norm(velocity, speed_limit(vehicle))
    yaw = choose_heading(vehicle, estimate, velocity, target.yaw_rad)
    turn = target.yaw_rate_radps * quaternion.world_up(estimate.q)
    return jnp.concatenate(
        [
            quaternion.rotate_inverse(estimate.q, velocity),
            turn + attitude_per_s * attitude_error(estimate.q, yaw),
        ]
    )


def target_acceleration(estimate: Estimate, target: TrackingTarget, nu: jax.Array) -> jax.Array:
    """Rate [6] of the body velocity ``nu`` [6] of a vehicle that moves with the target, in F.

    [R^T a_d - omega x v; alpha_d]: the components in F change as F turns.
    """
    linear = quaternion.rotate_inverse(estimate.q, target.acceleration_mps2)
    return jnp.concatenate(
        [
            linear - jnp.cross(nu[3:], nu[:3]),
            target.yaw_acceleration_radps2 * quaternion.world_up(estimate.q),
        ]
    )


def inertia_times(vehicle: VehicleParams, acceleration: jax.Array) -> jax.Array:
    """(M_RB + M_A) times an acceleration [6], in F; a wrench [6]."""
    dry = jnp.concatenate(
        [
            vehicle.mass_kg * acceleration[:3],
            matrix_times(vehicle.inertia_kgm2, acceleration[3:]),
        ]
    )
    return dry + matrix_times(vehicle.M_A, acceleration)


def inertia_diagonal(vehicle: VehicleParams) -> jax.Array:
    """Diagonal [6] of M_RB + M_A; kg, kg m^2."""
    inertia = vehicle.inertia_kgm2
    dry = [vehicle.mass_kg] * 3 + [inertia[i, i] for i in range(3)]
    return jnp.stack([dry[i] + vehicle.M_A[i, i] for i in range(6)])


def holding_wrench(
    vehicle: VehicleParams, q: jax.Array, density: float, gravity: float
) -> jax.Array:
    """Wrench [6], in F, that carries weight minus buoyancy; the righting moment is left to act."""
    lift = (density * vehicle.volume_m3 - vehicle.mass_kg) * gravity
    return -rigid_body.buoyancy_wrench(q, lift, jnp.zeros(3, q.dtype))


def motion_wrench(
    vehicle: VehicleParams,
    q: jax.Array,
    nu: jax.Array,
    nu_dot: jax.Array,
    flow: jax.Array,
    damped: jax.Array,
) -> jax.Array:
    """Wrench [6] of moving in a steady flow, without weight and buoyancy, in F.

    (M_RB + M_A) nu' + C_RB(nu) nu + C_A(nu_r) nu_r + D(nu_r) nu_r - M_A nu_c', with
    nu_c' = [-omega x R^T v_c; 0] (see `angler_kernels.rigid_body`).

    Args:
        vehicle: of one robot.
        q: [4] attitude.
        nu: [6] velocity over ground.
        nu_dot: [6] its rate, in F.
        flow: [3] velocity of the water, in W.
        damped: [6] velocity over ground at which damping is taken, in F: ``nu``, or a reference.
    """
    v_c = quaternion.rotate_inverse(q, flow)
    nu_c = jnp.concatenate([v_c, jnp.zeros_like(v_c)])
    return (
        inertia_times(vehicle, nu_dot)
        + rigid_body.rigid_body_coriolis(vehicle.mass_kg, vehicle.inertia_kgm2, nu)
        + rigid_body.added_mass_coriolis(vehicle.M_A, nu - nu_c)
        - damping_wrench(vehicle, damped - nu_c)
        - rigid_body.flow_inertia_wrench(
            vehicle.M_A, jnp.zeros_like(vehicle.mass_kg), nu[3:], v_c, jnp.zeros_like(v_c)
        )
    )


def model_wrench(
    vehicle: VehicleParams,
    estimate: Estimate,
    acceleration: jax.Array,
    flow: jax.Array | None,
    density: float,
    gravity: float,
    damped: jax.Array | None = None,
) -> jax.Array:
    """Wrench [6] that gives the vehicle an acceleration [6] in F as it moves now: all terms.

    `motion_wrench` at the estimated velocity, with weight, buoyancy and the righting moment of a
    submerged vehicle. ``damped`` [6] is the velocity over ground at which damping is taken, in F;
    the estimated one if left out.
    """
    current = jnp.zeros_like(estimate.p) if flow is None else flow
    buoyancy = density * gravity * vehicle.volume_m3
    nothing = jnp.zeros_like(estimate.p)
    return (
        motion_wrench(
            vehicle,
            estimate.q,
            estimate.nu,
            acceleration,
            current,
            estimate.nu if damped is None else damped,
        )
        - rigid_body.buoyancy_wrench(estimate.q, buoyancy, vehicle.p_cb_m)
        - rigid_body.buoyancy_wrench(estimate.q, -vehicle.mass_kg * gravity, nothing)
    )


def hold_integral(
    integral: jax.Array,
    growth: jax.Array,
    limit: jax.Array,
    dt: float,
    excess: jax.Array | None = None,
    excess_per_s: float = 0.0,
) -> jax.Array:
    """Integral [n] one step on, with anti-windup by clamping and, if given, by back-calculation.

    z' = growth - k_b (demand before - what became of it), then clamped to [-limit, limit]
    (Astrom and Hagglund, Advanced PID Control, 2006, section 3.5).

    Args:
        integral: [n] z.
        growth: [n] its rate without limits.
        limit: [n] or [].
        dt: s.
        excess: [n] demand of the step before minus what the thrusters gave, in the unit of z.
        excess_per_s: k_b.
    """
    rate = growth if excess is None else growth - excess_per_s * excess
    return jnp.clip(integral + dt * rate, -limit, limit)


def wrap_angle(angle: jax.Array) -> jax.Array:
    """The same angle within [-pi, pi)."""
    return jnp.mod(angle + jnp.pi, 2 * jnp.pi) - jnp.pi
