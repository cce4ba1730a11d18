"""What the network is told of one world: all of it seen from the straight lines of its robots.

Nothing here depends on where W begins, nor on the number of a robot. Rock, faces of the cube, sea
floor are one field of distances; obstacles that stand or move are rows of their own.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner.frames import StraightFrame, straight
from angler_experiments.learned_planner.rock import depth_field, read_field
from angler_experiments.learned_planner.shapes import ABOVE, ASIDE, LOOK_M, SLICES
from angler_mjx.planning.problem import Problem
from angler_mjx.sim.information import ObstacleInformation

_FAR_M = 3.0
"""Gaps count up to this."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Scene:
    """One world as the network sees it."""

    gap: jax.Array
    """[R, slices, aside, above] distance to what stands, less the robot's radius, over `_FAR_M`."""
    own: jax.Array
    """[R, 4] length, slope, radius, cruise speed."""
    others: jax.Array
    """[R, R, 14] of robot i: start, goal, place when they are nearest on straight lines, of robot
    j in i's frame; that distance, when, its radius and speed, and the length of its line."""
    bodies: jax.Array
    """[R, n, 7] place at the start, velocity, radius."""
    water: jax.Array
    """[R, slices, 3] the current as it is told, at t = 0, in the frame of each robot."""
    exists: jax.Array
    """bool [R]."""
    body_exists: jax.Array
    """bool [n]."""


def lines(problem: Problem) -> StraightFrame:
    """The frames [R] of a team."""
    return jax.vmap(straight)(problem.team.start_m, problem.team.goal_m)


def scene(problem: Problem) -> Scene:
    """One world; ``vmap`` it for a batch.

    Args:
        problem: arrays of JAX, without [world].
    """
    team, known = problem.team, problem.obstacles
    frames = lines(problem)
    field = depth_field(problem.grid, problem.floor_z_m)
    share = jnp.linspace(0.0, 1.0, SLICES)
    aside = (jnp.arange(ASIDE) - (ASIDE - 1) / 2) * LOOK_M
    above = (jnp.arange(ABOVE) - (ABOVE - 1) / 2) * LOOK_M

    def around(frame: StraightFrame, radius: jax.Array) -> jax.Array:
        place = (
            frame.line(share)[:, None, None]
            + aside[:, None, None] * frame.axes[1]
            + above[:, None] * frame.axes[2]
        )
        gap = read_field(problem.grid, field, place) - radius
        return jnp.clip(gap, -_FAR_M, _FAR_M) / _FAR_M

    def flow(frame: StraightFrame) -> jax.Array:
        zero = jnp.zeros((), team.start_m.dtype)
        there = jax.vmap(lambda p: problem.current.velocity(p, zero))(frame.line(share))
        return frame.inward(there)

    return Scene(
        gap=jax.vmap(around)(frames, team.radius_m),
        own=jnp.stack(
            [
                frames.length_m / 20.0,
                frames.axes[:, 0, 2],
                team.radius_m,
                team.cruise_speed_mps,
            ],
            axis=-1,
        ),
        others=_others(problem, frames),
        bodies=_bodies(known, frames),
        water=jax.vmap(flow)(frames),
        exists=jnp.ones(team.radius_m.shape, bool),
        body_exists=known.exists,
    )


def _others(problem: Problem, frames: StraightFrame) -> jax.Array:
    team = problem.team
    speed = team.cruise_speed_mps
    needs = frames.length_m / speed
    rate = (team.goal_m - team.start_m) / jnp.maximum(needs, 1e-3)[:, None]
    until = jnp.minimum(needs[:, None], needs)
    near = team.start_m[None] - team.start_m[:, None]
    relative = rate[None] - rate[:, None]
    square = jnp.sum(relative**2, axis=-1)
    when = -jnp.sum(near * relative, axis=-1) / jnp.where(square > 1e-9, square, 1.0)
    when = jnp.clip(when, 0.0, until)
    nearest = near + when[..., None] * relative

    def of(frame: StraightFrame, near: jax.Array, goal: jax.Array, met: jax.Array) -> jax.Array:
        each = (near / 10.0, (goal - frame.start_m) / 10.0, met / 5.0)
        return jnp.concatenate([frame.inward(vector) for vector in each], axis=-1)

    places = jax.vmap(of, in_axes=(0, 0, None, 0))(frames, near, team.goal_m, nearest)
    gap = jnp.sqrt(jnp.sum(nearest**2, axis=-1))
    shape = gap.shape
    numbers = (
        jnp.minimum(gap, 5.0) / 5.0,
        when / 40.0,
        jnp.broadcast_to(team.radius_m, shape),
        jnp.broadcast_to(speed, shape),
        jnp.broadcast_to(frames.length_m / 20.0, shape),
    )
    return jnp.concatenate([places, jnp.stack(numbers, axis=-1)], axis=-1)


def _bodies(known: ObstacleInformation, frames: StraightFrame) -> jax.Array:
    def of(frame: StraightFrame) -> jax.Array:
        place = frame.inward(known.p_m[:, 0] - frame.start_m) / 10.0
        return jnp.concatenate(
            [place, frame.inward(known.velocity_mps), known.radius_m[:, None]], axis=-1
        )

    return jax.vmap(of)(frames)
