"""The figure of a sweep: arrivals, time and energy over one key, a line for each of the others."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.report.viewing import style

LINES = 16
"""Combinations of other settings that are drawn; the table holds all."""
WIDE = 16.0
"""Ratio of the largest to the smallest value from which they are drawn by their logarithms."""
TICKS = 44
"""Letters of all names under an axis that stand beside each other; more are turned."""
_MARKS = "osD^vPX*"

type Panels = tuple[tuple[str, tuple[str, ...], float], ...]

PANELS: Panels = (
    ("robots that arrived, %", ("outcomes", "reached"), 100.0),
    ("worlds whose whole team arrived, %", ("team",), 100.0),
    ("mean time to goal, s", ("time_to_goal_s",), 1.0),
    ("mean energy of arrivals, kJ", ("energy_j",), 1e-3),
)
"""Title, keys of what is shown, and its scale."""
OF_TASKS: Panels = (
    ("worlds that completed their task, %", ("task", "completed"), 100.0),
    ("robots that did their part, %", ("outcomes", "reached"), 100.0),
    ("mean time to completion, s", ("task", "completed_s"), 1.0),
    ("mean energy of robots that did their part, kJ", ("energy_j",), 1e-3),
)
"""The same where all cells have a task."""


def draw(found: Mapping[str, Any]) -> Figure:
    """Draw a sweep.

    Args:
        found: as ``sweep.json`` holds it.
    """
    along = _along(found["axes"])
    others = [x for x in found["axes"] if x is not along and len(x["names"]) > 1]
    lines: dict[str, list[Mapping[str, Any]]] = {}
    for row in found["cells"]:
        name = ", ".join(f"{_short(x['key'])} {row['set'][x['key']]}" for x in others)
        lines.setdefault(name, []).append(row)
    places = _places(along)
    panels = OF_TASKS if all(row["task"] is not None for row in found["cells"]) else PANELS
    with style.styled():
        figure = style.new_figure(9.6, 7.6, headline_in=0.65)
        left_out = len(lines) - LINES
        more = f"; {left_out} more lines in the table" if left_out > 0 else ""
        style.headline(
            figure,
            f"{found['scenario']}: {along['key']}",
            f"{found['worlds']:,} worlds a point, the same ones for all; "
            f"bars are 95 % intervals clustered by world{more}",
        )
        for axes, (title, what, scale) in zip(figure.subplots(2, 2).flat, panels, strict=True):
            axes.set_title(title)
            for i, (name, rows) in enumerate(list(lines.items())[:LINES]):
                aside = (i - 0.5 * (min(len(lines), LINES) - 1)) * _aside(places)
                _line(axes, i, name, rows, along["key"], places, what, scale, aside)
            _ticks(axes, along, places)
            axes.grid(axis="y")
        if others:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)))
    return figure


def _along(axes: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """The axis that lies to the right: the one with most values, numbers before words."""
    return max(axes, key=lambda x: (len(x["names"]) > 1, _is_numbers(x), len(x["names"])))


def _is_numbers(axis: Mapping[str, Any]) -> bool:
    return all(type(value) in (int, float) for value in axis["values"])


def _short(key: str) -> str:
    return key.rpartition(".")[2]


def _places(axis: Mapping[str, Any]) -> dict[str, float]:
    """Where each value lies, by its name: numbers that span much by their logarithms."""
    values = axis["values"] if _is_numbers(axis) else range(len(axis["names"]))
    if _is_numbers(axis) and min(values) > 0 and max(values) >= WIDE * min(values):
        values = [math.log(value) for value in values]
    return dict(zip(axis["names"], map(float, values), strict=True))


def _aside(places: Mapping[str, float]) -> float:
    """How far beside each other lines are drawn, so that their bars can be seen."""
    values = sorted(places.values())
    gaps = [b - a for a, b in itertools.pairwise(values)]
    return 0.03 * min(gaps) if gaps else 0.03


def _line(
    axes: Axes,
    number: int,
    name: str,
    rows: Sequence[Mapping[str, Any]],
    key: str,
    places: Mapping[str, float],
    what: Sequence[str],
    scale: float,
    aside: float,
) -> None:
    """One line with its bars; a value without an interval stands without one."""
    points = []
    for row in rows:
        held: Mapping[str, Any] = row
        for part in what:
            held = held[part]
        value = held.get("rate", held.get("mean"))
        if value is None:
            continue
        low, high = (value if held[end] is None else held[end] for end in ("low", "high"))
        points.append([places[row["set"][key]], value, value - low, high - value])
    points.sort()
    if not points:
        return
    x, y, down, up = zip(*points, strict=True)
    axes.errorbar(
        [one + aside for one in x],
        [scale * one for one in y],
        yerr=[[max(scale * one, 0.0) for one in side] for side in (down, up)],
        color=style.robot_color(number),
        marker=_MARKS[number // len(style.ROBOTS) % len(_MARKS)],
        markersize=4.5,
        linewidth=1.4,
        elinewidth=1.0,
        capsize=2.5,
        label=name,
    )


def _ticks(axes: Axes, along: Mapping[str, Any], places: Mapping[str, float]) -> None:
    axes.set_xlabel(along["key"])
    names = [name if len(name) <= 18 else name[:15] + "..." for name in places]
    axes.set_xticks(list(places.values()), names)
    if sum(map(len, names)) > TICKS:
        axes.tick_params(axis="x", labelrotation=12.0)
    low, high = min(places.values()), max(places.values())
    room = 0.08 * (high - low) or 0.5
    axes.set_xlim(low - room, high + room)
