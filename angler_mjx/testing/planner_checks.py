"""What any planner must do, check by check.

    from angler_mjx.testing import check_planner
    check_planner(MyPlanner, simulator.problems(0, 3))

A planner on the host is made anew for each check, so that what one leaves behind is seen.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import jax
import numpy as np

from angler_mjx.planning.answers import checked
from angler_mjx.planning.planner import NoPlan, Planner
from angler_mjx.planning.problem import Problem
from angler_mjx.testing.driving import NonConformanceError

LATE = 1.1
"""Of its deadline that a planner may take."""


def check_planner(
    make: Callable[[], Planner], problems: Sequence[Problem], *, repeats: bool = True
) -> None:
    """Put a planner of the host through all checks.

    Args:
        make: the planner, anew.
        problems: at least two, in arrays of NumPy (`Simulator.problems`).
        repeats: whether the same problem must give the same plan; not so for planners that the
            clock stops.

    Raises:
        NonConformanceError: listing what does not hold.
    """
    if len(problems) < 2:
        raise NonConformanceError("give at least two problems")
    faults: list[str] = []
    for problem in problems:
        faults += _answers(make(), problem)
    if not faults and repeats:
        faults += _repeats(make, problems)
    if not faults:
        faults += _alone(make(), problems[0])
        faults += _impossible(make(), problems[0])
    if faults:
        raise NonConformanceError("\n".join(dict.fromkeys(faults)))


def _answers(planner: Planner, problem: Problem) -> list[str]:
    """One sound path a robot, or why not; in time; nothing of the problem changed."""
    before = jax.tree.map(np.array, problem)
    begun = time.perf_counter()
    given = planner.plan(problem)
    taken = time.perf_counter() - begun
    faults = [
        f"{_which(problem)}: robot {robot}: {path.reason}"
        for robot, path in enumerate(checked(given, problem))
        if isinstance(path, NoPlan) and not _meant(given, robot)
    ]
    if taken > LATE * problem.deadline_s:
        faults.append(f"{_which(problem)}: took {taken:.3g} s; it had {problem.deadline_s:g} s")
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(problem), strict=True)
    if any(not np.array_equal(a, b, equal_nan=True) for a, b in pairs):
        faults.append(f"{_which(problem)}: the planner changed the problem's arrays")
    return faults


def _repeats(make: Callable[[], Planner], problems: Sequence[Problem]) -> list[str]:
    """The same problem, the same plan: by another planner, and after other problems."""
    first, second = problems[:2]
    alone, again = make(), make()
    once = alone.plan(first)
    faults = []
    if not _same(once, again.plan(first)):
        faults.append(f"{_which(first)}: planned twice, gives two plans")
    again.plan(second)
    if not _same(once, again.plan(first)):
        faults.append(f"{_which(first)}: gives another plan after {_which(second)}")
    return faults


def _alone(planner: Planner, problem: Problem) -> list[str]:
    """A team of one is a team."""
    one = replace(problem, team=jax.tree.map(lambda leaf: leaf[:1], problem.team))
    return [f"team of one: {fault}" for fault in _answers(planner, one)]


def _impossible(planner: Planner, problem: Problem) -> list[str]:
    """A goal inside of rock is no error: its robot has no path."""
    rock: Any = np.ones_like(problem.grid.occupied)
    walled = replace(problem, grid=replace(problem.grid, occupied=rock))
    try:
        given = planner.plan(walled)
    except Exception as error:
        return [f"a world of rock: raises {type(error).__name__} ({error}); give NoPlan(reason)"]
    if len(given) != problem.robots:
        return [f"a world of rock: gives {len(given)} answers for {problem.robots} robots"]
    return []


def _meant(given: Any, robot: int) -> bool:
    """Whether the planner itself said that there is no path."""
    try:
        return isinstance(given[robot], NoPlan)
    except (TypeError, IndexError, KeyError):
        return False


def _same(a: Sequence[Any], b: Sequence[Any]) -> bool:
    return len(a) == len(b) and all(_alike(x, y) for x, y in zip(a, b, strict=True))


def _alike(a: Any, b: Any) -> bool:
    if type(a) is not type(b):
        return False
    if isinstance(a, NoPlan) or not is_dataclass(a):
        return bool(a == b)
    return all(
        np.array_equal(np.asarray(getattr(a, one.name)), np.asarray(getattr(b, one.name)))
        for one in fields(a)
    )


def _which(problem: Problem) -> str:
    return "problem" if problem.name is None else str(problem.name)
