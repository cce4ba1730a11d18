"""A problem as OMPL's planners take it: moving obstacles, other robots, bounds and checker."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl.settings import Moving
from angler_mjx.planning.problem import Problem

ROUNDING_M = 1e-4
"""Rounding [m] of float32 positions, by which a margin is below the distance at an end."""

SPHERE = 0
"""Kind of an obstacle."""


class BlockedRobotError(Exception):
    """A robot cannot be where it is to be; its text says why, ``robot`` which, if it is one."""

    def __init__(self, reason: str, robot: int | None = None) -> None:
        super().__init__(reason)
        self.robot = robot


def apply_moving_choice(problem: Problem, moving: Moving) -> Problem:
    """Return the problem with moving obstacles as the setting ``moving`` takes them.

    Args:
        problem: arrays of NumPy.
        moving: "timed" has those of which one place and a velocity is known go on straight; "still"
            has all stay; "ignored" takes them away.
    """
    obstacles = problem.obstacles
    moves = np.asarray(obstacles.moves, bool)
    if not (moves & np.asarray(obstacles.exists, bool)).any():
        return problem
    changed: dict[str, Any] = {}
    if moving == "ignored":
        changed = {"exists": np.asarray(obstacles.exists, bool) & ~moves}
    elif moving == "still":
        changed = {
            "moves": np.zeros_like(moves),
            "time_s": np.asarray(obstacles.time_s)[:1],
            "p_m": np.asarray(obstacles.p_m)[:, :1],
            "q": np.asarray(obstacles.q)[:, :1],
        }
    elif len(obstacles.time_s) == 1:
        displacement_m = problem.horizon_s * np.asarray(obstacles.velocity_mps)[:, None]
        changed = {
            "time_s": np.array([0.0, problem.horizon_s], np.float32),
            "p_m": np.concatenate([obstacles.p_m, obstacles.p_m + displacement_m], axis=1),
            "q": np.concatenate([obstacles.q, obstacles.q], axis=1),
        }
    return replace(problem, obstacles=replace(obstacles, **changed))


def add_standing_balls(problem: Problem, centres: np.ndarray, radii: np.ndarray) -> Problem:
    """Return the problem with additional balls that stand.

    Args:
        problem: arrays of NumPy.
        centres: [n, 3] m, W.
        radii: [n] m.
    """
    count = len(radii)
    if count == 0:
        return problem
    obstacles = problem.obstacles
    times = np.shape(obstacles.p_m)[1]
    size = np.zeros((count, 3))
    size[:, 0] = radii
    rotations = np.zeros((count, times, 4))
    rotations[..., 0] = 1.0
    added_rows = {
        "kind": np.full(count, SPHERE),
        "half_size_m": size,
        "radius_m": radii,
        "exists": np.ones(count, bool),
        "moves": np.zeros(count, bool),
        "velocity_mps": np.zeros((count, 3)),
        "p_m": np.repeat(centres[:, None], times, axis=1),
        "q": rotations,
    }
    added: dict[str, Any] = {}
    for name, rows in added_rows.items():
        rows_before = np.asarray(getattr(obstacles, name))
        added[name] = np.concatenate([rows_before, rows.astype(rows_before.dtype)])
    return replace(problem, obstacles=replace(obstacles, **added))


def build_checker(problem: Problem, robots: Sequence[int], margin_m: float) -> EdgeChecker:
    """Build the edge checker of some robots, with less margin where an end has less room.

    Raises:
        BlockedRobotError: a start or goal is taken or outside, or two overlap.
    """
    start = np.asarray(problem.team.start_m, float)[robots]
    goal = np.asarray(problem.team.goal_m, float)[robots]
    wide_checker = EdgeChecker(problem, margin_m=margin_m, robots=robots)
    if wide_checker.state(start) and wide_checker.state(goal):
        return wide_checker
    clearance_m = min(wide_checker.clearance(start), wide_checker.clearance(goal))
    tight_checker = EdgeChecker(
        problem, margin_m=max(0.0, min(margin_m, clearance_m - ROUNDING_M)), robots=robots
    )
    for name, ends in (("start", start), ("goal", goal)):
        if not tight_checker.state(ends):
            raise _blocked_error(problem, robots, name, ends)
    return tight_checker


def _blocked_error(
    problem: Problem, robots: Sequence[int], name: str, ends: np.ndarray
) -> BlockedRobotError:
    for robot, end in zip(robots, ends, strict=True):
        checker = EdgeChecker(problem, robots=[robot])
        if not checker.state(end[None]):
            return BlockedRobotError(f"its {name} is taken or outside", robot)
    return BlockedRobotError(f"robots overlap at their {name}s")


def space_bounds(
    problem: Problem, robots: Sequence[int], heading: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds [R d] of the space: the cube above the floor, less each radius.

    Headings are bounded by half a turn to each side of the start's.
    """
    radius = np.asarray(problem.team.radius_m, float)[robots][:, None]
    origin = np.asarray(problem.grid.origin_m, float)
    high = origin + float(problem.grid.cell_m) * np.array(problem.grid.occupied.shape)
    low = np.array([origin[0], origin[1], max(origin[2], float(problem.floor_z_m))])
    lows, highs = low + radius, high - radius
    if heading:
        yaw = np.asarray(problem.team.start_yaw_rad, float)[robots][:, None]
        lows = np.concatenate([lows, yaw - np.pi], axis=1)
        highs = np.concatenate([highs, yaw + np.pi], axis=1)
    return lows.reshape(-1), highs.reshape(-1)


def start_and_goal(
    problem: Problem, robots: Sequence[int], heading: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Start and goal [R, d]."""
    start = np.asarray(problem.team.start_m, float)[robots]
    goal = np.asarray(problem.team.goal_m, float)[robots]
    if heading:
        yaw = np.asarray(problem.team.start_yaw_rad, float)[robots][:, None]
        start, goal = (np.concatenate([end, yaw], axis=1) for end in (start, goal))
    return start, goal
