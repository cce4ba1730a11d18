"""Planner carry: the path of a body that robots hold, and of the robots with it, on the device.

The body with all who hold it is searched for as one ball on the lattice of planner grid
(`path_search`): conservative, and right in every attitude. The body turns evenly along its path.
Along the way it speeds up and slows down as a movement of minimum jerk does, no robot faster than
its cruise speed. Robots keep their poses in the body's frame: positions and headings of all
way-points lie on the manifold of the grasp; cubics between them leave it by millimetres.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.planning.carry.carriers import (
    APPROACH_POINTS,
    PEAK_SPEED,
    add_approach,
    ease,
    follow_body,
    hold_positions,
)
from angler_mjx.planning.path_search.grid import plan_grid
from angler_mjx.planning.path_search.robot_search import path_search_config, require_still_water
from angler_mjx.planning.problem import CargoProblem, Problem, ProblemSettings, Team
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory, hold_position
from angler_mjx.robot.control.commands.trajectory import Trajectory, sample_reference


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
        if cargo.grip_m is not None and cargo.lift_m is not None:
            up = cargo.lift_m * jnp.asarray([0.0, 0.0, 1.0], cargo.start_m.dtype)
            cargo = replace(cargo, start_m=cargo.start_m + up, grip_m=cargo.grip_m + up)
        path = _plan_body(problem, team, cargo)
        return _follow_body(team, problem.cargo, cargo, path, problem.points)

    def plan_batch(self, problems: Problem) -> JointTrajectory:
        """Return the paths of all worlds; see `BatchPlanner`."""
        return jax.vmap(self.plan_one)(problems)


def _plan_body(problem: Problem, team: Team, cargo: CargoProblem) -> Trajectory:
    """Return the path [] of the body's centre, at the cruise speed of the slowest robot."""
    offset = hold_positions(team, cargo) - cargo.start_m
    offset = jnp.sqrt(jnp.sum(offset**2, axis=1))
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


def _follow_body(
    team: Team, cargo: CargoProblem, lifted: CargoProblem, path: Trajectory, points: int
) -> JointTrajectory:
    """Return the paths [R] of robots that hold a body on its way.

    Args:
        team: at the start.
        cargo: at the start.
        lifted: where its way begins.
        path: [] of its centre.
        points: of each path.
    """
    body_points = points if cargo.grip_m is None else points - APPROACH_POINTS
    eased = ease(jnp.linspace(0.0, 1.0, body_points, dtype=path.time_s.dtype))
    straight_s = path.time_s[-1]
    at_m, _ = jax.vmap(sample_reference, (None, 0))(path, eased * straight_s)
    offset = hold_positions(team, lifted) - lifted.start_m
    reach_m = jnp.max(jnp.sqrt(jnp.sum(offset[:, :2] ** 2, axis=1)))
    turning_s = reach_m * jnp.abs(cargo.turn_rad) / jnp.min(team.cruise_speed_mps)
    duration_s = jnp.maximum(PEAK_SPEED * (straight_s + turning_s), 1e-3)
    moving = follow_body(team, lifted, at_m, eased * cargo.turn_rad, duration_s)
    moving = add_approach(team, cargo, moving)
    held = hold_position(team.start_m, team.start_yaw_rad, points)
    found = jnp.broadcast_to(path.found, moving.time_s.shape[:1])
    chosen: JointTrajectory = jax.tree.map(
        lambda a, b: jnp.where(path.found, a, b),
        replace(moving, found=found),
        replace(held, found=found),
    )
    return chosen
