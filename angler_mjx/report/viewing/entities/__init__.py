"""Worlds as entities of a Rerun recording; imported only where Rerun is installed.

What a replay and a live view draw alike is `scenery`; `task` and `water` are what replays draw of a
team's task and of the current over time.
"""

from angler_mjx.report.viewing.entities.scenery import (
    DOT,
    LARGE_DOT,
    MOST_NAMED,
    Rgba,
    arrows,
    color_of,
    ending,
    log_obstacles,
    log_still,
    log_surroundings,
    poses,
    rgba,
    times,
    xyzw,
)

__all__ = [
    "DOT",
    "LARGE_DOT",
    "MOST_NAMED",
    "Rgba",
    "arrows",
    "color_of",
    "ending",
    "log_obstacles",
    "log_still",
    "log_surroundings",
    "poses",
    "rgba",
    "times",
    "xyzw",
]
