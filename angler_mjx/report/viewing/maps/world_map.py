"""Map of one world: from above and from the south, with rock, water, obstacles and tracks."""

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.outlines import project_outline
from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.report.viewing.maps import base_map, legends
from angler_mjx.world.obstacles import STATIC

_HALO = [effects.withStroke(linewidth=2.6, foreground=style.PAPER)]


def plot_world(scene: ReplayScene, *, title: str, subtitle: str) -> Figure:
    """Plot the map of a world.

    Args:
        scene: the world.
        title: of the map.
        subtitle: a quieter line below.
    """
    low, high = scene.bounds_m
    size = high - low
    listed = min(len(scene.robots), legends.MAX_LISTED + 1)
    panel_in = min(4.8 * float(max(size[1], size[2]) / size[0]), 9.0)
    height_in = panel_in + 1.6 + 0.21 * max(listed, 4)
    with style.titled_figure(11.6, height_in, title, subtitle, headline_in=0.6) as figure:
        above, south = figure.subplots(1, 2)
        norm = Normalize(low[2], high[2])
        for axes, plane in ((above, base_map.ABOVE), (south, base_map.SOUTH)):
            base_map.plot_bounds(axes, scene, plane)
            base_map.plot_rock(axes, scene.environment.grid, plane, norm)
            if plane == base_map.ABOVE:
                _plot_current(axes, scene)
            _plot_obstacles(axes, scene, plane)
            for robot in scene.robots:
                _plot_track(axes, scene, robot, plane)
        above.set(title="From above", xlabel="east, m", ylabel="north, m")
        south.set(title="From the south", xlabel="east, m", ylabel="height, m (0: surface)")
        figure.legend(
            handles=legends.robot_handles(scene), loc="outside lower left", handlelength=2.2
        )
        figure.legend(
            handles=legends.symbol_handles(scene),
            loc="outside lower right",
            ncols=2,
            handlelength=2.2,
        )
    return figure


def describe_outcomes(scene: ReplayScene) -> str:
    """Return the outcomes of a world in words: arrivals, then the causes of failure."""
    ends = [robot.outcome for robot in scene.robots]
    arrived = ends.count("reached")
    causes = [
        f"{ends.count(outcome)} {text}"
        for outcome, text in style.OUTCOME_TEXT.items()
        if outcome != "reached" and outcome in ends
    ]
    verb = "arrived" if scene.task is None else "finished"
    return ", ".join([f"{arrived} of {len(ends)} robots {verb}", *causes])


def _plot_current(axes: Axes, scene: ReplayScene) -> None:
    """Plot the current at the start, in the middle of the cube's height."""
    if not scene.environment.current:
        return
    low, high = scene.bounds_m
    x, y = (np.linspace(low[i], high[i], 13)[1::2] for i in (0, 1))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.c_[grid, np.full(len(grid), 0.5 * (low[2] + high[2]))].astype(np.float32)
    v = scene.current_at(points, 0.0)
    fastest = float(np.max(np.linalg.norm(v[:, :2], axis=1)))
    if fastest < 1e-3:
        return
    spacing = float(x[1] - x[0])
    shown = float(f"{fastest:.1g}")
    arrows = axes.quiver(
        *grid.T,
        v[:, 0],
        v[:, 1],
        angles="xy",
        scale_units="xy",
        scale=fastest / (0.8 * spacing),
        pivot="middle",
        color=style.CURRENT,
        width=0.0042,
        headwidth=4.0,
        headlength=4.5,
        headaxislength=4.0,
        alpha=0.85,
        zorder=2,
    )
    axes.quiverkey(
        arrows,
        0.86,
        1.035,
        shown,
        f"current at t = 0: {shown:g} m/s",
        labelpos="W",
        labelcolor=style.QUIET,
        fontproperties={"size": 8.5},
        color=style.CURRENT,
    )


def _plot_obstacles(axes: Axes, scene: ReplayScene, plane: tuple[int, int]) -> None:
    """Plot outlines at the start; for moving obstacles also the path and a thin end outline."""
    obstacles = scene.environment.obstacles
    paths_m = []
    for i in np.flatnonzero(np.asarray(obstacles.exists)):
        kind, size = int(obstacles.kind[i]), np.asarray(obstacles.size_m[i])
        still = int(obstacles.motion[i]) == STATIC
        color = style.OBSTACLE_STATIC if still else style.OBSTACLE_DYNAMIC
        p, q = scene.obstacle_p_m[:, i], scene.obstacle_q[:, i]
        axes.add_patch(
            Polygon(
                project_outline(kind, size, p[0], q[0], plane),
                facecolor=color,
                edgecolor=color,
                alpha=0.75 if still else 0.45,
                linewidth=1.0,
                zorder=3,
            )
        )
        if not still:
            paths_m.append(p[:, list(plane)])
            axes.add_patch(
                Polygon(
                    project_outline(kind, size, p[-1], q[-1], plane),
                    fill=False,
                    edgecolor=color,
                    linewidth=0.8,
                    alpha=0.7,
                    zorder=3,
                )
            )
    axes.add_collection(
        LineCollection(
            paths_m, colors=style.OBSTACLE_DYNAMIC, linewidths=0.9, linestyles=":", zorder=3
        )
    )


def _plot_track(axes: Axes, scene: ReplayScene, robot: RobotTrack, plane: tuple[int, int]) -> None:
    a, b = plane
    color = style.robot_color(robot.index)
    path_m = scene.flown_path(robot)
    axes.plot(
        robot.plan_m[:, a],
        robot.plan_m[:, b],
        color=color,
        linewidth=1.1,
        linestyle=(0, (3, 2)),
        alpha=0.8,
        zorder=4,
    )
    axes.plot(path_m[:, a], path_m[:, b], color=color, linewidth=2.0, zorder=5, path_effects=_HALO)
    # Stars are larger than discs and lie below: crossing fleets start where others go.
    axes.plot(*robot.goal_m[[a, b]], "*", ms=21, color=color, mec=style.PAPER, mew=0.8, zorder=6)
    axes.plot(*robot.start_m[[a, b]], "o", ms=12, color=color, mec=style.PAPER, mew=1.0, zorder=7)
    axes.text(
        robot.start_m[a],
        robot.start_m[b],
        str(robot.index),
        color=style.PAPER,
        fontsize=8,
        fontweight="bold",
        ha="center",
        va="center_baseline",
        zorder=8,
        in_layout=False,
    )
    if not robot.arrived:
        _plot_failure(axes, scene, robot, plane)


def _plot_failure(
    axes: Axes, scene: ReplayScene, robot: RobotTrack, plane: tuple[int, int]
) -> None:
    x, y = (float(robot.failure_m[axis]) for axis in plane)
    if not (np.isfinite(x) and np.isfinite(y)):  # diverged
        return
    axes.plot(x, y, "X", ms=11, color=style.INK, mec=style.PAPER, mew=1.2, zorder=9)
    left, right = axes.get_xlim()
    far = x > left + 0.75 * (right - left)
    # Two robots that collided fail at one position: their labels stand below each other.
    above = sum(
        bool(np.linalg.norm((other.failure_m - robot.failure_m)[list(plane)]) < 1.5)
        for other in scene.robots[: robot.index]
    )
    axes.annotate(
        f"{robot.index}: {_describe_cause(robot)}",
        (x, y),
        xytext=(-9 if far else 9, 5 - 17 * above),
        textcoords="offset points",
        ha="right" if far else "left",
        fontsize=8.5,
        fontweight="bold",
        path_effects=_HALO,
        zorder=10,
        in_layout=False,
    )


def _describe_cause(robot: RobotTrack) -> str:
    """Return the cause of a robot's end, in a word or two."""
    if robot.failure_pair == "none":
        return {"out_of_bounds": "out of bounds", "timeout": "time out"}.get(
            robot.outcome, robot.outcome
        )
    kind, _, index = robot.failure_pair.partition(":")
    # Obstacles have no numbers on the map; robots have.
    return {"cell": "rock", "robot": f"robot {index}"}.get(kind, kind)
