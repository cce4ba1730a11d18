"""Conformance checks of any planner.

    from angler_mjx.testing import check_planner
    check_planner(MyPlanner, simulator.problems(0, 3))

A planner on the host is created anew for each check, so that leftover state is detected.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace

import jax
import numpy as np

from angler_mjx.host_arrays import as_leaf
from angler_mjx.planning.answers import check_paths
from angler_mjx.planning.planner import NoPlan, Planner
from angler_mjx.planning.problem import Problem
from angler_mjx.testing.driving import NonConformanceError

MAX_DEADLINE_RATIO = 1.1
"""Max ratio of a planner's time to its deadline."""


def check_planner(
    make: Callable[[], Planner], problems: Sequence[Problem], *, repeats: bool = True
) -> None:
    """Run all checks of a planner of the host.

    Args:
        make: factory of the planner.
        problems: at least two, in arrays of NumPy (`Simulator.problems`).
        repeats: whether the same problem must give the same plan; not so for planners stopped by
            the clock.

    Raises:
        NonConformanceError: listing the failures.
    """
    if len(problems) < 2:
        raise NonConformanceError("give at least two problems")
    faults: list[str] = []
    for problem in problems:
        faults += _check_answers(make(), problem)
    if not faults and repeats:
        faults += _check_repeatable(make, problems)
    if not faults:
        faults += _check_single_robot(make(), problems[0])
        faults += _check_unreachable_goal(make(), problems[0])
    if faults:
        raise NonConformanceError("\n".join(dict.fromkeys(faults)))


def _check_answers(planner: Planner, problem: Problem) -> list[str]:
    """Check for one sound path per robot, or a reason; in time; with the problem unchanged."""
    before = jax.tree.map(np.array, problem)
    start_s = time.perf_counter()
    returned = planner.plan(problem)
    elapsed_s = time.perf_counter() - start_s
    faults = [
        f"{_problem_label(problem)}: robot {robot}: {path.reason}"
        for robot, path in enumerate(check_paths(returned, problem))
        if isinstance(path, NoPlan) and not _is_reported_failure(returned, robot)
    ]
    if elapsed_s > MAX_DEADLINE_RATIO * problem.deadline_s:
        faults.append(
            f"{_problem_label(problem)}: took {elapsed_s:.3g} s; it had {problem.deadline_s:g} s"
        )
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(problem), strict=True)
    if any(not np.array_equal(a, b, equal_nan=True) for a, b in pairs):
        faults.append(f"{_problem_label(problem)}: the planner changed the problem's arrays")
    return faults


def _check_repeatable(make: Callable[[], Planner], problems: Sequence[Problem]) -> list[str]:
    """Check for the same plan of the same problem: by another planner, and after other problems."""
    first, second = problems[:2]
    planner, other_planner = make(), make()
    reference = planner.plan(first)
    faults = []
    if not _is_same_plan(reference, other_planner.plan(first)):
        faults.append(f"{_problem_label(first)}: planned twice, gives two plans")
    other_planner.plan(second)
    if not _is_same_plan(reference, other_planner.plan(first)):
        faults.append(f"{_problem_label(first)}: gives another plan after {_problem_label(second)}")
    return faults


def _check_single_robot(planner: Planner, problem: Problem) -> list[str]:
    """Check a team of one robot."""
    single = replace(problem, team=jax.tree.map(lambda leaf: leaf[:1], problem.team))
    return [f"team of one: {fault}" for fault in _check_answers(planner, single)]


def _check_unreachable_goal(planner: Planner, problem: Problem) -> list[str]:
    """Check a goal inside of rock: no error, and no path for its robot."""
    rock = as_leaf(np.ones_like(problem.grid.occupied))
    walled = replace(problem, grid=replace(problem.grid, occupied=rock))
    try:
        returned = planner.plan(walled)
    except Exception as error:
        return [f"a world of rock: raises {type(error).__name__} ({error}); give NoPlan(reason)"]
    if len(returned) != problem.robots:
        return [f"a world of rock: gives {len(returned)} answers for {problem.robots} robots"]
    return []


def _is_reported_failure(returned: Sequence[object], robot: int) -> bool:
    """Return whether the planner itself reported that there is no path."""
    try:
        return isinstance(returned[robot], NoPlan)
    except (TypeError, IndexError, KeyError):
        return False


def _is_same_plan(a: Sequence[object], b: Sequence[object]) -> bool:
    return len(a) == len(b) and all(_is_same_path(x, y) for x, y in zip(a, b, strict=True))


def _is_same_path(a: object, b: object) -> bool:
    if type(a) is not type(b):
        return False
    if isinstance(a, NoPlan | type) or not is_dataclass(a):
        return bool(a == b)
    return all(
        np.array_equal(np.asarray(getattr(a, item.name)), np.asarray(getattr(b, item.name)))
        for item in fields(a)
    )


def _problem_label(problem: Problem) -> str:
    return "problem" if problem.name is None else str(problem.name)
