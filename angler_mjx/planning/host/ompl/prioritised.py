"""Prioritised planning: each robot plans alone, among the paths of the robots before it.

At first a path is searched in space, past balls of standing robots: earlier ones at their goals,
later ones at their starts, unless they are on its own start or goal. Each edge has a constant
speed, and the departure is the first at which no path of an earlier robot and no known moving
obstacle is met. If a robot has no such path, as when two swap positions in a gap, all begin again
in another order: in turns in space and time (`spacetime`), where later robots are ignored, and in
space. Paths of earlier robots are never changed. If no order gives a path to all robots, the order
in space with most paths is used; robots without a path hold their starts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from angler_mjx.planning.host.ompl import problem_setup
from angler_mjx.planning.host.ompl.spacetime import plan_spacetime_motion as in_time
from angler_mjx.planning.host.ompl.team import NoPathError, TeamMotion, TeamTask
from angler_mjx.planning.host.ompl.team import plan_motion as together
from angler_mjx.planning.host.ompl.timing import robot_waypoints
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.problem import Problem

MAX_ORDERS = 8
"""That are tried while there is time, after the first: by turns in space and time, and in space."""


def plan_sequentially(problem: Problem, task: TeamTask) -> list[TeamMotion | str]:
    """Return a motion of each robot, or the reason for none.

    Args:
        problem: arrays of NumPy.
        task: how; its notes are of all robots and orders together.
    """
    robots = list(range(problem.robots))
    best = _plan_in_order(problem, robots, [], task, standing=True)
    if _count_planned(best) == len(robots):
        return [best[robot] for robot in robots]
    random = np.random.default_rng(task.seed)
    unplannable = _find_blocked(problem, task)
    plannable = [robot for robot in robots if robot not in unplannable]
    order = plannable
    for attempt in range(MAX_ORDERS):
        if task.remaining_s() <= 0.0 or _count_planned(best) == len(plannable):
            break
        standing = attempt % 2 == 1
        again = replace(task, seed=(*task.seed, attempt))
        attempt_answers = _plan_in_order(problem, order, sorted(unplannable), again, standing)
        if _count_planned(attempt_answers) > _count_planned(best) and (
            standing or _count_planned(attempt_answers) == len(plannable)
        ):
            best = attempt_answers
        order = random.permutation(plannable).tolist()
    return [unplannable.get(robot, best.get(robot, "")) for robot in robots]


def _count_planned(answers: Mapping[int, TeamMotion | str]) -> int:
    return sum(isinstance(answer, TeamMotion) for answer in answers.values())


def _find_blocked(problem: Problem, task: TeamTask) -> dict[int, TeamMotion | str]:
    """Return robots that cannot be at their start or goal wherever the others are, with reasons."""
    reasons: dict[int, TeamMotion | str] = {}
    for robot in range(problem.robots):
        try:
            problem_setup.build_checker(problem, [robot], task.settings.margin_m)
        except problem_setup.BlockedRobotError as error:
            reasons[robot] = str(error)
    return reasons


def _plan_in_order(
    problem: Problem, order: list[int], held: list[int], task: TeamTask, standing: bool
) -> dict[int, TeamMotion | str]:
    """Return motions of robots in an order; additional robots hold their starts.

    Args:
        problem: arrays of NumPy.
        order: of the robots.
        held: others, which stand.
        task: how.
        standing: whether all are taken to stand at their starts before, and their goals after,
            their motion; in space and time, only those that stay there are avoided.
    """
    goal = np.asarray(problem.team.goal_m, float)
    radius = np.asarray(problem.team.radius_m, float)
    positions_m = np.array(problem.team.start_m, float)
    answers: dict[int, TeamMotion | str] = {}
    for number, robot in enumerate(order):
        others = held + (
            _others_to_avoid(problem, robot, order, positions_m, task) if standing else []
        )
        visible_problem = problem_setup.add_standing_balls(
            problem, positions_m[others], radius[others]
        )
        traffic = _build_traffic([(answers[k], radius[k]) for k in answers])
        robot_task = replace(task, seed=(*task.seed, robot, standing))
        time_fraction = 1.0 / (len(order) - number + standing)
        try:
            plan = together if standing else in_time
            answers[robot] = plan(visible_problem, [robot], robot_task, traffic, time_fraction)
            positions_m[robot] = goal[robot]
        except (NoPathError, problem_setup.BlockedRobotError) as error:
            answers[robot] = str(error)
            if not standing:
                break
    return _remove_blocked(problem, answers, task)


def _remove_blocked(
    problem: Problem, answers: dict[int, TeamMotion | str], task: TeamTask
) -> dict[int, TeamMotion | str]:
    """Return the motions that pass no start that a robot without a path holds."""
    start = np.asarray(problem.team.start_m, float)
    answers = dict(answers)
    while True:
        failed = [robot for robot, answer in answers.items() if isinstance(answer, str)]
        blocked = {
            robot: f"robot {other} has no way and stays where it has to be"
            for robot in answers
            if robot not in failed
            for other in failed
            if other not in _others_to_avoid(problem, robot, failed, start, task)
        }
        if not blocked:
            return answers
        answers |= blocked


def _others_to_avoid(
    problem: Problem, robot: int, order: Sequence[int], stands: np.ndarray, task: TeamTask
) -> list[int]:
    """Return robots to go around where they stand: all that are not at its start or goal."""
    radius = np.asarray(problem.team.radius_m, float)
    ends_m = [np.asarray(end, float)[robot] for end in (problem.team.start_m, problem.team.goal_m)]
    others = []
    for other in order:
        min_gap_m = radius[robot] + radius[other] + 2.0 * task.settings.margin_m
        gap = min(np.linalg.norm(stands[other] - end) for end in ends_m)
        if other != robot and gap > min_gap_m:
            others.append(other)
    return others


def _build_traffic(movers: Sequence[tuple[TeamMotion | str, float]]) -> Traffic:
    """Return paths of robots with a motion, padded to the same number of points."""
    paths = [
        (*robot_waypoints(each.time_s, each.path[:, 0, :3], each.delay_s), radius)
        for each, radius in movers
        if isinstance(each, TeamMotion)
    ]
    if not paths:
        return Traffic.none()
    max_points = max(len(time_s) for time_s, _, _ in paths)
    return Traffic.of(
        np.stack([np.pad(time_s, (0, max_points - len(time_s)), "edge") for time_s, _, _ in paths]),
        np.stack([np.pad(p, ((0, max_points - len(p)), (0, 0)), "edge") for _, p, _ in paths]),
        np.array([radius for _, _, radius in paths]),
    )
