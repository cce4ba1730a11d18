"""Markers of a world: cells, obstacles at rest, goals; and obstacles that move."""

import numpy as np

from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE, STATIC, Obstacles

_ROCK, _STILL, _MOVING, _GOAL = (
    (0.55, 0.50, 0.42, 1.0),
    (0.62, 0.62, 0.62, 1.0),
    (0.70, 0.60, 0.84, 1.0),
    (0.31, 0.84, 0.65, 1.0),
)
"""Marker colours, RGBA."""


def list_obstacles(obstacles: Obstacles, *, still: bool) -> list[int]:
    """Return the rows of the obstacles at rest, or of the moving ones."""
    is_listed = np.asarray(obstacles.exists) & ((np.asarray(obstacles.motion) == STATIC) == still)
    rows: list[int] = np.flatnonzero(is_listed).tolist()
    return rows


def build_scenery(environment: Environment, frame: str, *, has_goals: bool) -> list[ros.Message]:
    """Return the markers of static objects: cells, obstacles at rest, goals.

    Args:
        environment: of one world.
        frame: of the world.
        has_goals: whether each robot has a goal of its own.
    """
    head = ros.make_header(0.0, frame)
    grid, obstacles = environment.grid, environment.obstacles
    cell = float(grid.cell_m)
    centers = np.asarray(grid.origin_m) + cell * (np.argwhere(np.asarray(grid.occupied)) + 0.5)
    origin = ros.make_pose(np.zeros(3))
    markers = []
    if len(centers):
        markers.append(
            ros.make_marker(head, "cells", 0, ros.CUBE_LIST, origin, [cell] * 3, _ROCK, centers)
        )
    p, q = np.asarray(obstacles.p0), np.asarray(obstacles.q0)
    for row in list_obstacles(obstacles, still=True):
        markers += _obstacle_markers(obstacles, frame, 0.0, row, p[row], q[row])
    goals = np.asarray(environment.goal_m)[: None if has_goals else 0]
    markers += [
        ros.make_marker(head, "goals", i, ros.SPHERE, ros.make_pose(goal), [0.5] * 3, _GOAL)
        for i, goal in enumerate(goals)
    ]
    return markers


def build_moving(
    obstacles: Obstacles, frame: str, time_s: float, p: np.ndarray, q: np.ndarray
) -> list[ros.Message]:
    """Return the markers of the moving obstacles; those that diverged have none.

    Args:
        obstacles: of one world.
        frame: of the world.
        time_s: of the positions.
        p: [n, 3] m in W.
        q: [n, 4] wxyz.
    """
    return [
        marker
        for row in list_obstacles(obstacles, still=False)
        if np.isfinite(p[row]).all()
        for marker in _obstacle_markers(obstacles, frame, time_s, row, p[row], q[row])
    ]


def _obstacle_markers(
    obstacles: Obstacles, frame: str, time_s: float, row: int, p: np.ndarray, q: np.ndarray
) -> list[ros.Message]:
    """Return the markers of one obstacle: one, and two ends for a capsule."""
    kind, (a, b, c) = int(obstacles.kind[row]), np.asarray(obstacles.size_m[row]).tolist()
    color = _STILL if int(obstacles.motion[row]) == STATIC else _MOVING
    head, pose = ros.make_header(time_s, frame), ros.make_pose(p, q)
    shape, scale = {
        SPHERE: (ros.SPHERE, [2 * a] * 3),
        BOX: (ros.CUBE, [2 * a, 2 * b, 2 * c]),
        CAPSULE: (ros.CYLINDER, [2 * a, 2 * a, 2 * b]),
    }[kind]
    markers = [ros.make_marker(head, "obstacles", row, shape, pose, scale, color)]
    if kind == CAPSULE:
        ends, ball = np.array([[0.0, 0.0, b], [0.0, 0.0, -b]]), [2 * a] * 3
        markers.append(
            ros.make_marker(head, "capsule_ends", row, ros.SPHERE_LIST, pose, ball, color, ends)
        )
    return markers
