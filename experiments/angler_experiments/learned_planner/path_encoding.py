"""Encoded paths of the network, from and to points and times.

An encoded path is [inner, 4]: for way-points at equal steps along the path the offset from the
straight line, at the same fraction of it, in the robot's straight frame; and the delay relative to
cruise speed along the path. Start and goal are left out: they are fixed.
"""

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner.frames import StraightFrame
from angler_experiments.learned_planner.shapes import DELAY_SCALE_S, N_INNER_POINTS, OFFSET_SCALE_M
from angler_mjx.robot.control.commands.trajectory import Trajectory

_SPEED_FACTOR = 0.999
"""Factor on the speed, so that rounding cannot make a robot faster than allowed."""


def encode_path(path: Trajectory, frame: StraightFrame, speed_mps: jax.Array) -> jax.Array:
    """Return the encoding [inner, 4] of one robot's path."""
    leg = path.position_m[1:] - path.position_m[:-1]
    length = jnp.sqrt(jnp.sum(leg * leg, axis=-1))
    distance_m = jnp.concatenate([jnp.zeros(1, length.dtype), jnp.cumsum(length)])
    fraction = jnp.arange(1, N_INNER_POINTS + 1) / (N_INNER_POINTS + 1)
    target_m = fraction * distance_m[-1]
    # The last of equal points: a wait belongs to the leg after it.
    index = jnp.clip(jnp.searchsorted(distance_m, target_m, side="right") - 1, 0, length.size - 1)
    part_fraction = (target_m - distance_m[index]) / jnp.where(
        length[index] > 0.0, length[index], 1.0
    )
    position_m = path.position_m[index] + part_fraction[:, None] * leg[index]
    reached_s = path.time_s[index] + part_fraction * (path.time_s[index + 1] - path.time_s[index])
    offset = frame.to_frame(position_m - frame.points_on_line(fraction)) / OFFSET_SCALE_M
    delay = jnp.maximum(reached_s - target_m / speed_mps, 0.0) / DELAY_SCALE_S
    return jnp.concatenate([offset, delay[:, None]], axis=-1)


def decode_points(encoded: jax.Array, frame: StraightFrame, goal_m: jax.Array) -> jax.Array:
    """Return points [inner + 2, 3] in W of an encoded path [inner, 4], from start to goal."""
    fraction = jnp.arange(1, N_INNER_POINTS + 1) / (N_INNER_POINTS + 1)
    inner = frame.points_on_line(fraction) + frame.to_world(encoded[:, :3] * OFFSET_SCALE_M)
    return jnp.concatenate([frame.start_m[None], inner, goal_m[None]])


def decode_delays_s(encoded: jax.Array) -> jax.Array:
    """Return delays [inner + 1] of an encoded path's legs, none negative."""
    delay_s = jax.lax.cummax(jnp.maximum(encoded[:, 3], 0.0)) * DELAY_SCALE_S
    added = jnp.diff(delay_s, prepend=jnp.zeros(1, delay_s.dtype))
    return jnp.append(added, 0.0)


def time_path(
    position_m: jax.Array, added_s: jax.Array, hold_s: jax.Array, speed_mps: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return times [n + 1] and points [n + 1, 3] of a path that starts after ``hold_s``.

    Args:
        position_m: [n, 3] points.
        added_s: [n - 1] delays of legs relative to the cruise speed.
        hold_s: [] hold at the start.
        speed_mps: [] cruise speed.
    """
    leg = position_m[1:] - position_m[:-1]
    span = jnp.sqrt(jnp.sum(leg * leg, axis=-1)) / (_SPEED_FACTOR * speed_mps) + added_s
    after = hold_s + jnp.cumsum(span)
    time = jnp.concatenate([jnp.zeros((1,), span.dtype), hold_s[None], after])
    return time, jnp.concatenate([position_m[:1], position_m])


def pad_path(path: Trajectory, count: int) -> Trajectory:
    """Pad a path to more points: the last repeated with its time."""
    n_extra = count - path.time_s.shape[-1]
    return Trajectory(
        time_s=jnp.pad(path.time_s, (0, n_extra), mode="edge"),
        position_m=jnp.pad(path.position_m, ((0, n_extra), (0, 0)), mode="edge"),
        found=path.found,
    )
