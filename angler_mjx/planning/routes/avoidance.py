"""The velocity of one robot among bodies that move: near to the wanted one, and without contact.

Velocity obstacles (P. Fiorini and Z. Shiller, "Motion planning in dynamic environments using
velocity obstacles", Int. J. Robotics Research 17(7), 1998): for each of a set of velocities the
time to the first contact is worked out, with all bodies going straight on. Among robots each takes
half of what is to be avoided: reciprocal velocity obstacles (J. van den Berg, M. Lin and
D. Manocha, "Reciprocal velocity obstacles for real-time multi-agent navigation", ICRA 2008), whose
penalty this is, w / time + |v - v wanted|. Robots that do the same and meet head-on pass each other
on their left-hand sides: each prefers to turn to its right.
"""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.world import routes as reading
from angler_mjx.world.routes import Routes

ANGLES_RAD = tuple(math.radians(angle) for angle in (15.0, 30.0, 50.0, 75.0, 105.0, 140.0))
"""Of the velocities that are tried, off the wanted one."""
SIDES = 8
"""Directions about the wanted one at each angle."""
SPEEDS = (1.0, 0.5)
"""Shares of the cruise speed at which they are tried."""
SLOWER = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Shares of the wanted velocity that are tried."""
CONTACT_S = 1.5
"""A contact in so many seconds costs as much as flying at cruise speed beside the wanted velocity,
more than it would in twice the time."""
ROCK = 6.0
"""What flying into rock at once costs, likewise."""
ROCK_S = tuple(0.3 * (k + 1) for k in range(8))
"""Times ahead at which rock is looked for."""
RIGHT = 0.03
"""What going straight to the left costs more than to the right, likewise."""
RESPONSE_S = 0.3
"""Time in which a robot takes up a velocity."""
STANDS_MPS = 0.05
"""A robot slower than this is not taken to get out of the way."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Bodies:
    """What one robot must not touch; [n] rows."""

    p_m: jax.Array
    """[n, 3] centres, in W."""
    v_mps: jax.Array
    """[n, 3] in W."""
    reach_m: jax.Array
    """[n] distance of the centres at a contact, with the margin; below 0 for what is not there."""
    yields: jax.Array
    """bool [n] whether the body avoids this robot as this robot does it."""


def choose(
    routes: Routes,
    bodies: Bodies,
    p: jax.Array,
    v: jax.Array,
    wanted: jax.Array,
    speed_mps: jax.Array,
    horizon_s: jax.Array | float,
) -> jax.Array:
    """The velocity to have, [3] m/s over ground in W.

    Args:
        routes: of the world, for rock.
        bodies: that are known.
        p: [3] of the robot, in W.
        v: [3] its velocity over ground.
        wanted: [3] velocity that it would have alone.
        speed_mps: [] its cruise speed.
        horizon_s: contacts later than this do not count.
    """
    tried = candidates(wanted, speed_mps)
    off = jnp.sqrt(jnp.sum((tried - wanted) ** 2, axis=-1)) / speed_mps
    when = jnp.min(_contact_s(bodies, p, v, tried), axis=-1, initial=jnp.inf)
    late = jnp.maximum(1.0 / jnp.maximum(when, 0.1) - 1.0 / horizon_s, 0.0)
    # Reached with a lag: the robot drifts on as it does now for a moment.
    begin = p + RESPONSE_S * (v - tried)
    ahead = begin[:, None] + jnp.array(ROCK_S)[:, None] * tried[:, None]
    share = np.linspace(2.0, 0.0, len(ROCK_S) + 1)[:-1] / len(ROCK_S)
    rock = jnp.sum(jnp.where(reading.is_clear(routes, ahead), 0.0, share), axis=-1)
    right = jnp.stack([wanted[1], -wanted[0], jnp.zeros_like(wanted[0])])
    aside = tried @ right / jnp.maximum(speed_mps**2, 1e-6)
    cost = off + CONTACT_S * late + ROCK * rock - RIGHT * jnp.clip(aside, -1.0, 1.0)
    return tried[jnp.argmin(cost)]


def candidates(wanted: jax.Array, speed_mps: jax.Array) -> jax.Array:
    """Velocities [n, 3] to be tried: slower ones, and others about the wanted one [3]."""
    length = jnp.sqrt(jnp.sum(wanted**2) + 1e-12)
    still = jnp.array([1.0, 0.0, 0.0])
    ahead = jnp.where(length > 1e-3, wanted / length, still)
    flat = jnp.sqrt(ahead[0] ** 2 + ahead[1] ** 2)
    right = jnp.where(
        flat > 1e-3,
        jnp.stack([ahead[1], -ahead[0], jnp.zeros_like(flat)]) / jnp.maximum(flat, 1e-3),
        jnp.array([0.0, -1.0, 0.0]),
    )
    up = jnp.cross(right, ahead)
    angle = np.repeat(ANGLES_RAD, SIDES)
    side = np.tile(2.0 * np.pi * np.arange(SIDES) / SIDES, len(ANGLES_RAD))
    about = (
        jnp.outer(np.cos(angle), ahead)
        + jnp.outer(np.sin(angle) * np.cos(side), right)
        + jnp.outer(np.sin(angle) * np.sin(side), up)
    )
    fast = (jnp.array(SPEEDS)[:, None, None] * speed_mps * about).reshape(-1, 3)
    return jnp.concatenate([jnp.outer(np.array(SLOWER), wanted), fast])


def _contact_s(bodies: Bodies, p: jax.Array, v: jax.Array, tried: jax.Array) -> jax.Array:
    """Times [m, n] to the first contact with each body at each velocity [m, 3]; inf for none."""
    apart = bodies.p_m - p
    square = jnp.sum(apart**2, axis=-1)
    # Nearer than the reach already: it only must not come nearer still.
    reach = jnp.minimum(bodies.reach_m, 0.95 * jnp.sqrt(square + 1e-12))
    # Whoever avoids likewise changes by the other half of what this robot changes by.
    own = jnp.where(bodies.yields[:, None], 2.0 * tried[:, None] - v, tried[:, None])
    closing = own - bodies.v_mps
    a, b = jnp.sum(closing**2, axis=-1), jnp.sum(closing * apart, axis=-1)
    c = square - reach**2
    root = b**2 - a * c
    meets = (b > 0.0) & (root > 0.0) & (bodies.reach_m > 0.0)
    when = c / jnp.where(meets, b + jnp.sqrt(jnp.where(meets, root, 1.0)), 1.0)
    return jnp.where(meets, when, jnp.inf)
