"""Loose bodies in vacuum that meet each other, rock and a floor: stepped with all of contact."""

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.sim.physics.contact import candidates, mjx_contact
from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.resolve import ContactSpec, WorldBodies, resolve_contact
from angler_mjx.world.obstacles import BOX, CAPSULE, DRIFT, SPHERE, Obstacles
from angler_mjx.world.rock.grid import Grid

FRICTION, ZETA, DT = 0.5, 0.4, 0.01
SPEC = ContactSpec(
    friction=((FRICTION,) * 4,) * 4, damping_ratio=((ZETA,) * 4,) * 4, rate_radps=0.25 / DT
)
NO_HULLS = np.zeros((0, 0, 3)), np.zeros((0, 0, 3)), np.zeros((0, 0))


def lay_out(n, boxes=True, axis_pieces=()):
    """Return the layout of n loose bodies."""
    return BodyLayout(
        robots=0,
        joints=0,
        capsules=0,
        obstacles=n,
        has_capsules=True,
        has_boxes=boxes,
        axis_pieces=axis_pieces,
    )


def describe(kind, size, mass, inertia):
    """Return bodies [n] without water; ``inertia`` [n] is that of a ball."""
    n = len(kind)
    zeros = np.zeros((n, 6))
    return Obstacles(
        kind=np.asarray(kind, np.int32),
        size_m=np.asarray(size, float),
        motion=np.full(n, DRIFT, np.int32),
        path=np.zeros((n, 8)),
        p0=np.zeros((n, 3)),
        q0=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        nu0=zeros,
        mass_kg=np.asarray(mass, float),
        inertia_kgm2=np.repeat(np.asarray(inertia, float)[:, None], 3, axis=1),
        volume_m3=np.zeros(n),
        M_A=zeros,
        D_l=zeros,
        D_q=zeros,
        exists=np.ones(n, bool),
        kinds=(SPHERE, BOX, CAPSULE),
        motions=(DRIFT,),
    )


def advance(layout, bodies, gravity, ground, now):
    """Return positions [n, 3], attitudes [n, 4], velocities [n, 6] and the depth after a step.

    Args:
        layout: of the bodies.
        bodies: their properties.
        gravity: [3] m/s2.
        ground: rock and height of the floor; None without.
        now: positions, attitudes, velocities (angular in the bodies' frames), greatest depth.
    """
    *moved, forces = push(layout, bodies, gravity, ground, now[:3])
    return *moved, jnp.maximum(now[3], jnp.max(forces.touches.depth_m))


def push(layout, bodies, gravity, ground, now, free=None):
    """Return positions, attitudes and velocities after a step, and its `ContactForces`.

    Args:
        layout: of the bodies.
        bodies: their properties.
        gravity: [3] m/s2, or [n, 3].
        ground: rock and height of the floor; None without.
        now: positions, attitudes, velocities (angular in the bodies' frames).
        free: bool [n] which can be pushed; all if None.
    """
    p, q, v = now
    n, dtype = layout.obstacles, p.dtype
    hulls = tuple(jnp.asarray(part, dtype) for part in NO_HULLS)
    shapes = candidates.locate_shapes(layout, hulls, bodies, p, q)
    touches = mjx_contact.find_touches(layout, shapes)
    if ground is not None:
        touches = candidates.join_touches(touches, candidates.touch_ground(layout, shapes, *ground))
    masses = jnp.concatenate(
        [jnp.repeat(bodies.mass_kg[:, None], 3, axis=1), bodies.inertia_kgm2], axis=1
    )
    gravity = jnp.broadcast_to(gravity, (n, 3))
    pull = jnp.concatenate([gravity, jnp.zeros((n, 3), dtype)], axis=1)
    forces = resolve_contact(
        SPEC,
        layout,
        WorldBodies(
            p=p,
            rotation=jax.vmap(quaternion.to_matrix)(q),
            free=jnp.ones(n, bool) if free is None else free,
            velocity=jnp.ravel(v),
            unconstrained=jnp.ravel(v + DT * pull),
            M_robots=jnp.zeros((0, 6, 6), dtype),
            M_obstacles=masses[:, :, None] * jnp.eye(6, dtype=dtype),
        ),
        touches,
        DT,
    )
    v = jnp.reshape(forces.velocity, (n, 6))
    turn = jax.vmap(quaternion.exp_small)(DT * v[:, 3:])
    q = jax.vmap(quaternion.multiply)(q, turn)
    q = q / jnp.sqrt(jnp.sum(q * q, axis=1, keepdims=True))
    return p + DT * v[:, :3], q, v, forces


def empty_grid():
    """Return rock of which there is none."""
    return Grid(
        occupied=np.zeros((1, 1, 1), bool), origin_m=np.full(3, -90.0), cell_m=np.asarray(1.0)
    )
