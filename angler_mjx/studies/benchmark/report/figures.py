"""The figures of a benchmark, drawn from its results alone into ``figures/``."""

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from angler_mjx.report.plotting.style import save_figure
from angler_mjx.studies.benchmark.report import curves, scene_maps, scenes
from angler_mjx.studies.benchmark.report.reading import Results

FOLDER = "figures"
_EXAMPLES = 4

FIGURES: dict[str, Callable[[Results], Figure | None]] = {
    "success_by_team": curves.success_by_team,
    "success_by_density": curves.success_by_density,
    "profiles_of_time": curves.profiles_of_time,
    "profiles_of_cost": curves.profiles_of_cost,
    "planning_time": curves.planning_time,
    "failures": scene_maps.plot_failures,
}
"""Figures by name; one gives None where the results hold nothing to draw."""


def _select_evenly(paths: Sequence[Path], max_count: int) -> list[Path]:
    """Some of them, from the beginning to the end."""
    if len(paths) <= max_count:
        return list(paths)
    return [paths[round((i + 0.5) * len(paths) / max_count - 0.5)] for i in range(max_count)]


def plot_figures(results: Results) -> list[Path]:
    """Draw all figures that the results have something for; older ones are replaced.

    Args:
        results: of a benchmark.

    Returns:
        The files.

    Raises:
        ConfigError: an example cannot be read.
        RunError: a file cannot be written.
    """
    folder = results.folder / FOLDER
    written = []
    for name, plot in FIGURES.items():
        figure = plot(results)
        if figure is not None:
            written.append(save_figure(figure, folder / f"{name}.png"))
    for path in _select_evenly(results.examples, _EXAMPLES):
        figure = scene_maps.plot_example(scenes.read_example(path))
        if figure is not None:
            written.append(save_figure(figure, folder / f"example_{path.stem}.png"))
    return written
