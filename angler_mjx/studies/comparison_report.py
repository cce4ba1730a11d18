"""What two runs against each other came to, as text and as a figure."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.errors import format_value
from angler_mjx.report.plotting import style
from angler_mjx.runs.storage import planning_summary
from angler_mjx.runs.storage.planning_summary import PlanningSummary
from angler_mjx.studies.rows import RateRow, RunComparison, ShiftRow

MAX_LISTED = 10
"""Worlds, and pairs of outcomes, that are listed."""

RATES = {
    "tasks": "tasks completed",
    "robots": "robots that arrived",
    "teams": "whole teams",
}
"""Words of each rate; of runs without a task there are no tasks."""

COSTS = {
    "time_to_goal_s": ("time to goal", "s", 1.0),
    "energy_j": ("energy", "kJ", 1e-3),
    "path_length_m": ("way", "m", 1.0),
    "min_clearance_m": ("least clearance", "m", 1.0),
}
"""Words, unit and scale of each cost."""
COMPLETION = ("time to completion of the task", "s", 1.0)
"""The same of the time at which a world completed its task."""

TASK_RATES = {
    "tasks": "tasks completed",
    "robots": "robots that did their part",
    "teams": "teams that all did their part",
}
"""Words of each rate in runs with a task."""
TASK_COSTS = {**COSTS, "time_to_goal_s": ("time until a robot did its part", "s", 1.0)}
"""Words, unit and scale of each cost of robots in runs with a task."""


def format_comparison(comparison: RunComparison) -> str:
    """For people.

    Args:
        comparison: by `angler_mjx.studies.compare.compare_runs`.
    """
    lines = [f"A: {comparison['first']}", f"B: {comparison['second']}", ""]
    lines += [
        f"  {row['key']}: {format_value(row['first'])} -> {format_value(row['second'])}"
        for row in comparison["config"]
    ]
    if not comparison["config"]:
        lines.append("  the scenarios are the same")
    if not comparison["same_problems"]:
        lines.append(
            "  problems are made of some of these: worlds may be drawn otherwise, pairs share seed "
            "and index"
        )
    lines += [
        "",
        *_format_rates(comparison),
        *_format_costs(comparison),
        *_format_planning(comparison["planning"]),
    ]
    lines += ["", "robots by outcome, A -> B:"]
    lines += [
        f"  {row['robots']:>7,}  {row['first']} -> {row['second']}"
        for row in comparison["outcomes"][:MAX_LISTED]
    ]
    return "\n".join([*lines, "", *_format_worlds(comparison)])


def _format_rates(comparison: RunComparison) -> list[str]:
    of_requested = (
        "" if comparison["worlds"] == comparison["asked"] else f" of {comparison['asked']:,}"
    )
    lines = [
        f"{comparison['worlds']:,} worlds{of_requested}; changes are B minus A, with 95 % "
        "intervals by world:"
    ]
    for label, rate in _select_rates(comparison):
        total = rate["both"] + rate["only_first"] + rate["only_second"] + rate["neither"]
        was, now = rate["both"] + rate["only_first"], rate["both"] + rate["only_second"]
        lines.append(
            f"  {label}: {100 * was / total:.1f} % -> {100 * now / total:.1f} %, change "
            f"{_format_points(rate)} points, p = {rate['p']:.2g}; in both {rate['both']:,}, only "
            "in A "
            f"{rate['only_first']:,}, only in B {rate['only_second']:,}, in neither "
            f"{rate['neither']:,}"
        )
    return lines


def _format_planning(planning: Mapping[str, PlanningSummary | None]) -> list[str]:
    """Fractions of robots with a plan in both runs, and why the others have none."""
    both = planning["first"], planning["second"]
    lines = [f"  robots with a plan: {' -> '.join(map(planning_summary.format_percent, both))}"]
    for name, run_planning in zip("AB", both, strict=True):
        lines += [f"    {name}: {line}" for line in planning_summary.reason_lines(run_planning)]
    return lines


def _select_rates(comparison: RunComparison) -> list[tuple[str, RateRow]]:
    """Return words and pairs of all rates in the order in which they are shown."""
    labels = TASK_RATES if _has_tasks(comparison) else RATES
    rates = {
        "tasks": comparison["tasks"],
        "robots": comparison["robots"],
        "teams": comparison["teams"],
    }
    return [(word, rate) for name, word in labels.items() if (rate := rates[name]) is not None]


def _format_points(rate: RateRow) -> str:
    numbers = rate["difference"], rate["low"], rate["high"]
    change, low, high = ("?" if x is None else f"{100 * x:+.1f}" for x in numbers)
    return f"{change} ({low} to {high})"


def _has_tasks(comparison: RunComparison) -> bool:
    """Whether both runs are of scenarios with a task."""
    return comparison["tasks"] is not None


type Cost = tuple[str, str, float, ShiftRow, str]
"""Words, unit, scale, values, and what has one."""


def _select_costs(comparison: RunComparison) -> list[Cost]:
    """Return all costs in the order in which they are shown: completion of the task first."""
    has_tasks, costs = _has_tasks(comparison), comparison["costs"]
    labels = TASK_COSTS if has_tasks else COSTS
    task_s = comparison["task_s"]
    rows: list[Cost] = [] if task_s is None else [(*COMPLETION, task_s, "world")]
    return rows + [(*labels[name], costs[name], "robot") for name in labels if name in costs]


def _format_costs(comparison: RunComparison) -> list[str]:
    lines = []
    for word, unit, scale, shift, subject in _select_costs(comparison):
        first, second, change = shift["first"], shift["second"], shift["difference"]
        if first is None or second is None or change is None:
            lines.append(f"  {word}: no {subject} has one in both")
            continue
        low, high = shift["low"], shift["high"]
        interval = (
            "one world tells no interval"
            if low is None or high is None
            else f"{scale * low:+.3g} to {scale * high:+.3g}"
        )
        lines.append(
            f"  {word}: {scale * first:.4g} -> {scale * second:.4g} {unit}, change "
            f"{scale * change:+.3g} ({interval}), of {shift['pairs']:,} {subject}s"
        )
    return lines


def _format_worlds(comparison: RunComparison) -> list[str]:
    changed = comparison["changed"]
    count = "1 world" if len(changed) == 1 else f"{len(changed):,} worlds"
    lines = [f"{count} changed" + (", these most:" if len(changed) > MAX_LISTED else "")]
    for world in changed[:MAX_LISTED]:
        did = "did their part" if world["task"] else "arrived"
        parts = [_format_task(world["task"])] if world["task"] else []
        parts.append(f"{world['arrived_first']} -> {world['arrived_second']} {did}")
        if world["time_s"] is not None:
            parts.append(f"time of those that did in both {world['time_s']:+.1f} s")
        parts += [f"robot {x['robot']}: {x['first']} -> {x['second']}" for x in world["robots"]]
        lines.append(f"  world {world['world']}: {'; '.join(parts)}")
    if len(changed) > MAX_LISTED:
        lines.append(f"  and {len(changed) - MAX_LISTED:,} more; --json lists all")
    return lines


def _format_task(task: Mapping[str, float | None]) -> str:
    first, second = (
        "not completed" if at_s is None else f"{at_s:.1f} s"
        for at_s in (task["first_s"], task["second_s"])
    )
    return f"task: {first} -> {second}"


def plot_comparison(comparison: RunComparison) -> Figure:
    """Changes with their intervals.

    Args:
        comparison: by `angler_mjx.studies.compare.compare_runs`.
    """
    rates = [
        (word, 100 * x["difference"], _scale_ends(x, 100))
        for word, x in _select_rates(comparison)
        if x["difference"] is not None
    ]
    costs = []
    for word, _, _, shift, _ in _select_costs(comparison):
        if shift["difference"] is None or not shift["first"]:
            continue
        percent_scale = 100 / abs(shift["first"])
        change = percent_scale * shift["difference"]
        costs.append((word, change, _scale_ends(shift, percent_scale)))
    with style.titled_figure(
        9.6,
        3.6,
        "What changed from A to B",
        f"{comparison['worlds']:,} worlds; bars are 95 % intervals by world. "
        f"A: {comparison['first']}, B: {comparison['second']}",
    ) as figure:
        left, right = figure.subplots(1, 2)
        _plot_forest(left, "rates, change in points", rates)
        _plot_forest(right, "means, change in % of A", costs)
    return figure


def _scale_ends(change: RateRow | ShiftRow, scale: float) -> list[float]:
    """Return both ends of an interval, or none where it is not known."""
    return [scale * end for end in (change["low"], change["high"]) if end is not None]


def _plot_forest(axes: Axes, title: str, rows: list[tuple[str, float, list[float]]]) -> None:
    axes.set_title(title)
    axes.axvline(0.0, color=style.FAINT, linewidth=1.0)
    for i, (_, value, ends) in enumerate(rows):
        axes.plot(ends, [i] * len(ends), color=style.INK, linewidth=1.4)
        axes.plot([value], [i], marker="o", color=style.robot_color(0))
    axes.set_yticks(range(len(rows)), [row[0] for row in rows])
    axes.invert_yaxis()
    axes.margins(y=0.3)
