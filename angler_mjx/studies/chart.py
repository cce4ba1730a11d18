"""The figure of a sweep: arrivals, time and energy over one key, a line for each of the others."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.report.plotting import series, style

MAX_LINES = 16
"""Combinations of other settings that are drawn; the table holds all."""
LOG_SCALE_RATIO = 16.0
"""Ratio of the largest to the smallest value from which they are drawn by their logarithms."""
MAX_TICK_LETTERS = 44
"""Letters of all names under an axis that stand beside each other; more are turned."""

type Panels = tuple[tuple[str, tuple[str, ...], float], ...]

PANELS: Panels = (
    ("robots that arrived, %", ("outcomes", "reached"), 100.0),
    ("worlds whose whole team arrived, %", ("team",), 100.0),
    ("mean time to goal, s", ("time_to_goal_s",), 1.0),
    ("mean energy of arrivals, kJ", ("energy_j",), 1e-3),
)
"""Title, keys of what is shown, and its scale."""
TASK_PANELS: Panels = (
    ("worlds that completed their task, %", ("task", "completed"), 100.0),
    ("robots that did their part, %", ("outcomes", "reached"), 100.0),
    ("mean time to completion, s", ("task", "completed_s"), 1.0),
    ("mean energy of robots that did their part, kJ", ("energy_j",), 1e-3),
)
"""The same where all cells have a task."""


def plot_sweep(sweep: Mapping[str, Any]) -> Figure:
    """Draw a sweep.

    Args:
        sweep: as ``sweep.json`` holds it.
    """
    main_axis = _select_main_axis(sweep["axes"])
    others = [x for x in sweep["axes"] if x is not main_axis and len(x["names"]) > 1]
    lines: dict[str, list[Mapping[str, Any]]] = {}
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
        for axes, (title, value_keys, scale) in zip(
            figure.subplots(2, 2).flat, panels, strict=True
        ):
            axes.set_title(title)
            for i, (name, rows) in enumerate(list(lines.items())[:MAX_LINES]):
                offset = (i - 0.5 * (min(len(lines), MAX_LINES) - 1)) * _line_offset(positions)
                _plot_line(
                    axes, i, name, rows, main_axis["key"], positions, value_keys, scale, offset
                )
            _set_ticks(axes, main_axis, positions)
            axes.grid(axis="y")
        if others:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)))
    return figure


def _select_main_axis(axes: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """The axis that lies to the right: the one with most values, numbers before words."""
    return max(axes, key=lambda x: (len(x["names"]) > 1, _is_numeric(x), len(x["names"])))


def _is_numeric(axis: Mapping[str, Any]) -> bool:
    return all(type(value) in (int, float) for value in axis["values"])


def _short_key(key: str) -> str:
    return key.rpartition(".")[2]


def _axis_positions(axis: Mapping[str, Any]) -> dict[str, float]:
    """Where each value lies, by its name: numbers that span much by their logarithms."""
    values = axis["values"] if _is_numeric(axis) else range(len(axis["names"]))
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
    rows: Sequence[Mapping[str, Any]],
    key: str,
    positions: Mapping[str, float],
    value_keys: Sequence[str],
    scale: float,
    offset: float,
) -> None:
    """One line with its bars; a value without an interval stands without one."""
    points = []
    for row in rows:
        held: Mapping[str, Any] = row
        for part in value_keys:
            held = held[part]
        value = held.get("rate", held.get("mean"))
        if value is None:
            continue
        low, high = (value if held[end] is None else held[end] for end in ("low", "high"))
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


def _set_ticks(axes: Axes, main_axis: Mapping[str, Any], positions: Mapping[str, float]) -> None:
    axes.set_xlabel(main_axis["key"])
    names = [name if len(name) <= 18 else name[:15] + "..." for name in positions]
    axes.set_xticks(list(positions.values()), names)
    if sum(map(len, names)) > MAX_TICK_LETTERS:
        axes.tick_params(axis="x", labelrotation=12.0)
    low, high = min(positions.values()), max(positions.values())
    margin = 0.08 * (high - low) or 0.5
    axes.set_xlim(low - margin, high + margin)
