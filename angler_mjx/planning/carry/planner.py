"""Planner carry: the path of a body that robots hold, and of the robots with it, on the device.

The body with all who hold it is searched for as one ball on the lattice of planner grid
(`path_search`): conservative, and right in every attitude. The body turns evenly along its path.
Along the way it speeds up and slows down as a movement of minimum jerk does (Flash and Hogan, "The
coordination of arm movements", Journal of Neuroscience 5, 1985), no robot faster than its cruise
speed. Robots keep their poses in the body's frame: positions and headings of all way-points lie on
the manifold of the grasp; cubics between them leave it by millimetres.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.planning.path_search.grid import plan_grid
from angler_mjx.planning.path_search.robot_search import path_search_config, require_still_water
from angler_mjx.planning.problem import CargoProblem, Problem, ProblemSettings, Team
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    JointTrajectory,
    hold_position,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory, sample_reference

PEAK_SPEED = 1.875
"""Greatest speed of a movement of minimum jerk over its mean."""


class CarryPlanner:
    """Planner ``carry`` of scenarios, a `BatchPlanner`."""

    joints = True

    def check_problem(self, problem: ProblemSettings) -> None:
        """Refuse problems with information that the planner cannot use; see `BatchPlanner`."""
        require_still_water(problem, "carry")

    def plan_one(self, problem: Problem) -> JointTrajectory:
        """Return the paths of one world; see `BatchPlanner`.

        Raises:
            ConfigError: the robots carry nothing together.
        """
        if problem.cargo is None:
            raise ConfigError('planner carry: plans the task "carry" alone; take another planner')
        team, cargo = problem.team, problem.cargo
        path = _plan_body(problem, team, cargo)
        return _follow_body(team, cargo, path, problem.points)

    def plan_batch(self, problems: Problem) -> JointTrajectory:
        """Return the paths of all worlds; see `BatchPlanner`."""
        return jax.vmap(self.plan_one)(problems)


def _plan_body(problem: Problem, team: Team, cargo: CargoProblem) -> Trajectory:
    """Return the path [] of the body's centre, at the cruise speed of the slowest robot."""
    offset = jnp.sqrt(jnp.sum((team.start_m - cargo.start_m) ** 2, axis=1))
    radius_m = jnp.maximum(jnp.max(offset + team.radius_m), cargo.radius_m)
    first: Team = jax.tree.map(lambda leaf: leaf[:1], replace(team, arms=None))
    body = replace(
        first,
        start_m=cargo.start_m[None],
        goal_m=cargo.goal_m[None],
        radius_m=radius_m[None],
        cruise_speed_mps=jnp.min(team.cruise_speed_mps)[None],
    )
    config = path_search_config(problem)
    paths = plan_grid(replace(problem, team=body, cargo=None), config)
    path: Trajectory = jax.tree.map(lambda leaf: leaf[0], paths)
    return path


def _follow_body(team: Team, cargo: CargoProblem, path: Trajectory, points: int) -> JointTrajectory:
    """Return the paths [R] of robots that hold a body on its way."""
    fraction = jnp.linspace(0.0, 1.0, points, dtype=path.time_s.dtype)
    eased = fraction**3 * (10.0 - 15.0 * fraction + 6.0 * fraction**2)
    ease_rate = 30.0 * fraction**2 * (1.0 - fraction) ** 2
    straight_s = path.time_s[-1]
    at_m, _ = jax.vmap(sample_reference, (None, 0))(path, eased * straight_s)
    cruise = jnp.min(team.cruise_speed_mps)
    offset = team.start_m - cargo.start_m
    reach_m = jnp.max(jnp.sqrt(jnp.sum(offset[:, :2] ** 2, axis=1)))
    duration_s = PEAK_SPEED * (straight_s + reach_m * jnp.abs(cargo.turn_rad) / cruise)
    duration_s = jnp.maximum(duration_s, 1e-3)
    turn = eased * cargo.turn_rad
    c, s, zero = jnp.cos(turn), jnp.sin(turn), jnp.zeros_like(turn)
    rotation = jnp.stack(
        [
            jnp.stack([c, -s, zero], 1),
            jnp.stack([s, c, zero], 1),
            jnp.stack([zero, zero, zero + 1.0], 1),
        ],
        axis=1,
    )
    position_m = at_m + jnp.einsum("nij,rj->rni", rotation, offset)
    yaw = team.start_yaw_rad[:, None] + turn
    pose = jnp.concatenate([position_m, yaw[..., None]], axis=2)
    velocity = _slopes(pose, fraction) / duration_s
    turn_rate = ease_rate * cargo.turn_rad / duration_s
    velocity = velocity.at[..., 3].set(turn_rate)
    robots = team.start_m.shape[0]
    moving = JointTrajectory(
        joints=hold_position(team.start_m, team.start_yaw_rad, points).joints,
        time_s=jnp.broadcast_to(fraction * duration_s, (robots, points)),
        position=pose,
        velocity=velocity,
        acceleration=jnp.zeros_like(pose),
        degree=jnp.full((robots, points), CUBIC, jnp.int32),
        commanded=jnp.ones((robots, 4), bool),
        found=jnp.broadcast_to(path.found, (robots,)),
    )
    held = hold_position(team.start_m, team.start_yaw_rad, points)
    chosen: JointTrajectory = jax.tree.map(
        lambda a, b: jnp.where(path.found, a, b), moving, replace(held, found=moving.found)
    )
    return chosen


def _slopes(values: jax.Array, at: jax.Array) -> jax.Array:
    """Return central differences [R, n, k] of values by ``at`` [n]; zero at both ends."""
    inner = (values[:, 2:] - values[:, :-2]) / (at[2:] - at[:-2])[:, None]
    return jnp.pad(inner, ((0, 0), (1, 1), (0, 0)))
