"""Worlds as entities of a Rerun recording; imported only where Rerun is installed.

`scenery` draws the entities common to replays and live views; `task` and `water` draw a team's task
and the current over time, for replays.
"""

from angler_mjx.report.viewing.entities.scenery import (
    DOT,
    LARGE_DOT,
    MAX_NAMED,
    Rgba,
    current_arrows,
    ending_color,
    log_links,
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
    "log_links",
    "log_obstacles",
    "log_robot",
    "log_surroundings",
    "obstacle_poses",
    "robot_rgba",
    "time_column",
    "to_rgba",
    "to_xyzw",
]
