"""The figure of a sweep: arrivals, time and energy over one key, a line for each of the others."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.report.plotting import series, style
from angler_mjx.studies.rows import (
    AxisRow,
    CellRow,
    Mean,
    Rate,
    SweepResults,
)

MAX_LINES = 16
"""Combinations of other settings that are drawn; the table holds all."""
LOG_SCALE_RATIO = 16.0
"""Ratio of the largest to the smallest value from which they are drawn by their logarithms."""
MAX_TICK_LETTERS = 44
"""Letters of all names under an axis that stand beside each other; more are turned."""

type Value = tuple[float | None, float | None, float | None]
"""A value, and the ends of its interval; None where there is none."""
type ReadValue = Callable[[CellRow], Value]
type Panels = tuple[tuple[str, ReadValue, float], ...]


def _rate_value(rate: Rate) -> Value:
    return rate["rate"], rate["low"], rate["high"]


def _mean_value(mean: Mean) -> Value:
    return mean["mean"], mean["low"], mean["high"]


def _task_completed(row: CellRow) -> Value:
    return (None, None, None) if row["task"] is None else _rate_value(row["task"]["completed"])


def _task_completed_s(row: CellRow) -> Value:
    return (None, None, None) if row["task"] is None else _mean_value(row["task"]["completed_s"])


PANELS: Panels = (
    ("robots that arrived, %", lambda row: _rate_value(row["outcomes"]["reached"]), 100.0),
    ("worlds whose whole team arrived, %", lambda row: _rate_value(row["team"]), 100.0),
    ("mean time to goal, s", lambda row: _mean_value(row["time_to_goal_s"]), 1.0),
    ("mean energy of arrivals, kJ", lambda row: _mean_value(row["energy_j"]), 1e-3),
)
"""Title, what is shown, and its scale."""
TASK_PANELS: Panels = (
    ("worlds that completed their task, %", _task_completed, 100.0),
    ("robots that did their part, %", PANELS[0][1], 100.0),
    ("mean time to completion, s", _task_completed_s, 1.0),
    ("mean energy of robots that did their part, kJ", PANELS[3][1], 1e-3),
)
"""The same where all cells have a task."""


def plot_sweep(sweep: SweepResults) -> Figure:
    """Draw a sweep.

    Args:
        sweep: as ``sweep.json`` holds it.
    """
    main_axis = _select_main_axis(sweep["axes"])
    others = [x for x in sweep["axes"] if x is not main_axis and len(x["names"]) > 1]
    lines: dict[str, list[CellRow]] = {}
    for row in sweep["cells"]:
        name = ", ".join(f"{_short_key(x['key'])} {row['set'][x['key']]}" for x in others)
        lines.setdefault(name, []).append(row)
    positions = _axis_positions(main_axis)
    panels = TASK_PANELS if all(row["task"] is not None for row in sweep["cells"]) else PANELS
    left_out = len(lines) - MAX_LINES
    more = f"; {left_out} more lines in the table" if left_out > 0 else ""
    with style.titled_figure(
        9.6,
        7.6,
        f"{sweep['scenario']}: {main_axis['key']}",
        f"{sweep['worlds']:,} worlds a point, the same ones for all; "
        f"bars are 95 % intervals clustered by world{more}",
    ) as figure:
        for axes, (title, read_value, scale) in zip(
            figure.subplots(2, 2).flat, panels, strict=True
        ):
            axes.set_title(title)
            for i, (name, rows) in enumerate(list(lines.items())[:MAX_LINES]):
                offset = (i - 0.5 * (min(len(lines), MAX_LINES) - 1)) * _line_offset(positions)
                _plot_line(
                    axes, i, name, rows, main_axis["key"], positions, read_value, scale, offset
                )
            _set_ticks(axes, main_axis, positions)
            axes.grid(axis="y")
        if others:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)))
    return figure


def _select_main_axis(axes: Sequence[AxisRow]) -> AxisRow:
    """The axis that lies to the right: the one with most values, numbers before words."""
    return max(axes, key=lambda x: (len(x["names"]) > 1, _is_numeric(x), len(x["names"])))


def _is_numeric(axis: AxisRow) -> bool:
    return len(_list_numbers(axis)) == len(axis["values"])


def _list_numbers(axis: AxisRow) -> list[float]:
    """Return the values that are numbers."""
    return [x for x in axis["values"] if isinstance(x, int | float) and type(x) is not bool]


def _short_key(key: str) -> str:
    return key.rpartition(".")[2]


def _axis_positions(axis: AxisRow) -> dict[str, float]:
    """Where each value lies, by its name: numbers that span much by their logarithms."""
    values = _list_numbers(axis) if _is_numeric(axis) else [*range(len(axis["names"]))]
    if _is_numeric(axis) and min(values) > 0 and max(values) >= LOG_SCALE_RATIO * min(values):
        values = [math.log(value) for value in values]
    return dict(zip(axis["names"], map(float, values), strict=True))


def _line_offset(positions: Mapping[str, float]) -> float:
    """How far beside each other lines are drawn, so that their bars can be seen."""
    values = sorted(positions.values())
    gaps = [b - a for a, b in itertools.pairwise(values)]
    return 0.03 * min(gaps) if gaps else 0.03


def _plot_line(
    axes: Axes,
    number: int,
    name: str,
    rows: Sequence[CellRow],
    key: str,
    positions: Mapping[str, float],
    read_value: ReadValue,
    scale: float,
    offset: float,
) -> None:
    """One line with its bars; a value without an interval stands without one."""
    points = []
    for row in rows:
        value, low, high = read_value(row)
        if value is None:
            continue
        low, high = (value if end is None else end for end in (low, high))
        points.append([positions[row["set"][key]], value, value - low, high - value])
    points.sort()
    if not points:
        return
    x, y, down, up = zip(*points, strict=True)
    axes.errorbar(
        [coordinate + offset for coordinate in x],
        [scale * coordinate for coordinate in y],
        yerr=[[max(scale * coordinate, 0.0) for coordinate in side] for side in (down, up)],
        color=style.robot_color(number),
        marker=series.MARKERS[number // len(style.ROBOTS) % len(series.MARKERS)],
        markersize=4.5,
        linewidth=1.4,
        elinewidth=1.0,
        capsize=2.5,
        label=name,
    )


def _set_ticks(axes: Axes, main_axis: AxisRow, positions: Mapping[str, float]) -> None:
    axes.set_xlabel(main_axis["key"])
    names = [name if len(name) <= 18 else name[:15] + "..." for name in positions]
    axes.set_xticks(list(positions.values()), names)
    if sum(map(len, names)) > MAX_TICK_LETTERS:
        axes.tick_params(axis="x", labelrotation=12.0)
    low, high = min(positions.values()), max(positions.values())
    margin = 0.08 * (high - low) or 0.5
    axes.set_xlim(low - margin, high + margin)
