"""Two runs of one world beside each other: what is around one robot, at a few times.

A row for each run and a column for each time. Each picture is a horizontal slice through the world
at the robot's height, so that what it shows is what the robot can meet.
"""

import math

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle

from angler_mjx.report.viewing import style
from angler_mjx.report.viewing.maps import ground
from angler_mjx.report.viewing.maps.pairing import Beside
from angler_mjx.report.viewing.outlines import outline
from angler_mjx.report.viewing.scene import ReplayScene, RobotTrack
from angler_mjx.robot.vehicles import library
from angler_mjx.world.obstacles import SPHERE

_ASIDE_M = 5.0
"""Half of what is seen, if both robots fit into it."""
_TRAIL_S = 6.0
"""Of an obstacle's way."""
_LEVEL_M = 0.75
"""Other robots and ways are drawn faintly further above or below than this."""
_HALO = [effects.withStroke(linewidth=2.6, foreground=style.PAPER)]


def draw(what: Beside) -> Figure:
    """A row for each run, a column for each time."""
    rows, columns = len(what.scenes), len(what.at_s)
    with style.styled():
        figure = style.new_figure(3.5 * columns + 0.4, 3.6 * rows + 1.5, headline_in=0.65)
        style.headline(
            figure,
            f"Robot {what.robot} of world {what.scenes[0].world}",
            "Slices from above, at the height of the robot; ways lead through other heights, too",
        )
        panels = figure.subplots(rows, columns, squeeze=False)
        windows = [_window(what, t) for t in what.at_s]
        aside = max(half for _, half in windows)
        for column, (t, (middle, _)) in enumerate(zip(what.at_s, windows, strict=True)):
            for row, one in enumerate(what.scenes):
                axes = panels[row, column]
                _picture(axes, one, what.robot, t)
                axes.set_xlim(middle[0] - aside, middle[0] + aside)
                axes.set_ylim(middle[1] - aside, middle[1] + aside)
                axes.set_aspect("equal")
                axes.set_xticks([])
                axes.set_yticks([])
                deep = -float(_at(one, one.robots[what.robot], t)[2])
                end = float(one.time_s[-1])
                # Behind its last sample, a tenth of a second of rounding aside, nothing is known.
                over = f", over since {end:g} s" if t > end + 0.1 else ""
                axes.set_title(f"t = {t:g} s, {deep:.1f} m deep{over}", fontsize=9.5)
                if column == 0:
                    ended = style.OUTCOME_TEXT[one.robots[what.robot].outcome]
                    axes.set_ylabel(f"{what.names[row]}:\n{ended}", fontsize=10.5, color=style.INK)
        _scale(panels[-1, 0])
        figure.legend(handles=_legend(), loc="outside lower left", ncols=4, handlelength=2.2)
    return figure


def _index(one: ReplayScene, t: float) -> int:
    return int(np.clip(np.searchsorted(one.time_s, t + 1e-6) - 1, 0, len(one.time_s) - 1))


def _at(one: ReplayScene, robot: RobotTrack, t: float) -> np.ndarray:
    """Where a robot [3] is, or ended."""
    place: np.ndarray = robot.p_m[_index(one, min(t, robot.end_time_s))]
    return place if np.isfinite(place).all() else one.way_taken(robot)[-1]


def _window(what: Beside, t: float) -> tuple[np.ndarray, float]:
    """Middle [2] and half of what is seen: all the runs' robots with something around them."""
    places = np.array([_at(one, one.robots[what.robot], t)[:2] for one in what.scenes])
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    return middle, max(_ASIDE_M, float(np.max(np.ptp(places, axis=0))) / 2 + 2.5)


def _picture(axes: Axes, one: ReplayScene, robot: int, t: float) -> None:
    mine = one.robots[robot]
    height = float(_at(one, mine, t)[2])
    low, high = one.bounds_m
    axes.set_facecolor(style.FAINT)
    axes.add_patch(Rectangle(_xy(low), *_xy(high - low), facecolor=style.WATER, zorder=0))
    _rock(axes, one, height)
    _obstacles(axes, one, height, t)
    plan = mine.plan_m
    if not one.replan_hz:
        axes.plot(*plan.T[:2], color=style.robot_color(robot), lw=1.2, ls=(0, (4, 2)), zorder=4)
    for other in one.robots:
        _robot(axes, one, other, t, faint=abs(_at(one, other, t)[2] - height) > _LEVEL_M)
    if not mine.arrived and t >= mine.end_time_s - 0.11:
        x, y = _at(one, mine, t)[:2]
        axes.plot(x, y, "X", ms=13, color=style.INK, mec=style.PAPER, mew=1.4, zorder=9)


def _rock(axes: Axes, one: ReplayScene, height_m: float) -> None:
    """Cells that the slice goes through."""
    grid = one.environment.grid
    origin, cell = np.asarray(grid.origin_m), float(grid.cell_m)
    occupied = np.asarray(grid.occupied)
    layer = int(np.clip((height_m - origin[2]) // cell, 0, occupied.shape[2] - 1))
    for i, j in np.argwhere(occupied[:, :, layer]):
        corner = _xy(origin[:2] + cell * np.array([i, j]))
        axes.add_patch(
            Rectangle(corner, cell, cell, facecolor=style.ROCK(0.45), edgecolor="none", zorder=1)
        )


def _obstacles(axes: Axes, one: ReplayScene, height_m: float, t: float) -> None:
    """Those that the slice goes through filled, with where they came from; others as lines."""
    given, now = one.environment.obstacles, _index(one, t)
    since = _index(one, max(t - _TRAIL_S, 0.0))
    for i in np.flatnonzero(np.asarray(given.exists)):
        kind, size = int(given.kind[i]), np.asarray(given.size_m[i])
        p, q = one.obstacle_p_m[:, i], one.obstacle_q[now, i]
        side = outline(kind, size, p[now], q, ground.SOUTH)[:, 1]
        met = side.min() <= height_m <= side.max()
        if not met and min(abs(side - height_m)) > 2 * _LEVEL_M:
            continue
        edge = outline(kind, size, p[now], q, ground.ABOVE)
        if met and kind == SPHERE:
            cut = math.sqrt(1.0 - ((height_m - p[now, 2]) / (0.5 * np.ptp(side))) ** 2)
            edge = p[now, :2] + cut * (edge - p[now, :2])
        axes.add_patch(
            Polygon(
                edge,
                facecolor=style.OBSTACLE_DYNAMIC if met else "none",
                edgecolor=style.OBSTACLE_DYNAMIC,
                linewidth=1.0,
                alpha=0.85 if met else 0.4,
                zorder=3,
            )
        )
        if met:
            way = p[since : now + 1]
            axes.plot(*way.T[:2], color=style.OBSTACLE_DYNAMIC, lw=1.3, ls=":", zorder=3)


def _robot(axes: Axes, one: ReplayScene, robot: RobotTrack, t: float, *, faint: bool) -> None:
    """Its body, the way until now, and what it flew afterwards."""
    color = style.robot_color(robot.index)
    way, place = one.way_taken(robot), _at(one, robot, t)
    now = _index(one, min(t, robot.end_time_s)) + 1
    alpha = 0.3 if faint else 1.0
    axes.plot(*way[:now].T[:2], color=color, lw=2.2, alpha=alpha, zorder=5)
    axes.plot(*way[now - 1 :].T[:2], color=color, lw=1.0, ls=":", alpha=alpha, zorder=5)
    axes.add_patch(
        Circle(
            _xy(place), _radius_m(robot), color=color, ec=style.PAPER, lw=0.8, alpha=alpha, zorder=6
        )
    )
    axes.plot(*robot.goal_m[:2], "*", ms=16, color=color, mec=style.PAPER, alpha=alpha, zorder=6)
    axes.annotate(
        str(robot.index),
        _xy(place),
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
    """Of the sphere that holds its hull, however it turns."""
    vehicle = library.load(robot.vehicle_file)
    center = np.asarray(vehicle.base.center_of_mass_m)
    return max(
        float(np.linalg.norm(np.asarray(end) - center)) + capsule.radius_m
        for capsule in vehicle.hull.capsules
        for end in (capsule.from_m, capsule.to_m)
    )


def _xy(place: np.ndarray) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _scale(axes: Axes) -> None:
    """A bar of two metres."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = left + 0.05 * (right - left), bottom + 0.06 * (top - bottom)
    axes.plot([x, x + 2.0], [y, y], color=style.INK, lw=2.5, solid_capstyle="butt", zorder=10)
    axes.text(x + 1.0, y + 0.25, "2 m", ha="center", fontsize=8.5, path_effects=_HALO, zorder=10)


def _legend() -> list[Line2D | Patch]:
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
