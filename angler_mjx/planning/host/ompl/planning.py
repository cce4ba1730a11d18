"""From a problem to paths, for all planners of OMPL."""

import time
from dataclasses import replace

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl import problem_setup
from angler_mjx.planning.host.ompl.arm_space import BASE_WIDTH
from angler_mjx.planning.host.ompl.arm_team import plan_arm_motion
from angler_mjx.planning.host.ompl.prioritised import plan_sequentially
from angler_mjx.planning.host.ompl.search import silence_log
from angler_mjx.planning.host.ompl.settings import OmplSettings
from angler_mjx.planning.host.ompl.shortcut import build_smoothing_problem
from angler_mjx.planning.host.ompl.still_water_timing import time_in_still_water
from angler_mjx.planning.host.ompl.straightening import (
    reduce_points,
    shortest_through_points,
    straighten_path,
)
from angler_mjx.planning.host.ompl.team import NoPathError, TeamMotion, TeamTask, plan_motion
from angler_mjx.planning.host.ompl.timing import PADDED, robot_waypoints
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.planner import NoPlan, Path, joint_path, way_points
from angler_mjx.planning.problem import Problem

DEADLINE_FRACTION = 0.99
"""Of the deadline: what follows a search that its end cut off, and the way back to whoever timed
it, take milliseconds."""


def begin() -> None:
    """Prepare OMPL once in a process, before anything else."""
    silence_log()


def planned(
    planner: str, settings: OmplSettings, problem: Problem
) -> tuple[list[Path | NoPlan], dict[str, float], list[tuple[float, float]]]:
    """Return paths of all robots, the numbers to note, and the progress of the search.

    Args:
        planner: OMPL's name.
        settings: of it.
        problem: arrays of NumPy.
    """
    limit_s = problem.deadline_s if settings.time_limit_s is None else settings.time_limit_s
    task = TeamTask(
        planner=planner,
        settings=settings,
        seed=(int(problem.seed),),
        end=time.perf_counter() + min(limit_s, DEADLINE_FRACTION * problem.deadline_s),
    )
    visible_problem = problem_setup.apply_moving_choice(problem, settings.moving)
    if settings.mode == "prioritised":
        answers = plan_sequentially(visible_problem, task)
        paths = [_build_path(answer, 0, settings) for answer in answers]
    else:
        paths = _plan_together(visible_problem, task)
    progress = task.progress if settings.mode == "composite" or problem.robots == 1 else []
    return paths, task.extras, progress


def warm_up(planner: str, settings: OmplSettings, problem: Problem) -> None:
    """Compile the functions that such problems need, and let OMPL check the parameters."""
    if settings.arm:
        planned(planner, replace(settings, first=True), problem)
        return
    checks = EdgeChecker(problem)
    start = np.asarray(problem.team.start_m, float)
    flat = start.reshape(-1)
    checks.edge_flat(flat, flat)
    checks.state_flat(flat)
    checks.edges(start[None], start[None])
    checks.clearance(start)
    speed = np.asarray(problem.team.cruise_speed_mps, float)
    bent_path = np.stack([start, start, np.asarray(problem.team.goal_m, float), start])
    straighten_path(
        build_smoothing_problem(checks),
        shortest_through_points(build_smoothing_problem(checks), bent_path, speed),
        speed,
    )
    reduce_points(build_smoothing_problem(checks), bent_path, speed, 2, 1)
    time_s, flown = time_in_still_water(bent_path, speed, settings.turn_radps)
    robot_waypoints(time_s, flown[:, 0], 0.0)
    no_traffic = Traffic.none()
    checks.timed_edge(0, start[0], 0.0, start[0], np.inf, no_traffic)
    checks.timed_edges(0, start[:1], np.zeros(1), start[:1], np.full(1, np.inf), no_traffic)
    if problem.current.components:
        problem.current_mps(np.zeros((PADDED, 3), np.float32), np.zeros(PADDED, np.float32))
    planned(planner, replace(settings, first=True), problem)


def _plan_together(problem: Problem, task: TeamTask) -> list[Path | NoPlan]:
    robots = list(range(problem.robots))
    try:
        if task.settings.arm:
            team_motion = plan_arm_motion(problem, task)
        else:
            team_motion = plan_motion(problem, robots, task)
    except problem_setup.BlockedRobotError as error:
        if error.robot is None:
            return [NoPlan(str(error))] * len(robots)
        other = f"robot {error.robot} has no way: {error}"
        return [NoPlan(str(error) if robot == error.robot else other) for robot in robots]
    except NoPathError as error:
        return [NoPlan(str(error))] * len(robots)
    if task.settings.arm:
        return [_build_arm_path(team_motion, robot, problem.joint_names) for robot in robots]
    return [_build_path(team_motion, robot, task.settings) for robot in robots]


def _build_arm_path(motion: TeamMotion, robot: int, names: tuple[str, ...]) -> Path:
    time_s, path = robot_waypoints(motion.time_s, motion.path[:, robot], motion.delay_s)
    arm = dict(zip(names, path.T[BASE_WIDTH:], strict=True))
    return joint_path(time_s, path[:, :3], path[:, 3], arm=arm)


def _build_path(answer: TeamMotion | str, robot: int, settings: OmplSettings) -> Path | NoPlan:
    if isinstance(answer, str):
        return NoPlan(answer)
    time_s, path = robot_waypoints(answer.time_s, answer.path[:, robot], answer.delay_s)
    if settings.heading:
        return joint_path(time_s, path[:, :3], path[:, 3])
    return way_points(time_s, path)
