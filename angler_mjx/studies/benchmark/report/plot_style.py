"""Style of planners in figures; fourteen have distinct looks."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from angler_mjx.report.plotting import style

_COLUMNS = 7


@contextmanager
def styled() -> Iterator[None]:
    """Apply the style of all figures, with names as they are, dollar signs included."""
    with style.figure_style(), mpl.rc_context({"text.parse_math": False}):
        yield


def line_style(planner_index: int) -> dict[str, Any]:
    """Return colour and dashes of a planner; colours repeat after eight, then lines are dashed."""
    is_dashed = planner_index // len(style.ROBOTS) % 2 == 1
    return {"color": style.robot_color(planner_index), "linestyle": "--" if is_dashed else "-"}


def marker_style(planner_index: int) -> str:
    """Return the marker of a planner's points."""
    return "s" if planner_index // len(style.ROBOTS) % 2 == 1 else "o"


def add_legend(figure: Figure, planners: list[str]) -> None:
    """Add the legend of planners below a figure."""
    handles = [
        Line2D(
            [], [], **line_style(i), marker=marker_style(i), markersize=4, linewidth=1.6, label=name
        )
        for i, name in enumerate(planners)
    ]
    columns = min(_COLUMNS, max(2, int(figure.get_figwidth() * 0.62)))
    figure.legend(handles=handles, loc="outside lower left", ncols=columns, handlelength=3.0)


def legend_height_in(planners: list[str]) -> float:
    """Return the height [inch] of a legend."""
    return 0.24 * (1 + len(planners) // _COLUMNS)


def format_fraction_axis(axes: Axes) -> None:
    """Format the vertical axis as fractions in per cent."""
    axes.set_ylim(-0.02, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.grid(axis="y")


def add_panels(figure: Figure, count: int, n_columns: int, *, sharey: bool = True) -> list[Axes]:
    """Add as many axes as are needed, ``n_columns`` side by side."""
    n_rows = -(-count // n_columns)
    grid = figure.subplots(n_rows, n_columns, squeeze=False, sharey=sharey)
    all_axes: list[Axes] = list(grid.flat)
    for spare in all_axes[count:]:
        spare.set_visible(False)
    return all_axes[:count]
