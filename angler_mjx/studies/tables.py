"""Tables of a sweep: Parquet for those who ask their own questions, Markdown for people."""

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from angler_mjx.report.viewing import markdown_tables as markdown
from angler_mjx.runs.storage import atomic_files, planning_summary
from angler_mjx.runs.storage.results import OUTCOMES
from angler_mjx.studies.measures import COSTS, cost_means
from angler_mjx.studies.rows import (
    Mean,
    PairRow,
    Rate,
    RateRow,
    ShiftRow,
    SweepResults,
    TaskRow,
)

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

TASK_NOTES = (
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


def write_parquet(sweep: SweepResults, path: Path) -> None:
    """A row for each cell.

    Args:
        sweep: as ``sweep.json`` holds it.
        path: of the file.
    """
    atomic_files.write_parquet(path, build_table(sweep), compression="zstd")


def build_table(sweep: SweepResults) -> pa.Table:
    """The rows; a column of settings holds numbers where all its values are."""
    cells = sweep["cells"]
    columns: dict[str, Sequence[str | float | None]] = {
        "cell": [row["cell"] for row in cells],
        "run": [row["run"] for row in cells],
    }
    for axis in sweep["axes"]:
        by_name = dict(zip(axis["names"], axis["values"], strict=True))
        names = [row["set"][axis["key"]] for row in cells]
        values = [by_name[name] for name in names]
        numbers = [
            float(x) for x in values if isinstance(x, int | float) and not isinstance(x, bool)
        ]
        columns[axis["key"]] = numbers if len(numbers) == len(names) else names
    columns["worlds"] = [row["worlds"] for row in cells]
    columns["robots"] = [row["robots"] for row in cells]
    columns["problems"] = [row["problems"] for row in cells]
    for outcome in OUTCOMES:
        columns |= _rate_columns(outcome, [row["outcomes"][outcome] for row in cells])
    columns |= _rate_columns("planned", [row["planned"] for row in cells])
    columns |= _rate_columns("team", [row["team"] for row in cells])
    for name in COSTS:
        columns |= _mean_columns(name, [cost_means(row)[name] for row in cells])
    if has_tasks(sweep):
        tasks = [row["task"] for row in cells]
        columns |= _rate_columns("task_completed", [task and task["completed"] for task in tasks])
        columns |= _mean_columns(
            "task_completed_s", [task and task["completed_s"] for task in tasks]
        )
    columns["vehicle_steps_per_s"] = [row["vehicle_steps_per_s"] for row in cells]
    columns["simulate_s"] = [row["simulate_s"] for row in cells]
    columns["compile_s"] = [row["compile_s"] for row in cells]
    return pa.table(columns)


def _rate_columns(name: str, rates: Sequence[Rate | None]) -> dict[str, list[float | None]]:
    parts = ("rate", "low", "high")
    return {f"{name}_{part}": [None if x is None else x[part] for x in rates] for part in parts}


def _mean_columns(name: str, means: Sequence[Mean | None]) -> dict[str, list[float | None]]:
    parts = ("mean", "low", "high", "count")
    return {f"{name}_{part}": [None if x is None else x[part] for x in means] for part in parts}


def has_tasks(sweep: SweepResults) -> bool:
    """Whether any cell is of a scenario with a task."""
    return any(row["task"] is not None for row in sweep["cells"])


def _outcome_labels(sweep: SweepResults) -> tuple[str, str, str]:
    """Return what robots did, of whole teams too, and the time they took, as heads call it."""
    if sweep["cells"] and all(row["task"] is not None for row in sweep["cells"]):
        return "did their part", "whole teams did", "time of their part, s"
    return "arrived", "whole teams", "time to goal, s"


def write_page(sweep: SweepResults, path: Path) -> None:
    """The tables as Markdown.

    Args:
        sweep: as ``sweep.json`` holds it.
        path: of the file.
    """
    atomic_files.write_text(path, format_page(sweep))


def format_page(sweep: SweepResults) -> str:
    """The same as text."""
    about = sweep["environment"]
    lines = [f"# Sweep of {sweep['scenario']}", ""]
    lines += [
        f"{len(sweep['cells'])} cells of {sweep['worlds']:,} worlds, seed {sweep['seed']}, on "
        f"{about['device']}. 95 % intervals are clustered by world.",
        "",
    ]
    if not sweep["complete"]:
        lines += ["Interrupted: cells that were not finished are missing.", ""]
    lines += [*format_grid(cells_table(sweep)), ""]
    if missing := without_plans(sweep):
        lines += [*(f"- {line}" for line in missing), ""]
    if sweep["pairs"]:
        lines += ["## What each setting changes, paired", "", HOW_TO_READ, ""]
        lines += [TASK_NOTES, ""] if has_tasks(sweep) else []
        lines += [*format_grid(pairs_table(sweep)), ""]
        if not all(pair["same_problems"] for pair in sweep["pairs"]):
            lines += [f"\\* {OTHER_PROBLEMS}", ""]
    return "\n".join(lines)


def without_plans(sweep: SweepResults) -> list[str]:
    """Return why robots of cells have no plan, a line for each reason; the cell is named."""
    return [
        f"{' '.join(f'{key}={x}' for key, x in row['set'].items())}: {line}"
        for row in sweep["cells"]
        for line in planning_summary.reason_lines(row.get("planning"))
    ]


def cells_table(sweep: SweepResults) -> Table:
    """A row for each cell."""
    keys = [axis["key"] for axis in sweep["axes"]]
    tasks, (did, teams, time) = has_tasks(sweep), _outcome_labels(sweep)
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
            *(_format_task(row["task"]) if tasks else ()),
            # Tasks ask no planner.
            "-" if row["task"] is not None else format_rate(row["planned"]),
            format_rate(row["outcomes"]["reached"]),
            format_rate(row["team"]),
            format_mean(row["time_to_goal_s"], 1.0),
            format_mean(row["energy_j"], 1e-3),
            format_mean(row["min_clearance_m"], 1.0),
        ]
        for row in sweep["cells"]
    ]
    return [*head, "clearance, m"], rows


def _format_task(task: TaskRow | None) -> tuple[str, str]:
    if task is None:
        return "-", "-"
    return format_rate(task["completed"]), format_mean(task["completed_s"], 1.0)


def pairs_table(sweep: SweepResults) -> Table:
    """A row for each pair of cells."""
    cells = {row["cell"]: row for row in sweep["cells"]}
    tasks, (did, _, time) = has_tasks(sweep), _outcome_labels(sweep)
    head = ["key", "from", "to", "others"]
    head += ["tasks, points", "p of tasks", "completed after, s"] if tasks else []
    head += [f"{did}, points", "p", "won", "lost", "time, s" if did == "arrived" else time]
    rows = []
    for pair in sweep["pairs"]:
        first, second = cells[pair["first"]]["set"], cells[pair["second"]]["set"]
        others = [f"{key}={x}" for key, x in first.items() if key != pair["key"]]
        rows.append(
            [
                pair["key"] + ("" if pair["same_problems"] else " *"),
                first[pair["key"]],
                second[pair["key"]],
                " ".join(others) or "-",
                *(_task_change(pair) if tasks else ()),
                format_shift(pair["share"], 100.0, 1),
                f"{pair['share_p']:.2g}",
                str(pair["teams"]["only_second"]),
                str(pair["teams"]["only_first"]),
                format_shift(pair["costs"].get("time_to_goal_s"), 1.0, 2),
                format_shift(pair["costs"].get("energy_j"), 1e-3, 2),
            ]
        )
    return [*head, "energy, kJ"], rows


def _task_change(pair: PairRow) -> tuple[str, str, str]:
    if pair["tasks"] is None:
        return "-", "-", "-"
    points = format_shift(pair["tasks"], 100.0, 1)
    return points, f"{pair['tasks']['p']:.2g}", format_shift(pair["task_s"], 1.0, 2)


def fit_to_width(table: Table, width: int) -> list[Table]:
    """The table where it fits between two margins; else it lies on its side, in parts that do.

    Args:
        table: rows of text.
        width: characters of a line.
    """
    head, rows = table
    if not rows or _line_width([head, *rows]) <= width:
        return [table]
    # What were columns are rows; as many of the old rows stand beside their names as fit.
    parts: list[Table] = []
    while rows:
        count = len(rows)
        while count > 1 and _line_width(_transpose(head, rows[:count])) > width:
            count -= 1
        top, *rest = _transpose(head, rows[:count])
        parts.append((top, rest))
        rows = rows[count:]
    return parts


def _transpose(head: list[str], rows: list[list[str]]) -> list[list[str]]:
    return [list(line) for line in zip(head, *rows, strict=True)]


def _line_width(lines: list[list[str]]) -> int:
    """Characters of a line with its frame."""
    return sum(max(map(len, column)) + 3 for column in zip(*lines, strict=True)) + 1


def format_grid(table: Table) -> list[str]:
    """Lines of a table in Markdown."""
    head, rows = table
    return markdown.format_table(
        head, [[x.replace("|", "&#124;").replace("*", "\\*") for x in row] for row in rows]
    ).splitlines()


def format_rate(rate: Rate) -> str:
    """A rate with its interval, in %."""
    return f"{100 * rate['rate']:.1f} ({100 * rate['low']:.1f} to {100 * rate['high']:.1f})"


def format_mean(mean: Mean, scale: float) -> str:
    """A mean with its interval."""
    return _format_interval(mean["mean"], mean["low"], mean["high"], scale, ".4g")


def format_shift(change: ShiftRow | RateRow | None, scale: float, digits: int) -> str:
    """A difference with its interval."""
    if change is None:
        return "-"
    ends = change["low"], change["high"]
    return _format_interval(change["difference"], *ends, scale, f"+.{digits}f")


def _format_interval(
    value: float | None, low: float | None, high: float | None, scale: float, form: str
) -> str:
    """Return a number with its interval; a dash for a number that is not defined."""
    if value is None:
        return "-"
    if low is None or high is None:
        return f"{scale * value:{form}}"
    return f"{scale * value:{form}} ({scale * low:{form}} to {scale * high:{form}})"
