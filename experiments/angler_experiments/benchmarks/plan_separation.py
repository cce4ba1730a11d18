"""Separation of the robots of planned teams, by their plans alone.

    python -m angler_experiments.benchmarks.plan_separation runs/reference

Every whole team of two or more, in closed form: between two way-points of any of its robots all of
them move straight, so the distance of two is least where that of two lines is. Rock is ignored.
Shares no code with planners, nor with the simulator's judgement.
"""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from angler_mjx.robot.control import plans
from angler_mjx.robot.vehicles import library
from angler_mjx.studies.benchmark.path_archive import unpack_paths
from angler_mjx.studies.benchmark.store import BenchmarkStore

QUERY = """
    SELECT plans.paths, plannerConfigs.name, runs.robots_planned AS robots, robots.text AS robots_of
    FROM runs
    JOIN plans ON plans.runid = runs.id
    JOIN plannerConfigs ON plannerConfigs.id = runs.plannerid
    JOIN (SELECT runid, json_group_array(json(episode)) AS text FROM robots GROUP BY runid)
        AS robots ON robots.runid = runs.id
    WHERE runs.robots_planned > 1
"""


def min_gap_m(times: list[np.ndarray], positions: list[np.ndarray], radius: np.ndarray) -> float:
    """Return the least distance of two of a team's spheres, m; negative where they overlap.

    Args:
        times: [n] s times of each robot's way-points, from 0; held after the last.
        positions: [n, 3] m positions of the way-points.
        radius: [R] m radii of the spheres.
    """
    knots = np.unique(np.concatenate(times))
    knots = np.append(knots, knots[-1] + 1.0)  # at the end all robots hold their positions
    positions_m = np.stack(
        [
            np.stack([np.interp(knots, t, p[:, axis]) for axis in range(3)], axis=-1)
            for t, p in zip(times, positions, strict=True)
        ]
    )
    first, other = np.triu_indices(len(times), k=1)
    separation = positions_m[first] - positions_m[other]
    offset, step = separation[:, :-1], np.diff(separation, axis=1)
    square = np.sum(step * step, axis=-1)
    fraction = -np.sum(offset * step, axis=-1) / np.where(square > 0.0, square, 1.0)
    nearest = offset + np.clip(fraction, 0.0, 1.0)[..., None] * step
    distance = np.sqrt(np.sum(nearest * nearest, axis=-1)).min(axis=1)
    return float(np.min(distance - radius[first] - radius[other]))


def main(folder: Annotated[Path, tyro.conf.Positional]) -> None:
    """Print the least distance by planner.

    Args:
        folder: Results folder of a benchmark.
    """
    gaps: dict[str, list[float]] = {}
    with BenchmarkStore(folder / "results.sqlite", only_read=True) as store:
        for row in store.rows(QUERY):
            paths = unpack_paths(row["paths"])
            robots = sorted(json.loads(row["robots_of"]), key=lambda robot: robot["robot"])
            if any(path is None for path in paths):
                continue
            trajectories = [plans.trace_path(path) for path in paths if path is not None]
            radius = np.array(
                [library.reach_m(library.load_vehicle(robot["vehicle"])) for robot in robots]
            )
            gap = min_gap_m([t for t, _ in trajectories], [p for _, p in trajectories], radius)
            gaps.setdefault(row["name"], []).append(gap)
    print("| planner | teams of two or more | spheres at least apart, m |\n|---|---|---|")
    for name, planner_gaps in gaps.items():
        print(f"| {name} | {len(planner_gaps)} | {min(planner_gaps):.3f} |")


if __name__ == "__main__":
    tyro.cli(main)
