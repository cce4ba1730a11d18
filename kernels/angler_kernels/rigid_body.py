"""Six-degree-of-freedom motion of one rigid body in moving water.

The equation, in the body frame F (x forward, y left, z up) with its origin at the centre of mass
(Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed. 2021, chapters 3, 6, 8,
10; the terms of an accelerated flow after Auton, Hunt and Prud'homme, J. Fluid Mech. 197, 1988)::

    (M_RB + M_A) nu' + C_RB(nu) nu + C_A(nu_r) nu_r + D(nu_r) nu_r + g(q, depth)
        = B f + M_A nu_c' + [rho V Dv_c/Dt; 0]

    nu_r  = nu - nu_c,  nu_c = [R^T v_c; 0]   (the vorticity of the flow exerts no moment)
    nu_c' = [R^T Dv_c/Dt - omega x R^T v_c; 0]

``Dv_c/Dt`` is the material derivative of the flow at the body. All functions are for one body:
``nu`` [6] = [u v w p q r] in m/s and rad/s, wrenches [6] in N and N m, ``q`` [4] wxyz.
"""

import jax
import jax.numpy as jnp

from angler_kernels import spd_solve
from angler_kernels.quaternion import exp_small, multiply, rotate, rotate_inverse, world_up


def rigid_body_coriolis(mass: jax.Array, inertia: jax.Array, nu: jax.Array) -> jax.Array:
    """Return C_RB(nu) nu, [6], for nu [6], mass [] and inertia [3, 3] about the origin."""
    v, omega = nu[:3], nu[3:]
    return jnp.concatenate(
        [mass * jnp.cross(omega, v), jnp.cross(omega, matrix_times(inertia, omega))]
    )


def added_mass_coriolis(M_A: jax.Array, nu_r: jax.Array) -> jax.Array:
    """Return C_A(nu_r) nu_r, [6], for nu_r [6], M_A [6, 6], by momenta (Fossen 2021, eq. 6.43)."""
    momentum = matrix_times(M_A, nu_r)
    linear, angular = momentum[:3], momentum[3:]
    v_r, omega = nu_r[:3], nu_r[3:]
    return jnp.concatenate(
        [jnp.cross(omega, linear), jnp.cross(v_r, linear) + jnp.cross(omega, angular)]
    )


def damping_wrench(D_l: jax.Array, D_q: jax.Array, nu_r: jax.Array) -> jax.Array:
    """Return wrench [6] ``-(D_l + D_q |nu_r|) nu_r`` for D_l [6] >= 0, D_q [6] >= 0, nu_r [6]."""
    return -(D_l + D_q * jnp.abs(nu_r)) * nu_r


def damping_slope(D_l: jax.Array, D_q: jax.Array, nu_r: jax.Array) -> jax.Array:
    """Return diagonal [6] D_l + 2 D_q |nu_r|: damping's derivative by velocity; N s/m, N m s/rad.

    For D_l [6], D_q [6] and nu_r [6].
    """
    return D_l + 2.0 * D_q * jnp.abs(nu_r)


def submerged_fraction(z: jax.Array, height: jax.Array) -> jax.Array:
    """Return the submerged fraction [] of a hull of ``height`` [] m, centred at ``z`` [] m.

    ``z`` is the height above the surface.
    """
    return jnp.clip(0.5 - z / height, 0.0, 1.0)


def buoyancy_wrench(q: jax.Array, lift: jax.Array, p_cb: jax.Array) -> jax.Array:
    """Return the wrench [6] of an upward force ``lift`` [] N at ``p_cb`` [3] m, for q [4].

    The force is in the world frame, ``p_cb`` in the body frame.
    """
    force = lift * world_up(q)
    return jnp.concatenate([force, jnp.cross(p_cb, force)])


def flow_inertia_wrench(
    M_A: jax.Array, displaced_mass: jax.Array, omega: jax.Array, v_c: jax.Array, Dv_c: jax.Array
) -> jax.Array:
    """Return the wrench [6] of an accelerated flow: M_A nu_c' + [rho V Dv_c/Dt; 0].

    Args:
        M_A: [6, 6] added mass.
        displaced_mass: [] rho V, kg.
        omega: [3] angular velocity of the body, in F.
        v_c: [3] velocity of the flow, in F.
        Dv_c: [3] material derivative of the flow, in F.
    """
    nu_c_dot = Dv_c - jnp.cross(omega, v_c)
    wrench = matrix_times(M_A, jnp.concatenate([nu_c_dot, jnp.zeros_like(omega)]))
    return wrench + jnp.concatenate([displaced_mass * Dv_c, jnp.zeros_like(omega)])


def water_wrench(
    *,
    M_A: jax.Array,
    D_l: jax.Array,
    D_q: jax.Array,
    volume: jax.Array,
    p_cb: jax.Array,
    height: jax.Array,
    z: jax.Array,
    q: jax.Array,
    nu: jax.Array,
    v_c: jax.Array,
    Dv_c: jax.Array,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> jax.Array:
    """Return the wrench of the water on a body, except the inertia M_A nu' itself.

    -C_A(nu_r) nu_r - D(nu_r) nu_r + buoyancy + M_A nu_c' + [rho V Dv_c/Dt; 0]. Buoyancy and
    rho V Dv_c/Dt fade linearly while the hull leaves the water; M_A and D do not.

    Args:
        M_A: [6, 6] added mass.
        D_l: [6] linear damping, >= 0.
        D_q: [6] quadratic damping, >= 0.
        volume: [] displaced volume under water, m^3.
        p_cb: [3] centre of buoyancy from the origin, m, in F.
        height: [] height of the hull over which buoyancy fades, m.
        z: [] height of the origin above the surface, m, in W.
        q: [4] attitude.
        nu: [6] velocity of the body.
        v_c: [3] flow at the body, m/s, in W.
        Dv_c: [3] its material derivative, m/s^2, in W.
        density: [] of the water, kg/m^3.
        gravity: [] m/s^2.

    Returns:
        Wrench [6] at the origin, in F.
    """
    v_c_body, Dv_c_body = rotate_inverse(q, v_c), rotate_inverse(q, Dv_c)
    nu_r = jnp.concatenate([nu[:3] - v_c_body, nu[3:]])
    z_cb = z + jnp.sum(world_up(q) * p_cb)
    displaced = density * volume * submerged_fraction(z_cb, height)
    return (
        damping_wrench(D_l, D_q, nu_r)
        - added_mass_coriolis(M_A, nu_r)
        + buoyancy_wrench(q, displaced * gravity, p_cb)
        + flow_inertia_wrench(M_A, displaced, nu[3:], v_c_body, Dv_c_body)
    )


def advance_velocity(
    nu: jax.Array, nu_dot: jax.Array, nu_dot_before: jax.Array, dt: jax.Array | float
) -> jax.Array:
    """Advance the velocity by the two-step Adams-Bashforth formula, second order.

    nu + dt (3/2 nu_dot - 1/2 nu_dot_before), one evaluation of the forces a step; the first step of
    a run passes nu_dot twice and is Euler's. Discontinuous forces (thrusters) are not put through
    it: their impulse over the step is exact and is added by the caller.
    """
    return nu + dt * (1.5 * nu_dot - 0.5 * nu_dot_before)


def advance_damped_velocity(
    nu: jax.Array,
    nu_r: jax.Array,
    M: jax.Array,
    D_l: jax.Array,
    D_q: jax.Array,
    force: jax.Array,
    force_before: jax.Array,
    mean_thrust: jax.Array,
    dt: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Advance the velocity by a second-order step, stable for any strength of damping.

    M d = dt (f + 1/2 h(d) + 1/2 (f - g) + b),  nu(t + dt) = nu + d,  g(t + dt) = f + h(d),

    where h(d) = D(nu_r) nu_r - D(nu_r + d) (nu_r + d) is the change of damping. Damping is taken by
    the trapezoidal rule, solved by two iterations of Newton's method with the slope J at the
    beginning, (M + dt/2 J) d = ...; other changes of the smooth force f are extrapolated by the
    two-step Adams-Bashforth formula. g is the force of the step before with the damping of the
    velocity that it led to: without other changes g = f. Without damping this is
    `advance_velocity`, which is unstable where dt J / M > 1.

    Args:
        nu: [6] velocity.
        nu_r: [6] velocity relative to the water.
        M: [6, 6] inertia with added mass.
        D_l: [6] linear damping, >= 0.
        D_q: [6] quadratic damping, >= 0.
        force: [6] f, all smooth forces, damping included.
        force_before: [6] g of the step before; f itself before the first step.
        mean_thrust: [6] b, mean over the step of the forces that are fixed in advance.
        dt: [] s.

    Returns:
        nu [6] at the end of the step, and g [6] for the next.
    """
    slope = damping_slope(D_l, D_q, nu_r)
    implicit = M + 0.5 * dt * slope[:, None] * jnp.eye(slope.shape[0], dtype=slope.dtype)
    impulse = (1.5 * dt) * force - (0.5 * dt) * force_before + dt * mean_thrust
    change = spd_solve.solve(implicit, impulse[:, None])[:, 0]
    damping = damping_wrench(D_l, D_q, nu_r)
    # Newton again: the part of the change of damping that the slope has missed.
    residual = damping_wrench(D_l, D_q, nu_r + change) - damping + slope * change
    change = change + spd_solve.solve(implicit, 0.5 * dt * residual[:, None])[:, 0]
    return nu + change, force + damping_wrench(D_l, D_q, nu_r + change) - damping


def advance_pose(
    p: jax.Array, q: jax.Array, nu: jax.Array, nu_next: jax.Array, dt: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """Advance the pose with the mean velocity of the step, on the manifold, second order.

    The body turns by exp(dt omega), at most 3 rad a step; the position moves along the mean body
    velocity expressed in the attitude at mid-step.

    Args:
        p: [3] position, m, in W.
        q: [4] attitude.
        nu: [6] velocity at the beginning of the step, in F.
        nu_next: [6] velocity at its end, in F.
        dt: [] s.

    Returns:
        Position [3] and unit attitude [4] at the end of the step.
    """
    mean = 0.5 * (nu + nu_next)
    half_turn = exp_small(0.5 * dt * mean[3:])
    q_middle = multiply(q, half_turn)
    q_next = multiply(q_middle, half_turn)
    q_next = q_next * jax.lax.rsqrt(jnp.sum(q_next * q_next))
    return p + dt * rotate(q_middle, mean[:3]), q_next


def matrix_times(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    """Return the product [m] of ``matrix`` [m, n] and ``vector`` [n], as products and sums.

    A dot product would be TF32 on some GPUs by default, and a call of its own.
    """
    return jnp.sum(matrix * vector[None, :], axis=1)
