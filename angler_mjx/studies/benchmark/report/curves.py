"""Figures of rates and costs: success by team and density, profiles, planning time."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from angler_mjx.report.viewing import style
from angler_mjx.studies.benchmark.report import look
from angler_mjx.studies.benchmark.report.profiles import Profiles, profiles
from angler_mjx.studies.benchmark.report.rates import FEW, ReportRate, by, density_bins
from angler_mjx.studies.benchmark.report.reading import Results

_COST_TEXT = {
    "planning_s": "planning time",
    "makespan_s": "makespan flown",
    "energy_j": "energy flown",
    "flowtime_s": "flowtime flown",
}
_WORDS = {"success": "success", "planned": "planned (nothing flown yet)"}
_RATIOS = (1, 1.02, 1.05, 1.1, 1.2, 1.5, 2, 3, 5, 10, 20, 50, 100, 1000, 10000)


def success_by_team(results: Results) -> Figure:
    """Success against team size, a panel a scene, a line a planner."""
    runs, scenes = results.runs, results.scenes
    teams = sorted(set(runs["robots"].tolist()))
    groups = (runs["scene"], runs["planner"], runs["robots"])
    found = by(groups, runs[results.judged], runs.counted)
    across = min(len(scenes), 3)
    down = -(-len(scenes) // across)
    with look.styled():
        figure = _figure(results, max(4.3 * across, 7.5), 3.3 * down)
        style.headline(
            figure,
            f"{results.about.get('name', '')}: {_WORDS[results.judged]} by team",
            _said(results),
        )
        for axes, scene in zip(look.panels(figure, len(scenes), across), scenes, strict=True):
            axes.set(title=scene, xlabel="robots")
            _rates(
                axes,
                [str(team) for team in teams],
                [
                    {i: found.get((scene, name, team)) for i, team in enumerate(teams)}
                    for name in results.planners
                ],
            )
        look.legend(figure, results.planners)
    return figure


def success_by_density(results: Results) -> Figure:
    """Success against the density of rock, over all scenes."""
    runs = results.runs
    bins = density_bins(runs, results.problem)
    found = by((runs["planner"], bins.of), runs[results.judged], runs.counted)
    with look.styled():
        figure = _figure(results, 9.6, 4.2)
        style.headline(
            figure,
            f"{results.about.get('name', '')}: {_WORDS[results.judged]} by density",
            _said(results),
        )
        axes = figure.subplots()
        axes.set_xlabel("cells that are rock (mean of each bin; bins hold about as many problems)")
        lines = [
            {i: found.get((name, i)) for i in range(len(bins.centres))} for name in results.planners
        ]
        _rates(axes, [f"{100 * x:.1f} %" for x in bins.centres], lines)
        look.legend(figure, results.planners)
    return figure


def profiles_of_time(results: Results) -> Figure | None:
    """Performance profile of planning time."""
    return _profiles(results, ("planning_s",))


def profiles_of_cost(results: Results) -> Figure | None:
    """Performance profiles of what was flown."""
    return _profiles(results, ("makespan_s", "energy_j", "flowtime_s"))


def planning_time(results: Results) -> Figure | None:
    """Planning time over team size: median, quartiles, and the 5th and 95th percentile."""
    runs = results.runs
    known = np.isfinite(runs["planning_s"]) & (runs["planning_s"] > 0) & runs.asked
    if not known.any():
        return None
    teams = sorted(set(runs["robots"].tolist()))
    shown = [i for i, name in enumerate(results.planners) if known[runs["planner"] == name].any()]
    with look.styled():
        figure = _figure(results, max(9.6, 2.2 * len(teams)), 4.2)
        style.headline(
            figure,
            f"{results.about.get('name', '')}: planning time",
            "of all runs that were asked, failures too; dot: median, thick: quartiles, "
            "thin: 5th to 95th percentile" + _deadline(results),
        )
        axes = figure.subplots()
        for slot, place in enumerate(shown):
            of = known & (runs["planner"] == results.planners[place])
            shift = _shift(slot, len(shown))
            for i, team in enumerate(teams):
                seconds = runs["planning_s"][of & (runs["robots"] == team)]
                if len(seconds):
                    _box(axes, i + shift, seconds, place)
        axes.set_yscale("log")
        if deadline := results.about.get("deadline_s"):
            axes.axhline(float(deadline), color=style.QUIET, linewidth=0.9, linestyle=":")
        axes.set_xticks(range(len(teams)), [str(team) for team in teams])
        axes.set(xlabel="robots", ylabel="planning time, s")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axes.grid(axis="y")
        look.legend(figure, results.planners)
    return figure


def _figure(results: Results, width_in: float, height_in: float) -> Figure:
    room = 0.95 + look.legend_in(results.planners)
    return style.new_figure(width_in, height_in + room, headline_in=0.65)


def _said(results: Results) -> str:
    given_up = int(np.sum(results.runs.counted & ~results.runs.asked))
    total = int(np.sum(results.runs.counted))
    less = f"; {given_up:,} of {total:,} runs count as failures, as their planner was given up"
    return f"Wilson's 95 %; hollow: under {FEW} runs{less if given_up else ''}"


def _deadline(results: Results) -> str:
    return "; dotted: deadline" if results.about.get("deadline_s") else ""


def _shift(place: int, count: int) -> float:
    return 0.66 * (place - (count - 1) / 2) / max(count, 3)


def _rates(
    axes: Axes, ticks: Sequence[str], lines: Sequence[Mapping[int, ReportRate | None]]
) -> None:
    for place, points in enumerate(lines):
        shift, drawn = _shift(place, len(lines)), look.line(place)
        held = {i: rate for i, rate in points.items() if rate is not None and rate.asked}
        x = np.array(list(held), float) + shift
        axes.plot(x, [r.share for r in held.values()], **drawn, linewidth=1.4, alpha=0.75)
        for at, rate in zip(x, held.values(), strict=True):
            color = drawn["color"]
            axes.plot([at, at], [rate.low, rate.high], color=color, linewidth=1.0, alpha=0.5)
            hollow = rate.few
            axes.plot(
                at,
                rate.share,
                look.mark(place),
                color=color,
                markersize=4.2,
                markerfacecolor=style.PAPER if hollow else color,
                zorder=3,
            )
    axes.set_xticks(range(len(ticks)), ticks)
    axes.set_xlim(-0.5, len(ticks) - 0.5)
    look.shares(axes)


def _box(axes: Axes, at: float, seconds: np.ndarray, place: int) -> None:
    low, first, half, third, high = np.quantile(seconds, [0.05, 0.25, 0.5, 0.75, 0.95])
    color = style.robot_color(place)
    axes.plot([at, at], [low, high], color=color, linewidth=0.9)
    axes.plot([at, at], [first, third], color=color, linewidth=4.0, alpha=0.45)
    axes.plot(at, half, look.mark(place), color=color, markersize=3.6)


def _profiles(results: Results, costs: Sequence[str]) -> Figure | None:
    found = {c: profiles(results.runs, results.problem, results.planners, c) for c in costs}
    found = {cost: one for cost, one in found.items() if one.problems}
    if not found:
        return None
    with look.styled():
        figure = _figure(results, max(4.5 * len(found), 9.0), 3.6)
        style.headline(
            figure,
            f"{results.about.get('name', '')}: performance profiles",
            "share of common problems solved within a ratio of the best; failures are infinite",
        )
        for axes, (cost, one) in zip(
            look.panels(figure, len(found), len(found)), found.items(), strict=True
        ):
            axes.set_title(f"{_COST_TEXT[cost].capitalize()}, {one.problems:,} problems")
            _profile(axes, one, results.planners)
        look.legend(figure, results.planners)
    return figure


def _profile(axes: Axes, found: Profiles, planners: Sequence[str]) -> None:
    ends = [float(np.quantile(r, 0.99)) for r in found.ratios.values() if len(r)]
    most = min(max([1.02, *ends]), 1e4)
    for name, ratios in found.ratios.items():
        share = np.arange(1, len(ratios) + 1) / found.problems
        end = share[-1] if len(share) else 0.0
        x, y = np.r_[1.0, ratios, max(most, found.largest)], np.r_[0.0, share, end]
        axes.step(x, y, where="post", **look.line(planners.index(name)), linewidth=1.6)
    axes.set_xscale("log")
    axes.set_xlim(1.0, most)
    ticks: list[float] = []
    for tick in _RATIOS:
        if tick <= most and (not ticks or np.log(tick / ticks[-1]) > 0.09 * np.log(most)):
            ticks.append(tick)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", which="minor", length=0)
    axes.set_xlabel("cost over that of the best planner")
    if found.left_out:
        text = f"nothing known of {', '.join(found.left_out)}"
        axes.text(0.98, 0.04, text, transform=axes.transAxes, ha="right", color=style.QUIET)
    look.shares(axes)
