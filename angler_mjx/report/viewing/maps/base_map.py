"""Base layer of a map: the cube's water, its floor, and rock."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.world.rock.grid import Grid

ABOVE, SOUTH = (0, 1), (0, 2)
"""World axes of figures from above and from the south: x and y, x and z."""


def plot_bounds(axes: Axes, scene: ReplayScene, plane: tuple[int, int]) -> None:
    """Plot the water of the cube, and the floor below it."""
    low, high = scene.bounds_m
    a, b = plane
    axes.set_aspect("equal", anchor="N")
    axes.set_facecolor(style.PAPER)
    axes.add_patch(
        Rectangle(
            (low[a], low[b]),
            high[a] - low[a],
            high[b] - low[b],
            facecolor=style.WATER,
            edgecolor=style.FAINT,
            zorder=0,
        )
    )
    margin = 0.02 * float(np.max(high - low))
    axes.set_xlim(low[a] - margin, high[a] + margin)
    bottom, top = low[b] - margin, high[b] + margin
    if b == 2:
        floor = float(scene.environment.floor_z_m)
        bottom = min(bottom, floor - 3 * margin)
        axes.axhspan(bottom, floor, facecolor="#cdbf9b", zorder=0)
    axes.set_ylim(bottom, top)


def plot_rock(axes: Axes, grid: Grid, plane: tuple[int, int], norm: Normalize) -> None:
    """Plot cells as squares, coloured by the height of the topmost or of the nearest one."""
    occupied = np.asarray(grid.occupied)
    origin, cell = np.asarray(grid.origin_m), float(grid.cell_m)
    height = origin[2] + cell * (np.arange(occupied.shape[2]) + 1.0)
    tops = np.where(occupied, height, np.nan)
    depth = 2 if plane == ABOVE else 1
    covered = occupied.any(axis=depth)
    first = occupied.argmax(axis=depth)
    if plane == ABOVE:
        first = occupied.shape[2] - 1 - occupied[:, :, ::-1].argmax(axis=2)
    shade = np.take_along_axis(tops, np.expand_dims(first, depth), axis=depth).squeeze(depth)
    squares = [
        Rectangle((origin[plane[0]] + cell * i, origin[plane[1]] + cell * j), cell, cell)
        for i, j in np.argwhere(covered)
    ]
    if squares:
        colors = style.ROCK(norm(shade[covered]))
        axes.add_collection(
            PatchCollection(
                squares, facecolors=colors, edgecolors=style.PAPER, linewidths=0.6, zorder=1
            )
        )
