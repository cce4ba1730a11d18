"""Figures of a tuning: how the search went, and errors before and after."""

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from angler_mjx.report.plotting import style
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.flights.measures import TRACK_PERIOD_S, FlightMeasures
from angler_mjx.studies.tuning.knobs import SPAN
from angler_mjx.studies.tuning.outcome import ObjectivePart, TuningOutcome
from angler_mjx.studies.tuning.samples import COURSES

BEFORE, AFTER = style.QUIET, style.ROBOTS[0]
_MIN_ERROR_M = 1e-3
"""Errors below this are drawn as this."""


def plot_search(outcome: TuningOutcome) -> Figure:
    """Costs of all candidates, and where each gain ended within its bounds."""
    settings = outcome.problem.settings
    with style.titled_figure(
        11.0,
        4.4,
        f"{settings.controller}: search for {settings.objective}",
        f"{settings.method}, {settings.rollouts} flights a candidate; the gains it began with "
        f"cost 1; held-out flights cost {outcome.held_out.cost:.3f} in the end",
        headline_in=0.75,
    ) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.2])
        _plot_costs(left, outcome)
        _plot_gains(right, outcome)
    return figure


def _plot_costs(panel: Axes, outcome: TuningOutcome) -> None:
    costs = [generation.costs for generation in outcome.history.generations]
    number = np.arange(1, len(costs) + 1)
    best = np.minimum.accumulate([min(1.0, *generation_costs) for generation_costs in costs])
    for i, generation_costs in zip(number, costs, strict=True):
        panel.plot(
            np.full(len(generation_costs), i),
            generation_costs,
            ".",
            color=style.FAINT,
            markersize=4.0,
        )
    panel.plot(number, best, color=AFTER, linewidth=1.8)
    panel.axhline(1.0, color=BEFORE, linewidth=1.0, linestyle=(0, (3, 1.5)))
    panel.set_yscale("log")
    panel.set_ylim(0.9 * best[-1], max(1.5, min(10.0, 1.1 * np.max(np.concatenate(costs)))))
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_formatter("{x:g}")
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.set_title("cost of candidates, and the best so far")
    panel.set_xlabel("generation")
    panel.grid(which="both")


def _plot_gains(panel: Axes, outcome: TuningOutcome) -> None:
    for i, (knob, turn) in enumerate(zip(outcome.problem.knobs, outcome.turns, strict=True)):
        low, high, at = np.exp([knob.low, knob.high, turn])
        panel.plot([low, high], [i, i], color=style.FAINT, linewidth=5.0, solid_capstyle="butt")
        panel.plot([1.0, at], [i, i], color=AFTER, linewidth=2.0)
        panel.plot(at, i, "o", color=AFTER, markersize=5.0)
    panel.axvline(1.0, color=BEFORE, linewidth=1.0)
    panel.set_xscale("log", base=2)
    panel.set_xlim(1 / (1.1 * SPAN), 1.1 * SPAN)
    ticks = [0.25, 0.5, 1.0, 2.0, 4.0]
    panel.set_xticks(ticks, [f"{x:g}" for x in ticks])
    panel.set_yticks(
        range(len(outcome.problem.knobs)),
        [" and ".join(name for name in knob.gains) for knob in outcome.problem.knobs],
        fontsize=7.5,
    )
    panel.invert_yaxis()
    panel.set_title("gains, times what they began with")
    panel.set_xlabel("factor; grey: searched in")


def plot_errors(outcome: TuningOutcome) -> Figure:
    """Errors of position over time on the held-out flights, by robot and course."""
    part, labels = outcome.held_out, outcome.problem.robots.labels
    with style.titled_figure(
        3.4 * len(labels) + 0.6,
        7.2,
        f"{outcome.problem.settings.controller}: error of position, before and after",
        "held-out flights: median, and the band from the 10th to the 90th of 100",
        headline_in=0.75,
    ) as figure:
        grid = figure.subplots(len(COURSES), len(labels), sharex=True, sharey=True, squeeze=False)
        for i, label in enumerate(labels):
            grid[0, i].set_title(label, fontsize=9.0)
            grid[-1, i].set_xlabel("time, s")
            for j, course in enumerate(COURSES):
                _plot_error_band(grid[j, i], part, part.flights.group == i * len(COURSES) + j)
                if i == 0:
                    grid[j, i].set_ylabel(f"{course}: error, m")
        lines = grid[0, 0].lines[:2]
        figure.legend(lines, ["before", "after"], loc="outside lower left", ncols=2)
    return figure


def _plot_error_band(panel: Axes, part: ObjectivePart, chosen: FloatArray) -> None:
    for measures, color in ((part.before, BEFORE), (part.after, AFTER)):
        off = _position_errors(part, measures)[chosen]
        time = TRACK_PERIOD_S * np.arange(off.shape[1])
        low, middle, high = np.nanpercentile(np.maximum(off, _MIN_ERROR_M), [10, 50, 90], axis=0)
        panel.plot(time, middle, color=color, linewidth=1.6)
        panel.fill_between(time, low, high, color=color, alpha=0.2, linewidth=0)
    panel.set_yscale("log")
    panel.grid()


def _position_errors(part: ObjectivePart, measures: FlightMeasures) -> FloatArray:
    """[n, k] distance from where each vehicle should be, m; nan where it failed."""
    pose = np.asarray(part.flights.reference.pose)
    every = round(pose.shape[1] / measures.position_m.shape[1])
    off = np.linalg.norm(measures.position_m - pose[:, ::every, :3], axis=-1)
    return np.where(np.asarray(measures.failed)[:, None], np.nan, off)


def plot_tracks(outcome: TuningOutcome) -> Figure:
    """The figure of eight from above: the held-out flight of each robot that erred most before."""
    part, labels = outcome.held_out, outcome.problem.robots.labels
    with style.titled_figure(
        3.4 * len(labels) + 0.6,
        3.4,
        f"{outcome.problem.settings.controller}: the figure of eight, before and after",
        "of each robot the held-out flight with the worst error before",
        headline_in=0.75,
    ) as figure:
        grid = figure.subplots(1, len(labels), sharex=True, sharey=True, squeeze=False)[0]
        for i, (panel, label) in enumerate(zip(grid, labels, strict=True)):
            rows = np.flatnonzero(part.flights.group == i * len(COURSES) + COURSES.index("eight"))
            row = rows[np.argmax(np.nan_to_num(part.before.rms_m[rows]))]
            wanted = np.asarray(part.flights.reference.pose)[row]
            panel.plot(*wanted[:, :2].T, color=style.FAINT, linewidth=4.0)
            panel.plot(*part.before.position_m[row, :, :2].T, color=BEFORE, linewidth=1.2)
            panel.plot(*part.after.position_m[row, :, :2].T, color=AFTER, linewidth=1.2)
            panel.set_title(label, fontsize=9.0)
            panel.set_xlim(-2.8, 2.8)
            panel.set_ylim(-1.8, 1.8)
            panel.set_aspect("equal")
            panel.set_xlabel("x, m")
            panel.grid()
        grid[0].set_ylabel("y, m")
        figure.legend(grid[0].lines[1:3], ["before", "after"], loc="outside lower left", ncols=2)
    return figure


FIGURES: Mapping[str, Callable[[TuningOutcome], Figure]] = {
    "search": plot_search,
    "errors": plot_errors,
    "tracks": plot_tracks,
}
"""By the name of their file."""
