"""Input of the network for one world, relative to the straight lines of its robots.

The input depends neither on the origin of W nor on the number of a robot. Rock, faces of the cube,
sea floor are one field of distances; obstacles that stand or move are rows of their own.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner.frames import StraightFrame, build_straight_frame
from angler_experiments.learned_planner.rock_distance import compute_depth_field, interpolate_field
from angler_experiments.learned_planner.shapes import N_ABOVE, N_ASIDE, N_SLICES, SAMPLE_SPACING_M
from angler_mjx.planning.problem import Problem
from angler_mjx.sim.information import ObstacleInformation

_MAX_GAP_M = 3.0
"""Maximum of gaps; greater ones are clipped."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Scene:
    """Input of the network for one world."""

    gap: jax.Array
    """[R, slices, aside, above] distance to rock, less the radius, over `_MAX_GAP_M`."""
    own: jax.Array
    """[R, 4] length, slope, radius, cruise speed of the robot."""
    others: jax.Array
    """[R, R, 14] of robot i: start, goal, position at the closest approach of straight lines, of
    robot j in i's frame; distance and time of that approach, its radius and speed, and the length
    of its line."""
    bodies: jax.Array
    """[R, n, 7] position at the start, velocity, radius."""
    water: jax.Array
    """[R, slices, 3] known current at t = 0, in the frame of each robot."""
    exists: jax.Array
    """bool [R] whether the robot exists."""
    body_exists: jax.Array
    """bool [n] whether the body exists."""


def build_frames(problem: Problem) -> StraightFrame:
    """Build the frames [R] of a team."""
    return jax.vmap(build_straight_frame)(problem.team.start_m, problem.team.goal_m)


def build_scene(problem: Problem) -> Scene:
    """Build the input of one world; ``vmap`` it for a batch.

    Args:
        problem: arrays of JAX, without [world].
    """
    team, obstacles = problem.team, problem.obstacles
    frames = build_frames(problem)
    field = compute_depth_field(problem.grid, problem.floor_z_m)
    fraction = jnp.linspace(0.0, 1.0, N_SLICES)
    aside = (jnp.arange(N_ASIDE) - (N_ASIDE - 1) / 2) * SAMPLE_SPACING_M
    above = (jnp.arange(N_ABOVE) - (N_ABOVE - 1) / 2) * SAMPLE_SPACING_M

    def sample_gaps(frame: StraightFrame, radius: jax.Array) -> jax.Array:
        position_m = (
            frame.points_on_line(fraction)[:, None, None]
            + aside[:, None, None] * frame.axes[1]
            + above[:, None] * frame.axes[2]
        )
        gap = interpolate_field(problem.grid, field, position_m) - radius
        return jnp.clip(gap, -_MAX_GAP_M, _MAX_GAP_M) / _MAX_GAP_M

    def sample_current(frame: StraightFrame) -> jax.Array:
        zero = jnp.zeros((), team.start_m.dtype)
        water_mps = jax.vmap(lambda p: problem.current.velocity(p, zero))(
            frame.points_on_line(fraction)
        )
        return frame.to_frame(water_mps)

    return Scene(
        gap=jax.vmap(sample_gaps)(frames, team.radius_m),
        own=jnp.stack(
            [
                frames.length_m / 20.0,
                frames.axes[:, 0, 2],
                team.radius_m,
                team.cruise_speed_mps,
            ],
            axis=-1,
        ),
        others=_encode_others(problem, frames),
        bodies=_encode_bodies(obstacles, frames),
        water=jax.vmap(sample_current)(frames),
        exists=jnp.ones(team.radius_m.shape, bool),
        body_exists=obstacles.exists,
    )


def _encode_others(problem: Problem, frames: StraightFrame) -> jax.Array:
    team = problem.team
    speed = team.cruise_speed_mps
    duration_s = frames.length_m / speed
    rate = (team.goal_m - team.start_m) / jnp.maximum(duration_s, 1e-3)[:, None]
    until = jnp.minimum(duration_s[:, None], duration_s)
    offset_m = team.start_m[None] - team.start_m[:, None]
    relative = rate[None] - rate[:, None]
    square = jnp.sum(relative**2, axis=-1)
    meeting_s = -jnp.sum(offset_m * relative, axis=-1) / jnp.where(square > 1e-9, square, 1.0)
    meeting_s = jnp.clip(meeting_s, 0.0, until)
    nearest = offset_m + meeting_s[..., None] * relative

    def encode_pair(
        frame: StraightFrame, offset_m: jax.Array, goal: jax.Array, meeting_m: jax.Array
    ) -> jax.Array:
        vectors = (offset_m / 10.0, (goal - frame.start_m) / 10.0, meeting_m / 5.0)
        return jnp.concatenate([frame.to_frame(vector) for vector in vectors], axis=-1)

    positions = jax.vmap(encode_pair, in_axes=(0, 0, None, 0))(
        frames, offset_m, team.goal_m, nearest
    )
    gap = jnp.sqrt(jnp.sum(nearest**2, axis=-1))
    shape = gap.shape
    numbers = (
        jnp.minimum(gap, 5.0) / 5.0,
        meeting_s / 40.0,
        jnp.broadcast_to(team.radius_m, shape),
        jnp.broadcast_to(speed, shape),
        jnp.broadcast_to(frames.length_m / 20.0, shape),
    )
    return jnp.concatenate([positions, jnp.stack(numbers, axis=-1)], axis=-1)


def _encode_bodies(obstacles: ObstacleInformation, frames: StraightFrame) -> jax.Array:
    def encode_robot(frame: StraightFrame) -> jax.Array:
        position = frame.to_frame(obstacles.p_m[:, 0] - frame.start_m) / 10.0
        return jnp.concatenate(
            [position, frame.to_frame(obstacles.velocity_mps), obstacles.radius_m[:, None]], axis=-1
        )

    return jax.vmap(encode_robot)(frames)
