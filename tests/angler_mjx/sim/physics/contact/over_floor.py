"""One rigid body over a level floor in vacuum, stepped with contact: what closed forms judge.

The body is a number of points with a radius each: one point is a sphere, two a capsule, eight
without a radius a box. Geometry and motion are written here; the contact alone is the simulator's.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import Touches
from angler_mjx.sim.physics.contact.resolve import ContactSpec, WorldBodies, resolve_contact

from ....compiling import thoroughly

LAYOUT = BodyLayout(
    robots=1, joints=0, capsules=1, obstacles=0, has_capsules=False, has_boxes=False
)
POINTS = 8
RECORDS = 60
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Body:
    """A body, its contact and what pulls it."""

    points: jax.Array
    """[8, 3] m from its centre, in its frame."""
    radius: jax.Array
    """[8] m; negative for a point that does not exist."""
    M: jax.Array
    """[6, 6] inertia with added mass."""
    pull: jax.Array
    """[3] force, N, in W."""
    friction: jax.Array
    zeta: jax.Array
    rate: jax.Array
    dt: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Motion:
    """Motion of a body, and the force on it."""

    p: jax.Array
    R: jax.Array
    """[3, 3] to W."""
    velocity: jax.Array
    """[6] linear in W, angular in the body's frame."""
    normal_n: jax.Array
    """[] normal force of all points in the last step."""
    most_depth_m: jax.Array
    """[] greatest overlap so far."""


def sphere(radius, mass, **others):
    """Return a sphere; ``mass`` [6] is the diagonal of its inertia."""
    radii = np.full(POINTS, -np.inf)
    radii[0] = radius
    return _body(np.zeros((POINTS, 3)), radii, mass, **others)


def box(half, mass, **others):
    """Return a box of half extents [3] m."""
    return _body(CORNERS * np.asarray(half), np.zeros(POINTS), mass, **others)


def _body(points, radius, mass, *, pull, friction=0.0, zeta=0.5, rate=50.0, dt=0.005):
    scalars = {"friction": friction, "zeta": zeta, "rate": rate, "dt": dt}
    return Body(
        points=np.asarray(points, float),
        radius=radius,
        M=np.diag(np.asarray(mass, float)),
        pull=np.asarray(pull, float),
        **{name: np.asarray(value, float) for name, value in scalars.items()},
    )


def begin(p, velocity=(0.0,) * 6, R=None):
    """Return a motion that begins at p [3]."""
    return Motion(
        p=np.asarray(p, float),
        R=np.eye(3) if R is None else np.asarray(R, float),
        velocity=np.asarray(velocity, float),
        normal_n=np.zeros(()),
        most_depth_m=np.zeros(()),
    )


def _turn(w):
    """Return the rotation [3, 3] by a vector w [3] (Rodrigues)."""
    angle = jnp.sqrt(jnp.sum(w * w) + 1e-30)
    K = jnp.cross(jnp.eye(3, dtype=w.dtype), w / angle)
    return jnp.eye(3, dtype=w.dtype) + jnp.sin(angle) * K + (1 - jnp.cos(angle)) * K @ K


def step(body, now):
    """Return the motion of one body a step later."""
    arm = body.points @ now.R.T
    center = now.p + arm
    depth = jnp.where(body.radius < 0.0, -1.0, body.radius - center[:, 2])
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0], depth.dtype), (POINTS, 3))
    lowest = jnp.where(body.radius < 0.0, 0.0, body.radius)
    touches = Touches(
        depth_m=depth,
        position=center - up * (lowest - 0.5 * jnp.maximum(depth, 0.0))[:, None],
        normal=up,
        first=jnp.full(POINTS, LAYOUT.shapes + 1, jnp.int32),
        second=jnp.zeros(POINTS, jnp.int32),
    )
    inertia = body.M[3:, 3:]
    spin = now.velocity[3:]
    gyroscopic = jnp.cross(inertia @ spin, spin)
    force = jnp.concatenate([body.pull, gyroscopic])
    bodies = WorldBodies(
        p=now.p[None],
        rotation=now.R[None],
        free=jnp.array([True]),
        velocity=now.velocity,
        unconstrained=now.velocity + body.dt * jnp.linalg.inv(body.M) @ force,
        M_robots=body.M[None],
        M_obstacles=jnp.zeros((0, 6, 6), body.M.dtype),
    )
    spec = ContactSpec(
        friction=jnp.broadcast_to(body.friction, (4, 4)),
        damping_ratio=jnp.broadcast_to(body.zeta, (4, 4)),
        rate_radps=body.rate,
    )
    forces = resolve_contact(spec, LAYOUT, bodies, touches, body.dt)
    velocity = forces.velocity
    return Motion(
        p=now.p + body.dt * velocity[:3],
        R=now.R @ _turn(body.dt * velocity[3:]),
        velocity=velocity,
        normal_n=jnp.sum(forces.normal_force_n),
        most_depth_m=jnp.maximum(now.most_depth_m, jnp.max(depth)),
    )


def _fly(bodies, motions, steps):
    def record(now, _):
        advance = jax.vmap(step)
        later = jax.lax.fori_loop(0, steps, lambda _, m: advance(bodies, m), now)
        return later, later

    return jax.lax.scan(record, motions, None, length=RECORDS)[1]


_fly_compiled = thoroughly(_fly)
BATCH = 12
"""Bodies of one program; fewer are padded."""


def fly(bodies, motions, steps, dtype=float):
    """Return motions [body, 60 records, ...] every ``steps`` steps, in NumPy."""
    n = len(bodies)
    chosen = [min(i, n - 1) for i in range(BATCH)]

    def stack(rows):
        return jax.tree.map(
            lambda *leaves: jnp.asarray(np.stack(leaves), dtype), *[rows[i] for i in chosen]
        )

    found = jax.device_get(_fly_compiled(stack(bodies), stack(motions), steps))
    return jax.tree.map(lambda leaf: np.swapaxes(leaf, 0, 1)[:n], found)
