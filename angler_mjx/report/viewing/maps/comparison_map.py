"""Two runs of one world side by side: the surroundings of one robot, at a few times.

A row for each run and a column for each time. Each panel is a horizontal slice through the world
at the robot's height, so that it shows the objects that the robot can meet.
"""

import math

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.outlines import project_outline
from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.report.viewing.maps import base_map
from angler_mjx.report.viewing.maps.comparison import WorldComparison
from angler_mjx.robot.vehicles import library
from angler_mjx.world.obstacles import SPHERE

_MIN_HALF_WIDTH_M = 5.0
"""Min half width of the view; more if the robots do not fit into it."""
_TRAIL_S = 6.0
"""Time span of an obstacle's trail."""
_LEVEL_M = 0.75
"""Height difference beyond which other robots and paths are plotted faintly."""
_HALO = [effects.withStroke(linewidth=2.6, foreground=style.PAPER)]


def plot_comparison(comparison: WorldComparison) -> Figure:
    """Plot a row for each run, a column for each time."""
    rows, columns = len(comparison.scenes), len(comparison.at_s)
    with style.titled_figure(
        3.5 * columns + 0.4,
        3.6 * rows + 1.5,
        f"Robot {comparison.robot} of world {comparison.scenes[0].world}",
        "Slices from above, at the height of the robot; ways lead through other heights, too",
    ) as figure:
        panels = figure.subplots(rows, columns, squeeze=False)
        windows = [_view_window(comparison, t) for t in comparison.at_s]
        half_width = max(half for _, half in windows)
        for column, (t, (middle, _)) in enumerate(zip(comparison.at_s, windows, strict=True)):
            for row, scene in enumerate(comparison.scenes):
                axes = panels[row, column]
                _plot_panel(axes, scene, comparison.robot, t)
                axes.set_xlim(middle[0] - half_width, middle[0] + half_width)
                axes.set_ylim(middle[1] - half_width, middle[1] + half_width)
                axes.set_aspect("equal")
                axes.set_xticks([])
                axes.set_yticks([])
                depth_m = -float(_position_at(scene, scene.robots[comparison.robot], t)[2])
                end = float(scene.time_s[-1])
                # Behind its last sample, a tenth of a second of rounding aside, there are no data.
                end_text = f", over since {end:g} s" if t > end + 0.1 else ""
                axes.set_title(f"t = {t:g} s, {depth_m:.1f} m deep{end_text}", fontsize=9.5)
                if column == 0:
                    outcome_text = style.OUTCOME_TEXT[scene.robots[comparison.robot].outcome]
                    axes.set_ylabel(
                        f"{comparison.names[row]}:\n{outcome_text}", fontsize=10.5, color=style.INK
                    )
        _plot_scale_bar(panels[-1, 0])
        figure.legend(
            handles=_legend_handles(), loc="outside lower left", ncols=4, handlelength=2.2
        )
    return figure


def _sample_index(scene: ReplayScene, t: float) -> int:
    return int(np.clip(np.searchsorted(scene.time_s, t + 1e-6) - 1, 0, len(scene.time_s) - 1))


def _position_at(scene: ReplayScene, robot: RobotTrack, t: float) -> np.ndarray:
    """Return a robot's position [3] at a time, or at its end."""
    position_m: np.ndarray = robot.p_m[_sample_index(scene, min(t, robot.end_time_s))]
    return position_m if np.isfinite(position_m).all() else scene.flown_path(robot)[-1]


def _view_window(comparison: WorldComparison, t: float) -> tuple[np.ndarray, float]:
    """Return middle [2] and half width of the view: all runs' robots with some margin."""
    positions_m = np.array(
        [_position_at(scene, scene.robots[comparison.robot], t)[:2] for scene in comparison.scenes]
    )
    middle = 0.5 * (positions_m.min(axis=0) + positions_m.max(axis=0))
    return middle, max(_MIN_HALF_WIDTH_M, float(np.max(np.ptp(positions_m, axis=0))) / 2 + 2.5)


def _plot_panel(axes: Axes, scene: ReplayScene, robot: int, t: float) -> None:
    track = scene.robots[robot]
    height = float(_position_at(scene, track, t)[2])
    low, high = scene.bounds_m
    axes.set_facecolor(style.FAINT)
    axes.add_patch(Rectangle(_to_xy(low), *_to_xy(high - low), facecolor=style.WATER, zorder=0))
    _plot_rock(axes, scene, height)
    _plot_obstacles(axes, scene, height, t)
    plan = track.plan_m
    if not scene.replan_hz:
        axes.plot(*plan.T[:2], color=style.robot_color(robot), lw=1.2, ls=(0, (4, 2)), zorder=4)
    for other in scene.robots:
        _plot_robot(
            axes, scene, other, t, faint=abs(_position_at(scene, other, t)[2] - height) > _LEVEL_M
        )
    if not track.arrived and t >= track.end_time_s - 0.11:
        x, y = _position_at(scene, track, t)[:2]
        axes.plot(x, y, "X", ms=13, color=style.INK, mec=style.PAPER, mew=1.4, zorder=9)


def _plot_rock(axes: Axes, scene: ReplayScene, height_m: float) -> None:
    """Plot the cells cut by the slice."""
    grid = scene.environment.grid
    origin, cell = np.asarray(grid.origin_m), float(grid.cell_m)
    occupied = np.asarray(grid.occupied)
    layer = int(np.clip((height_m - origin[2]) // cell, 0, occupied.shape[2] - 1))
    for i, j in np.argwhere(occupied[:, :, layer]):
        corner = _to_xy(origin[:2] + cell * np.array([i, j]))
        axes.add_patch(
            Rectangle(corner, cell, cell, facecolor=style.ROCK(0.45), edgecolor="none", zorder=1)
        )


def _plot_obstacles(axes: Axes, scene: ReplayScene, height_m: float, t: float) -> None:
    """Plot the obstacles cut by the slice filled, with their trails; others as lines."""
    obstacles, sample = scene.environment.obstacles, _sample_index(scene, t)
    since = _sample_index(scene, max(t - _TRAIL_S, 0.0))
    for i in np.flatnonzero(np.asarray(obstacles.exists)):
        kind, size = int(obstacles.kind[i]), np.asarray(obstacles.size_m[i])
        p, q = scene.obstacle_p_m[:, i], scene.obstacle_q[sample, i]
        side = project_outline(kind, size, p[sample], q, base_map.SOUTH)[:, 1]
        is_cut = side.min() <= height_m <= side.max()
        if not is_cut and min(abs(side - height_m)) > 2 * _LEVEL_M:
            continue
        edge = project_outline(kind, size, p[sample], q, base_map.ABOVE)
        if is_cut and kind == SPHERE:
            cut = math.sqrt(1.0 - ((height_m - p[sample, 2]) / (0.5 * np.ptp(side))) ** 2)
            edge = p[sample, :2] + cut * (edge - p[sample, :2])
        axes.add_patch(
            Polygon(
                edge,
                facecolor=style.OBSTACLE_DYNAMIC if is_cut else "none",
                edgecolor=style.OBSTACLE_DYNAMIC,
                linewidth=1.0,
                alpha=0.85 if is_cut else 0.4,
                zorder=3,
            )
        )
        if is_cut:
            path_m = p[since : sample + 1]
            axes.plot(*path_m.T[:2], color=style.OBSTACLE_DYNAMIC, lw=1.3, ls=":", zorder=3)


def _plot_robot(
    axes: Axes, scene: ReplayScene, robot: RobotTrack, t: float, *, faint: bool
) -> None:
    """Plot a robot's body, its path so far, and its later path."""
    color = style.robot_color(robot.index)
    path_m, position_m = scene.flown_path(robot), _position_at(scene, robot, t)
    n_flown = _sample_index(scene, min(t, robot.end_time_s)) + 1
    alpha = 0.3 if faint else 1.0
    axes.plot(*path_m[:n_flown].T[:2], color=color, lw=2.2, alpha=alpha, zorder=5)
    axes.plot(*path_m[n_flown - 1 :].T[:2], color=color, lw=1.0, ls=":", alpha=alpha, zorder=5)
    axes.add_patch(
        Circle(
            _to_xy(position_m),
            _radius_m(robot),
            color=color,
            ec=style.PAPER,
            lw=0.8,
            alpha=alpha,
            zorder=6,
        )
    )
    axes.plot(*robot.goal_m[:2], "*", ms=16, color=color, mec=style.PAPER, alpha=alpha, zorder=6)
    axes.annotate(
        str(robot.index),
        _to_xy(position_m),
        xytext=(7, 6),
        textcoords="offset points",
        color=color,
        fontsize=9,
        fontweight="bold",
        alpha=alpha,
        path_effects=_HALO,
        annotation_clip=True,
        clip_on=True,
        zorder=8,
    )


def _radius_m(robot: RobotTrack) -> float:
    """Return the radius of the sphere that holds its hull in any attitude."""
    vehicle = library.load_vehicle(robot.vehicle_file)
    center = np.asarray(vehicle.base.center_of_mass_m)
    return max(
        float(np.linalg.norm(np.asarray(end) - center)) + capsule.radius_m
        for capsule in vehicle.hull.capsules
        for end in (capsule.from_m, capsule.to_m)
    )


def _to_xy(position_m: np.ndarray) -> tuple[float, float]:
    return float(position_m[0]), float(position_m[1])


def _plot_scale_bar(axes: Axes) -> None:
    """Plot a bar of two metres."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = left + 0.05 * (right - left), bottom + 0.06 * (top - bottom)
    axes.plot([x, x + 2.0], [y, y], color=style.INK, lw=2.5, solid_capstyle="butt", zorder=10)
    axes.text(x + 1.0, y + 0.25, "2 m", ha="center", fontsize=8.5, path_effects=_HALO, zorder=10)


def _legend_handles() -> list[Line2D | Patch]:
    dash = (0, (4, 2))
    return [
        Line2D([], [], color=style.QUIET, lw=2.2, label="way until then"),
        Line2D([], [], color=style.QUIET, lw=1.0, ls=":", label="way afterwards"),
        Line2D([], [], color=style.QUIET, lw=1.2, ls=dash, label="plan of the start"),
        Line2D([], [], color=style.INK, marker="X", ms=9, ls="", label="failure"),
        Patch(color=style.OBSTACLE_DYNAMIC, label=f"obstacle; dotted: its last {_TRAIL_S:g} s"),
        Patch(
            facecolor="none",
            edgecolor=style.OBSTACLE_DYNAMIC,
            alpha=0.5,
            label="obstacle above or below",
        ),
        Patch(color=style.ROCK(0.45), label="rock"),
        Line2D([], [], color=style.QUIET, marker="*", ms=10, ls="", label="goal"),
    ]
