"""Legends of the lines and symbols on a map."""

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.world.obstacles import STATIC

MAX_LISTED = 12
"""Max robots listed below the map; a larger fleet is plotted whole but not listed whole."""


def robot_handles(scene: ReplayScene) -> list[Line2D]:
    """Return a line for each robot: its name, its outcome and its end time."""
    handles = [
        Line2D(
            [],
            [],
            color=style.robot_color(robot.index),
            linewidth=2.4,
            label=f"{robot.index}  {robot.vehicle}, {robot.parameter_set}: "
            f"{scene.ended(robot)} after {robot.end_time_s:.0f} s",
        )
        for robot in scene.robots[:MAX_LISTED]
    ]
    n_unlisted = len(scene.robots) - MAX_LISTED
    if n_unlisted > 0:
        handles.append(Line2D([], [], color="none", label=f"... and {n_unlisted} more"))
    return handles


def symbol_handles(scene: ReplayScene) -> list[Line2D | Patch]:
    """Return legend entries of the other occurring symbols."""
    obstacles = scene.environment.obstacles
    exists = np.asarray(obstacles.exists)
    still = np.asarray(obstacles.motion) == STATIC
    goals = any(np.isfinite(robot.goal_m).all() for robot in scene.robots)
    plans: list[Line2D | Patch] = [
        Line2D(
            [],
            [],
            color=style.QUIET,
            linestyle=(0, (3, 2)),
            label="first plan" if scene.replan_hz else "planned way",
        ),
        Line2D(
            [], [], color=style.QUIET, marker="*", ms=11, linestyle="", label="goal (disc: start)"
        ),
    ]
    handles: list[Line2D | Patch] = [
        *(plans if goals else []),
        Line2D([], [], color=style.QUIET, linewidth=2, label="way taken"),
    ]
    if any(not robot.arrived for robot in scene.robots):
        handles.append(
            Line2D([], [], color=style.INK, marker="X", ms=8, linestyle="", label="failure")
        )
    if np.asarray(scene.environment.grid.occupied).any():
        handles.append(Patch(color=style.ROCK(0.75), label="rock; lighter is higher"))
    if np.any(exists & ~still):
        handles.append(
            Patch(
                color=style.OBSTACLE_DYNAMIC,
                alpha=0.6,
                label="moving obstacle at the start; dotted: its way",
            )
        )
    if np.any(exists & still):
        handles.append(Patch(color=style.OBSTACLE_STATIC, label="still obstacle"))
    return handles
