"""Figures of rates and costs: success by team and density, profiles, planning time."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from angler_mjx.report.plotting import series, style
from angler_mjx.studies.benchmark.report.profiles import PerformanceProfiles, compute_profiles
from angler_mjx.studies.benchmark.report.rates import (
    FEW,
    ReportRate,
    build_density_bins,
    compute_rates,
)
from angler_mjx.studies.benchmark.report.reading import Results

_COST_TEXT = {
    "planning_s": "planning time",
    "makespan_s": "makespan flown",
    "energy_j": "energy flown",
    "flowtime_s": "flowtime flown",
}
_RATE_LABELS = {"success": "success", "planned": "planned (nothing flown yet)"}
_RATIO_TICKS = (1, 1.02, 1.05, 1.1, 1.2, 1.5, 2, 3, 5, 10, 20, 50, 100, 1000, 10000)


def success_by_team(results: Results) -> Figure:
    """Plot success against team size, a panel a scene, a line a planner."""
    runs, scenes = results.runs, results.scenes
    teams = sorted(set(runs["robots"].tolist()))
    groups = (runs["scene"], runs["planner"], runs["robots"])
    rates = compute_rates(groups, runs[results.judged], runs.counted)
    n_columns = min(len(scenes), 3)
    n_rows = -(-len(scenes) // n_columns)
    with _titled_figure(
        results,
        max(4.3 * n_columns, 7.5),
        3.3 * n_rows,
        f"{_RATE_LABELS[results.judged]} by team",
        _describe_rates(results),
    ) as figure:
        for axes, scene in zip(
            series.add_panels(figure, len(scenes), n_columns), scenes, strict=True
        ):
            axes.set(title=scene, xlabel="robots")
            _plot_rates(
                axes,
                [str(team) for team in teams],
                [
                    {i: rates.get((scene, name, team)) for i, team in enumerate(teams)}
                    for name in results.planners
                ],
            )
        series.add_legend(figure, results.planners)
    return figure


def success_by_density(results: Results) -> Figure:
    """Plot success against the density of rock, over all scenes."""
    runs = results.runs
    bins = build_density_bins(runs, results.problem)
    rates = compute_rates((runs["planner"], bins.of), runs[results.judged], runs.counted)
    title = f"{_RATE_LABELS[results.judged]} by density"
    with _titled_figure(results, 9.6, 4.2, title, _describe_rates(results)) as figure:
        axes = figure.subplots()
        axes.set_xlabel("cells that are rock (mean of each bin; bins hold about as many problems)")
        lines = [
            {i: rates.get((name, i)) for i in range(len(bins.centres))} for name in results.planners
        ]
        _plot_rates(axes, [f"{100 * x:.1f} %" for x in bins.centres], lines)
        series.add_legend(figure, results.planners)
    return figure


def profiles_of_time(results: Results) -> Figure | None:
    """Plot the performance profile of planning time."""
    return _plot_profiles(results, ("planning_s",))


def profiles_of_cost(results: Results) -> Figure | None:
    """Plot the performance profiles of flown costs."""
    return _plot_profiles(results, ("makespan_s", "energy_j", "flowtime_s"))


def planning_time(results: Results) -> Figure | None:
    """Plot planning time over team size: median, quartiles, and the 5th and 95th percentile."""
    runs = results.runs
    valid = np.isfinite(runs["planning_s"]) & (runs["planning_s"] > 0) & runs.requested
    if not valid.any():
        return None
    teams = sorted(set(runs["robots"].tolist()))
    shown = [i for i, name in enumerate(results.planners) if valid[runs["planner"] == name].any()]
    with _titled_figure(
        results,
        max(9.6, 2.2 * len(teams)),
        4.2,
        "planning time",
        "of all runs that were asked, failures too; dot: median, thick: quartiles, "
        "thin: 5th to 95th percentile" + _deadline_note(results),
    ) as figure:
        axes = figure.subplots()
        for slot, planner_index in enumerate(shown):
            rows = valid & (runs["planner"] == results.planners[planner_index])
            shift = _bar_offset(slot, len(shown))
            for i, team in enumerate(teams):
                seconds = runs["planning_s"][rows & (runs["robots"] == team)]
                if len(seconds):
                    _plot_box(axes, i + shift, seconds, planner_index)
        axes.set_yscale("log")
        if deadline := results.about.get("deadline_s"):
            axes.axhline(float(deadline), color=style.QUIET, linewidth=0.9, linestyle=":")
        axes.set_xticks(range(len(teams)), [str(team) for team in teams])
        axes.set(xlabel="robots", ylabel="planning time, s")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axes.grid(axis="y")
        series.add_legend(figure, results.planners)
    return figure


def _titled_figure(
    results: Results, width_in: float, height_in: float, title: str, subtitle: str
) -> AbstractContextManager[Figure]:
    """Return a context that gives a figure with a headline and room for the legend of planners."""
    return style.titled_figure(
        width_in,
        height_in + 0.95 + series.legend_height_in(results.planners),
        f"{results.about.get('name', '')}: {title}",
        subtitle,
        parse_math=False,
    )


def _describe_rates(results: Results) -> str:
    n_closed = int(np.sum(results.runs.counted & ~results.runs.requested))
    total = int(np.sum(results.runs.counted))
    less = f"; {n_closed:,} of {total:,} runs count as failures, as their planner was given up"
    return f"Wilson's 95 %; hollow: under {FEW} runs{less if n_closed else ''}"


def _deadline_note(results: Results) -> str:
    return "; dotted: deadline" if results.about.get("deadline_s") else ""


def _bar_offset(index: int, count: int) -> float:
    return 0.66 * (index - (count - 1) / 2) / max(count, 3)


def _plot_rates(
    axes: Axes, ticks: Sequence[str], lines: Sequence[Mapping[int, ReportRate | None]]
) -> None:
    for index, points in enumerate(lines):
        shift, line_style = _bar_offset(index, len(lines)), series.line_style(index)
        requested_rates = {
            i: rate for i, rate in points.items() if rate is not None and rate.requested
        }
        x = np.array(list(requested_rates), float) + shift
        axes.plot(
            x,
            [r.fraction for r in requested_rates.values()],
            **line_style,
            linewidth=1.4,
            alpha=0.75,
        )
        for at, rate in zip(x, requested_rates.values(), strict=True):
            color = line_style["color"]
            axes.plot([at, at], [rate.low, rate.high], color=color, linewidth=1.0, alpha=0.5)
            hollow = rate.few
            axes.plot(
                at,
                rate.fraction,
                series.marker_style(index),
                color=color,
                markersize=4.2,
                markerfacecolor=style.PAPER if hollow else color,
                zorder=3,
            )
    axes.set_xticks(range(len(ticks)), ticks)
    axes.set_xlim(-0.5, len(ticks) - 0.5)
    series.format_fraction_axis(axes)


def _plot_box(axes: Axes, at: float, seconds: np.ndarray, planner_index: int) -> None:
    low, first, half, third, high = np.quantile(seconds, [0.05, 0.25, 0.5, 0.75, 0.95])
    color = style.robot_color(planner_index)
    axes.plot([at, at], [low, high], color=color, linewidth=0.9)
    axes.plot([at, at], [first, third], color=color, linewidth=4.0, alpha=0.45)
    axes.plot(at, half, series.marker_style(planner_index), color=color, markersize=3.6)


def _plot_profiles(results: Results, costs: Sequence[str]) -> Figure | None:
    all_profiles = {cost: compute_profiles(results, results.run_table, cost) for cost in costs}
    by_cost = {cost: found for cost, found in all_profiles.items() if found.problems}
    if not by_cost:
        return None
    with _titled_figure(
        results,
        max(4.5 * len(by_cost), 9.0),
        3.6,
        "performance profiles",
        "share of common problems solved within a ratio of the best; failures are infinite",
    ) as figure:
        for axes, (cost, cost_profiles) in zip(
            series.add_panels(figure, len(by_cost), len(by_cost)), by_cost.items(), strict=True
        ):
            axes.set_title(f"{_COST_TEXT[cost].capitalize()}, {cost_profiles.problems:,} problems")
            _plot_profile(axes, cost_profiles, results.planners)
        series.add_legend(figure, results.planners)
    return figure


def _plot_profile(axes: Axes, cost_profiles: PerformanceProfiles, planners: Sequence[str]) -> None:
    ends = [float(np.quantile(r, 0.99)) for r in cost_profiles.ratios.values() if len(r)]
    max_ratio = min(max([1.02, *ends]), 1e4)
    for name, ratios in cost_profiles.ratios.items():
        fraction = np.arange(1, len(ratios) + 1) / cost_profiles.problems
        end = fraction[-1] if len(fraction) else 0.0
        x, y = np.r_[1.0, ratios, max(max_ratio, cost_profiles.largest)], np.r_[0.0, fraction, end]
        axes.step(x, y, where="post", **series.line_style(planners.index(name)), linewidth=1.6)
    axes.set_xscale("log")
    axes.set_xlim(1.0, max_ratio)
    ticks: list[float] = []
    for tick in _RATIO_TICKS:
        if tick <= max_ratio and (not ticks or np.log(tick / ticks[-1]) > 0.09 * np.log(max_ratio)):
            ticks.append(tick)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", which="minor", length=0)
    axes.set_xlabel("cost over that of the best planner")
    if cost_profiles.left_out:
        text = f"nothing known of {', '.join(cost_profiles.left_out)}"
        axes.text(0.98, 0.04, text, transform=axes.transAxes, ha="right", color=style.QUIET)
    series.format_fraction_axis(axes)
