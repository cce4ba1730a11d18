"""Figures of a study: success and time by size of the team, a colour for each condition."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

from angler_mjx.report.plotting import series, style
from angler_mjx.studies.fleet_size.report import FleetSizeResults, format_level

SUCCESS, TIME = "success.png", "time.png"


def plot_figures(results: FleetSizeResults, folder: Path) -> list[Path]:
    """Both figures of a study, into a folder."""
    return [
        style.save_figure(plot_success(results), folder / SUCCESS, palette=128),
        style.save_figure(plot_time(results), folder / TIME, palette=128),
    ]


def plot_success(results: FleetSizeResults) -> Figure:
    """Share of worlds that met the deadline, and the answers below."""
    conditions = results["conditions"]
    bars_in = 0.5 + 0.24 * len(conditions)
    with style.titled_figure(
        8.0,
        4.4 + bars_in,
        f"{results['name']}: how many robots does it take?",
        f"done within {results['deadline_s']:g} s; {results['worlds']:,} worlds; bars are "
        f"{format_level(results, 'share')} intervals of a share, lines below "
        f"{format_level(results, 'answer')} intervals of the answer",
        headline_in=0.75,
    ) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3.6, bars_in])
        _plot_rates(above, results)
        _plot_answers(below, results)
        _format_size_axis(below, results)
        below.set_xlabel("robots")
    return figure


def _plot_rates(axes: Axes, results: FleetSizeResults) -> None:
    """Share of worlds of each size and condition that met the deadline."""
    p, conditions = results["probability"], results["conditions"]
    axes.axhline(p, color=style.INK, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.annotate(
        f"{100 * p:g} %",
        (1.0, p),
        xycoords=("axes fraction", "data"),
        xytext=(4, 0),
        textcoords="offset points",
        va="center",
        color=style.INK,
    )
    for i, condition in enumerate(conditions):
        rows, color = condition["sizes"], style.robot_color(i)
        if not rows:
            continue
        x = _offset_sizes([row["size"] for row in rows], i, len(conditions))
        y = np.array([row["rate"] for row in rows])
        ends = np.array([[row["rate"] - row["low"], row["high"] - row["rate"]] for row in rows]).T
        axes.plot(x, y, color=color, linewidth=1.3, alpha=0.7)
        axes.errorbar(
            x,
            y,
            np.maximum(ends, 0.0),
            fmt="o",
            color=color,
            markersize=3.8,
            capsize=2.0,
            linewidth=1.1,
            label=condition["name"],
        )
    axes.set_ylim(-0.03, 1.03)
    axes.set_ylabel("worlds that met the deadline")
    axes.yaxis.set_major_formatter(series.percent_formatter())
    axes.grid(axis="y")
    axes.legend(loc="lower right" if len(conditions) < 6 else "best")


def _plot_answers(axes: Axes, results: FleetSizeResults) -> None:
    """The interval of each condition's answer."""
    conditions, top = results["conditions"], results["sizes"][-1]
    for i, condition in enumerate(conditions):
        answer, color = condition["answer"], style.robot_color(i)
        low, high = answer["low"], answer["high"]
        if low is not None:
            ends = [low, top if high is None else high]
            axes.plot(ends, [i, i], color=color, linewidth=4.0, solid_capstyle="round", alpha=0.45)
            if answer["estimate"] is not None:
                axes.plot([answer["estimate"]], [i], "o", color=color, markersize=5.5)
        if low is None or high is None:
            axes.plot([top], [i], ">", color=color, markersize=6.0)
        axes.annotate(
            answer["text"],
            (top if low is None or high is None else high, i),
            xytext=(8, 0) if (low or top) <= top / 4 else (-8, 8),
            textcoords="offset points",
            ha="left" if (low or top) <= top / 4 else "right",
            va="center",
            fontsize=7.5,
            color=style.QUIET,
        )
    axes.set_yticks(range(len(conditions)), [condition["name"] for condition in conditions])
    axes.set_ylim(len(conditions) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")


def plot_time(results: FleetSizeResults) -> Figure:
    """Median and 90 % quantile of the time that the task takes."""
    with style.titled_figure(
        8.0,
        4.4,
        f"{results['name']}: how long does it take?",
        f"median over all worlds, with its {format_level(results, 'quantile')} interval; dots: "
        "nine worlds in ten are done by then",
        headline_in=0.75,
    ) as figure:
        axes = figure.subplots()
        _plot_times(axes, results)
        _format_size_axis(axes, results)
    return figure


def _plot_times(axes: Axes, results: FleetSizeResults) -> None:
    conditions = results["conditions"]
    axes.axhline(results["deadline_s"], color=style.INK, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.annotate(
        "deadline",
        (1.0, results["deadline_s"]),
        xycoords=("axes fraction", "data"),
        xytext=(-2, 3),
        textcoords="offset points",
        ha="right",
        va="bottom",
        color=style.INK,
    )
    horizon_s = max(
        (row["horizon_s"] for condition in conditions for row in condition["sizes"]), default=1.0
    )
    for i, condition in enumerate(conditions):
        color = style.robot_color(i)
        rows = [row for row in condition["sizes"] if row["median_s"]["value"] is not None]
        x = _offset_sizes([row["size"] for row in rows], i, len(conditions))
        y = np.array([row["median_s"]["value"] for row in rows])
        low = np.array([row["median_s"]["low"] for row in rows])
        high = np.array([row["median_s"]["high"] or horizon_s for row in rows])
        axes.errorbar(
            x,
            y,
            [y - low, high - y],
            fmt="-o",
            color=color,
            markersize=3.8,
            capsize=2.0,
            linewidth=1.2,
            label=condition["name"],
        )
        late = [(a, row["p90_s"]["value"]) for a, row in zip(x, rows, strict=True)]
        late = [pair for pair in late if pair[1] is not None]
        axes.plot(*np.array(late).reshape(-1, 2).T, ":", marker=".", color=color, linewidth=1.0)
    axes.set_ylim(0.0, horizon_s * 1.02)
    axes.set_ylabel("time until the task is done, s")
    axes.set_xlabel("robots")
    axes.grid(axis="y")
    axes.legend(loc="best")


def _format_size_axis(axes: Axes, results: FleetSizeResults) -> None:
    """Sizes along x, by their logarithm."""
    sizes = results["sizes"]
    flown = {row["size"] for condition in results["conditions"] for row in condition["sizes"]}
    shown = sorted({size for size in flown if size & (size - 1) == 0} | {sizes[0], sizes[-1]})
    axes.set_xscale("log", base=2)
    axes.set_xlim(sizes[0] / 1.25, sizes[-1] * 1.25)
    axes.xaxis.set_major_locator(FixedLocator(shown))
    axes.xaxis.set_minor_locator(FixedLocator(sorted(flown)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())


def _offset_sizes(sizes: Sequence[int], i: int, count: int) -> np.ndarray:
    """Sizes moved a little, so that bars of conditions stand side by side."""
    moved: np.ndarray = np.array(sizes, float) * 1.02 ** (i - 0.5 * (count - 1))
    return moved
