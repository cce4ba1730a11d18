"""Figures of rows."""

from pathlib import Path

import numpy as np

from angler_experiments.learned_planner.evaluate.evaluation_log import EvaluationRow
from angler_mjx.report.plotting import style

_PERCENT = 100.0


def plot_arrivals(rows: list[EvaluationRow], file: Path) -> Path:
    """Plot bars of arrivals with their intervals, planners side by side in each sea."""
    seas = list(dict.fromkeys(row["key"]["sea"] for row in rows))
    names = list(dict.fromkeys(_row_name(row) for row in rows))
    row_colors = _row_colors(rows)
    with style.figure_style():
        figure = style.new_figure(3.4 + 1.9 * len(seas), 3.6)
        axes = figure.add_subplot()
        bar_width = 0.8 / len(names)
        for number, name in enumerate(names):
            planner_rows = [row for row in rows if _row_name(row) == name]
            bar_x = [
                seas.index(row["key"]["sea"]) + (number + 0.5) * bar_width - 0.4
                for row in planner_rows
            ]
            rate, error = _rates_with_interval(planner_rows)
            color, depth = row_colors[name]
            axes.bar(bar_x, rate, 0.9 * bar_width, color=color, alpha=depth, label=name)
            axes.errorbar(bar_x, rate, error, fmt="none", ecolor=style.INK, elinewidth=0.9)
        axes.set_xticks(range(len(seas)), seas)
        axes.set_ylim(0.0, 105.0)
        axes.set_ylabel("robots that arrive, %")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        return style.save_figure(figure, file, palette=128)


def _row_colors(rows: list[EvaluationRow]) -> dict[str, tuple[str, float]]:
    """Return colour of each name by its planner, and its depth by its samples: more are darker."""
    planners = list(dict.fromkeys(row["key"]["planner"] for row in rows))
    counts = sorted({row["key"]["samples"] for row in rows if "samples" in row["key"]})
    step = 0.65 / max(len(counts) - 1, 1)
    row_colors = {}
    for row in rows:
        key = row["key"]
        fewer = len(counts) - 1 - counts.index(key["samples"]) if "samples" in key else 0
        color = style.robot_color(planners.index(key["planner"]))
        row_colors[_row_name(row)] = color, 1.0 - step * fewer
    return row_colors


def _row_name(row: EvaluationRow) -> str:
    key = row["key"]
    return f"{key['planner']}, {key['samples']}" if "samples" in key else str(key["planner"])


def plot_curve(rows: list[EvaluationRow], file: Path) -> Path:
    """Plot arrivals and validation loss against the size of the training set."""
    names = list(dict.fromkeys(row["key"]["planner"] for row in rows))
    with style.figure_style():
        figure = style.new_figure(8.4, 3.4)
        left, right = figure.subplots(1, 2)
        for number, name in enumerate(names):
            planner_rows = [row for row in rows if row["key"]["planner"] == name]
            rate, error = _rates_with_interval(planner_rows)
            size = [row["key"]["learned_from"] for row in planner_rows]
            color = style.robot_color(number)
            left.errorbar(size, rate, error, fmt="o-", capsize=3.0, color=color, label=name)
        first = [row for row in rows if row["key"]["planner"] == names[0]]
        size = [row["key"]["learned_from"] for row in first]
        right.plot(size, [row["loss"] for row in first], "o-", color=style.INK)
        left.set_ylabel("robots that arrive, %")
        right.set_ylabel("loss on worlds held back")
        for axes in (left, right):
            axes.set_xscale("log")
            axes.set_xlabel("worlds learned from")
            axes.grid(visible=True)
        left.legend()
        return style.save_figure(figure, file, palette=128)


def _rates_with_interval(rows: list[EvaluationRow]) -> tuple[np.ndarray, np.ndarray]:
    """Return arrivals [n] in per cent, and the extents of their intervals down and up [2, n]."""
    arrived = [row["arrived"] for row in rows]
    rate, low, high = (
        _PERCENT
        * np.array([(entry["rate"], entry["low"], entry["high"]) for entry in arrived])
        .reshape(-1, 3)
        .T
    )
    return rate, np.maximum([rate - low, high - rate], 0.0)
