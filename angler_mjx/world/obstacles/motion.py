"""Motion of obstacles: drifting as rigid bodies in moving water, scripted by closed form.

Drifting bodies have added mass, quadratic drag, weight and buoyancy, and the force of the flow's
own acceleration; the vortices exert no moment on them. Static cells and the bounds reflect them, as
their bounding spheres and without loss. They do not touch each other, explicit obstacles or robots,
unless a simulation has contact (`angler_mjx.sim.contact_motion`).
Scripted obstacles are never stopped.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels.clearance import point_grid
from angler_kernels.quaternion import rotate, rotate_inverse, to_matrix
from angler_kernels.rigid_body import (
    advance_pose,
    advance_velocity,
    buoyancy_wrench,
    rigid_body_coriolis,
    water_wrench,
)
from angler_mjx.world.currents import Current, evaluate_current
from angler_mjx.world.obstacles.types import (
    BOX,
    CIRCLE,
    DRIFT,
    SINE,
    SPHERE,
    STRAIGHT,
    Obstacles,
    ObstacleState,
    bounding_radius,
)
from angler_mjx.world.rock.grid import Grid

type NearestCell = Callable[[jax.Array], tuple[jax.Array, jax.Array]]
"""Distance [] of a point [3] to the occupied cells, and the unit direction [3] away from them."""

type Law = Callable[[Obstacles, jax.Array], tuple[jax.Array, jax.Array]]
"""Position [3] and velocity [3], in W, of a scripted obstacle."""


def reset(
    obstacles: Obstacles,
    current: Current,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> ObstacleState:
    """Return the state of the obstacles at t = 0; drifting ones move with the water, plus ``nu0``.

    Args:
        obstacles: [n] rows of one world.
        current: current of the same world.
        density: [] density of the water, kg/m^3.
        gravity: [] m/s^2, positive.
    """
    zero = jnp.zeros_like(obstacles.nu0)
    state = ObstacleState(p=obstacles.p0, q=obstacles.q0, nu=zero, nu_dot=zero)
    start = jnp.zeros((), obstacles.p0.dtype)
    state = jax.vmap(
        lambda body, now: _move_scripted(body, now, start, lambda of, _: (of.p0, of.path[:3]))
    )(obstacles, state)
    if DRIFT not in obstacles.motions:
        return state

    def carried(body: Obstacles, now: ObstacleState) -> ObstacleState:
        v_c = rotate_inverse(now.q, evaluate_current(current, now.p, start)[0])
        nu = jnp.concatenate([body.nu0[:3] + v_c, body.nu0[3:]])
        moving = replace(now, nu=nu)
        nu_dot = _compute_acceleration(body, moving, current, start, density, gravity)
        return _select(body.motion == DRIFT, replace(moving, nu_dot=nu_dot), now)

    return jax.vmap(carried)(obstacles, state)


def step(
    obstacles: Obstacles,
    state: ObstacleState,
    current: Current,
    t: jax.Array,
    dt: jax.Array | float,
    bounds_lo: jax.Array,
    bounds_hi: jax.Array,
    grid: Grid,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> ObstacleState:
    """Return the state of the obstacles at t + dt.

    Args:
        obstacles: [n] rows of one world.
        state: at t.
        current: current of the same world.
        t: [] s.
        dt: [] s.
        bounds_lo: [3] lower corner of the region that obstacles stay in, m, W.
        bounds_hi: [3] upper corner.
        grid: static cells of the world.
        density: [] density of the water, kg/m^3.
        gravity: [] m/s^2, positive.
    """

    def nearest_cell(p: jax.Array) -> tuple[jax.Array, jax.Array]:
        return point_grid(p, grid.occupied, grid.origin_m, grid.cell_m)

    def advance_one(body: Obstacles, now: ObstacleState) -> ObstacleState:
        return advance_obstacle(
            body, now, current, t, dt, bounds_lo, bounds_hi, nearest_cell, density, gravity
        )

    return jax.vmap(advance_one)(obstacles, state)


def advance_obstacle(
    body: Obstacles,
    now: ObstacleState,
    current: Current,
    t: jax.Array,
    dt: jax.Array | float,
    bounds_lo: jax.Array,
    bounds_hi: jax.Array,
    nearest_cell: NearestCell,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> ObstacleState:
    """Return the state of one obstacle at t + dt; arguments as in `step`, for one row."""
    after = follow_script(body, now, t + dt, bounds_lo, bounds_hi)
    if DRIFT not in body.motions:
        return after
    nu, nu_dot = drift_freely(body, now, current, t, dt, density, gravity)
    p, q = advance_pose(now.p, now.q, now.nu, nu, dt)
    radius = bounding_radius(body.kind, body.size_m)
    v = rotate(q, nu[:3])
    p, v = _off_cells(p, v, radius, nearest_cell)
    p, v = keep_within(p, v, bounds_lo + radius, bounds_hi - radius)
    nu = jnp.concatenate([rotate_inverse(q, v), nu[3:]])
    drifted = ObstacleState(p=p, q=q, nu=nu, nu_dot=nu_dot)
    return _select(body.motion == DRIFT, drifted, after)


def drift_freely(
    body: Obstacles,
    now: ObstacleState,
    current: Current,
    t: jax.Array,
    dt: jax.Array | float,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Return the velocity [6] of one drifting body at t + dt where it touches nothing, and nu'.

    Arguments as in `step`, for one row.
    """
    nu_dot = _compute_acceleration(body, now, current, t, density, gravity)
    return advance_velocity(now.nu, nu_dot, now.nu_dot, dt), nu_dot


def follow_script(
    body: Obstacles,
    now: ObstacleState,
    t: jax.Array,
    bounds_lo: jax.Array,
    bounds_hi: jax.Array,
) -> ObstacleState:
    """Return the state of one scripted obstacle at t; any other unchanged; see `step`."""
    straight = partial(_straight_motion, bounds_lo=bounds_lo, bounds_hi=bounds_hi)
    return _move_scripted(body, now, t, straight)


def _compute_acceleration(
    body: Obstacles,
    now: ObstacleState,
    current: Current,
    t: jax.Array,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> jax.Array:
    """Return nu' [6] of one drifting body, body frame."""
    v_c, Dv_c = evaluate_current(current, now.p, t)
    v_r = now.nu[:3] - rotate_inverse(now.q, v_c)
    omega = now.nu[3:]
    speed = jnp.concatenate([jnp.full(3, _norm(v_r)), jnp.full(3, _norm(omega))])
    water = water_wrench(
        M_A=_diagonal_matrix(body.M_A),
        D_l=body.D_l + body.D_q * speed,
        D_q=jnp.zeros_like(body.D_q),
        volume=body.volume_m3,
        p_cb=jnp.zeros_like(now.p),
        height=2.0 * _half_height(body, now.q),
        z=now.p[2],
        q=now.q,
        nu=now.nu,
        v_c=v_c,
        Dv_c=Dv_c,
        density=density,
        gravity=gravity,
    )
    weight = buoyancy_wrench(now.q, -body.mass_kg * gravity, jnp.zeros_like(now.p))
    gyro = rigid_body_coriolis(body.mass_kg, _diagonal_matrix(body.inertia_kgm2), now.nu)
    inertia = jnp.concatenate([jnp.full(3, body.mass_kg), body.inertia_kgm2]) + body.M_A
    return (water + weight - gyro) / inertia


def _half_height(body: Obstacles, q: jax.Array) -> jax.Array:
    """Return half the vertical extent [] of a body at attitude q."""
    up = jnp.abs(to_matrix(q)[2])
    box = jnp.sum(up * body.size_m)
    capsule = body.size_m[0] + up[2] * body.size_m[1]
    round_one = jnp.where(body.kind == SPHERE, body.size_m[0], capsule)
    return jnp.where(body.kind == BOX, box, round_one)


def _off_cells(
    p: jax.Array, v: jax.Array, radius: jax.Array, nearest_cell: NearestCell
) -> tuple[jax.Array, jax.Array]:
    """Move a sphere that overlaps a cell back to its surface, and turn its velocity outward."""
    distance, normal = nearest_cell(p)
    inside = jnp.maximum(radius - distance, 0.0)
    inward = jnp.minimum(jnp.sum(v * normal), 0.0)
    return p + inside * normal, v - jnp.where(inside > 0.0, 2.0 * inward, 0.0) * normal


def keep_within(
    p: jax.Array, v: jax.Array, lo: jax.Array, hi: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Move a centre beyond a bound back onto it, and reverse the outward velocity component.

    Args:
        p: [3] centre, m.
        v: [3] m/s.
        lo: [3] lower bounds.
        hi: [3] upper bounds.
    """
    leaving = ((p < lo) & (v < 0.0)) | ((p > hi) & (v > 0.0))
    return jnp.clip(p, lo, jnp.maximum(lo, hi)), jnp.where(leaving, -v, v)


def _move_scripted(
    body: Obstacles, now: ObstacleState, t: jax.Array, straight: Law
) -> ObstacleState:
    """Return the state of a scripted obstacle at t; any other obstacle unchanged."""
    laws: dict[int, Law] = {STRAIGHT: straight, SINE: _sine_motion, CIRCLE: _circle_motion}
    for motion, law in laws.items():
        if motion not in body.motions:
            continue
        p, v = law(body, t)
        nu = jnp.concatenate([rotate_inverse(body.q0, v), jnp.zeros_like(v)])
        now = _select(body.motion == motion, replace(now, p=p, nu=nu), now)
    return now


def _straight_motion(
    body: Obstacles, t: jax.Array, *, bounds_lo: jax.Array, bounds_hi: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return constant speed, reflected by the bounds: a triangle wave in each axis.

    The bounds are those of the centre, one bounding radius inside the region, and are widened to
    hold the start where that lies outside.
    """
    radius = bounding_radius(body.kind, body.size_m)
    lo = jnp.minimum(bounds_lo + radius, body.p0)
    span = jnp.maximum(jnp.maximum(bounds_hi - radius, body.p0) - lo, 1e-6)
    v = body.path[:3]
    phase = jnp.mod(body.p0 - lo + v * t, 2.0 * span)
    back = phase > span
    return lo + jnp.where(back, 2.0 * span - phase, phase), jnp.where(back, -v, v)


def _sine_motion(body: Obstacles, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return p0 + A sin(omega t + phase), and its velocity."""
    amplitude, rate, phase = body.path[:3], body.path[3], body.path[4]
    angle = rate * t + phase
    return body.p0 + amplitude * jnp.sin(angle), amplitude * (rate * jnp.cos(angle))


def _circle_motion(body: Obstacles, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return p0 + arm cos(omega t + phase) + axis x arm sin(omega t + phase), and its velocity."""
    arm, rate, phase, axis = body.path[:3], body.path[3], body.path[4], body.path[5:8]
    angle = rate * t + phase
    side = jnp.cross(axis, arm)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return body.p0 + c * arm + s * side, rate * (c * side - s * arm)


def _select(where: jax.Array, a: ObstacleState, b: ObstacleState) -> ObstacleState:
    """Return a where true, else b, leaf by leaf."""
    chosen: ObstacleState = jax.tree.map(lambda x, y: jnp.where(where, x, y), a, b)
    return chosen


def _diagonal_matrix(v: jax.Array) -> jax.Array:
    """Return the matrix [n, n] with v [n] on its diagonal."""
    return v[:, None] * jnp.eye(v.shape[0], dtype=v.dtype)


def _norm(v: jax.Array) -> jax.Array:
    """Return the length [] of a vector [3], with gradient zero instead of NaN at zero."""
    square = jnp.sum(v * v)
    return jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)
