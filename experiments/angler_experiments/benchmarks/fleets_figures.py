"""Figures of the study of fleets: arrivals against the team, and against information levels."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_experiments.benchmarks.fleets import LEVELS, FleetsStudy, arrival_rate
from angler_mjx.report.plotting import series, style
from angler_mjx.studies.benchmark.report.rates import ReportRate


def make_figures(study: FleetsStudy, level: str, folder: Path) -> list[Path]:
    """Plot both figures; the second only where several levels were flown."""
    figures = {"fleets_teams.png": plot_by_team(study, level)}
    if any(study.multi_level_cases):
        figures["fleets_known.png"] = plot_by_level(study)
    return [style.save_figure(figure, folder / name) for name, figure in figures.items()]


def plot_by_team(study: FleetsStudy, level: str) -> Figure:
    """Plot arrivals of whole teams, a panel per scene."""
    ticks = [str(team) for team in study.teams]
    panels = {
        scene: {
            flight_mode: [
                arrival_rate(study.select_runs(flight_mode, scene, team, level))
                for team in study.teams
            ]
            for flight_mode in study.all_flight_modes
        }
        for scene in study.results.scenes
    }
    subtitle = f"what moves is told as {level}; Wilson's 95 %"
    return _plot_panels(
        study, "Whole teams that arrive, by their robots", subtitle, panels, ticks, "robots"
    )


def plot_by_level(study: FleetsStudy) -> Figure:
    """Plot arrivals of whole teams by information level, a panel per scene and team."""
    panels = {
        f"{scene}, {robots} robot{'' if robots == 1 else 's'}": {
            flight_mode: [
                arrival_rate(study.select_runs(flight_mode, scene, robots, level))
                for level in LEVELS
            ]
            for flight_mode in study.all_flight_modes
        }
        for scene, robots in study.multi_level_cases
    }
    subtitle = "Wilson's 95 %"
    title = "Whole teams that arrive, by what is known"
    return _plot_panels(study, title, subtitle, panels, LEVELS, "of moving obstacles")


def _plot_panels(
    study: FleetsStudy,
    title: str,
    subtitle: str,
    panels: Mapping[str, Mapping[str, Sequence[ReportRate]]],
    ticks: Sequence[str],
    x_label: str,
) -> Figure:
    n_columns = min(len(panels), 2)
    n_rows = -(-len(panels) // n_columns)
    width_in = max(4.6 * n_columns, 7.5)
    height_in = 2.9 * n_rows + 0.95 + series.legend_height_in(study.all_flight_modes)
    with style.titled_figure(width_in, height_in, title, subtitle, parse_math=False) as figure:
        panel_axes = series.add_panels(figure, len(panels), n_columns)
        for axes, (name, lines) in zip(panel_axes, panels.items(), strict=True):
            axes.set(title=name, xlabel=x_label)
            _plot_lines(axes, list(lines.values()), ticks)
        series.add_legend(figure, study.all_flight_modes)
    return figure


def _plot_lines(axes: Axes, lines: Sequence[Sequence[ReportRate]], ticks: Sequence[str]) -> None:
    for line_index, rates in enumerate(lines):
        rate_points = [(i, rate) for i, rate in enumerate(rates) if rate.requested]
        shift = 0.35 * (line_index - (len(lines) - 1) / 2) / max(len(lines), 3)
        x = np.array([i + shift for i, _ in rate_points])
        fraction = np.array([rate.fraction for _, rate in rate_points])
        line_options = series.line_style(line_index)
        axes.plot(
            x,
            fraction,
            series.marker_style(line_index),
            **line_options,
            linewidth=1.5,
            markersize=4.5,
        )
        for at, (_, rate) in zip(x, rate_points, strict=True):
            axes.plot([at, at], [rate.low, rate.high], color=line_options["color"], alpha=0.5)
    axes.set_xticks(range(len(ticks)), ticks)
    axes.set_xlim(-0.5, len(ticks) - 0.5)
    series.format_fraction_axis(axes)
