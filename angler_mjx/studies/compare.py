"""Two runs against each other: what of their scenarios differs, and what that changed, by world."""

from collections.abc import Iterator, Mapping
from typing import TypeGuard

import numpy as np
import pyarrow as pa

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.storage import planning_summary
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.results import completion_times
from angler_mjx.studies import paired
from angler_mjx.studies.measures import arrived_of, finite_or_none, read_numbers, worlds_of
from angler_mjx.studies.rows import ChangedWorld, OutcomeChange, RobotChange, RunComparison


def compare_runs(first: Run, second: Run) -> RunComparison:
    """Return what the second of two runs changed, in the worlds that both hold.

    Raises:
        ConfigError: the runs are not of the same seed, worlds and robots; the key is named.
    """
    _require_pairs(first, second)
    changed_keys = {
        key: values
        for key, values in find_differences(_scenario_table(first), _scenario_table(second)).items()
        if key != "description"
    }
    first_rows, second_rows = first.episodes, second.episodes
    common = np.intersect1d(worlds_of(first_rows), worlds_of(second_rows))
    first_rows, second_rows = (
        rows.filter(np.isin(worlds_of(rows), common)) for rows in (first_rows, second_rows)
    )
    return {
        "first": str(first.path),
        "second": str(second.path),
        "config": [
            {"key": key, "first": a, "second": b} for key, (a, b) in sorted(changed_keys.items())
        ],
        "same_problems": first.scenario.digest() == second.scenario.digest(),
        "asked": first.scenario.worlds,
        **paired.pair_runs(first_rows, second_rows),
        "planning": {
            "first": planning_summary.summarise_planning(first_rows),
            "second": planning_summary.summarise_planning(second_rows),
        },
        "outcomes": _count_outcomes(first_rows, second_rows),
        "changed": _list_changed_worlds(first_rows, second_rows),
    }


def _scenario_table(run: Run) -> dict[str, object]:
    table: dict[str, object] = run.scenario.model_dump(mode="json")
    return table


def _require_pairs(first: Run, second: Run) -> None:
    """Refuse runs whose robots are no pairs."""
    a, b = first.scenario, second.scenario
    pairs: list[tuple[str, object, object]] = [
        ("seed", a.seed, b.seed),
        ("worlds", a.worlds, b.worlds),
        ("fleet", len(a.fleet), len(b.fleet)),
    ]
    for i, (x, y) in enumerate(zip(a.fleet, b.fleet, strict=False)):
        vehicles = (library.load_vehicle(x.vehicle).name, library.load_vehicle(y.vehicle).name)
        pairs += [(f"fleet[{i}].count", x.count, y.count), (f"fleet[{i}].vehicle", *vehicles)]
    for key, first_value, second_value in pairs:
        if first_value != second_value:
            raise ConfigError(
                f"{first.path} and {second.path}: {key} = {format_value(first_value)} and "
                f"{format_value(second_value)}; "
                "compare runs of the same seed, worlds and robots"
            )
    for run in (first, second):
        if run.episodes.num_rows == 0:
            raise ConfigError(f"{run.path}: holds no episodes")


def find_differences(
    first: object, second: object, key: str = ""
) -> dict[str, tuple[object, object]]:
    """Values that differ, by dotted key; None stands for what is not there.

    Args:
        first: plain values.
        second: plain values.
        key: of both.
    """
    changes: dict[str, tuple[object, object]] = {}
    if first == second:
        return changes
    for name, a, b in _iterate_parts(first, second):
        changes |= find_differences(a, b, f"{key}.{name}" if key else name)
    return changes or {key: (first, second)}


def _iterate_parts(first: object, second: object) -> Iterator[tuple[str, object, object]]:
    """Parts of two tables, or of two lists of tables; nothing of other values."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        for name in sorted({*first, *second}):
            yield name, first.get(name), second.get(name)
    elif _is_tables(first) and _is_tables(second) and len(first) == len(second):
        for i, (a, b) in enumerate(zip(first, second, strict=True)):
            yield str(i), a, b


def _is_tables(value: object) -> TypeGuard[list[Mapping[str, object]]]:
    return isinstance(value, list) and all(isinstance(entry, Mapping) for entry in value)


def _count_outcomes(first: pa.Table, second: pa.Table) -> list[OutcomeChange]:
    """Robots by their two outcomes, the most first."""
    pairs = list(zip(first["outcome"].to_pylist(), second["outcome"].to_pylist(), strict=True))
    counts = {pair: pairs.count(pair) for pair in dict.fromkeys(pairs)}
    return [
        {"first": a, "second": b, "robots": count}
        for (a, b), count in sorted(counts.items(), key=lambda item: -item[1])
    ]


def _list_changed_worlds(first: pa.Table, second: pa.Table) -> list[ChangedWorld]:
    """Return worlds that changed, those that changed most first.

    Of runs with a task: worlds that completed it in one run alone, then by the change of the time
    of completion. Ties, and other runs: more robots that arrived in one run alone, then the change
    of their mean time.
    """
    worlds, arrived = worlds_of(first), [arrived_of(rows) for rows in (first, second)]
    ended = [rows["outcome"].to_pylist() for rows in (first, second)]
    late = read_numbers(second, "time_to_goal_s") - read_numbers(first, "time_to_goal_s")
    completed = [completion_times(rows) for rows in (first, second)]
    lost, won = arrived[0] & ~arrived[1], ~arrived[0] & arrived[1]
    changed_worlds: list[ChangedWorld] = []
    begins = np.flatnonzero(np.r_[True, np.diff(worlds) != 0])
    for number, (begin, end) in enumerate(zip(begins, [*begins[1:], len(worlds)], strict=True)):
        rows = range(begin, end)
        both = [float(late[i]) for i in rows if np.isfinite(late[i])]
        robots: list[RobotChange] = [
            {"robot": i - int(begin), "first": ended[0][i], "second": ended[1][i]}
            for i in rows
            if ended[0][i] != ended[1][i]
        ]
        task = _task_change(*(None if x is None else float(x[number]) for x in completed))
        if robots or any(both) or (task is not None and task["first_s"] != task["second_s"]):
            changed_worlds.append(
                {
                    "world": int(worlds[begin]),
                    "task": task,
                    "arrived_first": int(np.sum(arrived[0][begin:end])),
                    "arrived_second": int(np.sum(arrived[1][begin:end])),
                    "lost": int(np.sum(lost[begin:end])),
                    "won": int(np.sum(won[begin:end])),
                    "time_s": sum(both) / len(both) if both else None,
                    "robots": robots,
                }
            )
    return sorted(changed_worlds, key=_sort_key)


def _task_change(first_s: float | None, second_s: float | None) -> dict[str, float | None] | None:
    """Return the times of completion of a world in both runs; None where a run has no task."""
    if first_s is None or second_s is None:
        return None
    return {"first_s": finite_or_none(first_s), "second_s": finite_or_none(second_s)}


def _sort_key(changed: ChangedWorld) -> tuple[float, ...]:
    """Return the sort key of a world that changed."""
    task: tuple[float, float] = 0.0, 0.0
    if changed["task"] is not None:
        first_s, second_s = changed["task"]["first_s"], changed["task"]["second_s"]
        alone = (first_s is None) != (second_s is None)
        moved = 0.0 if first_s is None or second_s is None else abs(second_s - first_s)
        task = -float(alone), -moved
    robots = -changed["lost"] - changed["won"], -abs(changed["time_s"] or 0.0)
    return (*task, *robots, changed["world"])
