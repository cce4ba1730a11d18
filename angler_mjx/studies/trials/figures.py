"""One figure a controller: its answers to steps, and its tracks of the figure of eight."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.report.plotting import style
from angler_mjx.studies.flights import kinds
from angler_mjx.studies.flights.kinds import FlightKind
from angler_mjx.studies.trials import figure_of_eight, steps
from angler_mjx.studies.trials.trial import Trial

SHOWN_S = 20.0
"""Of the steps; the rest is steady, or an oscillation that can be seen by then."""
_MAX_RESPONSE = 1.5
"""Steps are drawn to this share; lost vehicles leave the panel."""
_SHOWN_M = (2.8, 1.7)
"""Half width and height of the panels of the figure of eight."""


def plot_trial(trial: Trial) -> Figure:
    """Steps of all vehicles above, tracks of the figure of eight below."""
    vehicles = list(dict.fromkeys(step.kind for step in trial.flown.steps))
    axes_flown = list(dict.fromkeys(step.axis for step in trial.flown.steps))
    with style.titled_figure(
        12.0,
        7.4,
        f"{trial.controller}: steps of 2 m{' and 90 degrees' * ('yaw' in axes_flown)}, "
        "figure of eight",
        f"steps: full lines in still water, dashed in {steps.CURRENTS_MPS[1]:g} m/s from the "
        f"side; figure of eight at {figure_of_eight.SPEED_MPS:g} m/s "
        f"({', '.join(figure_of_eight.SLOW_SETS)} among vortices at "
        f"{figure_of_eight.SLOW_MPS:g})",
        headline_in=0.75,
    ) as figure:
        grid = figure.add_gridspec(2, 1, height_ratios=[1.0, 1.1])
        upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
        row = upper.subplots(1, len(axes_flown), sharey=True)
        for panel, axis in zip(row, axes_flown, strict=True):
            _plot_steps(panel, trial, axis, vehicles)
        row[0].set_ylabel("share of the step")
        row = lower.subplots(1, len(figure_of_eight.CONDITIONS), sharey=True, sharex=True)
        for panel, (condition, _, _) in zip(row, figure_of_eight.CONDITIONS, strict=True):
            _plot_tracks(panel, trial, condition, vehicles)
        row[0].set_ylabel("y, m")
        lines = [figure.axes[0].lines[1 + 2 * i] for i in range(len(vehicles))]
        figure.legend(
            lines, [_format_label(kind) for kind in vehicles], loc="outside lower left", ncols=3
        )
    return figure


def _format_label(kind: FlightKind) -> str:
    return kind.label + (" (nothing holds it level)" if kind in kinds.find_unstabilised() else "")


def _plot_steps(panel: Axes, trial: Trial, axis: str, vehicles: Sequence[FlightKind]) -> None:
    time = trial.flown.time_s
    early = time <= SHOWN_S
    panel.axhline(1.0, color=style.FAINT, linewidth=1.0)
    for i, kind in enumerate(vehicles):
        for flow, line in zip(steps.CURRENTS_MPS, ("-", (0, (3, 1.5))), strict=True):
            step = next(
                s
                for s in trial.flown.steps
                if (s.kind, s.axis, s.current_mps) == (kind, axis, flow)
            )
            panel.plot(
                time[early],
                step.response[early],
                color=style.robot_color(i),
                linestyle=line,
                linewidth=1.4,
            )
    panel.set_ylim(-0.15, _MAX_RESPONSE)
    panel.set_xticks(np.arange(0.0, SHOWN_S + 1.0, 5.0))
    panel.set_xlim(0.0, SHOWN_S)
    panel.set_title("90 degrees of yaw" if axis == "yaw" else f"2 m along {axis}")
    panel.set_xlabel("time, s")
    panel.grid()


def _plot_tracks(panel: Axes, trial: Trial, condition: str, vehicles: Sequence[FlightKind]) -> None:
    for i, kind in enumerate(vehicles):
        result = next(e for e in trial.eights if (e.kind, e.condition) == (kind, condition))
        if i == 0:
            panel.plot(*result.course_m.T, color=style.FAINT, linewidth=4.0, solid_capstyle="round")
        near = np.where(np.abs(result.track_m) < _SHOWN_M, result.track_m, np.nan)
        panel.plot(*near.T, color=style.robot_color(i), linewidth=1.1)
    panel.set_xlim(-_SHOWN_M[0], _SHOWN_M[0])
    panel.set_ylim(-_SHOWN_M[1], _SHOWN_M[1])
    panel.set_aspect("equal")
    panel.set_title("still water" if condition == figure_of_eight.CONDITIONS[0][0] else condition)
    panel.set_xlabel("x, m")
    panel.grid()
