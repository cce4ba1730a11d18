"""Pictures of a spot check: all flights of a world laid over each other, and the gaps of all."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colors
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from angler_mjx.report.viewing import style
from angler_mjx.runs.storage import layout
from angler_mjx.runs.storage.results import OUTCOMES
from angler_sitl.spotcheck.flight import RECORDED, SpotcheckFlight
from angler_sitl.spotcheck.gaps import Gap
from angler_sitl.spotcheck.results import SpotcheckResult

COLORS = {
    RECORDED: style.INK,
    "surrogate": style.ROBOTS[4],
    "cascade": style.ROBOTS[5],
    "thrusters": style.ROBOTS[0],
    "guided": style.ROBOTS[1],
}
"""Of each flight."""
SHOWN = 4
"""Robots of a world that are drawn, at most."""
_PLANES = (((0, 1), "east, m", "north, m"), ((0, 2), "east, m", "height, m"))
_LEAST_M = 1e-3
"""Distances below this are drawn as this."""


def overlay(found: SpotcheckResult, world: int, robots: int) -> Figure:
    """All flights of a world: a column for each robot, from above, from the south, and over time.

    Args:
        found: the spot check.
        world: global index.
        robots: of the flights.
    """
    flights = {
        name: found.flights[world, name, robots]
        for name in found.names()
        if (world, name, robots) in found.flights
    }
    columns = min(robots, SHOWN)
    with style.styled():
        width = max(3.1 * columns + 0.6, 9.4)
        figure = style.new_figure(width, 9.4, headline_in=0.75)
        shown = f"the first {SHOWN} of {robots} robots" if robots > SHOWN else f"{robots} robots"
        anew = found.run.scenario.planner.replan_hz > 0.0
        plans, way = (
            ("planned anew in flight", "first plan") if anew else ("the same plans", "planned way")
        )
        style.headline(
            figure,
            f"World {world}: {plans}, flown {len(flights)} times",
            f"{shown}; cross: failed there; the grey band is the {way}",
        )
        grid = figure.subplots(3, columns, squeeze=False, height_ratios=[1.0, 1.0, 0.65])
        for robot in range(columns):
            _column(found, world, robot, flights, grid[:, robot].tolist())
        for row in grid[:, 1:]:
            for panel in row:
                panel.set_ylabel("")
        handles: list[Any] = [
            Line2D([], [], color=COLORS[name], linewidth=2.0, label=name) for name in flights
        ]
        handles.append(Line2D([], [], color=style.FAINT, linewidth=5.0, label=way))
        handles.append(Patch(color=style.ROCK(0.75), label="rock, at any height"))
        figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))
    return figure


def _column(
    found: SpotcheckResult,
    world: int,
    robot: int,
    flights: dict[str, SpotcheckFlight],
    panels: Sequence[Axes],
) -> None:
    stored: Any = found.run.trajectories
    way = layout.courses(stored, world)[robot][1]
    row = next(iter(flights.values())).rows[robot]
    panels[0].set_title(f"robot {robot}: {row['vehicle']},\n{row['parameter_set']}", fontsize=9.0)
    for panel, (plane, *labels) in zip(panels, _PLANES, strict=False):
        _rock(panel, stored["environment"], world, plane)
        panel.plot(*way[:, plane].T, color=style.FAINT, linewidth=5.0, zorder=2)
        for name, flight in flights.items():
            _track(panel, flight, robot, plane, name)
        _frame(panel, [way, *(one.p_m[:, robot] for one in flights.values())], plane)
        panel.set(xlabel=labels[0], ylabel=labels[1])
    _distance(panels[2], flights, robot)


def _track(
    panel: Axes, flight: SpotcheckFlight, robot: int, plane: tuple[int, int], name: str
) -> None:
    end = float(flight.end_s[robot])
    way = flight.p_m[flight.time_s <= end + 1e-6, robot]
    panel.plot(
        *way[:, plane].T,
        color=COLORS[name],
        linewidth=1.3,
        # What was recorded lies below: the others are often on it.
        zorder=3 if name == RECORDED else 4,
    )
    if flight.rows[robot]["outcome"] != "reached":
        place = flight.place(robot, end)[list(plane)]
        panel.plot(*place, "x", color=COLORS[name], markersize=8, markeredgewidth=2.0, zorder=6)


def _rock(panel: Axes, environment: Any, world: int, plane: tuple[int, int]) -> None:
    """Where there is rock at any height, or at any place north."""
    occupied = np.asarray(environment["grid/occupied"][world])
    low, cell = environment["grid/origin_m"][world], float(environment["grid/cell_m"][world])
    (other,) = {0, 1, 2} - set(plane)
    there = occupied.any(axis=other)
    high = low + cell * np.asarray(occupied.shape)
    a, b = plane
    panel.imshow(
        np.where(there, 1.0, np.nan).T,
        origin="lower",
        extent=(low[a], high[a], low[b], high[b]),
        cmap=colors.ListedColormap([style.ROCK(0.75)]),
        alpha=0.45,
        interpolation="nearest",
        zorder=1,
    )


def _frame(panel: Axes, ways: Sequence[Any], plane: tuple[int, int]) -> None:
    """A square that holds all flights, and a metre around."""
    points = np.concatenate(ways)[:, plane]
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    half = 0.5 * float(np.max(high - low)) + 1.0
    middle = 0.5 * (low + high)
    panel.set_xlim(middle[0] - half, middle[0] + half)
    panel.set_ylim(middle[1] - half, middle[1] + half)
    panel.set_aspect("equal", anchor="N")


def _distance(panel: Axes, flights: dict[str, SpotcheckFlight], robot: int) -> None:
    """Distance of each flight to what was recorded, over time, until either ends."""
    recorded = flights[RECORDED]
    for name, flight in flights.items():
        count = min(flight.time_s.size, recorded.time_s.size)
        last = min(float(flight.end_s[robot]), float(recorded.end_s[robot]))
        both = flight.time_s[:count] <= last
        apart = np.linalg.norm(
            flight.p_m[:count, robot][both] - recorded.p_m[:count, robot][both], axis=1
        )
        if name != RECORDED:
            panel.plot(
                flight.time_s[:count][both],
                np.maximum(apart, _LEAST_M),
                color=COLORS[name],
                linewidth=1.3,
            )
    panel.set_yscale("log")
    panel.set_ylim(_LEAST_M, 10.0)
    panel.set_yticks([1e-3, 1e-2, 0.1, 1.0, 10.0], ["≤ 1 mm", "1 cm", "10 cm", "1 m", "10 m"])
    panel.set(xlabel="time, s", ylabel="from what was recorded")
    panel.grid()


def summary(found: SpotcheckResult) -> Figure:
    """Distances over time of each level to each reference, and all outcomes beside each other."""
    levels, references = found.settings.levels, found.settings.references
    count = max(found.counts)
    with style.styled():
        figure = style.new_figure(11.6, 7.4, headline_in=0.75)
        style.headline(
            figure,
            "Real autopilots against the batch simulator",
            f"{len(found.picks)} worlds, {count} robots in each; line: median, band: from the "
            "10th to the 90th of 100",
        )
        parts: Any = figure.subfigures(2, 1, height_ratios=[1.0, 0.9])
        upper, lower = parts
        panels = upper.subplots(1, len(references), sharey=True, squeeze=False)[0]
        for panel, reference in zip(panels, references, strict=True):
            for level in levels:
                _band(panel, found.gaps(level, count, reference), COLORS[level], level)
            panel.set_title(f"distance to {reference}", fontsize=10.0)
            panel.set_xlabel("time, s")
            panel.grid()
        panels[0].set_yscale("log")
        panels[0].set_ylim(_LEAST_M, 20.0)
        panels[0].set_yticks([1e-3, 1e-2, 0.1, 1.0, 10.0], ["1 mm", "1 cm", "10 cm", "1 m", "10 m"])
        panels[0].legend(loc="lower right")
        _outcomes(lower.subplots(), found, count)
        ends = {row["outcome"] for one in found.flights.values() for row in one.rows}
        lower.legend(
            handles=[
                Patch(color=style.OUTCOMES[name], label=style.OUTCOME_TEXT[name])
                for name in OUTCOMES
                if name in ends
            ],
            loc="outside lower left",
            ncols=len(ends),
        )
    return figure


def _band(panel: Axes, gaps: Sequence[Gap], color: str, label: str) -> None:
    if not gaps:
        return
    time = max((gap.time_s for gap in gaps), key=len)
    apart = np.full((len(gaps), time.size), np.nan)
    for row, gap in zip(apart, gaps, strict=True):
        row[: gap.apart_m.size] = np.maximum(gap.apart_m, _LEAST_M)
    # The last few robots on their way are no sample.
    there = np.sum(np.isfinite(apart), axis=0) >= max(1, len(gaps) // 4)
    low, middle, high = np.nanpercentile(apart[:, there], [10, 50, 90], axis=0)
    panel.plot(time[there], middle, color=color, linewidth=1.6, label=label)
    panel.fill_between(time[there], low, high, color=color, alpha=0.2, linewidth=0)


def _outcomes(panel: Axes, found: SpotcheckResult, count: int) -> None:
    """A row for each kind of flight, a column for each robot of each world."""
    names = found.names()
    table = np.full((len(names), len(found.picks) * count), np.nan)
    for i, name in enumerate(names):
        for j, pick in enumerate(found.picks):
            flight = found.flights.get((pick.world, name, count))
            if flight is not None:
                ends = [OUTCOMES.index(row["outcome"]) for row in flight.rows]
                table[i, j * count : (j + 1) * count] = ends
    shades = colors.ListedColormap([style.OUTCOMES[name] for name in OUTCOMES])
    panel.imshow(table, cmap=shades, vmin=-0.5, vmax=len(OUTCOMES) - 0.5, aspect="auto", alpha=0.85)
    for j in range(table.shape[1]):
        wide = 2.0 if j % count == 0 else 0.5
        panel.axvline(j - 0.5, color=style.PAPER, linewidth=wide)
    for i in range(len(names)):
        panel.axhline(i - 0.5, color=style.PAPER, linewidth=2.0)
    panel.set_yticks(range(len(names)), names)
    middle = [j * count + 0.5 * (count - 1) for j in range(len(found.picks))]
    panel.set_xticks(middle, [f"world {pick.world}" for pick in found.picks], fontsize=8.0)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    panel.set_title("how each robot ended", fontsize=10.0)
