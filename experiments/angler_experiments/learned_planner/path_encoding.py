"""Ways as the network has them, from paths and to points and times.

A way is [inner, 4]: of way-points at equal steps along the path how far each is off the straight
line, at the same share of that, in the robot's straight frame; and by how much it is later than
the cruise speed along the path would be there. Start and goal are in none: they are what they are.
"""

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner.frames import StraightFrame
from angler_experiments.learned_planner.shapes import DELAY_S, INNER, OFF_M
from angler_mjx.robot.control.trajectory import Trajectory

_SLOWER = 0.999
"""Rounding must not make a robot faster than it may be."""


def from_path(path: Trajectory, frame: StraightFrame, speed_mps: jax.Array) -> jax.Array:
    """The way [inner, 4] of one robot's path."""
    leg = path.position_m[1:] - path.position_m[:-1]
    length = jnp.sqrt(jnp.sum(leg * leg, axis=-1))
    far = jnp.concatenate([jnp.zeros(1, length.dtype), jnp.cumsum(length)])
    share = jnp.arange(1, INNER + 1) / (INNER + 1)
    at = share * far[-1]
    # The last of equal points: a wait belongs to what comes after it.
    low = jnp.clip(jnp.searchsorted(far, at, side="right") - 1, 0, length.size - 1)
    part = (at - far[low]) / jnp.where(length[low] > 0.0, length[low], 1.0)
    place = path.position_m[low] + part[:, None] * leg[low]
    when = path.time_s[low] + part * (path.time_s[low + 1] - path.time_s[low])
    off = frame.inward(place - frame.line(share)) / OFF_M
    late = jnp.maximum(when - at / speed_mps, 0.0) / DELAY_S
    return jnp.concatenate([off, late[:, None]], axis=-1)


def points(way: jax.Array, frame: StraightFrame, goal_m: jax.Array) -> jax.Array:
    """Points [inner + 2, 3] in W of a way [inner, 4], from start to goal."""
    share = jnp.arange(1, INNER + 1) / (INNER + 1)
    inner = frame.line(share) + frame.outward(way[:, :3] * OFF_M)
    return jnp.concatenate([frame.start_m[None], inner, goal_m[None]])


def delays_s(way: jax.Array) -> jax.Array:
    """Delays [inner + 1] that a way adds in its legs, none negative."""
    late = jax.lax.cummax(jnp.maximum(way[:, 3], 0.0)) * DELAY_S
    added = jnp.diff(late, prepend=jnp.zeros(1, late.dtype))
    return jnp.append(added, 0.0)


def timed(
    place: jax.Array, added_s: jax.Array, hold_s: jax.Array, speed_mps: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Times [n + 1] and points [n + 1, 3] of a way that sets off after ``hold_s``.

    Args:
        place: [n, 3] points.
        added_s: [n - 1] by which legs are slower than the cruise speed.
        hold_s: [].
        speed_mps: [] cruise speed.
    """
    leg = place[1:] - place[:-1]
    span = jnp.sqrt(jnp.sum(leg * leg, axis=-1)) / (_SLOWER * speed_mps) + added_s
    after = hold_s + jnp.cumsum(span)
    time = jnp.concatenate([jnp.zeros((1,), span.dtype), hold_s[None], after])
    return time, jnp.concatenate([place[:1], place])


def padded(path: Trajectory, count: int) -> Trajectory:
    """A path of more points: the last repeated with its time."""
    more = count - path.time_s.shape[-1]
    return Trajectory(
        time_s=jnp.pad(path.time_s, (0, more), mode="edge"),
        position_m=jnp.pad(path.position_m, ((0, more), (0, 0)), mode="edge"),
        found=path.found,
    )
