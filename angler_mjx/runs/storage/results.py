"""The results of a run: one row per robot per world, and what they add up to."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from angler_mjx.runs.simulator.host_planning import PlanNotes, planning_status
from angler_mjx.runs.storage import confidence_intervals
from angler_mjx.runs.storage import planning_summary as how_planned
from angler_mjx.runs.storage.episode_columns import (
    ADDED_COLUMNS,
    EPISODE_SCHEMA,
    NULLABLE_NUMBERS,
    NULLABLE_OTHERS,
)
from angler_mjx.sim.state import Outcome, Touched

OUTCOMES = tuple(o.name.lower() for o in Outcome if o is not Outcome.RUNNING)
"""How an episode can end, in the order of every table and figure."""


@dataclass(frozen=True, kw_only=True)
class TaskResult:
    """How far the tasks of a tile of worlds were at their ends, as host arrays."""

    jobs_done: np.ndarray
    """int [w, r] that each robot did."""
    progress: np.ndarray
    """[w] share that was done, of a survey share that was seen."""
    completed_s: np.ndarray
    """[w] NaN where a task was not completed."""


@dataclass(frozen=True, kw_only=True)
class TileResult:
    """What a tile of worlds leaves behind, as host arrays; [w, r] worlds and robots lead."""

    world: np.ndarray
    """int [w] global indices."""
    variant: np.ndarray
    """int [w, r]."""
    planned: np.ndarray
    """bool [w, r]."""
    outcome: np.ndarray
    """int [w, r]."""
    end_time_s: np.ndarray
    passed_early: np.ndarray
    """bool [w, r]."""
    path_length_m: np.ndarray
    energy_j: np.ndarray
    min_clearance_m: np.ndarray
    min_separation_m: np.ndarray
    touched: np.ndarray
    touched_index: np.ndarray
    impact_speed_mps: np.ndarray
    p: np.ndarray
    """[w, r, 3] where each robot was at the end."""
    plan_length_m: np.ndarray
    plan_end_s: np.ndarray
    notes: PlanNotes | None
    """None where worlds were planned on the device."""
    redraws: np.ndarray
    """int [w]."""
    failed_replans: np.ndarray | None = None
    """int [w, r]; None where nothing was planned anew."""
    current_factor: np.ndarray | None = None
    """[w]; None where none was drawn, as with the next."""
    sensor_noise_factor: np.ndarray | None = None
    """[w, r]."""
    task: TaskResult | None = None
    """None where each robot has a goal of its own."""
    packets: np.ndarray | None = None
    """int [w, r, 2] that each robot sent, and heard; None without acoustics."""


def episode_table(result: TileResult, variants: Sequence[tuple[str, str]], seed: int) -> pa.Table:
    """Rows of a tile.

    Args:
        result: of the tile.
        variants: vehicle and parameter set of each variant.
        seed: of the run.
    """
    n_world, n_robot = result.outcome.shape
    outcome = result.outcome.reshape(-1)
    reached = outcome == Outcome.REACHED
    position_m = result.p.reshape(-1, 3)
    kind = result.variant.reshape(-1)
    end = result.end_time_s.reshape(-1)

    def unless_reached(values: np.ndarray) -> pa.Array:
        return _nullable_column(np.where(reached, np.nan, values))

    columns: dict[str, Any] = {
        "world": np.repeat(result.world, n_robot),
        "robot": np.tile(np.arange(n_robot, dtype=np.int32), n_world),
        "seed": np.full(n_world * n_robot, seed, np.int64),
        "vehicle": [variants[k][0] for k in kind],
        "parameter_set": [variants[k][1] for k in kind],
        "planned": result.planned.reshape(-1),
        "outcome": [Outcome(o).name.lower() for o in outcome],
        "time_to_goal_s": _nullable_column(np.where(reached, end, np.nan)),
        "path_length_m": result.path_length_m.reshape(-1),
        "energy_j": result.energy_j.reshape(-1),
        "min_clearance_m": result.min_clearance_m.reshape(-1),
        "min_separation_m": _nullable_column(result.min_separation_m.reshape(-1)),
        "failure_time_s": unless_reached(end),
        "failure_x_m": unless_reached(position_m[:, 0]),
        "failure_y_m": unless_reached(position_m[:, 1]),
        "failure_z_m": unless_reached(position_m[:, 2]),
        "failure_pair": [
            _format_pair(kind, index)
            for kind, index in zip(
                result.touched.reshape(-1), result.touched_index.reshape(-1), strict=True
            )
        ],
        "impact_speed_mps": _nullable_column(result.impact_speed_mps.reshape(-1)),
        "redraws": np.repeat(result.redraws, n_robot).astype(np.int32),
    }
    extra_columns = {
        **_plan_columns(result, end, reached),
        **_factor_columns(result),
        **_task_columns(result),
        **_packet_columns(result),
        "passed_goal_early": result.passed_early.reshape(-1),
    }
    return pa.table({**columns, **extra_columns}, schema=EPISODE_SCHEMA)


def _plan_columns(result: TileResult, end: np.ndarray, reached: np.ndarray) -> dict[str, Any]:
    """What the plans were; [w * r] values each."""
    robots, notes = result.outcome.shape[1], result.notes
    planned = result.planned.reshape(-1)
    plan_end_s = np.where(planned, result.plan_end_s.reshape(-1), np.nan)
    if notes is None:
        seconds = np.full(planned.shape, np.nan)
        status = np.repeat(planning_status(result.planned), robots).tolist()
        reason = [None] * planned.size
    else:
        seconds = np.repeat(notes.planning_s, robots)
        status = np.repeat(notes.status, robots).tolist()
        reason = [text or None for text in notes.reason.reshape(-1)]
    return {
        "planning_s": _nullable_column(seconds),
        "plan_status": status,
        "plan_reason": pa.array(reason, pa.string()),
        "plan_length_m": _nullable_column(
            np.where(planned, result.plan_length_m.reshape(-1), np.nan)
        ),
        "plan_end_s": _nullable_column(plan_end_s),
        "late_s": _nullable_column(np.where(reached, end - plan_end_s, np.nan)),
        "failed_replans": pa.nulls(planned.size, pa.int32())
        if result.failed_replans is None
        else pa.array(result.failed_replans.reshape(-1), pa.int32()),
    }


def _factor_columns(result: TileResult) -> dict[str, Any]:
    """What was drawn for the robots and their water; [w * r] values each."""
    shape = result.variant.shape
    blank = np.full(shape, np.nan)
    of_world, of_robot = result.current_factor, result.sensor_noise_factor
    current = blank if of_world is None else np.broadcast_to(of_world[:, None], shape)
    noise = blank if of_robot is None else of_robot
    return {
        "variant": result.variant.reshape(-1).astype(np.int32),
        "current_factor": _nullable_column(current.reshape(-1)),
        "sensor_noise_factor": _nullable_column(noise.reshape(-1)),
    }


def _task_columns(result: TileResult) -> dict[str, Any]:
    """How far the task was; [w * r] values each."""
    robots, size, task = result.outcome.shape[1], result.outcome.size, result.task
    if task is None:
        blank = pa.nulls(size, pa.float32())
        return {
            "jobs_done": pa.nulls(size, pa.int32()),
            "task_progress": blank,
            "task_completed_s": blank,
        }
    return {
        "jobs_done": pa.array(task.jobs_done.reshape(-1), pa.int32()),
        "task_progress": _nullable_column(np.repeat(task.progress, robots)),
        "task_completed_s": _nullable_column(np.repeat(task.completed_s, robots)),
    }


def _packet_columns(result: TileResult) -> dict[str, Any]:
    """What robots said and heard; [w * r] values each."""
    names = ("packets_sent", "packets_heard")
    if result.packets is None:
        return {name: pa.nulls(result.outcome.size, pa.int32()) for name in names}
    rows = result.packets.reshape(-1, len(names))
    return {name: pa.array(rows[:, i], pa.int32()) for i, name in enumerate(names)}


def _nullable_column(values: np.ndarray) -> pa.Array:
    """A column with nulls where nothing is known."""
    return pa.array(values.astype(np.float32), mask=~np.isfinite(values))


def check_table(table: pa.Table) -> pa.Table:
    """Rows that were read back: with our columns, and nulls where older runs wrote NaN.

    Raises:
        ValueError: they are something else.
    """
    table = _add_missing_columns(table)
    if table.schema.names != EPISODE_SCHEMA.names or table.schema.types != EPISODE_SCHEMA.types:
        raise ValueError(f"holds the columns {', '.join(table.schema.names)}")
    table.validate(full=True)
    if table.num_rows == 0:
        raise ValueError("holds no rows")
    for index, field in enumerate(EPISODE_SCHEMA):
        column = table[field.name]
        if field.name in NULLABLE_NUMBERS:
            is_finite = pc.fill_null(pc.is_finite(column), False)
            column = pc.if_else(is_finite, column, pa.scalar(None, field.type))
        elif column.null_count and field.name not in NULLABLE_OTHERS:
            raise ValueError(f"has nulls in {field.name}")
        table = table.set_column(index, field, column)
    unknown = set(table["outcome"].unique().to_pylist()) - set(OUTCOMES)
    if unknown:
        raise ValueError(f"knows outcomes that are none: {', '.join(sorted(unknown))}")
    return table


def _add_missing_columns(table: pa.Table) -> pa.Table:
    """Rows with the columns that older runs lack, empty."""
    lacking = next((n for n in ADDED_COLUMNS if table.schema.names == EPISODE_SCHEMA.names[:-n]), 0)
    for field in list(EPISODE_SCHEMA)[len(EPISODE_SCHEMA) - lacking :]:
        table = table.append_column(field, pa.nulls(table.num_rows, field.type))
    return table


def end_time_s(row: Mapping[str, Any]) -> float:
    """When a robot's episode ended, s: a row as ``to_pylist`` gives it."""
    return float(row["time_to_goal_s" if row["outcome"] == "reached" else "failure_time_s"])


def _format_pair(kind: int, index: int) -> str:
    name = {
        Touched.NOTHING: "none",
        Touched.CELL: "cell",
        Touched.FLOOR: "floor",
        Touched.OBSTACLE: f"obstacle:{index}",
        Touched.ROBOT: f"robot:{index}",
    }
    return name[Touched(kind)]


def outcome_rates(episodes: pa.Table) -> dict[str, Any]:
    """Count, rate and 95 % interval of every outcome, clustered by world.

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


def summarise_episodes(episodes: pa.Table) -> dict[str, Any]:
    """What the rows add up to: outcomes, and quantiles of the main figures.

    Returns:
        Keys ``robots``, ``task`` (of runs with a task), ``outcomes``, ``planned_rate``,
        ``planning`` (`runs.storage.planning_summary.summarise_episodes`; None where robots have a
        task), ``passed_goal_early`` (number of robots), ``time_to_goal_s``, ``path_length_m``,
        ``energy_j``, ``min_clearance_m``, ``redraws``, ``by_vehicle``.
    """
    world, redraws = episodes["world"].to_numpy(), episodes["redraws"].to_numpy()
    first_rows = np.unique(world, return_index=True)[1]
    kinds = sorted(
        set(
            zip(episodes["vehicle"].to_pylist(), episodes["parameter_set"].to_pylist(), strict=True)
        )
    )
    by_vehicle = {}
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


def _summarise_task(worlds: pa.Table) -> dict[str, Any]:
    """Share of worlds whose task was completed, and how long that took; one row a world.

    The interval of the mean time is Student's, of the worlds that completed theirs.
    """
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


def _compute_quantiles(column: pa.ChunkedArray) -> dict[str, float | None]:
    values = column.to_numpy()
    values = values[np.isfinite(values)]
    if values.size == 0:
        return {"p10": None, "p50": None, "p90": None}
    ten, half, ninety = np.quantile(values, [0.1, 0.5, 0.9])
    return {"p10": float(ten), "p50": float(half), "p90": float(ninety)}
