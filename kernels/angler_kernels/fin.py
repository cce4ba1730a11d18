"""Fins and control surfaces: lift and drag by the flow at each, and the servos that deflect them.

A fin is a flat foil with a chord c, which points forward at no deflection, a span s, about which it
turns, and the normal n = s x c. With the velocity (V_c, V_n) of the fin through the water, its
angle beta = atan2(V_n, V_c) and the deflection delta, alpha = delta - beta is the angle of attack::

    L = 1/2 rho A V^2 C_L(alpha)  along the motion turned by 90 degrees towards n,
    D = 1/2 rho A V^2 C_D(alpha)  against the motion

C_L is linear up to the stall and C_D a parabola of it. Beyond the stall the foil becomes a plate
within `STALL_WIDTH_RAD`, whose force is across it: C_L = C_P sin(alpha) cos(alpha), C_D =
C_P sin(alpha)^2 (Hoerner and Borst, Fluid-Dynamic Lift 1975, chapter 4). For small angles the force
along n is 1/2 rho A dC_L/dalpha (u^2 delta - u v_n) (Prestero, MSc thesis, MIT and WHOI 2001).

Functions are of all fins [n] of one body. The velocity of the flow along the span makes no force.
"""

import jax
import jax.numpy as jnp

from angler_kernels.rigid_body import matrix_times

STALL_WIDTH_RAD = 0.15
"""Angle of attack over which lift falls to that of a plate."""
_STILL_M2PS2 = 1e-12
"""Square of a speed below which there is no flow: keeps derivatives finite."""


def fin_wrench(
    *,
    chord: jax.Array,
    normal: jax.Array,
    area: jax.Array,
    lift_slope: jax.Array,
    zero_drag: jax.Array,
    induced_drag: jax.Array,
    plate_drag: jax.Array,
    stall: jax.Array,
    deflection: jax.Array,
    nu_r: jax.Array,
    density: jax.Array | float,
) -> jax.Array:
    """Compute the wrench of fins at the origin, in the body frame.

    Args:
        chord: [n, 6] [c; r x c] of each fin at r: its product with a velocity is V_c.
        normal: [n, 6] [n; r x n].
        area: [n] m^2.
        lift_slope: [n] dC_L/dalpha, 1/rad.
        zero_drag: [n] C_D without lift.
        induced_drag: [n] C_D per C_L^2.
        plate_drag: [n] C_D across the flow.
        stall: [n] angle of attack of the stall, below pi / 4, rad.
        deflection: [n] delta, right-handed about the span, rad.
        nu_r: [6] velocity of the body through the water.
        density: [] of the water, kg/m^3.

    Returns:
        Wrench [6], N and N m.
    """
    V_c, V_n = matrix_times(chord, nu_r), matrix_times(normal, nu_r)
    square = V_c * V_c + V_n * V_n
    inverse = jax.lax.rsqrt(square + _STILL_M2PS2)
    cos_flow, sin_flow = V_c * inverse, V_n * inverse
    cos_fin, sin_fin = jnp.cos(deflection), jnp.sin(deflection)
    sine = sin_fin * cos_flow - cos_fin * sin_flow
    cosine = cos_fin * cos_flow + sin_fin * sin_flow
    # A body at rest has no direction of flow, and atan2 no derivative there.
    alpha = jnp.arctan2(sine, jnp.where(square > _STILL_M2PS2, cosine, 1.0))
    stalled = jnp.clip((jnp.abs(alpha) - stall) / STALL_WIDTH_RAD, 0.0, 1.0)
    linear = (1.0 - stalled) * lift_slope * jnp.clip(alpha, -stall, stall)
    lift = linear + stalled * plate_drag * sine * cosine
    drag = zero_drag + induced_drag * linear * linear + stalled * plate_drag * sine * sine
    pressure = 0.5 * density * area * square
    along = pressure * (-lift * sin_flow - drag * cos_flow)
    across = pressure * (lift * cos_flow - drag * sin_flow)
    return jnp.sum(along[:, None] * chord + across[:, None] * normal, axis=0)


def turn_fins(
    angle: jax.Array,
    command: jax.Array,
    time_constant: jax.Array,
    rate: jax.Array,
    dt: jax.Array | float,
) -> jax.Array:
    """Turn fins for a step, or move other servos: a lag of first order with a limit of rate.

    Args:
        angle: [n] rad, at the beginning; of tanks m^3, of moving masses m.
        command: [n] rad, held over the step.
        time_constant: [n] s.
        rate: [n] rad/s.
        dt: [] s.

    Returns:
        Deflections [n] at the end of the step, rad.
    """
    change = (command - angle) * (1.0 - jnp.exp(-dt / time_constant))
    return angle + jnp.clip(change, -rate * dt, rate * dt)
