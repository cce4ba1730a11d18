"""Problems made by hand."""

import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.path_search.grid import plan_grid
from angler_mjx.planning.problem import Problem, Team
from angler_mjx.sim.information import (
    CurrentInformation,
    Information,
    ObstacleInformation,
    obstacle_information,
)
from angler_mjx.world.currents import Uniform
from angler_mjx.world.rock.grid import Grid


def f32(values):
    return np.asarray(values, np.float32)


def team(starts, goals, *, radius=0.3, cruise=0.5, terminal=1.0, acceleration=1.0):
    """Spheres, as far as planners see them."""
    starts, goals = f32(starts).reshape(-1, 3), f32(goals).reshape(-1, 3)
    robots = len(starts)
    return Team(
        start_m=starts,
        start_yaw_rad=np.zeros(robots, np.float32),
        goal_m=goals,
        radius_m=np.full(robots, radius, np.float32),
        capsule_a_m=np.zeros((robots, 1, 3), np.float32),
        capsule_b_m=np.zeros((robots, 1, 3), np.float32),
        capsule_r_m=np.full((robots, 1), radius, np.float32),
        cruise_speed_mps=np.full(robots, cruise, np.float32),
        terminal_speed_mps=np.full((robots, 3), terminal, np.float32),
        power_w=_powers(robots, terminal),
        acceleration_mps2=np.full((robots, 3), acceleration, np.float32),
    )


def _powers(robots, terminal):
    """100 W at the terminal speed, and the cube of the speed below it."""
    speed = np.linspace(0.0, 1.0, 9)
    return np.broadcast_to(100.0 * (terminal * speed) ** 3, (robots, 3, 9)).astype(np.float32)


def no_obstacles(**arrays):
    """None; or spheres, given by radius_m [n] and p_m [n, T, 3] with time_s [T]."""
    radius = f32(arrays.get("radius_m", np.zeros(0)))
    count = len(radius)
    time = f32(arrays.get("time_s", [0.0]))
    attitude = np.zeros((count, len(time), 4), np.float32)
    attitude[..., 0] = 1.0
    return ObstacleInformation(
        kind=np.zeros(count, np.int32),
        half_size_m=np.stack([radius, 0 * radius, 0 * radius], axis=-1),
        radius_m=radius,
        exists=np.ones(count, bool),
        moves=np.full(count, len(time) > 1),
        velocity_mps=np.zeros((count, 3), np.float32),
        time_s=time,
        p_m=f32(arrays.get("p_m", np.zeros((0, 1, 3)))),
        q=attitude,
    )


def problem(
    starts=((2.0, 2.0, 2.0),),
    goals=((8.0, 8.0, 8.0),),
    *,
    cells=10,
    rock=(),
    current=None,
    seed=7,
    horizon_s=120.0,
    deadline_s=2.0,
    obstacles=None,
    **of_team,
):
    """A cube of 1 m cells from the origin up; ``rock`` are slices that are filled."""
    occupied = np.zeros((cells,) * 3, bool)
    for where in rock:
        occupied[where] = True
    flow = () if current is None else (Uniform(velocity_mps=f32(current)),)
    return Problem(
        grid=Grid(occupied=occupied, origin_m=f32([0, 0, 0]), cell_m=np.float32(1.0)),
        floor_z_m=np.float32(0.0),
        team=team(starts, goals, **of_team),
        obstacles=no_obstacles() if obstacles is None else no_obstacles(**obstacles),
        current=CurrentInformation(components=flow, stays=True),
        seed=np.uint32(seed),
        horizon_s=horizon_s,
        goal_tolerance_m=0.5,
        information=Information(),
        deadline_s=deadline_s,
    )


def world_problem(world, radius_m, speed_mps, obstacles=None, seed=0, horizon_s=120.0):
    """The problem of an `Environment` in which nothing is known to move, or ``obstacles`` are."""
    zeros = jnp.zeros((*radius_m.shape, 3))
    known = "nothing" if obstacles is None else "truth"
    still = obstacle_information(world, Information(), horizon_s, 0.05, 1000.0, 9.81)
    return Problem(
        grid=world.grid,
        floor_z_m=world.floor_z_m,
        team=Team(
            start_m=world.start_m,
            start_yaw_rad=world.start_yaw_rad,
            goal_m=world.goal_m,
            radius_m=radius_m,
            capsule_a_m=zeros[:, None],
            capsule_b_m=zeros[:, None],
            capsule_r_m=radius_m[:, None],
            cruise_speed_mps=speed_mps,
            terminal_speed_mps=zeros,
            acceleration_mps2=zeros,
            power_w=zeros[..., None],
        ),
        obstacles=still if obstacles is None else obstacles,
        current=CurrentInformation(components=(), stays=True),
        seed=seed,
        horizon_s=horizon_s,
        goal_tolerance_m=0.5,
        information=Information(obstacles=known),
        deadline_s=2.0,
    )


def plan_world(world, radius_m, speed_mps, config, obstacles=None):
    """Paths of the grid planner in an `Environment`."""
    asked = world_problem(world, radius_m, speed_mps, obstacles, horizon_s=config.horizon_s)
    return plan_grid(asked, config)
