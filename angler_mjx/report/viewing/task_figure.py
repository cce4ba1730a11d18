"""What a team did of its task in one world: where, who, and how far it was when."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from angler_mjx.report.viewing import style
from angler_mjx.report.viewing.maps import ground
from angler_mjx.report.viewing.scene import ReplayScene
from angler_mjx.runs.storage.damage import reading
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run
from angler_mjx.sim.record import TASK

SEEN, UNSEEN = "#9fd0a5", "#e8a39b"


def draw(run: Run, scene: ReplayScene) -> Figure:
    """Map from above with all places, and progress over time.

    Args:
        run: run folder of a scenario with a task.
        scene: one of its worlds.
    """
    with reading(run.path / TRAJECTORIES):
        stored: Any = run.trajectories[TASK]
        read = {name: np.asarray(stored[name][scene.world]) for name in stored}
        share, time = np.asarray(stored["share"]), np.asarray(run.trajectories["time_s"])
    rows = run.episodes.to_pylist()
    completed = {row["world"]: row["task_completed_s"] for row in rows}
    at_s, kind = completed[scene.world], run.scenario.task.type
    ended = "not completed" if at_s is None else f"completed after {at_s:.0f} s"
    last = next(row["task_progress"] for row in rows if row["world"] == scene.world)
    with style.styled():
        figure = style.new_figure(11.6, 6.6, headline_in=0.6)
        style.headline(
            figure,
            f"World {scene.world}: {kind} {ended}, {100 * last:.0f} % done",
            f"{run.scenario.name}, seed {run.scenario.seed}; all {len(completed)} worlds on the "
            "right, this one black",
        )
        above, over_time = figure.subplots(1, 2)
        _map(above, scene, read)
        _progress(over_time, time, share, scene.world, completed)
        figure.legend(handles=_signs(scene, read), loc="outside lower left", ncols=4)
    return figure


def _map(axes: Axes, scene: ReplayScene, task: dict[str, np.ndarray]) -> None:
    low, high = scene.bounds_m
    ground.bounds(axes, scene, ground.ABOVE)
    if "cells" in task:
        _cells(axes, scene, task["cells"])
    else:
        norm = Normalize(low[2], high[2])
        ground.rock(axes, scene.environment.grid, ground.ABOVE, norm)
    for robot in scene.robots:
        way, color = scene.way_taken(robot), style.robot_color(robot.index)
        axes.plot(way[:, 0], way[:, 1], color=color, linewidth=0.9, alpha=0.6, zorder=4)
        axes.plot(*robot.start_m[:2], "s", ms=8, color=color, mec=style.PAPER, zorder=6)
    jobs, there = len(task["by"]), task["exists"].astype(bool)
    begin = task["place_m"][:jobs]
    ends = task["place_m"][jobs : 2 * jobs]
    if len(task["place_m"]) == 2 * jobs + len(scene.robots):
        lines = np.stack([begin, ends], axis=1)[there, :, :2]
        axes.add_collection(
            LineCollection(list(lines), colors=style.QUIET, linewidths=0.7, linestyles=":")
        )
        _places(axes, ends[there], task["by"][there], "D")
    _places(axes, begin[there], task["by"][there], "o")
    axes.set(title="From above", xlabel="east, m", ylabel="north, m")


def _places(axes: Axes, places: np.ndarray, by: np.ndarray, marker: str) -> None:
    colors = [style.robot_color(int(robot)) if robot >= 0 else style.PAPER for robot in by]
    axes.scatter(
        places[:, 0],
        places[:, 1],
        s=34,
        c=colors,
        marker=marker,
        edgecolors=style.INK,
        linewidths=0.6,
        zorder=7,
    )


def _cells(axes: Axes, scene: ReplayScene, cells: np.ndarray) -> None:
    """Columns of a survey by the share of their cells that was seen; those with none stay water."""
    grid = scene.environment.grid
    origin, cell = np.asarray(grid.origin_m), float(grid.cell_m)
    wanted, seen = np.sum(cells > 0, axis=2), np.sum(cells == 2, axis=2)
    for i, j in np.argwhere(wanted > 0):
        corner = (origin[0] + cell * i, origin[1] + cell * j)
        share = seen[i, j] / wanted[i, j]
        for color, part in ((UNSEEN, 1.0), (SEEN, share)):
            box = Rectangle(corner, cell, cell * part, facecolor=color, linewidth=0, zorder=1)
            axes.add_patch(box)


def _progress(
    axes: Axes,
    time: np.ndarray,
    share: np.ndarray,
    world: int,
    completed: dict[int, float | None],
) -> None:
    for number in [*(n for n in range(len(share)) if n != world), world]:
        known = np.isfinite(share[number])
        chosen = number == world
        axes.step(
            time[known],
            100 * share[number][known],
            where="post",
            color=style.INK if chosen else style.FAINT,
            linewidth=2.0 if chosen else 0.8,
            zorder=3 if chosen else 2,
        )
    done = [at for at in completed.values() if at is not None]
    if done:
        axes.plot(done, np.full(len(done), 101.5), "|", color=style.QUIET, ms=9, clip_on=False)
    axes.set(
        title="Progress; ticks above: completed",
        xlabel="time, s",
        ylabel="share of the task that is done, %",
        ylim=(0, 104),
    )


def _signs(scene: ReplayScene, task: dict[str, np.ndarray]) -> list[Line2D | Patch]:
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
