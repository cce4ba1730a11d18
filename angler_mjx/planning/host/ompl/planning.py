"""What all of OMPL's planners do with a problem."""

import time
from dataclasses import replace

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl import seeing
from angler_mjx.planning.host.ompl.prioritised import one_by_one
from angler_mjx.planning.host.ompl.search import quiet
from angler_mjx.planning.host.ompl.settings import Common
from angler_mjx.planning.host.ompl.shortcut import ways
from angler_mjx.planning.host.ompl.still import still_timed
from angler_mjx.planning.host.ompl.straightening import fewer, straighter, through
from angler_mjx.planning.host.ompl.team import NoWayError, TeamMotion, TeamTask, motion
from angler_mjx.planning.host.ompl.timing import PADDED, apart
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.planner import NoPlan, Path, joint_path, way_points
from angler_mjx.planning.problem import Problem


def begin() -> None:
    """Once in a process, before anything else."""
    quiet()


def planned(
    planner: str, settings: Common, problem: Problem
) -> tuple[list[Path | NoPlan], dict[str, float], list[tuple[float, float]]]:
    """Paths of all robots, what there is to note of them, and how the search got better.

    Args:
        planner: OMPL's name.
        settings: of it.
        problem: arrays of NumPy.
    """
    limit = problem.deadline_s if settings.time_limit_s is None else settings.time_limit_s
    task = TeamTask(
        planner=planner,
        settings=settings,
        seed=(int(problem.seed),),
        end=time.perf_counter() + min(limit, problem.deadline_s),
    )
    known = seeing.seen(problem, settings.moving)
    if settings.mode == "prioritised":
        answers = one_by_one(known, task)
        paths = [_path(answer, 0, settings) for answer in answers]
    else:
        paths = _together(known, task)
    progress = task.progress if settings.mode == "composite" or problem.robots == 1 else []
    return paths, task.extras, progress


def warm_up(planner: str, settings: Common, problem: Problem) -> None:
    """Compiles all that planning such problems needs, and has OMPL look at the parameters."""
    checks = EdgeChecker(problem)
    start = np.asarray(problem.team.start_m, float)
    flat = start.reshape(-1)
    checks.edge_flat(flat, flat)
    checks.state_flat(flat)
    checks.edges(start[None], start[None])
    checks.clearance(start)
    speed = np.asarray(problem.team.cruise_speed_mps, float)
    bent = np.stack([start, start, np.asarray(problem.team.goal_m, float), start])
    straighter(ways(checks), through(ways(checks), bent, speed), speed)
    fewer(ways(checks), bent, speed, 2, 1)
    when, flown = still_timed(bent, speed, settings.turn_radps)
    apart(when, flown[:, 0], 0.0)
    none = Traffic.none()
    checks.timed_edge(0, start[0], 0.0, start[0], np.inf, none)
    checks.timed_edges(0, start[:1], np.zeros(1), start[:1], np.full(1, np.inf), none)
    if problem.current.components:
        problem.current_mps(np.zeros((PADDED, 3), np.float32), np.zeros(PADDED, np.float32))
    planned(planner, replace(settings, first=True), problem)


def _together(problem: Problem, task: TeamTask) -> list[Path | NoPlan]:
    robots = list(range(problem.robots))
    try:
        found = motion(problem, robots, task)
    except seeing.CannotError as error:
        if error.robot is None:
            return [NoPlan(str(error))] * len(robots)
        other = f"robot {error.robot} has no way: {error}"
        return [NoPlan(str(error) if robot == error.robot else other) for robot in robots]
    except NoWayError as error:
        return [NoPlan(str(error))] * len(robots)
    return [_path(found, robot, task.settings) for robot in robots]


def _path(answer: TeamMotion | str, robot: int, settings: Common) -> Path | NoPlan:
    if isinstance(answer, str):
        return NoPlan(answer)
    when, path = apart(answer.time_s, answer.path[:, robot], answer.delay_s)
    if settings.heading:
        return joint_path(when, path[:, :3], path[:, 3])
    return way_points(when, path)
