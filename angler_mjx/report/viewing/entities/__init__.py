"""Worlds as entities of a Rerun recording; imported only where Rerun is installed.

What a replay and a live view draw alike is `scenery`; `task` and `water` are what replays draw of a
team's task and of the current over time.
"""

from angler_mjx.report.viewing.entities.scenery import (
    DOT,
    LARGE_DOT,
    MAX_NAMED,
    Rgba,
    current_arrows,
    ending_color,
    log_obstacles,
    log_robot,
    log_surroundings,
    obstacle_poses,
    robot_rgba,
    time_column,
    to_rgba,
    to_xyzw,
)

__all__ = [
    "DOT",
    "LARGE_DOT",
    "MAX_NAMED",
    "Rgba",
    "current_arrows",
    "ending_color",
    "log_obstacles",
    "log_robot",
    "log_surroundings",
    "obstacle_poses",
    "robot_rgba",
    "time_column",
    "to_rgba",
    "to_xyzw",
]
