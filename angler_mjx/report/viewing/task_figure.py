"""Figure of a team's task in one world: places, robots, and progress over time."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.report.viewing.maps import base_map
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.sim.record import TASK

SEEN, UNSEEN = "#9fd0a5", "#e8a39b"


def plot_task(run: Run, scene: ReplayScene) -> Figure:
    """Plot a map from above with all places, and progress over time.

    Args:
        run: run folder of a scenario with a task.
        scene: one of its worlds.
    """
    with wrap_read_errors(run.path / TRAJECTORIES):
        stored: Any = run.trajectories[TASK]
        task_arrays = {name: np.asarray(stored[name][scene.world]) for name in stored}
        progress, time = np.asarray(stored["share"]), np.asarray(run.trajectories["time_s"])
    rows = run.episodes.to_pylist()
    completed = {row["world"]: row["task_completed_s"] for row in rows}
    at_s, kind = completed[scene.world], run.scenario.task.type
    ended = "not completed" if at_s is None else f"completed after {at_s:.0f} s"
    last = next(row["task_progress"] for row in rows if row["world"] == scene.world)
    with style.titled_figure(
        11.6,
        6.6,
        f"World {scene.world}: {kind} {ended}, {100 * last:.0f} % done",
        f"{run.scenario.name}, seed {run.scenario.seed}; all {len(completed)} worlds on the "
        "right, this one black",
        headline_in=0.6,
    ) as figure:
        above, over_time = figure.subplots(1, 2)
        _plot_map(above, scene, task_arrays)
        _plot_progress(over_time, time, progress, scene.world, completed)
        figure.legend(
            handles=_legend_handles(scene, task_arrays), loc="outside lower left", ncols=4
        )
    return figure


def _plot_map(axes: Axes, scene: ReplayScene, task: dict[str, np.ndarray]) -> None:
    low, high = scene.bounds_m
    base_map.plot_bounds(axes, scene, base_map.ABOVE)
    if "cells" in task:
        _plot_cells(axes, scene, task["cells"])
    else:
        norm = Normalize(low[2], high[2])
        base_map.plot_rock(axes, scene.environment.grid, base_map.ABOVE, norm)
    for robot in scene.robots:
        path_m, color = scene.flown_path(robot), style.robot_color(robot.index)
        axes.plot(path_m[:, 0], path_m[:, 1], color=color, linewidth=0.9, alpha=0.6, zorder=4)
        axes.plot(*robot.start_m[:2], "s", ms=8, color=color, mec=style.PAPER, zorder=6)
    jobs, exists = len(task["by"]), task["exists"].astype(bool)
    begin = task["place_m"][:jobs]
    ends = task["place_m"][jobs : 2 * jobs]
    if len(task["place_m"]) == 2 * jobs + len(scene.robots):
        lines = np.stack([begin, ends], axis=1)[exists, :, :2]
        axes.add_collection(
            LineCollection(list(lines), colors=style.QUIET, linewidths=0.7, linestyles=":")
        )
        _plot_points(axes, ends[exists], task["by"][exists], "D")
    _plot_points(axes, begin[exists], task["by"][exists], "o")
    axes.set(title="From above", xlabel="east, m", ylabel="north, m")


def _plot_points(axes: Axes, points_m: np.ndarray, by: np.ndarray, marker: str) -> None:
    colors = [style.robot_color(int(robot)) if robot >= 0 else style.PAPER for robot in by]
    axes.scatter(
        points_m[:, 0],
        points_m[:, 1],
        s=34,
        c=colors,
        marker=marker,
        edgecolors=style.INK,
        linewidths=0.6,
        zorder=7,
    )


def _plot_cells(axes: Axes, scene: ReplayScene, cells: np.ndarray) -> None:
    """Plot the columns of a survey by the fraction of their seen cells; empty ones stay water."""
    grid = scene.environment.grid
    origin, cell = np.asarray(grid.origin_m), float(grid.cell_m)
    n_wanted, seen = np.sum(cells > 0, axis=2), np.sum(cells == 2, axis=2)
    for i, j in np.argwhere(n_wanted > 0):
        corner = (origin[0] + cell * i, origin[1] + cell * j)
        fraction = seen[i, j] / n_wanted[i, j]
        for color, height in ((UNSEEN, 1.0), (SEEN, fraction)):
            box = Rectangle(corner, cell, cell * height, facecolor=color, linewidth=0, zorder=1)
            axes.add_patch(box)


def _plot_progress(
    axes: Axes,
    time: np.ndarray,
    progress: np.ndarray,
    world: int,
    completed: dict[int, float | None],
) -> None:
    for number in [*(n for n in range(len(progress)) if n != world), world]:
        is_finite = np.isfinite(progress[number])
        chosen = number == world
        axes.step(
            time[is_finite],
            100 * progress[number][is_finite],
            where="post",
            color=style.INK if chosen else style.FAINT,
            linewidth=2.0 if chosen else 0.8,
            zorder=3 if chosen else 2,
        )
    done = [end_s for end_s in completed.values() if end_s is not None]
    if done:
        axes.plot(done, np.full(len(done), 101.5), "|", color=style.QUIET, ms=9, clip_on=False)
    axes.set(
        title="Progress; ticks above: completed",
        xlabel="time, s",
        ylabel="share of the task that is done, %",
        ylim=(0, 104),
    )


def _legend_handles(scene: ReplayScene, task: dict[str, np.ndarray]) -> list[Line2D | Patch]:
    done = task["by"]
    handles: list[Line2D | Patch] = [
        Line2D(
            [],
            [],
            color=style.robot_color(robot.index),
            marker="s",
            label=f"robot {robot.index}: {int(np.sum(done == robot.index))} done",
        )
        for robot in scene.robots[:12]
    ]
    handles.append(
        Line2D([], [], color=style.PAPER, mec=style.INK, marker="o", label="place, not done")
    )
    if "cells" in task:
        handles += [
            Patch(color=SEEN, label="share of the column that was seen"),
            Patch(color=UNSEEN, label="that was not"),
        ]
    return handles
