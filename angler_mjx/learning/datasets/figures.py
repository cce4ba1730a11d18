"""Figures of a dataset's card, plotted from its folder alone: counts, lengths, and some flights."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from angler_mjx.learning.datasets import manifest_building
from angler_mjx.learning.datasets.manifest import Manifest
from angler_mjx.report.plotting import scene, series, style
from angler_mjx.report.viewing.maps import base_map
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.results import OUTCOMES

COUNTS_FILE, LENGTHS_FILE, FLIGHTS_FILE = "counts.png", "lengths.png", "flights.png"

COUNTED_COLUMNS = ("split", "difficulty", "preset", "expert")
"""Columns of the index whose values are counted."""
MAX_MAPS = 6
"""Number of mapped episodes."""
NUM_COLORS = 128
"""Number of colours of a file."""

_MEASURES = (
    ("duration_s", "time until the last robot's end, s", "episodes"),
    ("path_length_m", "way that a robot flew, m", "robots"),
    ("min_clearance_m", "least clearance of a robot, m", "robots"),
    ("path_ratio", "shortest way around rock over straight line", "episodes"),
)
"""Distributions: column of the index or of the runs, its label, and its table."""
_BIN_LIMITS = (10, 40)
"""Lower and upper limits of the number of bins."""


def plot_figures(root: Path, manifest: Manifest, table: pa.Table) -> None:
    """Plot all figures of a dataset into its folder.

    Args:
        root: folder of the dataset.
        manifest: its manifest.
        table: its index.

    Raises:
        ConfigError: a run is damaged.
        RunError: a file cannot be written.
    """
    robots = _read_robots(root, manifest)
    for figure, name in (
        (
            plot_counts(manifest, table, manifest_building.count_values(robots, "outcome")),
            COUNTS_FILE,
        ),
        (plot_distributions(table, robots), LENGTHS_FILE),
        (plot_flights(root, manifest, table), FLIGHTS_FILE),
    ):
        style.save_figure(figure, root / name, palette=NUM_COLORS)


def _read_robots(root: Path, manifest: Manifest) -> pa.Table:
    """Return columns of all parts' robots, and the expert of each."""
    names = ["outcome", *(name for name, _, of in _MEASURES if of == "robots")]
    parts = []
    for part in manifest.parts:
        rows = Run(root / part.path).episodes.select(names)
        parts.append(rows.append_column("expert", pa.repeat(part.expert, len(rows))))
    return pa.concat_tables(parts)


def plot_counts(manifest: Manifest, table: pa.Table, ended: Mapping[str, int]) -> Figure:
    """Plot outcomes of robots, and numbers of episodes by split, difficulty and so on.

    Args:
        manifest: manifest of the dataset.
        table: its index.
        ended: robots by outcome.
    """
    chosen = table.filter(table["chosen"])
    bars = [
        (c, manifest_building.count_values(table, c), manifest_building.count_values(chosen, c))
        for c in COUNTED_COLUMNS
    ]
    names = [name for name in OUTCOMES if name in ended]
    upper = max(len(names), len(bars[0][1]), len(bars[1][1]))
    lower = max(len(bars[2][1]), len(bars[3][1]), 2)
    success_fraction = ended.get("reached", 0) / sum(ended.values())
    with style.titled_figure(
        10.4,
        1.9 + 0.36 * (upper + lower),
        f"{manifest.name}: {len(table):,} episodes, {100 * success_fraction:.0f} % of robots "
        "arrived",
        f"{len(chosen):,} episodes are chosen (dark)"
        if manifest.sample.has_bounds
        else f"{sum(ended.values()):,} robots",
    ) as figure:
        grid = figure.subplots(2, 3, height_ratios=[upper + 0.8, lower + 0.8])
        _plot_bars(
            grid[0, 0],
            "robots that",
            [style.OUTCOME_TEXT[name] for name in names],
            [ended[name] for name in names],
            colors=[style.OUTCOMES[name] for name in names],
        )
        for panel, (column, all_of, kept_of) in zip(
            (grid[0, 1], grid[0, 2], grid[1, 0], grid[1, 1]), bars, strict=True
        ):
            labels = sorted(all_of)
            _plot_bars(
                panel,
                f"episodes by {column}",
                labels,
                [all_of[name] for name in labels],
                dark=[kept_of.get(name, 0) for name in labels],
            )
        grid[1, 2].set_axis_off()
    return figure


def _plot_bars(
    panel: Axes,
    title: str,
    labels: Sequence[str],
    values: Sequence[int],
    *,
    dark: Sequence[int] | None = None,
    colors: Sequence[str] | None = None,
) -> None:
    """Plot bars with their numbers; ``dark`` is the dark part of each."""
    positions = np.arange(len(labels))
    panel.barh(positions, values, height=0.66, color=style.FAINT if colors is None else colors)
    if dark is not None:
        panel.barh(positions, dark, height=0.66, color=style.ROBOTS[0])
    max_value = max(values, default=1)
    for i, (value, part) in enumerate(zip(values, dark or values, strict=True)):
        label = f"{value:,}" if part == value else f"{part:,} of {value:,}"
        panel.text(value + 0.02 * max_value, i, label, va="center", fontsize=8.5)
    series.label_rows(panel, labels)
    panel.set_xlim(0.0, 1.32 * max_value)
    panel.set_xticks([])
    panel.spines["bottom"].set_visible(False)
    panel.set_title(title, fontsize=10.0)


def plot_distributions(table: pa.Table, robots: pa.Table) -> Figure:
    """Plot durations, distances and clearances of flights, by expert.

    Args:
        table: the index.
        robots: rows of all robots.
    """
    experts = sorted(manifest_building.count_values(table, "expert"))
    with style.titled_figure(
        10.4,
        6.2,
        "Duration, length, clearance",
        "fraction of each expert's episodes or robots; outer bars include all values beyond",
    ) as figure:
        panels = figure.subplots(2, 2).ravel()
        for panel, (name, label, of) in zip(panels, _MEASURES, strict=True):
            rows = table if of == "episodes" else robots
            expert = pc.index_in(rows["expert"], pa.array(experts)).to_numpy()
            _plot_distribution(panel, rows[name].to_numpy().astype(float), expert, len(experts))
            panel.set(xlabel=label, ylabel=f"fraction of {of}, %")
        handles = [
            Line2D([], [], color=style.robot_color(i), linewidth=2.0, label=expert)
            for i, expert in enumerate(experts)
        ]
        figure.legend(handles=handles, loc="outside lower left", ncols=min(len(handles), 6))
    return figure


def _plot_distribution(panel: Axes, values: np.ndarray, expert: np.ndarray, experts: int) -> None:
    """Plot outlines of histograms, one per expert, between the 1st and 99th percentile of all."""
    is_finite = np.isfinite(values)
    panel.grid(axis="y")
    if not is_finite.any():
        panel.text(0.5, 0.5, "no values", ha="center", transform=panel.transAxes)
        return
    low, high = np.quantile(values[is_finite], [0.01, 0.99])
    bins = int(np.clip(2.0 * np.sqrt(is_finite.sum() / experts), *_BIN_LIMITS))
    edges = np.linspace(low, max(high, low + 1e-3), bins + 1)
    for i in range(experts):
        clipped = np.clip(values[is_finite & (expert == i)], edges[0], edges[-1])
        if clipped.size:
            count, _ = np.histogram(clipped, edges)
            panel.stairs(
                100 * count / clipped.size, edges, color=style.robot_color(i), linewidth=1.5
            )
    panel.set_ylim(bottom=0.0)


def plot_flights(root: Path, manifest: Manifest, table: pa.Table) -> Figure:
    """Plot maps of some episodes, evenly spread over the chosen ones.

    Args:
        root: folder of the dataset.
        manifest: its manifest.
        table: its index.
    """
    rows = table.filter(table["chosen"]) if pc.any(table["chosen"]).as_py() else table
    selected = np.unique(
        np.linspace(0, len(rows) - 1, min(MAX_MAPS, len(rows))).round().astype(int)
    )
    with style.titled_figure(
        10.4,
        3.7 * -(-len(selected) // 3) + 0.95,
        "Some flights from above",
        "line: way taken; dashes: plan; disc: start; star: goal; cross: failure",
    ) as figure:
        panels = series.add_panels(figure, len(selected), 3, sharey=False)
        for panel, index in zip(panels, selected, strict=True):
            row = rows.slice(int(index), 1).to_pylist()[0]
            run = Run(root / manifest.parts[row["part"]].path)
            _plot_map(panel, scene.read_scene(run, row["world"]))
            panel.set_title(
                f"{row['episode']:,}: {row['scene']}, {row['expert']}\n"
                f"{row['difficulty']}, {row['reached']} of {row['robots']} arrived",
                fontsize=9.0,
            )
        handles: list[Line2D | Patch] = [
            Patch(color=style.ROCK(0.75), label="rock; lighter is higher"),
            Line2D([], [], color=style.OBSTACLE_DYNAMIC, linestyle=":", label="moving obstacles"),
        ]
        figure.legend(handles=handles, loc="outside lower left", ncols=2)
    return figure


def _plot_map(panel: Axes, replay: scene.ReplayScene) -> None:
    low, high = replay.bounds_m
    base_map.plot_bounds(panel, replay, base_map.ABOVE)
    base_map.plot_rock(panel, replay.environment.grid, base_map.ABOVE, Normalize(low[2], high[2]))
    for i in np.flatnonzero(np.asarray(replay.environment.obstacles.exists)):
        path_m = replay.obstacle_p_m[:, i]
        panel.plot(
            path_m[:, 0], path_m[:, 1], ":", color=style.OBSTACLE_DYNAMIC, linewidth=1.0, zorder=3
        )
    for robot in replay.robots:
        color = style.robot_color(robot.index)
        path_m = replay.flown_path(robot)
        panel.plot(*robot.plan_m[:, :2].T, "--", color=color, linewidth=0.7, alpha=0.8, zorder=4)
        panel.plot(*path_m[:, :2].T, color=color, linewidth=1.5, zorder=5)
        panel.plot(*robot.goal_m[:2], "*", color=color, ms=10, mec=style.PAPER, mew=0.5, zorder=6)
        panel.plot(*robot.start_m[:2], "o", color=color, ms=5, mec=style.PAPER, mew=0.5, zorder=7)
        if not robot.arrived and np.isfinite(robot.failure_m).all():
            panel.plot(
                *robot.failure_m[:2], "X", color=style.INK, ms=7, mec=style.PAPER, mew=0.7, zorder=9
            )
    panel.tick_params(labelsize=7.5)
