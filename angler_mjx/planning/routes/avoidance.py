"""Velocity of one robot among moving bodies: near the wanted one, and without contact.

Velocity obstacles (P. Fiorini and Z. Shiller, "Motion planning in dynamic environments using
velocity obstacles", Int. J. Robotics Research 17(7), 1998): for each of a set of velocities the
time to the first contact is computed, with all bodies going straight on. Among robots each takes
half of the avoidance: reciprocal velocity obstacles (J. van den Berg, M. Lin and
D. Manocha, "Reciprocal velocity obstacles for real-time multi-agent navigation", ICRA 2008), whose
penalty this is, w / time + |v - v wanted|. Robots that do the same and meet head-on pass each other
on their left-hand sides: each prefers to turn to its right.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.world import routes as reading
from angler_mjx.world.routes import Routes

ANGLES_RAD = tuple(math.radians(angle) for angle in (15.0, 35.0, 60.0, 95.0, 140.0))
"""Of the velocities that are tried, off the wanted one."""
SIDES = 6
"""Directions about the wanted one at each angle."""
SPEED_FRACTIONS = (1.0, 0.5)
"""Shares of the cruise speed at which they are tried."""
SLOWER_FRACTIONS = (1.0, 0.7, 0.35, 0.0)
"""Shares of the wanted velocity that are tried."""
CONTACT_S = 1.5
"""A contact in so many seconds costs as much as a velocity that is off the wanted one by the cruise
speed; one at the horizon costs nothing."""
ROCK_COST = 6.0
"""Cost of an immediate contact with rock, likewise."""
ROCK_S = (0.5, 1.0, 1.5, 2.0)
"""Times ahead at which rock is looked for."""
LEFT_TURN_COST = 0.03
"""Extra cost of a velocity straight to the left over one to the right, likewise."""
RESPONSE_S = 0.3
"""Time in which a robot takes up a velocity."""
STANDS_MPS = 0.05
"""Speed [m/s] below which a robot counts as standing and does not give way."""
STANDING_COST = 1.5
"""Cost of standing still for a robot without progress for long, likewise."""
ROOM_M = 0.5
"""Beside the margin, that robots with nowhere to go leave to others."""
OUT_PER_S = 0.5
"""Fraction of a deficit of distance that a robot has to regain in a second."""
SLIP = 0.05
"""Share of the distance to such a body that it must not lose."""
SLIP_S = 0.5
"""Losing it sooner costs no more: there may be rock on the other side."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AvoidedBodies:
    """Bodies that one robot must not touch; [n] rows."""

    p_m: jax.Array
    """[n, 3] centres, in W."""
    v_mps: jax.Array
    """[n, 3] in W."""
    reach_m: jax.Array
    """[n] distance of the centres at a contact, with the margin; below 0 for absent bodies."""
    yields: jax.Array
    """bool [n] whether the body avoids this robot as this robot does it."""


def choose_velocity(
    routes: Routes,
    bodies: AvoidedBodies,
    p: jax.Array,
    v: jax.Array,
    preferred_mps: jax.Array,
    speed_mps: jax.Array,
    horizon_s: jax.Array | float,
    held_up: jax.Array | float = 0.0,
) -> jax.Array:
    """Return the velocity to fly, [3] m/s over ground in W.

    Args:
        routes: of the world, for rock.
        bodies: that are known.
        p: [3] of the robot, in W.
        v: [3] its velocity over ground.
        preferred_mps: [3] velocity that it would have alone.
        speed_mps: [] its cruise speed.
        horizon_s: contacts later than this do not count.
        held_up: [] 0 to 1, lack of progress of late. Before a body that stands,
            too, nothing is as near to the wanted velocity as to stand there for ever.
    """
    candidates_mps = candidate_velocities(preferred_mps, speed_mps)
    deviation = (
        jnp.sqrt(sum((candidates_mps[i] - preferred_mps[i]) ** 2 for i in range(3))) / speed_mps
    )
    contact_time_s = jnp.min(contact_s(bodies, p, v, candidates_mps), axis=0, initial=jnp.inf)
    urgency = jnp.maximum(1.0 / jnp.maximum(contact_time_s, 0.1) - 1.0 / horizon_s, 0.0)
    # Reached with a lag: the robot drifts on as it does now for a moment.
    ahead_s = jnp.array(ROCK_S)[:, None]
    ahead = [
        p[i] + RESPONSE_S * (v[i] - candidates_mps[i]) + ahead_s * candidates_mps[i]
        for i in range(3)
    ]
    rock_weights = np.linspace(2.0, 0.0, len(ROCK_S) + 1)[:-1, None] / len(ROCK_S)
    rock = jnp.sum(jnp.where(reading.is_clear(routes, *ahead), 0.0, rock_weights), axis=0)
    turn_side = (
        candidates_mps[0] * preferred_mps[1] - candidates_mps[1] * preferred_mps[0]
    ) / speed_mps**2
    slowness = 1.0 - jnp.sqrt(sum(each**2 for each in candidates_mps)) / speed_mps
    cost = (
        deviation
        + STANDING_COST * held_up * slowness
        + CONTACT_S * urgency
        + ROCK_COST * rock
        - LEFT_TURN_COST * jnp.clip(turn_side, -1.0, 1.0)
    )
    # One thread for each velocity, and then the least: threads of a whole robot would be too few.
    best = jnp.argmin(jax.lax.optimization_barrier(cost))
    return jnp.stack([each[best] for each in candidates_mps])


def make_room(bodies: AvoidedBodies, p: jax.Array) -> jax.Array:
    """Return the vector [3] along which a robot without a goal gives way; at most 1 long."""
    apart = p - bodies.p_m
    far = jnp.sqrt(jnp.sum(apart**2, axis=-1) + 1e-12)
    near = jnp.clip(1.0 - (far - bodies.reach_m) / ROOM_M, 0.0, 1.0) * (bodies.reach_m > 0.0)
    away = jnp.sum(apart * (near / far)[:, None], axis=0)
    return away / jnp.maximum(jnp.sqrt(jnp.sum(away**2) + 1e-12), 1.0)


def inflate_for_doubt(bodies: AvoidedBodies, p: jax.Array, doubt_m: jax.Array) -> AvoidedBodies:
    """Inflate bodies by their position uncertainty [n] m, but not into contact with the robot."""
    distance_m = jnp.sqrt(jnp.sum((bodies.p_m - p) ** 2, axis=-1) + 1e-12)
    max_reach_m = jnp.maximum(bodies.reach_m, (1.0 - SLIP) * distance_m)
    inflated_m = jnp.minimum(bodies.reach_m + doubt_m, max_reach_m)
    inflated_m = jnp.where(bodies.reach_m > 0.0, inflated_m, -1.0)
    # Once for each body, not again for each velocity that is tried.
    return replace(bodies, reach_m=jax.lax.optimization_barrier(inflated_m))


def candidate_velocities(preferred_mps: jax.Array, speed_mps: jax.Array) -> list[jax.Array]:
    """Return candidate velocities x, y, z [m]: slower ones, and others about the wanted one [3]."""
    length = jnp.sqrt(jnp.sum(preferred_mps**2) + 1e-12)
    still = jnp.array([1.0, 0.0, 0.0])
    ahead = jnp.where(length > 1e-3, preferred_mps / length, still)
    flat = jnp.sqrt(ahead[0] ** 2 + ahead[1] ** 2)
    right = jnp.where(
        flat > 1e-3,
        jnp.stack([ahead[1], -ahead[0], jnp.zeros_like(flat)]) / jnp.maximum(flat, 1e-3),
        jnp.array([0.0, -1.0, 0.0]),
    )
    up = jnp.cross(right, ahead)
    angle = np.repeat(ANGLES_RAD, SIDES)
    side = np.tile(2.0 * np.pi * np.arange(SIDES) / SIDES, len(ANGLES_RAD))
    turned, along = np.cos(angle), [np.sin(angle) * np.cos(side), np.sin(angle) * np.sin(side)]
    velocities = []
    for i in range(3):
        about = turned * ahead[i] + along[0] * right[i] + along[1] * up[i]
        around = jnp.append(about, -ahead[i]) * speed_mps
        slower = np.array(SLOWER_FRACTIONS) * preferred_mps[i]
        velocities.append(
            jnp.concatenate([slower, *(fraction * around for fraction in SPEED_FRACTIONS)])
        )
    return velocities


def contact_s(
    bodies: AvoidedBodies, p: jax.Array, v: jax.Array, candidates_mps: Sequence[jax.Array]
) -> jax.Array:
    """Return times [n, m] to first contact with each body at velocities x, y, z [m]; inf for none.

    With a body that is nearer than its reach: until the distance is less by `SLIP`, unless the
    robot comes away.
    """
    apart = bodies.p_m - p
    square = jnp.sum(apart**2, axis=-1)
    far = jnp.sqrt(square + 1e-12)[:, None]
    # Whoever avoids likewise changes by the other half of what this robot changes by.
    times = jnp.where(bodies.yields, 2.0, 1.0)
    goes = bodies.v_mps + (times - 1.0)[:, None] * v
    closing = [times[:, None] * candidates_mps[i] - goes[:, i, None] for i in range(3)]
    a = sum(each**2 for each in closing)
    b = sum(each * apart[:, i, None] for i, each in enumerate(closing))
    c = (square - bodies.reach_m**2)[:, None]
    root = b**2 - a * c
    meets = (b > 0.0) & (root > 0.0) & (bodies.reach_m > 0.0)[:, None]
    when = c / jnp.where(meets, b + jnp.sqrt(jnp.where(meets, root, 1.0)), 1.0)
    # Nearer than the reach already: to come no nearer does not do, since two side by side that both
    # slip a little would touch in the end.
    deep = bodies.reach_m[:, None] - far
    nears = b / far + OUT_PER_S * deep
    slips = jnp.maximum(SLIP * far / jnp.where(nears > 0.0, nears, 1.0), SLIP_S)
    inside = deep > 0.0
    return jnp.where(jnp.where(inside, nears > 0.0, meets), jnp.where(inside, slips, when), jnp.inf)
