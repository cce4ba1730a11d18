"""Tables of a sweep: Parquet for those who ask their own questions, Markdown for people."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from angler_mjx.report.viewing import tables as markdown
from angler_mjx.runs.storage import atomic, planned
from angler_mjx.runs.storage.results import OUTCOMES
from angler_mjx.studies.measures import COSTS

type Table = tuple[list[str], list[list[str]]]
"""Head and rows."""

HOW_TO_READ = (
    "Each row sets one key otherwise and leaves all else as it was, in the same worlds. "
    "*Arrived* is the change of the share of robots that arrive, in points, with its 95 % "
    "interval by world; p is that of the exact sign test over worlds. *Won* and *lost* count "
    "worlds whose whole team arrived only with the second value, and only with the first. Times "
    "and energies are changes of the mean over robots that arrived both times. An interval that "
    "holds 0 shows no change; with many rows, one in twenty leaves 0 out by chance."
)

OF_TASKS = (
    "*Tasks* is the change of the share of worlds that complete their task, with Newcombe's "
    "interval and McNemar's exact test; *completed after* that of the mean time, over worlds that "
    "did in both. *Did their part* and *time of their part* are of robots: one has done its part "
    "when nothing is left for it, which may be before the task is completed or without its being "
    "completed."
)

OTHER_PROBLEMS = (
    "The setting belongs to what problems are made of: world, fleet, horizon or what is drawn of "
    "them. Pairs share the seed and the index of the world; its rock, current, starts and goals "
    "are the same only as far as the setting lets them."
)


def write_parquet(found: Mapping[str, Any], path: Path) -> None:
    """A row for each cell.

    Args:
        found: as ``sweep.json`` holds it.
        path: of the file.
    """
    with atomic.whole(path) as writing:
        pq.write_table(table(found), writing, compression="zstd")


def table(found: Mapping[str, Any]) -> pa.Table:
    """The rows; a column of settings holds numbers where all its values are."""
    cells = found["cells"]
    columns: dict[str, Any] = {key: [row[key] for row in cells] for key in ("cell", "run")}
    for axis in found["axes"]:
        by_name = dict(zip(axis["names"], axis["values"], strict=True))
        values = [by_name[row["set"][axis["key"]]] for row in cells]
        numbers = all(type(value) in (int, float) for value in values)
        names = [row["set"][axis["key"]] for row in cells]
        columns[axis["key"]] = [float(x) for x in values] if numbers else names
    for key in ("worlds", "robots", "problems"):
        columns[key] = [row[key] for row in cells]
    for outcome in OUTCOMES:
        for part in ("rate", "low", "high"):
            columns[f"{outcome}_{part}"] = [row["outcomes"][outcome][part] for row in cells]
    for name in ("planned", "team"):
        for part in ("rate", "low", "high"):
            columns[f"{name}_{part}"] = [row[name][part] for row in cells]
    for name in COSTS:
        for part in ("mean", "low", "high", "count"):
            columns[f"{name}_{part}"] = [row[name][part] for row in cells]
    if has_tasks(found):
        for what, parts in (
            ("completed", ("rate", "low", "high")),
            ("completed_s", ("mean", "low", "high", "count")),
        ):
            for part in parts:
                columns[f"task_{what}_{part}"] = [
                    None if row["task"] is None else row["task"][what][part] for row in cells
                ]
    for key in ("vehicle_steps_per_s", "simulate_s", "compile_s"):
        columns[key] = [row[key] for row in cells]
    return pa.table(columns)


def has_tasks(found: Mapping[str, Any]) -> bool:
    """Whether any cell is of a scenario with a task."""
    return any(row["task"] is not None for row in found["cells"])


def _words(found: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return what robots did, of whole teams too, and the time they took, as heads call it."""
    if found["cells"] and all(row["task"] is not None for row in found["cells"]):
        return "did their part", "whole teams did", "time of their part, s"
    return "arrived", "whole teams", "time to goal, s"


def write_page(found: Mapping[str, Any], path: Path) -> None:
    """The tables as Markdown.

    Args:
        found: as ``sweep.json`` holds it.
        path: of the file.
    """
    atomic.write_text(path, page(found))


def page(found: Mapping[str, Any]) -> str:
    """The same as text."""
    about = found["environment"]
    lines = [f"# Sweep of {found['scenario']}", ""]
    lines += [
        f"{len(found['cells'])} cells of {found['worlds']:,} worlds, seed {found['seed']}, on "
        f"{about['device']}. 95 % intervals are clustered by world.",
        "",
    ]
    if not found["complete"]:
        lines += ["Interrupted: cells that were not finished are missing.", ""]
    lines += [*grid(cells_table(found)), ""]
    if without := without_plans(found):
        lines += [*(f"- {line}" for line in without), ""]
    if found["pairs"]:
        lines += ["## What each setting changes, paired", "", HOW_TO_READ, ""]
        lines += [OF_TASKS, ""] if has_tasks(found) else []
        lines += [*grid(pairs_table(found)), ""]
        if not all(pair["same_problems"] for pair in found["pairs"]):
            lines += [f"\\* {OTHER_PROBLEMS}", ""]
    return "\n".join(lines)


def without_plans(found: Mapping[str, Any]) -> list[str]:
    """Return why robots of cells have no plan, a line for each reason; the cell is named."""
    return [
        f"{' '.join(f'{key}={x}' for key, x in row['set'].items())}: {line}"
        for row in found["cells"]
        for line in planned.lines(row.get("planning"))
    ]


def cells_table(found: Mapping[str, Any]) -> Table:
    """A row for each cell."""
    keys = [axis["key"] for axis in found["axes"]]
    tasks, (did, teams, time) = has_tasks(found), _words(found)
    head = [
        *keys,
        "robots",
        *(("tasks completed, %", "completed after, s") if tasks else ()),
        "planned, %",
        f"{did}, %",
        f"{teams}, %",
        time,
        "energy, kJ",
    ]
    rows = [
        [
            *(row["set"][key] for key in keys),
            str(row["robots"]),
            *(_task(row["task"]) if tasks else ()),
            # Tasks ask no planner.
            "-" if row["task"] is not None else percent(row["planned"]),
            percent(row["outcomes"]["reached"]),
            percent(row["team"]),
            span(row["time_to_goal_s"], 1.0),
            span(row["energy_j"], 1e-3),
            span(row["min_clearance_m"], 1.0),
        ]
        for row in found["cells"]
    ]
    return [*head, "clearance, m"], rows


def _task(found: Mapping[str, Any] | None) -> tuple[str, str]:
    if found is None:
        return "-", "-"
    return percent(found["completed"]), span(found["completed_s"], 1.0)


def pairs_table(found: Mapping[str, Any]) -> Table:
    """A row for each pair of cells."""
    cells = {row["cell"]: row for row in found["cells"]}
    tasks, (did, _, time) = has_tasks(found), _words(found)
    head = ["key", "from", "to", "others"]
    head += ["tasks, points", "p of tasks", "completed after, s"] if tasks else []
    head += [f"{did}, points", "p", "won", "lost", "time, s" if did == "arrived" else time]
    rows = []
    for pair in found["pairs"]:
        first, second = cells[pair["first"]]["set"], cells[pair["second"]]["set"]
        others = [f"{key}={x}" for key, x in first.items() if key != pair["key"]]
        rows.append(
            [
                pair["key"] + ("" if pair["same_problems"] else " *"),
                first[pair["key"]],
                second[pair["key"]],
                " ".join(others) or "-",
                *(_task_change(pair) if tasks else ()),
                shift(pair["share"], 100.0, 1),
                f"{pair['share_p']:.2g}",
                str(pair["teams"]["only_second"]),
                str(pair["teams"]["only_first"]),
                shift(pair["costs"].get("time_to_goal_s"), 1.0, 2),
                shift(pair["costs"].get("energy_j"), 1e-3, 2),
            ]
        )
    return [*head, "energy, kJ"], rows


def _task_change(pair: Mapping[str, Any]) -> tuple[str, str, str]:
    if pair["tasks"] is None:
        return "-", "-", "-"
    points = shift(pair["tasks"], 100.0, 1)
    return points, f"{pair['tasks']['p']:.2g}", shift(pair["task_s"], 1.0, 2)


def to_fit(table: Table, width: int) -> list[Table]:
    """The table where it fits between two margins; else it lies on its side, in parts that do.

    Args:
        table: rows of text.
        width: characters of a line.
    """
    head, rows = table
    if not rows or _wide([head, *rows]) <= width:
        return [table]
    # What were columns are rows; as many of the old rows stand beside their names as fit.
    parts: list[Table] = []
    while rows:
        count = len(rows)
        while count > 1 and _wide(_on_its_side(head, rows[:count])) > width:
            count -= 1
        top, *rest = _on_its_side(head, rows[:count])
        parts.append((top, rest))
        rows = rows[count:]
    return parts


def _on_its_side(head: list[str], rows: list[list[str]]) -> list[list[str]]:
    return [list(line) for line in zip(head, *rows, strict=True)]


def _wide(lines: list[list[str]]) -> int:
    """Characters of a line with its frame."""
    return sum(max(map(len, column)) + 3 for column in zip(*lines, strict=True)) + 1


def grid(table: Table) -> list[str]:
    """Lines of a table in Markdown."""
    head, rows = table
    return markdown.table(
        head, [[x.replace("|", "&#124;").replace("*", "\\*") for x in row] for row in rows]
    ).splitlines()


def percent(rate: Mapping[str, float]) -> str:
    """A rate with its interval, in %."""
    return f"{100 * rate['rate']:.1f} ({100 * rate['low']:.1f} to {100 * rate['high']:.1f})"


def span(mean: Mapping[str, Any], scale: float) -> str:
    """A mean with its interval."""
    if mean["mean"] is None:
        return "-"
    if mean["low"] is None:
        return f"{scale * mean['mean']:.4g}"
    return f"{scale * mean['mean']:.4g} ({scale * mean['low']:.4g} to {scale * mean['high']:.4g})"


def shift(found: Mapping[str, Any] | None, scale: float, digits: int) -> str:
    """A difference with its interval."""
    if found is None or found["difference"] is None:
        return "-"
    text = f"{scale * found['difference']:+.{digits}f}"
    if found["low"] is None:
        return text
    return f"{text} ({scale * found['low']:+.{digits}f} to {scale * found['high']:+.{digits}f})"
