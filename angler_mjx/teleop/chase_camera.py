"""Chase camera of a driven robot: behind and above it, looking ahead, never in rock."""

import math

import numpy as np

from angler_mjx.teleop.pilot import heading
from angler_mjx.world.grid import Grid

BACK_M, UP_M = 2.0, 0.8
"""Offset of the camera from the robot, along its level heading and upright."""

DOWN_RAD = 0.21
"""Pitch of the camera.

It is less than that of the line to the robot, so the robot is seen below the middle, and the
scene ahead of it above."""

_STEPS = 14
"""Number of rock checks on the line from the robot to the camera: every 0.15 m."""


def camera_pose(p: np.ndarray, q: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Return the position and attitude of the camera.

    It follows the robot's heading and stays level while the robot tilts, as the keys do. Where
    rock would hide the robot, the camera comes nearer.

    Args:
        p: [3] of the robot, m in W.
        q: [4] attitude of the robot, F to W.
        grid: cells of the world, as host arrays.

    Returns:
        Position [3], m in W, and quaternion [4] wxyz: x ahead, y to the left, z up.
    """
    psi = heading(q)
    offset_m = np.array([-BACK_M * math.cos(psi), -BACK_M * math.sin(psi), UP_M])
    path_m = p + np.linspace(0.0, 1.0, _STEPS + 1)[1:, None] * offset_m
    blocked = np.flatnonzero(_is_in_rock(path_m, grid))
    n_clear = _STEPS if blocked.size == 0 else int(blocked[0])
    half, down = 0.5 * psi, 0.5 * DOWN_RAD
    attitude = np.array(
        [
            math.cos(half) * math.cos(down),
            -math.sin(half) * math.sin(down),
            math.cos(half) * math.sin(down),
            math.sin(half) * math.cos(down),
        ]
    )
    return p + max(n_clear, 1) / _STEPS * offset_m, attitude


def _is_in_rock(points_m: np.ndarray, grid: Grid) -> np.ndarray:
    """Return whether points [n, 3] lie in an occupied cell; outside the cells none does."""
    occupied = np.asarray(grid.occupied)
    cells = np.floor((points_m - np.asarray(grid.origin_m)) / float(grid.cell_m)).astype(int)
    inside = ((cells >= 0) & (cells < occupied.shape)).all(axis=1)
    x, y, z = np.clip(cells, 0, np.array(occupied.shape) - 1).T
    rock: np.ndarray = inside & occupied[x, y, z].astype(bool)
    return rock
