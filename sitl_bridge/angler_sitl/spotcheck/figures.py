"""Figures of a spot check: all flights of a world in one plot, and all gaps."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import zarr
from matplotlib import colors
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from angler_mjx.report.plotting import style
from angler_mjx.runs.storage import trajectory_layout
from angler_mjx.runs.storage.results import OUTCOMES
from angler_mjx.runs.stored_arrays import stored_array
from angler_sitl.spotcheck.flight import RECORDED, SpotcheckFlight
from angler_sitl.spotcheck.gaps import FlightGap
from angler_sitl.spotcheck.results import SpotcheckResult

COLORS = {
    RECORDED: style.INK,
    "surrogate": style.ROBOTS[4],
    "cascade": style.ROBOTS[5],
    "thrusters": style.ROBOTS[0],
    "guided": style.ROBOTS[1],
}
"""Color of each kind of flight."""
MAX_ROBOTS = 4
"""Max number of robots of a world that are plotted."""
_PLANES = (((0, 1), "east, m", "north, m"), ((0, 2), "east, m", "height, m"))
_MIN_DISTANCE_M = 1e-3
"""Lower limit of plotted distances."""


def plot_world(result: SpotcheckResult, world: int, robots: int) -> Figure:
    """Plot all flights of a world: a column per robot, from above, from the south, and over time.

    Args:
        result: the spot check.
        world: global index.
        robots: of the flights.
    """
    flights = {
        name: result.flights[world, name, robots]
        for name in result.flight_names()
        if (world, name, robots) in result.flights
    }
    columns = min(robots, MAX_ROBOTS)
    with style.figure_style():
        width = max(3.1 * columns + 0.6, 9.4)
        figure = style.new_figure(width, 9.4, headline_in=0.75)
        shown = (
            f"the first {MAX_ROBOTS} of {robots} robots"
            if robots > MAX_ROBOTS
            else f"{robots} robots"
        )
        is_replanned = result.run.scenario.planner.replan_hz > 0.0
        plans, path_label = (
            ("planned anew in flight", "first plan")
            if is_replanned
            else ("the same plans", "planned way")
        )
        style.add_headline(
            figure,
            f"World {world}: {plans}, flown {len(flights)} times",
            f"{shown}; cross: failed there; the grey band is the {path_label}",
        )
        grid = figure.subplots(3, columns, squeeze=False, height_ratios=[1.0, 1.0, 0.65])
        for robot in range(columns):
            _plot_robot(result, world, robot, flights, grid[:, robot].tolist())
        for row in grid[:, 1:]:
            for panel in row:
                panel.set_ylabel("")
        handles: list[Artist] = [
            Line2D([], [], color=COLORS[name], linewidth=2.0, label=name) for name in flights
        ]
        handles.append(Line2D([], [], color=style.FAINT, linewidth=5.0, label=path_label))
        handles.append(Patch(color=style.ROCK(0.75), label="rock, at any height"))
        figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))
    return figure


def _plot_robot(
    result: SpotcheckResult,
    world: int,
    robot: int,
    flights: dict[str, SpotcheckFlight],
    panels: Sequence[Axes],
) -> None:
    stored: Any = result.run.trajectories
    path = trajectory_layout.plan_courses(stored, world)[robot][1]
    row = next(iter(flights.values())).rows[robot]
    panels[0].set_title(f"robot {robot}: {row['vehicle']},\n{row['parameter_set']}", fontsize=9.0)
    for panel, (plane, *labels) in zip(panels, _PLANES, strict=False):
        _plot_rock(panel, stored, world, plane)
        panel.plot(*path[:, plane].T, color=style.FAINT, linewidth=5.0, zorder=2)
        for name, flight in flights.items():
            _plot_track(panel, flight, robot, plane, name)
        _set_limits(panel, [path, *(track.p_m[:, robot] for track in flights.values())], plane)
        panel.set(xlabel=labels[0], ylabel=labels[1])
    _plot_distance(panels[2], flights, robot)


def _plot_track(
    panel: Axes, flight: SpotcheckFlight, robot: int, plane: tuple[int, int], name: str
) -> None:
    end = float(flight.end_s[robot])
    path = flight.p_m[flight.time_s <= end + 1e-6, robot]
    panel.plot(
        *path[:, plane].T,
        color=COLORS[name],
        linewidth=1.3,
        # The recorded flight lies below: the others are often on it.
        zorder=3 if name == RECORDED else 4,
    )
    if flight.rows[robot]["outcome"] != "reached":
        position = flight.position_at(robot, end)[list(plane)]
        panel.plot(*position, "x", color=COLORS[name], markersize=8, markeredgewidth=2.0, zorder=6)


def _plot_rock(panel: Axes, stored: zarr.Group, world: int, plane: tuple[int, int]) -> None:
    """Plot the rock at any height, or at any position north."""
    occupied, low, cell = (
        np.asarray(stored_array(stored, f"environment/grid/{name}")[world])
        for name in ("occupied", "origin_m", "cell_m")
    )
    (other,) = {0, 1, 2} - set(plane)
    is_rock = occupied.any(axis=other)
    high = low + float(cell) * np.asarray(occupied.shape)
    a, b = plane
    panel.imshow(
        np.where(is_rock, 1.0, np.nan).T,
        origin="lower",
        extent=(low[a], high[a], low[b], high[b]),
        cmap=colors.ListedColormap([style.ROCK(0.75)]),
        alpha=0.45,
        interpolation="nearest",
        zorder=1,
    )


def _set_limits(panel: Axes, paths: Sequence[np.ndarray], plane: tuple[int, int]) -> None:
    """Set square limits that hold all flights, with a margin of a metre."""
    points = np.concatenate(paths)[:, plane]
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    half = 0.5 * float(np.max(high - low)) + 1.0
    middle = 0.5 * (low + high)
    panel.set_xlim(middle[0] - half, middle[0] + half)
    panel.set_ylim(middle[1] - half, middle[1] + half)
    panel.set_aspect("equal", anchor="N")


def _plot_distance(panel: Axes, flights: dict[str, SpotcheckFlight], robot: int) -> None:
    """Plot the distance of each flight to the recorded one, over time, until either ends."""
    recorded = flights[RECORDED]
    for name, flight in flights.items():
        count = min(flight.time_s.size, recorded.time_s.size)
        last = min(float(flight.end_s[robot]), float(recorded.end_s[robot]))
        is_shared = flight.time_s[:count] <= last
        apart = np.linalg.norm(
            flight.p_m[:count, robot][is_shared] - recorded.p_m[:count, robot][is_shared], axis=1
        )
        if name != RECORDED:
            panel.plot(
                flight.time_s[:count][is_shared],
                np.maximum(apart, _MIN_DISTANCE_M),
                color=COLORS[name],
                linewidth=1.3,
            )
    panel.set_yscale("log")
    panel.set_ylim(_MIN_DISTANCE_M, 10.0)
    panel.set_yticks([1e-3, 1e-2, 0.1, 1.0, 10.0], ["≤ 1 mm", "1 cm", "10 cm", "1 m", "10 m"])
    panel.set(xlabel="time, s", ylabel="from what was recorded")
    panel.grid()


def plot_summary(result: SpotcheckResult) -> Figure:
    """Plot distances over time of each level to each reference, and all outcomes side by side."""
    levels, references = result.settings.levels, result.settings.references
    count = max(result.counts)
    with style.figure_style():
        figure = style.new_figure(11.6, 7.4, headline_in=0.75)
        style.add_headline(
            figure,
            "Real autopilots against the batch simulator",
            f"{len(result.picks)} worlds, {count} robots in each; line: median, band: from the "
            "10th to the 90th of 100",
        )
        upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.0, 0.9]).flat
        panels = upper.subplots(1, len(references), sharey=True, squeeze=False)[0]
        for panel, reference in zip(panels, references, strict=True):
            for level in levels:
                _plot_band(panel, result.list_gaps(level, count, reference), COLORS[level], level)
            panel.set_title(f"distance to {reference}", fontsize=10.0)
            panel.set_xlabel("time, s")
            panel.grid()
        panels[0].set_yscale("log")
        panels[0].set_ylim(_MIN_DISTANCE_M, 20.0)
        panels[0].set_yticks([1e-3, 1e-2, 0.1, 1.0, 10.0], ["1 mm", "1 cm", "10 cm", "1 m", "10 m"])
        panels[0].legend(loc="lower right")
        _plot_outcomes(lower.subplots(), result, count)
        end_outcomes = {row["outcome"] for flight in result.flights.values() for row in flight.rows}
        lower.legend(
            handles=[
                Patch(color=style.OUTCOMES[name], label=style.OUTCOME_TEXT[name])
                for name in OUTCOMES
                if name in end_outcomes
            ],
            loc="outside lower left",
            ncols=len(end_outcomes),
        )
    return figure


def _plot_band(panel: Axes, gaps: Sequence[FlightGap], color: str, label: str) -> None:
    if not gaps:
        return
    time = max((gap.time_s for gap in gaps), key=len)
    apart = np.full((len(gaps), time.size), np.nan)
    for row, gap in zip(apart, gaps, strict=True):
        row[: gap.apart_m.size] = np.maximum(gap.apart_m, _MIN_DISTANCE_M)
    # The last few active robots are no sample.
    has_samples = np.sum(np.isfinite(apart), axis=0) >= max(1, len(gaps) // 4)
    low, middle, high = np.nanpercentile(apart[:, has_samples], [10, 50, 90], axis=0)
    panel.plot(time[has_samples], middle, color=color, linewidth=1.6, label=label)
    panel.fill_between(time[has_samples], low, high, color=color, alpha=0.2, linewidth=0)


def _plot_outcomes(panel: Axes, result: SpotcheckResult, count: int) -> None:
    """Plot a row for each kind of flight, a column for each robot of each world."""
    names = result.flight_names()
    table = np.full((len(names), len(result.picks) * count), np.nan)
    for i, name in enumerate(names):
        for j, pick in enumerate(result.picks):
            flight = result.flights.get((pick.world, name, count))
            if flight is not None:
                outcome_indices = [OUTCOMES.index(row["outcome"]) for row in flight.rows]
                table[i, j * count : (j + 1) * count] = outcome_indices
    shades = colors.ListedColormap([style.OUTCOMES[name] for name in OUTCOMES])
    panel.imshow(table, cmap=shades, vmin=-0.5, vmax=len(OUTCOMES) - 0.5, aspect="auto", alpha=0.85)
    for j in range(table.shape[1]):
        wide = 2.0 if j % count == 0 else 0.5
        panel.axvline(j - 0.5, color=style.PAPER, linewidth=wide)
    for i in range(len(names)):
        panel.axhline(i - 0.5, color=style.PAPER, linewidth=2.0)
    panel.set_yticks(range(len(names)), names)
    middle = [j * count + 0.5 * (count - 1) for j in range(len(result.picks))]
    panel.set_xticks(middle, [f"world {pick.world}" for pick in result.picks], fontsize=8.0)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    panel.set_title("how each robot ended", fontsize=10.0)
