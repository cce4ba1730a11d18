"""Results of a run: one row per robot per world, and their summary."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TypedDict

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from angler_mjx.runs.storage import confidence_intervals
from angler_mjx.runs.storage import planning_summary as how_planned
from angler_mjx.runs.storage.episode_columns import EPISODE_COLUMNS, EPISODE_SCHEMA, TileResult
from angler_mjx.runs.storage.planning_summary import PlanningSummary
from angler_mjx.sim.state import Outcome

OUTCOMES = tuple(o.name.lower() for o in Outcome if o is not Outcome.RUNNING)
"""How an episode can end, in the order of every table and figure."""


type Quantiles = dict[str, float | None]
"""Quantiles p10, p50 and p90; None without values."""


class TaskSummary(TypedDict):
    """Tasks of some worlds."""

    completed: dict[str, float]
    """Number ``count`` and fraction ``rate`` of worlds that completed theirs, and the interval."""
    completed_s: dict[str, float | list[float] | None]
    """Mean time, its interval by Student, and quantiles, of the worlds that completed theirs."""
    progress: float


class _TaskPart(TypedDict, total=False):
    task: TaskSummary


class EpisodeSummary(_TaskPart):
    """Summary of rows of episodes: outcomes, and quantiles of the main measures."""

    robots: int
    outcomes: dict[str, dict[str, float]]
    planned_rate: float
    planning: PlanningSummary | None
    """None where robots have a task."""
    passed_goal_early: int
    """Number of robots."""
    time_to_goal_s: Quantiles
    path_length_m: Quantiles
    energy_j: Quantiles
    min_clearance_m: Quantiles
    redraws: dict[str, int]
    by_vehicle: dict[str, dict[str, int | dict[str, float]]]


def episode_table(result: TileResult, variants: Sequence[tuple[str, str]], seed: int) -> pa.Table:
    """Return the rows of a tile.

    Args:
        result: of the tile.
        variants: vehicle and parameter set of each variant.
        seed: of the run.
    """
    result = replace(result, variants=variants, seed=seed)
    columns = {column.name: column.build(result) for column in EPISODE_COLUMNS}
    return pa.table(columns, schema=EPISODE_SCHEMA)


def check_table(table: pa.Table) -> pa.Table:
    """Return rows that were read back, with all columns, and nulls where older runs wrote NaN.

    Raises:
        ValueError: they are something else.
    """
    table = _add_missing_columns(table)
    if table.schema.names != EPISODE_SCHEMA.names or table.schema.types != EPISODE_SCHEMA.types:
        raise ValueError(f"holds the columns {', '.join(table.schema.names)}")
    table.validate(full=True)
    if table.num_rows == 0:
        raise ValueError("holds no rows")
    for index, column in enumerate(EPISODE_COLUMNS):
        values = table[column.name]
        if not column.nullable and values.null_count:
            raise ValueError(f"has nulls in {column.name}")
        if column.nullable and pa.types.is_floating(column.type):
            is_finite = pc.fill_null(pc.is_finite(values), False)
            values = pc.if_else(is_finite, values, pa.scalar(None, column.type))
        table = table.set_column(index, column.arrow_field, values)
    unknown = set(table["outcome"].unique().to_pylist()) - set(OUTCOMES)
    if unknown:
        raise ValueError(f"knows outcomes that are none: {', '.join(sorted(unknown))}")
    return table


def _add_missing_columns(table: pa.Table) -> pa.Table:
    """Return rows of an older edition of the table with the columns that it lacks, empty."""
    for edition in {column.since for column in EPISODE_COLUMNS}:
        names = [column.name for column in EPISODE_COLUMNS if column.since <= edition]
        if table.schema.names == names:
            for field in list(EPISODE_SCHEMA)[len(names) :]:
                table = table.append_column(field, pa.nulls(table.num_rows, field.type))
    return table


def end_time_s(row: Mapping[str, object]) -> float:
    """Return the end of a robot's episode, s, from a row as ``to_pylist`` gives it."""
    column = "time_to_goal_s" if row["outcome"] == "reached" else "failure_time_s"
    end_s = row[column]
    if not isinstance(end_s, float):
        raise TypeError(f"{column} is {end_s!r}")
    return end_s


def outcome_rates(episodes: pa.Table) -> dict[str, dict[str, float]]:
    """Return count, rate and 95 % interval of every outcome, clustered by world.

    Args:
        episodes: rows of ``EPISODE_SCHEMA``.

    Returns:
        By outcome ``count``, ``rate``, ``low``, ``high``, and ``effective``: how many independent
        robots the rows are worth; see `angler_mjx.runs.storage.confidence_intervals`.
    """
    names = episodes["outcome"].combine_chunks()
    has_outcome = {
        name: np.asarray(pc.equal(names, name).to_numpy(zero_copy_only=False)) for name in OUTCOMES
    }
    by_outcome = confidence_intervals.clustered_rates(has_outcome, episodes["world"].to_numpy())
    return {name: asdict(interval) for name, interval in by_outcome.items()}


def completion_times(episodes: pa.Table) -> np.ndarray | None:
    """Return when each world completed its task [w], s: NaN if it did not; None without a task.

    Args:
        episodes: rows of ``EPISODE_SCHEMA``; worlds come in increasing order.
    """
    rows = episodes.take(np.unique(episodes["world"].to_numpy(), return_index=True)[1])
    if not np.isfinite(np.asarray(rows["task_progress"].to_numpy(), float)).any():
        return None
    return np.asarray(rows["task_completed_s"].to_numpy(), float)


def summarise_episodes(episodes: pa.Table) -> EpisodeSummary:
    """Summarise rows; only runs with a task have the key ``task``."""
    world, redraws = episodes["world"].to_numpy(), episodes["redraws"].to_numpy()
    first_rows = np.unique(world, return_index=True)[1]
    kinds = sorted(
        set(
            zip(episodes["vehicle"].to_pylist(), episodes["parameter_set"].to_pylist(), strict=True)
        )
    )
    by_vehicle: dict[str, dict[str, int | dict[str, float]]] = {}
    for vehicle, parameter_set in kinds:
        selected = episodes.filter(
            (pc.field("vehicle") == vehicle) & (pc.field("parameter_set") == parameter_set)
        )
        reached = outcome_rates(selected)["reached"]
        by_vehicle[f"{vehicle}/{parameter_set}"] = {"robots": selected.num_rows, "reached": reached}
    planned = episodes["planned"].to_numpy(zero_copy_only=False)
    return {
        "robots": episodes.num_rows,
        **_summarise_task(episodes.take(first_rows)),
        "outcomes": outcome_rates(episodes),
        "planned_rate": float(planned.mean()) if planned.size else 0.0,
        "planning": how_planned.summarise_planning(episodes),
        "passed_goal_early": pc.sum(episodes["passed_goal_early"], min_count=0).as_py(),
        "time_to_goal_s": _compute_quantiles(episodes["time_to_goal_s"]),
        "path_length_m": _compute_quantiles(episodes["path_length_m"]),
        "energy_j": _compute_quantiles(episodes["energy_j"]),
        "min_clearance_m": _compute_quantiles(episodes["min_clearance_m"]),
        "redraws": {
            "total": int(redraws[first_rows].sum()),
            "worlds": int((redraws[first_rows] > 0).sum()),
        },
        "by_vehicle": by_vehicle,
    }


def _summarise_task(worlds: pa.Table) -> _TaskPart:
    """Summarise tasks, one row a world; empty where there are none."""
    progress = worlds["task_progress"].to_numpy()
    if not np.isfinite(progress).any():
        return {}
    times_s = worlds["task_completed_s"].to_numpy()
    done = np.isfinite(times_s)
    count, total = int(done.sum()), len(times_s)
    low, high = confidence_intervals.wilson_interval(count, total)
    mean = interval = None
    if count:
        mean = float(times_s[done].mean())
    if count > 1:
        half_width = (
            confidence_intervals.student_quantile(count - 1)
            * float(times_s[done].std(ddof=1))
            / count**0.5
        )
        interval = [max(mean - half_width, 0.0), mean + half_width]
    return {
        "task": {
            "completed": {"count": count, "rate": count / total, "low": low, "high": high},
            "completed_s": {
                "mean": mean,
                "interval": interval,
                **_compute_quantiles(worlds["task_completed_s"]),
            },
            "progress": float(np.nanmean(progress)),
        }
    }


def _compute_quantiles(column: pa.ChunkedArray) -> Quantiles:
    values = column.to_numpy()
    values = values[np.isfinite(values)]
    if values.size == 0:
        return {"p10": None, "p50": None, "p90": None}
    ten, half, ninety = np.quantile(values, [0.1, 0.5, 0.9])
    return {"p10": float(ten), "p50": float(half), "p90": float(ninety)}
