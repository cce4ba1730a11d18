"""A path in time for each robot: what a planner hands to the controllers."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels.table import count_not_above, last_not_above, take_row


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """Way-points with times of one robot; linear in between, held at the end.

    Padding repeats the last way-point with its time, so every row is valid.
    """

    time_s: jax.Array
    """[n_point] increasing (equal where padded), first one 0."""
    position_m: jax.Array
    """[n_point, 3] in W."""
    found: jax.Array
    """bool [] False where the planner found no path: the robot holds its start."""


def hold_position(start_m: jax.Array, n_point: int) -> Trajectory:
    """Trajectories [R] that stay at ``start_m`` [R, 3]: no way was found, or none is known yet."""
    n_robot = start_m.shape[0]
    return Trajectory(
        time_s=jnp.zeros((n_robot, n_point), start_m.dtype),
        position_m=jnp.repeat(start_m[:, None], n_point, axis=1),
        found=jnp.zeros((n_robot,), bool),
    )


def segment_at(time_s: jax.Array, t: jax.Array, near: jax.Array | None = None) -> jax.Array:
    """Which segment of a path is flown at a time: int32 [], the row of its first point.

    Args:
        time_s: [n_point] of the points.
        t: [] s.
        near: int32 [] segment of a little before, where the search begins; by bisection if left
            out. Past the end of the path the segment does not matter, and is what ``near`` is.
    """
    n = time_s.shape[0]
    if near is None:
        return jnp.clip(count_not_above(time_s, t) - 1, 0, n - 2)
    # Padding is not walked along.
    until = jnp.where(t < time_s[-1], t, take_row(time_s, near))
    return jnp.minimum(last_not_above(time_s, until, near), n - 2)


def sample_reference(
    trajectory: Trajectory, t: jax.Array, segment: jax.Array | None = None
) -> tuple[jax.Array, jax.Array]:
    """Position and velocity of the reference at a time.

    Args:
        trajectory: of one robot.
        t: [] s.
        segment: int32 [] `segment_at` that time; looked for if left out.

    Returns:
        Position [3] m and velocity [3] m/s, in W; velocity is zero past the last way-point.
    """
    time, point = trajectory.time_s, trajectory.position_m
    k = segment_at(time, t) if segment is None else segment
    begin, start, end = take_row(time, k), take_row(point, k), point[-1]
    span = take_row(time, k + 1) - begin
    inside = (span > 0) & (t < time[-1])
    rate = (take_row(point, k + 1) - start) / jnp.where(span > 0, span, 1.0)
    velocity = jnp.where(inside, rate, 0.0)
    position = jnp.where(inside, start + rate * (t - begin), end)
    return position, velocity
