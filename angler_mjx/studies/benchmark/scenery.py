"""Worlds that are drawn: what they look like, the plans in them, and the flights."""

import sqlite3
from pathlib import Path

import numpy as np

from angler_mjx.planning.problem import Problem
from angler_mjx.runs.storage import atomic_files
from angler_mjx.studies.benchmark import path_archive as bytes_of
from angler_mjx.studies.benchmark.store import BenchmarkStore

FOLDER = "examples"

NOT_FLOWN = "not flown"
"""Outcome of robots of a plan that was not flown."""


def pack_scenery(problem: Problem) -> bytes:
    """What the world of a problem looks like at t = 0, as far as the planner may know."""
    grid, obstacles = problem.grid, problem.obstacles
    exists = np.asarray(obstacles.exists)
    return bytes_of.pack_arrays(
        occupied=np.asarray(grid.occupied, bool),
        origin_m=np.asarray(grid.origin_m),
        cell_m=np.asarray(grid.cell_m),
        floor_z_m=np.asarray(problem.floor_z_m),
        start_m=np.asarray(problem.team.start_m),
        goal_m=np.asarray(problem.team.goal_m),
        obstacle_p_m=np.asarray(obstacles.p_m)[exists, 0],
        obstacle_radius_m=np.asarray(obstacles.radius_m)[exists],
        obstacle_moves=np.asarray(obstacles.moves)[exists],
    )


def write_examples(store: BenchmarkStore, folder: Path) -> int:
    """Write the worlds that a database keeps as files of their own; returns how many.

    ``examples/N.npz``: arrays of `pack_scenery`; ``scene``, ``robots``, ``world``; ``planners``
    [K], and of each k-th ``planned_k`` [R, P, 3] and ``time_k`` [R, P] (NaN where there is no
    more), ``flown_k`` [T, R, 3] and ``outcome_k`` [R].
    """
    examples_folder = folder / FOLDER
    examples_folder.mkdir(exist_ok=True)
    rows = store.rows(
        "SELECT name, robots, world, group_concat(experimentid) AS asked FROM scenery "
        "JOIN experiments ON experiments.id = experimentid "
        "GROUP BY name, robots, problem_seed, world ORDER BY min(experimentid), world"
    )
    for number, row in enumerate(rows):
        arrays = _read_scenery(store, row["asked"], row["world"])
        labels = []
        for k, run in enumerate(_read_runs(store, row["asked"], row["world"])):
            labels.append(run["name"])
            arrays |= {
                f"{name}_{k}": x for name, x in _read_run_arrays(store, run, row["robots"]).items()
            }
        data = bytes_of.pack_arrays(
            scene=row["name"],
            robots=row["robots"],
            world=row["world"],
            planners=np.array(labels, np.str_),
            **arrays,
        )
        atomic_files.write_bytes(examples_folder / f"{number}.npz", data)
    return len(rows)


def _read_scenery(store: BenchmarkStore, experiment_ids: str, world: int) -> dict[str, np.ndarray]:
    """What is known of a world by those who know most of it."""
    rows = store.rows(
        f"SELECT arrays FROM scenery WHERE experimentid IN ({experiment_ids}) AND world = ?",
        (world,),
    )
    return max(
        (bytes_of.unpack_arrays(row["arrays"]) for row in rows),
        key=lambda x: len(x["obstacle_p_m"]),
    )


def _read_runs(store: BenchmarkStore, experiment_ids: str, world: int) -> list[sqlite3.Row]:
    return store.rows(
        "SELECT runs.id, name, paths, track FROM runs "
        "JOIN plannerConfigs ON plannerConfigs.id = plannerid "
        "LEFT JOIN plans ON plans.runid = runs.id LEFT JOIN tracks ON tracks.runid = runs.id "
        f"WHERE experimentid IN ({experiment_ids}) AND world = ? ORDER BY plannerid",
        (world,),
    )


def _read_run_arrays(store: BenchmarkStore, run: sqlite3.Row, robots: int) -> dict[str, np.ndarray]:
    paths = [None] * robots if run["paths"] is None else bytes_of.unpack_paths(run["paths"])
    max_points = max([2, *(len(path.time_s) for path in paths if path is not None)])
    planned = np.full((robots, max_points, 3), np.nan, np.float32)
    time = np.full((robots, max_points), np.nan, np.float32)
    for r, path in enumerate(paths):
        if path is not None:
            points = bytes_of.points_m(path)
            planned[r, : len(points)] = points
            time[r, : len(points)] = path.time_s
    ended = store.rows(
        "SELECT robot, json_extract(episode, '$.outcome') AS outcome FROM robots "
        "WHERE runid = ? ORDER BY robot",
        (run["id"],),
    )
    flown = np.zeros((0, robots, 3), np.float32)
    return {
        "planned": planned,
        "time": time,
        "flown": flown if run["track"] is None else bytes_of.unpack_arrays(run["track"])["p_m"],
        "outcome": np.array([row["outcome"] for row in ended] or [NOT_FLOWN] * robots, np.str_),
    }
