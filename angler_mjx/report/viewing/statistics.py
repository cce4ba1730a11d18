"""Figures about all robots of a run: outcomes, min distances, and times."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from angler_mjx.report.plotting import series, style
from angler_mjx.runs.storage.results import OUTCOMES, completion_times, outcome_rates


def robot_kinds(episodes: pa.Table) -> list[tuple[str, str]]:
    """Return vehicle and parameter set of all kinds of robot in a run, sorted."""
    pairs = zip(episodes["vehicle"].to_pylist(), episodes["parameter_set"].to_pylist(), strict=True)
    return sorted(set(pairs))


def rows_of(episodes: pa.Table, kind: tuple[str, str]) -> pa.Table:
    """Return the rows of one kind of robot."""
    return episodes.filter(
        (pc.field("vehicle") == kind[0]) & (pc.field("parameter_set") == kind[1])
    )


def plot_outcomes(episodes: pa.Table, name: str) -> Figure:
    """Plot the fraction of robots by outcome, with 95 % intervals clustered by world, per kind.

    Args:
        episodes: rows of the run.
        name: of the scenario, for the title.
    """
    groups, all_rates = robot_kinds(episodes), outcome_rates(episodes)
    with style.titled_figure(
        9.6,
        5.4 + 0.46 * len(groups),
        f"{name}: {_headline(episodes, all_rates['reached']['rate'])}",
        f"{episodes.num_rows:,} robots in {len(set(episodes['world'].to_pylist())):,} worlds; "
        "lines are 95 % intervals, clustered by world",
    ) as figure:
        top, bottom = figure.subplots(
            2, 1, height_ratios=[len(OUTCOMES) + 0.5, 1.2 + 0.9 * len(groups)]
        )
        _rate_bars(top, all_rates)
        top.set_title("All robots")
        _stacked_kinds(bottom, {kind: outcome_rates(rows_of(episodes, kind)) for kind in groups})
    return figure


def _headline(episodes: pa.Table, reached: float) -> str:
    """Return the result of a run in words: that of its tasks first."""
    completed_s = completion_times(episodes)
    if completed_s is None:
        return f"{100 * reached:.0f} % of robots arrived"
    percent = 100 * np.mean(np.isfinite(completed_s))
    return f"{percent:.0f} % of tasks completed, {100 * reached:.0f} % of robots did their part"


def _rate_bars(axes: Axes, table: Mapping[str, Mapping[str, float]]) -> None:
    for row_index, outcome in enumerate(OUTCOMES):
        row = table[outcome]
        axes.barh(row_index, row["rate"], height=0.66, color=style.OUTCOMES[outcome])
        axes.plot([row["low"], row["high"]], [row_index, row_index], color=style.INK, linewidth=1.3)
        axes.text(
            max(row["high"], row["rate"]) + 0.012,
            row_index,
            f"{100 * row['rate']:.1f} %  ({row['count']:,})",
            va="center",
            fontsize=8.8,
            color=style.INK if row["count"] else style.QUIET,
        )
    series.label_rows(axes, [style.OUTCOME_TEXT[outcome] for outcome in OUTCOMES])
    max_rate = max(row["high"] for row in table.values())
    axes.set_xlim(0.0, min(1.16, max_rate + 0.16))
    axes.xaxis.set_major_formatter(series.percent_formatter())
    axes.set_xlabel("share of robots")
    axes.grid(axis="x")
    axes.spines["left"].set_visible(False)


def _stacked_kinds(
    axes: Axes, tables: Mapping[tuple[str, str], Mapping[str, Mapping[str, float]]]
) -> None:
    """Plot one bar per kind of robot, outcomes stacked; the interval is that of arrival."""
    for row_index, table in enumerate(tables.values()):
        left = 0.0
        for outcome in OUTCOMES:
            rate = table[outcome]["rate"]
            axes.barh(
                row_index,
                rate,
                left=left,
                height=0.62,
                color=style.OUTCOMES[outcome],
                edgecolor=style.PAPER,
                linewidth=0.6,
            )
            if rate > 0.06:
                axes.text(
                    left + 0.008,
                    row_index,
                    f"{100 * rate:.0f} %",
                    va="center",
                    color=style.PAPER,
                    fontsize=8.5,
                    fontweight="bold",
                )
            left += rate
        reached = table["reached"]
        below = row_index + 0.39  # beside the bar, where it crosses no number
        axes.plot([reached["low"], reached["high"]], [below, below], color=style.INK, linewidth=1.6)
    labels = [
        f"{vehicle}\n{parameter_set} ({round(sum(row['count'] for row in table.values())):,})"
        for (vehicle, parameter_set), table in tables.items()
    ]
    series.label_rows(axes, labels)
    axes.set_xlim(0.0, 1.0)
    axes.xaxis.set_major_formatter(series.percent_formatter())
    axes.set_title("By vehicle and parameter set")
    axes.set_xlabel("share of robots of the kind, colours as above; line: interval of arrival")
    axes.spines["left"].set_visible(False)


def plot_distances(episodes: pa.Table, name: str) -> Figure:
    """Plot the min distances of robots to rock, floor and obstacles, and to each other.

    Args:
        episodes: rows of the run.
        name: of the scenario, for the title.
    """
    names = [
        ("min_clearance_m", "least distance of the hull to rock, floor and obstacles, m"),
        ("min_separation_m", "least distance to another robot's hull, m"),
    ]
    shown = [(column, label) for column, label in names if _finite_values(episodes, column).size]
    arrived = _arrived_mask(episodes)
    with style.titled_figure(
        5.2 * max(len(shown), 1),
        4.6,
        f"{name}: {_describe_clearance(episodes)}",
        "least distances of whole episodes; 0 is touch; the last bar holds all beyond",
    ) as figure:
        for axes, (column, label) in zip(
            figure.subplots(1, max(len(shown), 1), squeeze=False)[0], shown, strict=False
        ):
            values = _read_column(episodes, column)
            is_finite = np.isfinite(values)
            _touch_histogram(axes, values[is_finite], arrived[is_finite], label)
    return figure


def _describe_clearance(episodes: pa.Table) -> str:
    """Return the median clearance of the robots that arrived, in words."""
    clearance = _read_column(episodes, "min_clearance_m")[_arrived_mask(episodes)]
    clearance = clearance[np.isfinite(clearance)]
    if clearance.size == 0:
        return "no robot arrived"
    return f"half of the arrived robots came within {np.median(clearance):.2f} m of something"


def _touch_histogram(axes: Axes, values: np.ndarray, arrived: np.ndarray, label: str) -> None:
    """Plot a stacked histogram of a min distance, arrived and failed, up to the 98th percentile."""
    high = max(float(np.quantile(values, 0.98)), 0.1)
    bins = np.linspace(0.0, high, 31)
    inside = np.clip(values, 0.0, high)
    axes.hist(
        [inside[arrived], inside[~arrived]],
        bins=bins.tolist(),
        stacked=True,
        color=[style.OUTCOMES["reached"], style.OUTCOMES["collision_robot"]],
        label=["arrived", "failed"],
        edgecolor=style.PAPER,
        linewidth=0.4,
    )
    axes.set(xlabel=label, ylabel="robots", xlim=(0.0, high))
    axes.grid(axis="y")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    # Above the panel: inside, it would cover bars.
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)


def plot_times(episodes: pa.Table, name: str, horizon_s: float) -> Figure:
    """Plot the fraction of robots that had arrived by a time, per vehicle and parameter set.

    Robots that never arrive count in the fraction, so a curve ends at the rate of arrival. For a
    run with a task, the first curve is the fraction of worlds that had completed it.

    Args:
        episodes: rows of the run.
        name: of the scenario, for the title.
        horizon_s: end of the run, s.
    """
    completed_s, groups = completion_times(episodes), robot_kinds(episodes)
    never, unit = "none arrived", "robots at their goal"
    if completed_s is not None:
        never, unit = "none did its part", "worlds with the task completed, robots done"
    with style.titled_figure(
        9.6,
        4.6 + 0.11 * len(groups),
        f"{name}: {_describe_time(episodes, completed_s)}",
        "a curve levels off at the share of its robots that ever arrive"
        if completed_s is None
        else "a curve levels off at the share of worlds that complete the task, or of robots "
        "that do their part",
    ) as figure:
        axes = figure.subplots()
        shown = _finite_values(episodes, "time_to_goal_s")
        if completed_s is not None:
            done_s = completed_s[np.isfinite(completed_s)]
            total = len(completed_s)
            _plot_curve(axes, done_s, total, horizon_s, "task completed", "never", color=style.INK)
            shown = np.r_[shown, done_s]
        for i, kind in enumerate(groups):
            rows = rows_of(episodes, kind)
            linestyles: tuple[Literal["-", "--", ":"], ...] = ("-", "--", ":")
            _plot_curve(
                axes,
                _finite_values(rows, "time_to_goal_s"),
                rows.num_rows,
                horizon_s,
                f"{kind[0]}, {kind[1]}",
                never,
                color=style.robot_color(i),
                linestyle=linestyles[i // len(style.ROBOTS) % 3],
            )
        axes.set_xlim(*_time_window(shown, horizon_s))
        axes.set_ylim(0.0, 1.02)
        axes.yaxis.set_major_formatter(series.percent_formatter())
        axes.set_xlabel("time since the start, s")
        axes.set_ylabel(unit)
        axes.grid()
        figure.legend(loc="outside lower left", ncols=2, handlelength=2.4)
    return figure


def _describe_time(episodes: pa.Table, completed_s: np.ndarray | None) -> str:
    """Return the median time of a run's objective, in words."""
    if completed_s is None:
        times_s = _finite_values(episodes, "time_to_goal_s")
        none_text, subject = "no robot arrived", "those that arrive need"
    else:
        times_s = completed_s[np.isfinite(completed_s)]
        none_text, subject = "no task was completed", "the tasks that are completed take"
    return f"half of {subject} at most {np.median(times_s):.0f} s" if times_s.size else none_text


def _plot_curve(
    axes: Axes,
    times_s: np.ndarray,
    total: int,
    horizon_s: float,
    name: str,
    never: str,
    *,
    color: str,
    linestyle: Literal["-", "--", ":"] = "-",
) -> None:
    """Plot the fraction of ``total`` that was done by each time, with its median."""
    ordered = np.sort(times_s)
    fraction = np.arange(1, ordered.size + 1) / max(total, 1)
    median = f"median {np.median(ordered):.0f} s" if ordered.size else never
    axes.step(
        np.r_[0.0, ordered, horizon_s],
        np.r_[0.0, fraction, fraction[-1] if ordered.size else 0.0],
        where="post",
        linewidth=2.0,
        label=f"{name}: {median}",
        color=color,
        linestyle=linestyle,
    )


def _time_window(arrival: np.ndarray, horizon_s: float) -> tuple[float, float]:
    """Return the time window in which robots arrive, with some margin; all of it if none does."""
    if arrival.size == 0:
        return 0.0, horizon_s
    first, last = 0.9 * float(arrival.min()), 1.1 * float(arrival.max())
    return 10.0 * np.floor(first / 10.0), min(horizon_s, 10.0 * np.ceil(last / 10.0))


def _read_column(episodes: pa.Table, name: str) -> np.ndarray:
    values: np.ndarray = episodes[name].to_numpy()
    return values


def _finite_values(episodes: pa.Table, name: str) -> np.ndarray:
    values = _read_column(episodes, name)
    finite: np.ndarray = values[np.isfinite(values)]
    return finite


def _arrived_mask(episodes: pa.Table) -> np.ndarray:
    return np.array([outcome == "reached" for outcome in episodes["outcome"].to_pylist()])
