"""What is measured of a plan, and of its flight."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from angler_mjx.planning.answers import Answer
from angler_mjx.planning.planner import NoPlan, Path
from angler_mjx.robot.control.plans import trace_path
from angler_mjx.runs.storage import results

type Row = dict[str, object]

MIN_LEG_M = 1e-3
"""A leg between points that are nearer turns nobody."""


def measure_answer(answer: Answer) -> Row:
    """Columns of a plan, by the names of `angler_mjx.studies.benchmark.columns`."""
    paths = [path for path in answer.paths if not isinstance(path, NoPlan)]
    whole = len(paths) == len(answer.paths)
    seconds = answer.planning_s
    row: Row = {
        "planning_s": seconds,
        "warm_up_s": answer.extras.get("warm_up_s"),
        "first_s": answer.extras.get("first_s", seconds) if whole else None,
        "best_s": answer.extras.get("best_s", seconds) if whole else None,
        "planned": whole,
        "robots_planned": len(paths),
    }
    return {**row, **(measure_paths(paths) if whole else {})}


def measure_paths(paths: Sequence[Path]) -> Row:
    """Length, times and turning of the paths of a whole team."""
    ends = [float(path.time_s[-1]) for path in paths]
    return {
        "plan_length_m": float(sum(length_m(trace_path(path)[1]) for path in paths)),
        "plan_makespan_s": max(ends),
        "plan_flowtime_s": float(sum(ends)),
        "plan_turn_rad": float(np.mean([turn_rad(trace_path(path)[1]) for path in paths])),
    }


def length_m(points: np.ndarray) -> float:
    """Length of the lines between points [n, 3], m."""
    return float(np.linalg.norm(np.diff(points.astype(float), axis=0), axis=1).sum())


def turn_rad(points: np.ndarray) -> float:
    """Sum of the angles by which lines between points [n, 3] turn, rad."""
    legs = np.diff(points.astype(float), axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    unit = legs[lengths > MIN_LEG_M] / lengths[lengths > MIN_LEG_M][:, None]
    # The half angle's tangent is exact for small angles, where the cosine is not.
    apart = np.linalg.norm(unit[1:] - unit[:-1], axis=1)
    along = np.linalg.norm(unit[1:] + unit[:-1], axis=1)
    return float((2.0 * np.arctan2(apart, along)).sum())


def measure_flight(robots: Sequence[Mapping[str, Any]], whole: bool) -> Row:
    """Columns of a flight.

    Args:
        robots: rows of `angler_mjx.runs.storage.episode_columns.EPISODE_SCHEMA`, of all robots of a
            world.
        whole: whether each of them had a path, or needed none.
    """
    reached = [robot for robot in robots if robot["outcome"] == "reached"]
    success = whole and len(reached) == len(robots)
    row: Row = {
        "flown": True,
        "robots_reached": len(reached),
        "reached": len(reached) == len(robots),
        "success": success,
        "path_length_m": float(sum(robot["path_length_m"] for robot in robots)),
        "energy_j": float(sum(robot["energy_j"] for robot in robots)),
        "min_clearance_m": float(min(robot["min_clearance_m"] for robot in robots)),
        "min_separation_m": _min_or_none([robot["min_separation_m"] for robot in robots]),
        "failed_replans": _sum_or_none([robot.get("failed_replans") for robot in robots]),
    }
    if success:
        ends = [float(robot["time_to_goal_s"]) for robot in robots]
        row |= {"makespan_s": max(ends), "flowtime_s": float(sum(ends))}
        row["late_s"] = _max_or_none([robot["late_s"] for robot in robots])
    failed = [robot for robot in robots if robot["outcome"] != "reached"]
    if failed:
        first = min(failed, key=results.end_time_s)
        row |= {
            "failure": first["outcome"],
            "failure_robot": first["robot"],
            "failure_time_s": first["failure_time_s"],
            "failure_x_m": first["failure_x_m"],
            "failure_y_m": first["failure_y_m"],
            "failure_z_m": first["failure_z_m"],
            "failure_pair": first["failure_pair"],
        }
    return row


def _min_or_none(values: Sequence[float | None]) -> float | None:
    present = [value for value in values if value is not None]
    return float(min(present)) if present else None


def _max_or_none(values: Sequence[float | None]) -> float | None:
    present = [value for value in values if value is not None]
    return float(max(present)) if present else None


def _sum_or_none(values: Sequence[int | None]) -> int | None:
    present = [value for value in values if value is not None]
    return sum(present) if present else None
