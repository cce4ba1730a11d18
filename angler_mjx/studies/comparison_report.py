"""What two runs against each other came to, as text and as a figure."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from angler_mjx.errors import shown
from angler_mjx.report.viewing import style
from angler_mjx.runs.storage import planned

MOST = 10
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


def text(found: Mapping[str, Any]) -> str:
    """For people.

    Args:
        found: by `angler_mjx.studies.compare.compare`.
    """
    lines = [f"A: {found['first']}", f"B: {found['second']}", ""]
    lines += [
        f"  {one['key']}: {shown(one['first'])} -> {shown(one['second'])}"
        for one in found["config"]
    ]
    if not found["config"]:
        lines.append("  the scenarios are the same")
    if not found["same_problems"]:
        lines.append(
            "  problems are made of some of these: worlds may be drawn otherwise, pairs share seed "
            "and index"
        )
    lines += ["", *_rates(found), *_costs(found), *_planned(found["planning"])]
    lines += ["", "robots by outcome, A -> B:"]
    lines += [
        f"  {one['robots']:>7,}  {one['first']} -> {one['second']}"
        for one in found["outcomes"][:MOST]
    ]
    return "\n".join([*lines, "", *_worlds(found)])


def _rates(found: Mapping[str, Any]) -> list[str]:
    held = "" if found["worlds"] == found["asked"] else f" of {found['asked']:,}"
    lines = [
        f"{found['worlds']:,} worlds{held}; changes are B minus A, with 95 % intervals by world:"
    ]
    for name, what in (TASK_RATES if _has_tasks(found) else RATES).items():
        one = found[name]
        if one is None:
            continue
        total = sum(one[key] for key in ("both", "only_first", "only_second", "neither"))
        was, now = one["both"] + one["only_first"], one["both"] + one["only_second"]
        lines.append(
            f"  {what}: {100 * was / total:.1f} % -> {100 * now / total:.1f} %, change "
            f"{_points(one)} points, p = {one['p']:.2g}; in both {one['both']:,}, only in A "
            f"{one['only_first']:,}, only in B {one['only_second']:,}, in neither "
            f"{one['neither']:,}"
        )
    return lines


def _planned(planning: Mapping[str, Any]) -> list[str]:
    """Fractions of robots with a plan in both runs, and why the others have none."""
    both = planning["first"], planning["second"]
    lines = [f"  robots with a plan: {' -> '.join(map(planned.percent, both))}"]
    for name, one in zip("AB", both, strict=True):
        lines += [f"    {name}: {line}" for line in planned.lines(one)]
    return lines


def _points(one: Mapping[str, Any]) -> str:
    low, high = ("?" if one[end] is None else f"{100 * one[end]:+.1f}" for end in ("low", "high"))
    return f"{100 * one['difference']:+.1f} ({low} to {high})"


def _has_tasks(found: Mapping[str, Any]) -> bool:
    """Whether both runs are of scenarios with a task."""
    return found["tasks"] is not None


type Cost = tuple[str, str, float, Mapping[str, Any], str]
"""Words, unit, scale, values, and what has one."""


def _costs_of(found: Mapping[str, Any]) -> list[Cost]:
    """Return all costs in the order in which they are shown: completion of the task first."""
    has_tasks, costs = _has_tasks(found), found["costs"]
    words = TASK_COSTS if has_tasks else COSTS
    rows: list[Cost] = [(*COMPLETION, found["task_s"], "world")] if has_tasks else []
    return rows + [(*words[name], costs[name], "robot") for name in words if name in costs]


def _costs(found: Mapping[str, Any]) -> list[str]:
    lines = []
    for word, unit, scale, one, whose in _costs_of(found):
        if one["difference"] is None:
            lines.append(f"  {word}: no {whose} has one in both")
            continue
        first, second, change = (scale * one[key] for key in ("first", "second", "difference"))
        interval = (
            "one world tells no interval"
            if one["low"] is None
            else f"{scale * one['low']:+.3g} to {scale * one['high']:+.3g}"
        )
        lines.append(
            f"  {word}: {first:.4g} -> {second:.4g} {unit}, change {change:+.3g} ({interval}), of "
            f"{one['pairs']:,} {whose}s"
        )
    return lines


def _worlds(found: Mapping[str, Any]) -> list[str]:
    changed = found["changed"]
    count = "1 world" if len(changed) == 1 else f"{len(changed):,} worlds"
    lines = [f"{count} changed" + (", these most:" if len(changed) > MOST else "")]
    for one in changed[:MOST]:
        did = "did their part" if one["task"] else "arrived"
        parts = [_task(one["task"])] if one["task"] else []
        parts.append(f"{one['arrived_first']} -> {one['arrived_second']} {did}")
        if one["time_s"] is not None:
            parts.append(f"time of those that did in both {one['time_s']:+.1f} s")
        parts += [f"robot {x['robot']}: {x['first']} -> {x['second']}" for x in one["robots"]]
        lines.append(f"  world {one['world']}: {'; '.join(parts)}")
    if len(changed) > MOST:
        lines.append(f"  and {len(changed) - MOST:,} more; --json lists all")
    return lines


def _task(task: Mapping[str, float | None]) -> str:
    first, second = (
        "not completed" if at_s is None else f"{at_s:.1f} s"
        for at_s in (task["first_s"], task["second_s"])
    )
    return f"task: {first} -> {second}"


def draw(found: Mapping[str, Any]) -> Figure:
    """Changes with their intervals.

    Args:
        found: by `angler_mjx.studies.compare.compare`.
    """
    words = TASK_RATES if _has_tasks(found) else RATES
    rates = [
        (word, 100 * x["difference"], [None if x[e] is None else 100 * x[e] for e in _ENDS])
        for word, x in ((word, found[name]) for name, word in words.items())
        if x is not None
    ]
    costs = []
    for word, _, _, one, _ in _costs_of(found):
        if one["difference"] is None or not one["first"]:
            continue
        share = 100 / abs(one["first"])
        ends = [None if one[end] is None else share * one[end] for end in _ENDS]
        costs.append((word, share * one["difference"], ends))
    with style.styled():
        figure = style.new_figure(9.6, 3.6, headline_in=0.65)
        left, right = figure.subplots(1, 2)
        style.headline(
            figure,
            "What changed from A to B",
            f"{found['worlds']:,} worlds; bars are 95 % intervals by world. "
            f"A: {found['first']}, B: {found['second']}",
        )
        _forest(left, "rates, change in points", rates)
        _forest(right, "means, change in % of A", costs)
    return figure


_ENDS = ("low", "high")


def _forest(axes: Axes, title: str, rows: list[tuple[str, float, list[float | None]]]) -> None:
    axes.set_title(title)
    axes.axvline(0.0, color=style.FAINT, linewidth=1.0)
    for i, (_, value, ends) in enumerate(rows):
        known = [end for end in ends if end is not None]
        axes.plot(known, [i] * len(known), color=style.INK, linewidth=1.4)
        axes.plot([value], [i], marker="o", color=style.robot_color(0))
    axes.set_yticks(range(len(rows)), [row[0] for row in rows])
    axes.invert_yaxis()
    axes.margins(y=0.3)
