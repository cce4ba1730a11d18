"""Robot after robot: each plans alone, among the paths of those before it.

At first a path is searched in space, past the balls of robots that stand: those before it at their
goals, those after it at their starts, unless they are on its own start or goal. It is flown at
constant speed along each of its edges, and set off as soon as no earlier robot's path and no
obstacle known to move is met in time. Where a robot has no way so, as where two swap places in a
gap, all begin anew in another order: by turns in space and time (`spacetime`), where those after it
are not in its way, and in space. The ways of earlier robots are never changed. If no order gives
all of them a way, that in space with most ways stands; robots without one hold their starts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from angler_mjx.planning.host.ompl import seeing
from angler_mjx.planning.host.ompl.spacetime import motion as in_time
from angler_mjx.planning.host.ompl.team import NoWayError, TeamMotion, TeamTask
from angler_mjx.planning.host.ompl.team import motion as together
from angler_mjx.planning.host.ompl.timing import apart
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.problem import Problem

ORDERS = 8
"""That are tried while there is time, after the first: by turns in space and time, and in space."""


def one_by_one(problem: Problem, task: TeamTask) -> list[TeamMotion | str]:
    """A motion of each robot, or why it has none.

    Args:
        problem: arrays of NumPy.
        task: how; its notes are of all robots and orders together.
    """
    robots = list(range(problem.robots))
    best = _in_order(problem, robots, [], task, standing=True)
    if _planned(best) == len(robots):
        return [best[robot] for robot in robots]
    random = np.random.default_rng(task.seed)
    taken = _taken(problem, task)
    able = [robot for robot in robots if robot not in taken]
    order = able
    for attempt in range(ORDERS):
        if task.left() <= 0.0 or _planned(best) == len(able):
            break
        standing = attempt % 2 == 1
        again = replace(task, seed=(*task.seed, attempt))
        tried = _in_order(problem, order, sorted(taken), again, standing)
        if _planned(tried) > _planned(best) and (standing or _planned(tried) == len(able)):
            best = tried
        order = random.permutation(able).tolist()
    return [taken.get(robot, best.get(robot, "")) for robot in robots]


def _planned(answers: Mapping[int, TeamMotion | str]) -> int:
    return sum(isinstance(answer, TeamMotion) for answer in answers.values())


def _taken(problem: Problem, task: TeamTask) -> dict[int, TeamMotion | str]:
    """Robots that cannot be at their start or goal, whoever else is where; and why."""
    found: dict[int, TeamMotion | str] = {}
    for robot in range(problem.robots):
        try:
            seeing.checker(problem, [robot], task.settings.margin_m)
        except seeing.CannotError as error:
            found[robot] = str(error)
    return found


def _in_order(
    problem: Problem, order: list[int], held: list[int], task: TeamTask, standing: bool
) -> dict[int, TeamMotion | str]:
    """Motions of robots in an order, of which some more hold their starts.

    Args:
        problem: arrays of NumPy.
        order: of the robots.
        held: others, which stand.
        task: how.
        standing: whether all are taken to stand at their starts before, and their goals after,
            their motion; in space and time, only those that stay there are looked at.
    """
    goal = np.asarray(problem.team.goal_m, float)
    radius = np.asarray(problem.team.radius_m, float)
    stands = np.array(problem.team.start_m, float)
    answers: dict[int, TeamMotion | str] = {}
    for number, robot in enumerate(order):
        others = held + (_beside(problem, robot, order, stands, task) if standing else [])
        alone = seeing.among(problem, stands[others], radius[others])
        traffic = _traffic([(answers[k], radius[k]) for k in answers])
        own = replace(task, seed=(*task.seed, robot, standing))
        share = 1.0 / (len(order) - number + standing)
        try:
            plan = together if standing else in_time
            answers[robot] = plan(alone, [robot], own, traffic, share)
            stands[robot] = goal[robot]
        except (NoWayError, seeing.CannotError) as error:
            answers[robot] = str(error)
            if not standing:
                break
    return _without_blocked(problem, answers, task)


def _without_blocked(
    problem: Problem, answers: dict[int, TeamMotion | str], task: TeamTask
) -> dict[int, TeamMotion | str]:
    """The same, but nobody goes where a robot that has no way holds its start."""
    start = np.asarray(problem.team.start_m, float)
    answers = dict(answers)
    while True:
        failed = [robot for robot, one in answers.items() if isinstance(one, str)]
        blocked = {
            robot: f"robot {other} has no way and stays where it has to be"
            for robot in answers
            if robot not in failed
            for other in failed
            if other not in _beside(problem, robot, failed, start, task)
        }
        if not blocked:
            return answers
        answers |= blocked


def _beside(
    problem: Problem, robot: int, order: Sequence[int], stands: np.ndarray, task: TeamTask
) -> list[int]:
    """Others that a robot goes around where they stand: all that are not at its start or goal."""
    radius = np.asarray(problem.team.radius_m, float)
    own = [np.asarray(end, float)[robot] for end in (problem.team.start_m, problem.team.goal_m)]
    found = []
    for other in order:
        room = radius[robot] + radius[other] + 2.0 * task.settings.margin_m
        gap = min(np.linalg.norm(stands[other] - end) for end in own)
        if other != robot and gap > room:
            found.append(other)
    return found


def _traffic(movers: Sequence[tuple[TeamMotion | str, float]]) -> Traffic:
    """Paths of robots with a motion, all with as many points."""
    paths = [
        (*apart(each.time_s, each.path[:, 0, :3], each.delay_s), radius)
        for each, radius in movers
        if isinstance(each, TeamMotion)
    ]
    if not paths:
        return Traffic.none()
    most = max(len(when) for when, _, _ in paths)
    return Traffic.of(
        np.stack([np.pad(when, (0, most - len(when)), "edge") for when, _, _ in paths]),
        np.stack([np.pad(p, ((0, most - len(p)), (0, 0)), "edge") for _, p, _ in paths]),
        np.array([radius for _, _, radius in paths]),
    )
