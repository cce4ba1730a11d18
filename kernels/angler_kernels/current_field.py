"""Velocity fields at one point: value, rate and gradient, in closed form.

Each field returns ``(v, v_t, J)``: the velocity [3] m/s, its rate at the fixed point [3] m/s^2 and
its Jacobian [3, 3] 1/s with ``J[i, j] = dv_i / dx_j``, all in the world frame. Fields add up, and
so do their three parts; the material derivative does not and is taken of the sum.
"""

import math

import jax
import jax.numpy as jnp

from angler_kernels.table import count_not_above, take_row

type Field = tuple[jax.Array, jax.Array, jax.Array]

PEAK_RADIUS = 1.1209064227785
"""Radius of the greatest speed of a Lamb-Oseen vortex in core radii: the root x of
exp(x^2) = 1 + 2 x^2 (x^2 = 1.25643; Devenport et al., J. Fluid Mech. 312, 1996, p. 67)."""

_SERIES_BELOW = 0.1
_SERIES = tuple((-1.0) ** k / math.factorial(k + 1) for k in range(14))


def smooth_knots(t: jax.Array, knots: jax.Array, knot_dt: jax.Array) -> Field:
    """Return the field that is uniform in space and passes through knots in time.

    Between two knots v = v_k + (3 s^2 - 2 s^3) (v_k+1 - v_k): once continuously differentiable in
    time and never outside the convex hull of the knots. Held before the first and after the last.

    Args:
        t: [] s.
        knots: [n_knot, 3] m/s at 0, knot_dt, 2 knot_dt ...; at least two.
        knot_dt: [] s.
    """
    last = knots.shape[0] - 1
    phase = jnp.clip(t / knot_dt, 0.0, last)
    k = jnp.clip(jnp.floor(phase).astype(jnp.int32), 0, last - 1)
    s = phase - k
    begin = jax.lax.dynamic_index_in_dim(knots, k, keepdims=False)
    jump = jax.lax.dynamic_index_in_dim(knots, k + 1, keepdims=False) - begin
    v = begin + (s * s * (3.0 - 2.0 * s)) * jump
    v_t = (6.0 * s * (1.0 - s) / knot_dt) * jump
    return v, v_t, jnp.zeros((3, 3), v.dtype)


def lamb_oseen_vortices(
    p: jax.Array, centre: jax.Array, circulation: jax.Array, core: jax.Array
) -> Field:
    """Return the field of steady Lamb-Oseen vortices with vertical axes.

    Each vortex turns the water at v_theta = Gamma / (2 pi r) (1 - exp(-r^2 / a^2)) (Saffman, Vortex
    Dynamics, 1992, section 13.1, with a^2 = 4 nu t frozen). Written with phi(s) = (1 - exp(-s)) / s
    and s = r^2 / a^2 it is v = Gamma / (2 pi a^2) phi(s) [-y, x, 0], smooth at the axis too.

    Args:
        p: [3] m.
        centre: [n, 2] x and y of the axes, m.
        circulation: [n] Gamma, m^2/s, positive anticlockwise seen from above.
        core: [n] a, m.
    """
    x, y = p[0] - centre[:, 0], p[1] - centre[:, 1]
    inverse = 1.0 / (core * core)
    phi, slope = _phi((x * x + y * y) * inverse)
    rate = circulation * inverse / (2.0 * math.pi)
    turn = rate * phi
    bend = 2.0 * inverse * rate * slope
    shear = jnp.sum(bend * x * y)
    v = jnp.stack([-jnp.sum(turn * y), jnp.sum(turn * x), jnp.zeros_like(shear)])
    J = _level_jacobian(shear, jnp.sum(turn + bend * y * y), jnp.sum(turn + bend * x * x))
    return v, jnp.zeros_like(v), J


def lamb_oseen_circulation(peak_speed: jax.Array, core: jax.Array) -> jax.Array:
    """Return the circulation [m^2/s] of the Lamb-Oseen vortex of the greatest speed ``peak_speed``.

    At r = PEAK_RADIUS a, where exp(x^2) = 1 + 2 x^2, the speed is
    Gamma / (2 pi a) 2 x / (1 + 2 x^2) = 0.6382 Gamma / (2 pi a).
    """
    x = PEAK_RADIUS
    return 2.0 * math.pi * core * peak_speed * (1.0 + 2.0 * x * x) / (2.0 * x)


def rankine_vortices(
    p: jax.Array, centre: jax.Array, circulation: jax.Array, core: jax.Array
) -> Field:
    """Return the field of steady Rankine vortices with vertical axes.

    Each vortex turns the water at v_theta = Gamma r / (2 pi a^2) within its core, r <= a, and at
    Gamma / (2 pi r) outside; fastest at r = a. The velocity is continuous, the Jacobian jumps at r
    = a: there it is that of the core.

    Args:
        p: [3] m.
        centre: [n, 2] x and y of the axes, m.
        circulation: [n] Gamma, m^2/s, positive anticlockwise seen from above.
        core: [n] a, m.
    """
    x, y = p[0] - centre[:, 0], p[1] - centre[:, 1]
    square, inside = x * x + y * y, core * core
    inverse = 1.0 / jnp.maximum(square, inside)
    turn = circulation * inverse / (2.0 * math.pi)
    bend = jnp.where(square > inside, -2.0 * turn * inverse, 0.0)
    shear = jnp.sum(bend * x * y)
    v = jnp.stack([-jnp.sum(turn * y), jnp.sum(turn * x), jnp.zeros_like(shear)])
    J = _level_jacobian(shear, jnp.sum(turn + bend * y * y), jnp.sum(turn + bend * x * x))
    return v, jnp.zeros_like(v), J


def double_gyre(
    p: jax.Array,
    t: jax.Array,
    lo: jax.Array,
    extent: jax.Array,
    stream: jax.Array,
    epsilon: jax.Array,
    period: jax.Array,
) -> Field:
    """Return the field of two gyres in a rectangle whose common wall sways (stream function in m).

    From Shadden, Lekien & Marsden, Physica D 212, 2005:
    psi = A sin(pi f) sin(pi Y), f = e X^2 + (1 - 2 e) X, e = epsilon sin(2 pi t / period), where X
    goes from 0 to 2 along x and Y from 0 to 1 along y; u = -dpsi/dy and v = dpsi/dx. No water
    crosses the sides.

    Args:
        p: [3] m.
        t: [] s.
        lo: [2] lower corner of the rectangle, m.
        extent: [2] lengths of its sides, m.
        stream: [] A, m^2/s.
        epsilon: [] from 0 to below 0.5.
        period: [] s.
    """
    kx, ky = 2.0 / extent[0], 1.0 / extent[1]
    X, Y = (p[0] - lo[0]) * kx, (p[1] - lo[1]) * ky
    turn = 2.0 * math.pi / period
    e, e_t = epsilon * jnp.sin(turn * t), epsilon * turn * jnp.cos(turn * t)
    f, f_x, f_t = X * (1.0 + e * (X - 2.0)), 1.0 + 2.0 * e * (X - 1.0), e_t * X * (X - 2.0)
    sin_f, cos_f = jnp.sin(math.pi * f), jnp.cos(math.pi * f)
    sin_y, cos_y = jnp.sin(math.pi * Y), jnp.cos(math.pi * Y)
    a = math.pi * stream
    zero = jnp.zeros_like(f)
    v = jnp.stack([-a * ky * sin_f * cos_y, a * kx * f_x * cos_f * sin_y, zero])
    sway = 2.0 * e_t * (X - 1.0) * cos_f - math.pi * f_x * f_t * sin_f
    v_t = jnp.stack([-a * ky * math.pi * f_t * cos_f * cos_y, a * kx * sway * sin_y, zero])
    bow = 2.0 * e * cos_f - math.pi * f_x * f_x * sin_f
    J = _level_jacobian(
        a * math.pi * kx * ky * f_x * cos_f * cos_y,
        -a * math.pi * ky * ky * sin_f * sin_y,
        a * kx * kx * bow * sin_y,
    )
    return v, v_t, J


def double_gyre_stream(peak_speed: jax.Array, extent: jax.Array) -> jax.Array:
    """Return the stream function A [] m^2/s of the steady double gyre of a greatest speed, m/s.

    The square of the speed is (pi A)^2 times a mean of (1 / b)^2 and (2 / a)^2 at most, for sides
    a and b. Where the gyres sway, 2 / a grows by |df/dX| <= 1 + 2 epsilon.

    Args:
        peak_speed: [] m/s.
        extent: [2] a and b, m.
    """
    return peak_speed / (math.pi * jnp.maximum(2.0 / extent[0], 1.0 / extent[1]))


def depth_profile(p: jax.Array, depth: jax.Array, knots: jax.Array, slopes: jax.Array) -> Field:
    """Return the field of a steady level velocity that depends on depth alone.

    Between two knots each component is the cubic with their values and slopes (Hermite); held
    above the first and below the last. Free of divergence: it has no vertical part, and nothing
    changes along x or y.

    Args:
        p: [3] m, z up from the surface.
        depth: [n] m below the surface, rising; at least two.
        knots: [n, 2] velocity along x and y, m/s.
        slopes: [n, 2] their derivatives by depth, 1/s, zero at both ends (see `monotone_slopes`).
    """
    last = depth.shape[0] - 1
    clamped_depth = jnp.clip(-p[2], take_row(depth, jnp.int32(0)), take_row(depth, jnp.int32(last)))
    k = jnp.clip(count_not_above(depth, clamped_depth) - 1, 0, last - 1)
    begin = take_row(depth, k)
    length = take_row(depth, k + 1) - begin
    s = (clamped_depth - begin) / length
    start, jump = take_row(knots, k), take_row(knots, k + 1) - take_row(knots, k)
    first, second = length * take_row(slopes, k), length * take_row(slopes, k + 1)
    square, cube = 3.0 * jump - 2.0 * first - second, first + second - 2.0 * jump
    level = start + s * (first + s * (square + s * cube))
    by_z = -(first + s * (2.0 * square + 3.0 * s * cube)) / length
    zero = jnp.zeros_like(s)
    v = jnp.stack([level[0], level[1], zero])
    rows = ((zero, zero, by_z[0]), (zero, zero, by_z[1]), (zero, zero, zero))
    return v, jnp.zeros_like(v), jnp.stack([jnp.stack(row) for row in rows])


def monotone_slopes(depth: jax.Array, knots: jax.Array) -> jax.Array:
    """Return slopes [n, 2] of a profile that stays within each pair of neighbouring knots.

    Zero where a component turns back and at both ends; else the weighted harmonic mean of the
    slopes of the chords on either side (Fritsch & Butland, SIAM J. Sci. Stat. Comput. 5, 1984,
    p. 300).

    Args:
        depth: [n] m, rising.
        knots: [n, 2] m/s.
    """
    step = (depth[1:] - depth[:-1])[:, None]
    chord = (knots[1:] - knots[:-1]) / step
    before, after = chord[:-1], chord[1:]
    w, x = 2.0 * step[1:] + step[:-1], step[1:] + 2.0 * step[:-1]
    alike = before * after > 0.0
    safe_before, safe_after = (
        jnp.where(alike, chord_slope, 1.0) for chord_slope in (before, after)
    )
    inner = jnp.where(alike, (w + x) / (w / safe_before + x / safe_after), 0.0)
    return jnp.pad(inner, ((1, 1), (0, 0)))


def tidal_current(
    t: jax.Array, speed: jax.Array, phase: jax.Array, cosine: jax.Array, sine: jax.Array
) -> Field:
    """Return the field of tidal constituents: uniform in space, each turning along an ellipse.

    v = sum_k cosine_k cos(speed_k t + phase_k) + sine_k sin(speed_k t + phase_k).

    Args:
        t: [] s.
        speed: [n] rad/s.
        phase: [n] at t = 0, rad.
        cosine: [n, 2] half axis along which the velocity points at phase 0, m/s.
        sine: [n, 2] half axis at a quarter of a turn, m/s.
    """
    angle = (speed * t + phase)[:, None]
    cos, sin, rate = jnp.cos(angle), jnp.sin(angle), speed[:, None]
    level = jnp.sum(cosine * cos + sine * sin, axis=0)
    level_t = jnp.sum(rate * (sine * cos - cosine * sin), axis=0)
    zero = jnp.zeros_like(t)
    v, v_t = (jnp.stack([part[0], part[1], zero]) for part in (level, level_t))
    return v, v_t, jnp.zeros((3, 3), v.dtype)


def _level_jacobian(shear: jax.Array, down: jax.Array, up: jax.Array) -> jax.Array:
    """Return [[-shear, -down, 0], [up, shear, 0], 0].

    The Jacobian of a divergence-free level flow.
    """
    zero = jnp.zeros_like(shear)
    rows = ((-shear, -down, zero), (up, shear, zero), (zero, zero, zero))
    return jnp.stack([jnp.stack(row) for row in rows])


def material_derivative(v: jax.Array, v_t: jax.Array, J: jax.Array) -> jax.Array:
    """Return Dv/Dt = dv/dt + (v . grad) v, [3] m/s^2: the acceleration of a particle of water.

    For v [3], its time derivative v_t [3], and its spatial derivative J [3, 3].
    """
    return v_t + jnp.sum(J * v[None, :], axis=1)


def _phi(s: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return phi(s) = (1 - exp(-s)) / s and its derivative, for s >= 0.

    Near zero both are power series with as many terms as the type has digits; the closed form,
    which cancels there, gets a harmless argument there so that gradients stay finite.
    """
    is_small = s < _SERIES_BELOW
    safe = jnp.where(is_small, 1.0, s)
    inverse = 1.0 / safe
    fall = jnp.exp(-safe)
    far = (1.0 - fall) * inverse
    far_slope = (fall - far) * inverse
    near, near_slope = jnp.zeros_like(s), jnp.zeros_like(s)
    for k in range(_count_terms(s.dtype) - 1, 0, -1):
        near = (near + _SERIES[k]) * s
        near_slope = near_slope * s + k * _SERIES[k]
    return jnp.where(is_small, near + _SERIES[0], far), jnp.where(is_small, near_slope, far_slope)


def _count_terms(dtype: jnp.dtype) -> int:
    """Count the terms of the series of phi's derivative that a type resolves at the threshold."""
    threshold = 2.0 ** (-56 if dtype.itemsize > 4 else -27)
    return next(
        k for k, c in enumerate(_SERIES) if k and k * abs(c) * _SERIES_BELOW ** (k - 1) < threshold
    )
