"""What the runs of a sweep come to: rates and means with 95 % intervals, clustered by world."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import pyarrow as pa

from angler_mjx.runs.storage import planning_summary as how_planned
from angler_mjx.runs.storage.confidence_intervals import (
    ClusteredMean,
    clustered_mean,
    clustered_rates,
    wilson_interval,
)
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.results import completion_times, outcome_rates
from angler_mjx.studies.rows import Mean, Rate, RunRow, TaskRow

COSTS = {
    "time_to_goal_s": "of robots that arrived",
    "energy_j": "of robots that arrived",
    "path_length_m": "of robots that arrived",
    "min_clearance_m": "of all robots",
}
"""Columns of episodes whose means are taken, and of whom."""


def measure_run(run: Run) -> RunRow:
    """Return the measures of a run."""
    episodes = run.episodes
    world, arrived = worlds_of(episodes), arrived_of(episodes)
    each = mean_by_world(arrived, world)
    timing = run.summary["timing"]
    return {
        "worlds": len(each),
        "robots": len(run.scenario.members()),
        "problems": run.scenario.digest(),
        "planned": _robot_rate(
            np.asarray(episodes["planned"].to_numpy(zero_copy_only=False)), world
        ),
        "planning": how_planned.summarise_planning(episodes),
        "outcomes": outcome_rates(episodes),
        "team": _world_rate(each == 1.0),
        "task": _measure_task(episodes),
        "time_to_goal_s": _plain_mean(mean_cost(episodes, "time_to_goal_s")),
        "energy_j": _plain_mean(mean_cost(episodes, "energy_j")),
        "path_length_m": _plain_mean(mean_cost(episodes, "path_length_m")),
        "min_clearance_m": _plain_mean(mean_cost(episodes, "min_clearance_m")),
        "vehicle_steps_per_s": timing["vehicle_steps_per_s"],
        "simulate_s": timing["simulate_s"],
        "compile_s": timing["compile_s"],
    }


def cost_means(row: RunRow) -> dict[str, Mean]:
    """Return the mean of each cost of `COSTS`."""
    return {
        "time_to_goal_s": row["time_to_goal_s"],
        "energy_j": row["energy_j"],
        "path_length_m": row["path_length_m"],
        "min_clearance_m": row["min_clearance_m"],
    }


def _world_rate(hit: np.ndarray) -> Rate:
    """Share of worlds, with Wilson's interval."""
    count = int(np.sum(hit))
    low, high = wilson_interval(count, len(hit))
    return {"count": count, "rate": count / len(hit), "low": low, "high": high}


def _measure_task(episodes: pa.Table) -> TaskRow | None:
    when = completion_times(episodes)
    if when is None:
        return None
    mean = clustered_mean(when, np.arange(len(when)))
    return {"completed": _world_rate(np.isfinite(when)), "completed_s": _plain_mean(mean)}


def _robot_rate(hit: np.ndarray, world: np.ndarray) -> Rate:
    """Share of robots, with its interval by world."""
    return asdict(clustered_rates({"yes": hit, "no": ~hit}, world)["yes"])


def _plain_mean(mean: ClusteredMean) -> Mean:
    return {name: finite_or_none(value) for name, value in asdict(mean).items()}


def mean_cost(episodes: pa.Table, name: str) -> ClusteredMean:
    """Mean of a cost, of those robots that it is taken of."""
    values = read_numbers(episodes, name)
    if COSTS[name] != "of all robots":
        values = np.where(arrived_of(episodes), values, np.nan)
    return clustered_mean(values, worlds_of(episodes))


def worlds_of(episodes: pa.Table) -> np.ndarray:
    """[n] world of each row."""
    return np.asarray(episodes["world"].to_numpy())


def arrived_of(episodes: pa.Table) -> np.ndarray:
    """Bool [n]: whether each robot reached its goal."""
    return np.array([name == "reached" for name in episodes["outcome"].to_pylist()], bool)


def read_numbers(episodes: pa.Table, name: str) -> np.ndarray:
    """[n] values of a column, NaN where there is none."""
    return np.asarray(episodes[name].to_numpy(zero_copy_only=False), float)


def mean_by_world(values: np.ndarray, world: Sequence[int] | np.ndarray) -> np.ndarray:
    """[w] means over the robots of each world, in the worlds' order."""
    world_index = np.unique(world, return_inverse=True)[1]
    means: np.ndarray = np.bincount(world_index, weights=values) / np.bincount(world_index)
    return means


def finite_or_none(value: float) -> float | None:
    """Return a number; None for NaN and infinity."""
    return value if np.isfinite(value) else None
