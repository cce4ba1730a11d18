"""Figures of the study of fleets: arrivals against the team, and against what is known."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_experiments.benchmarks.fleets import LEVELS, FleetsStudy, arrivals
from angler_mjx.report.viewing import style
from angler_mjx.studies.benchmark.report import look
from angler_mjx.studies.benchmark.report.rates import ReportRate


def make(study: FleetsStudy, level: str, folder: Path) -> list[Path]:
    """Draw both; the second only where more than one level was flown."""
    drawn = {"fleets_teams.png": by_team(study, level)}
    if any(study.known):
        drawn["fleets_known.png"] = by_level(study)
    return [style.save(figure, folder / name) for name, figure in drawn.items()]


def by_team(study: FleetsStudy, level: str) -> Figure:
    """Whole teams that arrive, a panel a scene."""
    ticks = [str(team) for team in study.teams]
    panels = {
        scene: {
            way: [arrivals(study.of(way, scene, team, level)) for team in study.teams]
            for way in study.every_way
        }
        for scene in study.results.scenes
    }
    said = f"what moves is told as {level}; Wilson's 95 %"
    return _drawn(study, "Whole teams that arrive, by their robots", said, panels, ticks, "robots")


def by_level(study: FleetsStudy) -> Figure:
    """Whole teams that arrive, by what may be known, a panel a scene and team."""
    panels = {
        f"{scene}, {robots} robot{'' if robots == 1 else 's'}": {
            way: [arrivals(study.of(way, scene, robots, level)) for level in LEVELS]
            for way in study.every_way
        }
        for scene, robots in study.known
    }
    said = "Wilson's 95 %"
    title = "Whole teams that arrive, by what is known"
    return _drawn(study, title, said, panels, LEVELS, "of moving obstacles")


def _drawn(
    study: FleetsStudy,
    title: str,
    said: str,
    panels: Mapping[str, Mapping[str, Sequence[ReportRate]]],
    ticks: Sequence[str],
    below: str,
) -> Figure:
    across = min(len(panels), 2)
    down = -(-len(panels) // across)
    with look.styled():
        room = 0.95 + look.legend_in(study.every_way)
        figure = style.new_figure(max(4.6 * across, 7.5), 2.9 * down + room, headline_in=0.65)
        style.headline(figure, title, said)
        every = look.panels(figure, len(panels), across)
        for axes, (name, lines) in zip(every, panels.items(), strict=True):
            axes.set(title=name, xlabel=below)
            _lines(axes, list(lines.values()), ticks)
        look.legend(figure, study.every_way)
    return figure


def _lines(axes: Axes, lines: Sequence[Sequence[ReportRate]], ticks: Sequence[str]) -> None:
    for place, rates in enumerate(lines):
        held = [(i, one) for i, one in enumerate(rates) if one.asked]
        shift = 0.35 * (place - (len(lines) - 1) / 2) / max(len(lines), 3)
        x = np.array([i + shift for i, _ in held])
        share = np.array([one.share for _, one in held])
        drawn = look.line(place)
        axes.plot(x, share, look.mark(place), **drawn, linewidth=1.5, markersize=4.5)
        for at, (_, one) in zip(x, held, strict=True):
            axes.plot([at, at], [one.low, one.high], color=drawn["color"], alpha=0.5)
    axes.set_xticks(range(len(ticks)), ticks)
    axes.set_xlim(-0.5, len(ticks) - 0.5)
    look.shares(axes)
