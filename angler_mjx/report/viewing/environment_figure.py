"""Figure of one initial environment: in perspective, and from above."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LightSource, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.art3d import (  # type: ignore[import-untyped]
    Line3DCollection,
    Poly3DCollection,
)

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.outlines import project_outline, rotation_matrix
from angler_mjx.world import currents
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, STATIC
from angler_mjx.world.rock.grid import Grid

_LIGHT = LightSource(azdeg=300, altdeg=50)
_SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
_FLOOR = "#cdbf9b"


def plot_environment(environment: Environment, *, title: str) -> Figure:
    """Plot cells, obstacles, starts, goals and current of one world.

    Args:
        environment: of one world.
        title: of the figure.
    """
    low, high = _grid_bounds(environment.grid)
    with style.titled_figure(
        12.4, 6.5, title, _describe_difficulty(environment), headline_in=0.62
    ) as figure:
        solid: Axes3D = figure.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
        above = figure.add_subplot(1, 2, 2)
        _plot_perspective(solid, environment, low, high)
        _plot_map(above, environment, low, high)
        figure.legend(handles=_legend_handles(environment), loc="outside lower center", ncols=6)
    return figure


def _grid_bounds(grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    low = np.asarray(grid.origin_m, float)
    return low, low + float(grid.cell_m) * np.array(np.shape(grid.occupied))


def _describe_difficulty(environment: Environment) -> str:
    """Return the difficulty in one line."""
    n_robot = len(environment.start_m)
    facts = [
        f"{100 * float(environment.density):.1f} % of {np.size(environment.grid.occupied)} cells",
        f"{int(np.sum(environment.obstacles.exists))} obstacles",
        f"{n_robot} robots, straight line free for {int(np.sum(environment.line_free))}",
        f"shortest way {np.mean(environment.path_ratio):.2f} of the straight line",
        f"drawn again {int(environment.redraws)} times",
    ]
    if not environment.valid:
        facts.append("CANNOT HOLD THE FLEET")
    return "   ·   ".join(facts)


def _plot_perspective(
    axes: Axes3D, environment: Environment, low: np.ndarray, high: np.ndarray
) -> None:
    # A floor far below would squeeze all else; it is left out.
    floor, size = float(environment.floor_z_m), high - low
    shown = floor > low[2] - max(size)
    bottom = floor if shown else float(low[2])
    size[2] = high[2] - bottom
    axes.view_init(elev=24, azim=-58)
    axes.set_proj_type("persp", focal_length=0.9)
    axes.set_box_aspect(size, zoom=1.12)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(bottom, high[2]))
    axes.set(xlabel="east, m", ylabel="north, m", zlabel="height, m")
    for axis, edge in zip((axes.xaxis, axes.yaxis, axes.zaxis), size, strict=True):
        axis.set_major_locator(MaxNLocator(max(2, round(6 * edge / max(size)))))
        axis.set_pane_color(style.WATER)
        axis._axinfo["grid"].update(color="#dbe6ec", linewidth=0.6)
    if shown:
        corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
        sand = [[(*corner, bottom) for corner in corners]]
        axes.add_collection3d(Poly3DCollection(sand, facecolors=_FLOOR, alpha=0.55, zorder=0))
    polygons, colors = _rock_polygons(environment.grid, Normalize(low[2], high[2]))
    for i in np.flatnonzero(np.asarray(environment.obstacles.exists)):
        obstacle_polygons, tint = _obstacle_polygons(environment, int(i))
        polygons, colors = [*polygons, *obstacle_polygons], [*colors, *tint]
    if polygons:
        solid = Poly3DCollection(polygons, facecolors=colors, edgecolors=colors, linewidths=0.2)
        axes.add_collection3d(solid)
    lines = np.stack([environment.start_m, environment.goal_m], axis=1)
    robots = [style.robot_color(i) for i in range(len(lines))]
    axes.add_collection3d(Line3DCollection(lines, colors=robots, linestyles=":", linewidths=1.2))
    for (start, goal), color in zip(lines, robots, strict=True):
        axes.plot(*start, "o", ms=8, color=color, mec=style.PAPER, zorder=10)
        axes.plot(*goal, "*", ms=13, color=color, mec=style.PAPER, zorder=10)


def _rock_polygons(grid: Grid, norm: Normalize) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the outer faces of the occupied cells, [4, 3] each, and their shaded colours."""
    occupied = np.asarray(grid.occupied)
    origin, cell = np.asarray(grid.origin_m), float(grid.cell_m)
    beside = np.pad(occupied, 1)
    polygons, colors = [], []
    for side in _SIDES:
        window = tuple(slice(1 + s, 1 + s + n) for s, n in zip(side, occupied.shape, strict=True))
        for index in np.argwhere(occupied & ~beside[window]):
            corners = origin + cell * (index + _square_corners(side))
            polygons.append(corners)
            base = np.array(style.ROCK(norm(origin[2] + cell * (index[2] + 0.5)))[:3])
            colors.append(_shade_color(base, side))
    return polygons, colors


def _obstacle_polygons(
    environment: Environment, i: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the faces of one obstacle at its start, and their shaded colours."""
    obstacles = environment.obstacles
    kind, size = int(obstacles.kind[i]), np.asarray(obstacles.size_m[i])
    turn, centre = rotation_matrix(np.asarray(obstacles.q0[i])), np.asarray(obstacles.p0[i])
    base = np.array(to_rgb(_obstacle_color(environment, i)))
    if kind == BOX:
        local = [(2.0 * _square_corners(side) - 1.0) * size for side in _SIDES]
    else:
        local = _capsule_polygons(float(size[0]), float(size[1]))
    polygons = [face @ turn.T + centre for face in local]
    return polygons, [_shade_color(base, face.mean(axis=0) - centre) for face in polygons]


def _capsule_polygons(radius: float, half_length: float) -> list[np.ndarray]:
    """Return the faces of a capsule about the origin along z; half length 0 gives a sphere."""
    polar, around = np.linspace(0.0, np.pi, 11), np.linspace(0.0, 2.0 * np.pi, 17)
    theta, phi = np.meshgrid(polar, around, indexing="ij")
    point = radius * np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )
    point[..., 2] += np.where(point[..., 2] >= 0, half_length, -half_length)
    corners = (point[:-1, :-1], point[1:, :-1], point[1:, 1:], point[:-1, 1:])
    return list(np.stack(corners, axis=2).reshape(-1, 4, 3))


def _square_corners(side: np.ndarray) -> np.ndarray:
    """Return the corners [4, 3] of the unit cube's face on one side, in order around it."""
    axis = int(np.argmax(np.abs(side)))
    first, second = (a for a in range(3) if a != axis)
    corners = np.zeros((4, 3))
    corners[:, axis] = side[axis] > 0
    corners[:, first], corners[:, second] = [0, 1, 1, 0], [0, 0, 1, 1]
    return corners


def _shade_color(base: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return a colour as shaded by the light on a face with that outward normal."""
    facing = float(normal @ _LIGHT.direction) / max(float(np.linalg.norm(normal)), 1e-9)
    shade: np.ndarray = np.clip(base * (0.78 + 0.26 * facing), 0.0, 1.0)
    return shade


def _obstacle_color(environment: Environment, i: int) -> str:
    still = int(environment.obstacles.motion[i]) == STATIC
    return style.OBSTACLE_STATIC if still else style.OBSTACLE_DYNAMIC


def _plot_map(axes: Axes, environment: Environment, low: np.ndarray, high: np.ndarray) -> None:
    axes.set_aspect("equal", anchor="C")
    axes.set(title="From above", xlabel="east, m", ylabel="north, m", facecolor=style.WATER)
    occupied = np.asarray(environment.grid.occupied)
    top = occupied.shape[2] - occupied[:, :, ::-1].argmax(axis=2)
    height = np.ma.masked_where(~occupied.any(axis=2), top / occupied.shape[2])
    axes.imshow(
        height.T,
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        cmap=style.ROCK,
        vmin=0,
        vmax=1,
        zorder=1,
    )
    obstacles = environment.obstacles
    present = np.flatnonzero(np.asarray(obstacles.exists))
    size, p0, q0 = np.asarray(obstacles.size_m), np.asarray(obstacles.p0), np.asarray(obstacles.q0)
    shapes = [
        Polygon(project_outline(int(obstacles.kind[i]), size[i], p0[i], q0[i], (0, 1)))
        for i in present
    ]
    tints = [_obstacle_color(environment, int(i)) for i in present]
    axes.add_collection(PatchCollection(shapes, facecolors=tints, alpha=0.7, zorder=3))
    for i, (start, goal) in enumerate(zip(environment.start_m, environment.goal_m, strict=True)):
        color = style.robot_color(i)
        axes.plot(*np.stack([start, goal])[:, :2].T, ":", color=color, linewidth=1.2, zorder=4)
        axes.plot(*start[:2], "o", ms=9, color=color, mec=style.PAPER, zorder=5)
        axes.plot(*goal[:2], "*", ms=14, color=color, mec=style.PAPER, zorder=5)
    _plot_current(axes, environment, low, high)


def _plot_current(axes: Axes, environment: Environment, low: np.ndarray, high: np.ndarray) -> None:
    """Plot the current at t = 0 in the middle of the grid's height."""
    if not environment.current:
        return
    x, y = (np.linspace(low[i], high[i], 15)[1::2] for i in (0, 1))
    point = np.stack([*np.meshgrid(x, y), np.full((7, 7), 0.5 * (low[2] + high[2]))], axis=-1)
    v = currents.velocities_at(environment.current, point.reshape(-1, 3), 0.0)
    fastest = float(np.max(np.hypot(v[:, 0], v[:, 1])))
    if fastest > 0:
        arrows = axes.quiver(
            point[..., 0],
            point[..., 1],
            v[:, 0],
            v[:, 1],
            color=style.CURRENT,
            zorder=2,
            angles="xy",
            scale_units="xy",
            scale=fastest / (0.8 * float(x[1] - x[0])),
            pivot="middle",
            width=0.0045,
        )
        shown = float(f"{fastest:.1g}")
        label = f"current: {shown:g} m/s"
        axes.quiverkey(arrows, 0.88, 1.03, shown, label, labelpos="W", labelcolor=style.QUIET)


def _legend_handles(environment: Environment) -> list[Line2D | Patch]:
    """Return legend entries of the occurring symbols."""
    obstacles = environment.obstacles
    exists, still = np.asarray(obstacles.exists), np.asarray(obstacles.motion) == STATIC
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=style.QUIET, marker="o", ms=8, linestyle="", label="start"),
        Line2D([], [], color=style.QUIET, marker="*", ms=11, linestyle="", label="goal"),
    ]
    if np.asarray(environment.grid.occupied).any():
        handles.append(Patch(color=style.ROCK(0.75), label="rock; lighter is higher"))
    if np.any(exists & ~still):
        handles.append(Patch(color=style.OBSTACLE_DYNAMIC, label="moving obstacle"))
    if np.any(exists & still):
        handles.append(Patch(color=style.OBSTACLE_STATIC, label="still obstacle"))
    return handles
