"""From a problem to a motion of a team and its arms, planned together.

A search finds a path from the start to one of the sampled goals, which is shortened and timed. The
team waits at its start until known moving obstacles let it pass.
"""

import math
import time
import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from angler_mjx.planning.host.ompl.arm_space import BASE_WIDTH, ArmSpace
from angler_mjx.planning.host.ompl.problem_setup import ROUNDING_M, BlockedRobotError
from angler_mjx.planning.host.ompl.search import PlanningOrder, SearchSpace, search_path
from angler_mjx.planning.host.ompl.settings import OmplSettings, ompl_parameters
from angler_mjx.planning.host.ompl.team import (
    DELAY_STEP_S,
    MAX_DELAYS,
    SEARCH_TIME_FRACTION,
    NoPathError,
    TeamMotion,
    TeamTask,
)
from angler_mjx.planning.host.ompl.timing import CurrentTooStrongError, column_rates, time_path
from angler_mjx.planning.path_search.bodies import GOAL_CLEAR_S
from angler_mjx.planning.problem import Problem

GOALS = 16
"""Configurations of each robot at its goal that a search may end at."""

SHORTCUTS = 150
"""Shortcuts that are tried."""

CHECK_DT_S = 0.2
"""Time between two states that are checked against moving obstacles."""

type LegTimes = Callable[[np.ndarray], np.ndarray]
"""Times [k - 1] s that the legs of a path [k, R, 4 + J] take in still water."""


def plan_arm_motion(problem: Problem, task: TeamTask) -> TeamMotion:
    """Return a motion of a team and its arms from their start to their goals.

    Args:
        problem: arrays of NumPy.
        task: how.

    Raises:
        BlockedRobotError: a start is taken, or no free posture reaches a goal.
        NoPathError: there is no path.
    """
    begin = time.perf_counter()
    if problem.team.arms is None:
        raise NoPathError("arm = true, and no robot has joints")
    static = _without_moving(problem)
    margin_m = _fitting_margin_m(static, task.settings.margin_m)
    space = ArmSpace.build(static, range(problem.robots), margin_m)
    random = np.random.default_rng(zlib.crc32(repr((*task.seed, "arm")).encode()))
    goals = _team_goals(space, margin_m, random)
    task.add_extras({"setup_s": time.perf_counter() - begin})
    path = _search(space, goals, task)
    if task.settings.simplify == "shortcut":
        begin = time.perf_counter()
        path = shorten_arm_path(path, space, _leg_times(space, task.settings), random, task.end)
        task.add_extras({"simplify_s": time.perf_counter() - begin})
    return _time_motion(path, problem, space, margin_m, task)


def _without_moving(problem: Problem) -> Problem:
    """Return the problem without moving obstacles."""
    obstacles = problem.obstacles
    stands = np.asarray(obstacles.exists, bool) & ~np.asarray(obstacles.moves, bool)
    return replace(problem, obstacles=replace(obstacles, exists=stands))


def _fitting_margin_m(problem: Problem, margin_m: float) -> float:
    """Return the margin, or less where a start has less room.

    Raises:
        BlockedRobotError: a start is taken.
    """
    space = ArmSpace.build(problem, range(problem.robots), 0.0)
    if not space.state(space.start):
        for robot in range(problem.robots):
            alone = ArmSpace.build(problem, [robot], 0.0)
            if not alone.state(alone.start):
                raise BlockedRobotError("its start is taken or outside", robot)
        raise BlockedRobotError("robots overlap at their starts")
    # Between two robots the margin counts twice.
    room_m = space.clearance(space.start) / (2.0 if problem.robots > 1 else 1.0)
    return max(0.0, min(margin_m, room_m - ROUNDING_M))


def _team_goals(space: ArmSpace, margin_m: float, random: np.random.Generator) -> np.ndarray:
    """Return free configurations [n, R, 4 + J] of the team at its goals.

    Raises:
        BlockedRobotError: there are none.
    """
    rows = []
    for robot in space.robots:
        alone = space
        if len(space.robots) > 1:
            alone = ArmSpace.build(space.problem, [robot], margin_m)
        goals = alone.sample_goals(random, GOALS)
        if not len(goals):
            raise BlockedRobotError("no free posture reaches its goal", robot)
        rows.append(goals)
    picks = [goals[np.arange(GOALS) % len(goals)] for goals in rows]
    team = np.stack(picks, axis=1)[: max(map(len, rows))]
    team = np.array([q for q in team if space.state(q)]).reshape(-1, *team.shape[1:])
    if not len(team):
        raise BlockedRobotError("robots overlap at their goals")
    return team


def _search(space: ArmSpace, goals: np.ndarray, task: TeamTask) -> np.ndarray:
    """Return a path [k, R, 4 + J] to one of the goals [n, R, 4 + J]."""
    settings, remaining_s = task.settings, max(0.0, task.remaining_s())
    order = PlanningOrder(
        planner=task.planner,
        parameters=ompl_parameters(settings),
        seed=(*task.seed, 0),
        limit_s=SEARCH_TIME_FRACTION * remaining_s,
        edge_limit=settings.edge_limit,
        first=settings.first,
        simplify_s=(1.0 - SEARCH_TIME_FRACTION) * remaining_s
        if settings.simplify == "ompl"
        else 0.0,
    )
    searched = SearchSpace(
        low=space.to_columns(space.lower),
        high=space.to_columns(space.upper),
        checked_columns=list(range(len(space.weight_m))),
        edge=lambda a, b: space.edge(space.from_columns(a), space.from_columns(b)),
        state=lambda p: space.state(space.from_columns(p)),
    )
    result = search_path(searched, space.to_columns(space.start), space.to_columns(goals), order)
    task.add_extras(result.extras)
    task.progress = result.progress
    if result.points is None:
        raise NoPathError(f"no way found in {order.limit_s:.3g} s")
    path = space.from_columns(result.points)
    path[0] = space.start
    return path


def _leg_times(space: ArmSpace, settings: OmplSettings) -> LegTimes:
    """Return the function of the times of legs."""
    speed = np.asarray(space.problem.team.cruise_speed_mps, float)
    rates = column_rates(space.problem, settings)

    def leg_times(path: np.ndarray) -> np.ndarray:
        steps = np.abs(np.diff(path, axis=0))
        along_s = np.linalg.norm(steps[..., :3], axis=-1) / speed
        slowest_s = np.maximum(along_s, (steps[..., 3:] / rates).max(axis=-1))
        return np.asarray(slowest_s.max(axis=-1))

    return leg_times


def shorten_arm_path(
    path: np.ndarray,
    space: ArmSpace,
    leg_times: LegTimes,
    random: np.random.Generator,
    end: float,
) -> np.ndarray:
    """Return a quicker path, or the same.

    Between two random points of the path, all columns, or the base or the arm of one robot alone,
    go straight, if that is free and quicker.

    Args:
        path: [k, R, 4 + J]; its edges are free.
        space: of the checks.
        leg_times: time of each leg.
        random: of the points.
        end: of `time.perf_counter`.
    """
    robots, width = path.shape[1:]
    path = _skip_points(path, space, leg_times)
    for _ in range(SHORTCUTS):
        if time.perf_counter() > end or len(path) == 2:
            break
        at = np.concatenate([[0.0], np.cumsum(leg_times(path))])
        low, high = np.sort(random.uniform(0.0, at[-1], 2))
        chosen = np.ones((robots, width), bool)
        if random.uniform() < 0.5:
            chosen[:] = False
            part = slice(0, BASE_WIDTH) if random.uniform() < 0.5 else slice(BASE_WIDTH, width)
            chosen[random.integers(robots), part] = True
        path = _try_shortcut(path, at, (low, high), chosen, space, leg_times)
    return _skip_points(path, space, leg_times)


def _skip_points(path: np.ndarray, space: ArmSpace, leg_times: LegTimes) -> np.ndarray:
    """Return the path without points that a free line, no slower, can pass over."""
    first = 0
    while first < len(path) - 2:
        for last in range(len(path) - 1, first + 1, -1):
            ends = path[[first, last]]
            old_s = leg_times(path[first : last + 1]).sum()
            if leg_times(ends).sum() <= old_s + 1e-6 and space.edge(*ends):
                path = np.delete(path, np.s_[first + 1 : last], axis=0)
                break
        first += 1
    return path


def _try_shortcut(
    path: np.ndarray,
    at: np.ndarray,
    between: tuple[float, float],
    chosen: np.ndarray,
    space: ArmSpace,
    leg_times: LegTimes,
) -> np.ndarray:
    """Return the path with a straight part of the chosen columns, or as it was."""
    low, high = between
    inner = (at > low) & (at < high)
    if not inner.any():
        return path
    times = np.concatenate([[low], at[inner] if not chosen.all() else [], [high]])
    points = np.array([_point_at(path, at, t) for t in times])
    fraction = ((times - low) / (high - low))[:, None, None]
    points = np.where(chosen, points[0] + fraction * (points[-1] - points[0]), points)
    candidate = np.concatenate([path[at <= low], points, path[at >= high]])
    candidate = candidate[np.r_[True, np.abs(np.diff(candidate, axis=0)).max(axis=(1, 2)) > 1e-9]]
    if leg_times(candidate).sum() > leg_times(path).sum() - 1e-3:
        return path
    return candidate if space.path(points) else path


def _point_at(path: np.ndarray, at: np.ndarray, t: float) -> np.ndarray:
    """Return the configuration of a path at a time."""
    k = int(np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2))
    fraction = (t - at[k]) / max(at[k + 1] - at[k], 1e-12)
    point: np.ndarray = path[k] + fraction * (path[k + 1] - path[k])
    return point


def _time_motion(
    path: np.ndarray, problem: Problem, space: ArmSpace, margin_m: float, task: TeamTask
) -> TeamMotion:
    """Return a path in time, after the wait that moving obstacles need."""
    settings = task.settings
    try:
        time_s, path = time_path(path, problem, list(range(problem.robots)), settings)
    except CurrentTooStrongError as error:
        raise NoPathError(str(error)) from error
    if time_s[-1] > problem.horizon_s:
        raise NoPathError(f"the way takes {time_s[-1]:.0f} s of {problem.horizon_s:.0f} s")
    if len(time_s) >= settings.points:
        raise NoPathError(f"the way has {len(time_s)} points; {settings.points} may be flown")
    delay_s = _find_delay(problem, time_s, path, margin_m, task.end)
    if delay_s is None:
        raise NoPathError("what moves is in the way, however long it waits")
    task.add_extras({"delay_s": delay_s, "attempts": 1.0})
    return TeamMotion(time_s=time_s, path=path, delay_s=delay_s)


def _find_delay(
    problem: Problem, time_s: np.ndarray, path: np.ndarray, margin_m: float, end: float
) -> float | None:
    """Return the wait of all robots that avoids what moves; None if none does."""
    obstacles = problem.obstacles
    if not (np.asarray(obstacles.exists, bool) & np.asarray(obstacles.moves, bool)).any():
        return 0.0
    space = ArmSpace.build(problem, range(problem.robots), margin_m)
    max_delay_s = max(0.0, problem.horizon_s - float(time_s[-1]))
    step_s = max(DELAY_STEP_S, max_delay_s / MAX_DELAYS)
    for delay_s in np.arange(0.0, max_delay_s + 1e-9, step_s):
        if time.perf_counter() > end:
            return None
        if _is_clear(space, time_s, path, float(delay_s)):
            return float(delay_s)
    return None


def _is_clear(space: ArmSpace, time_s: np.ndarray, path: np.ndarray, delay_s: float) -> bool:
    """Return whether the team meets nothing, up to `GOAL_CLEAR_S` after its arrival."""
    count = math.ceil((time_s[-1] + delay_s + GOAL_CLEAR_S) / CHECK_DT_S)
    for t in CHECK_DT_S * np.arange(count + 1):
        space.model.at(float(t))
        on_path_s = float(np.clip(t - delay_s, 0.0, time_s[-1]))
        if not space.state(_point_at(path, time_s, on_path_s)):
            return False
    return True
