"""Series of a figure: colours, dashes and markers that differ, their legend, and panels."""

from collections.abc import Sequence
from typing import Literal, TypedDict

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from angler_mjx.report.plotting import style

MARKERS = "osD^vPX*"
"""Markers of series that are told apart by them."""
_LEGEND_COLUMNS = 7


class LineStyle(TypedDict):
    """Colour and dashes of a line."""

    color: str
    linestyle: Literal["-", "--"]


def is_repeated(index: int) -> bool:
    """Return whether another series before this one has its colour."""
    return index // len(style.ROBOTS) % 2 == 1


def line_style(index: int) -> LineStyle:
    """Return colour and dashes of a series; colours repeat after eight, then lines are dashed."""
    return {"color": style.robot_color(index), "linestyle": "--" if is_repeated(index) else "-"}


def marker_style(index: int) -> str:
    """Return the marker of a series' points: a disc, or a square where colours repeat."""
    return "s" if is_repeated(index) else "o"


def add_legend(figure: Figure, names: Sequence[str]) -> None:
    """Add the legend of series below a figure."""
    handles = [
        Line2D(
            [], [], **line_style(i), marker=marker_style(i), markersize=4, linewidth=1.6, label=name
        )
        for i, name in enumerate(names)
    ]
    columns = min(_LEGEND_COLUMNS, max(2, int(figure.get_figwidth() * 0.62)))
    figure.legend(handles=handles, loc="outside lower left", ncols=columns, handlelength=3.0)


def legend_height_in(names: Sequence[str]) -> float:
    """Return the height [inch] of a legend."""
    return 0.24 * (1 + len(names) // _LEGEND_COLUMNS)


def format_fraction_axis(axes: Axes) -> None:
    """Format the vertical axis as fractions in per cent."""
    axes.set_ylim(-0.02, 1.03)
    axes.yaxis.set_major_formatter(percent_formatter())
    axes.grid(axis="y")


def percent_formatter() -> PercentFormatter:
    """Return the format of ticks of fractions: whole per cents."""
    return PercentFormatter(1.0, decimals=0, symbol=" %")


def label_rows(axes: Axes, labels: Sequence[str]) -> None:
    """Label the rows of a chart of bars, the first one at the top."""
    axes.set_yticks(range(len(labels)), labels)
    axes.tick_params(axis="y", length=0, labelcolor=style.INK)
    axes.invert_yaxis()


def add_panels(figure: Figure, count: int, n_columns: int, *, sharey: bool = True) -> list[Axes]:
    """Add as many axes as are needed, ``n_columns`` side by side."""
    n_rows = -(-count // n_columns)
    grid = figure.subplots(n_rows, n_columns, squeeze=False, sharey=sharey)
    all_axes: list[Axes] = list(grid.flat)
    for spare in all_axes[count:]:
        spare.set_visible(False)
    return all_axes[:count]
