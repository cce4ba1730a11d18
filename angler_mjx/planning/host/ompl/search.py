"""One search of OMPL: from a team's start to its goal, in the space of all its numbers.

The space is RealVector of x, y, z (and heading) of each robot. Its edges are looked at whole, by
the compiled check, and never by states between. OMPL takes its seed from a generator that gives
one to each sampler as it is made; setting it before they are made fixes them all, any number of
times in a process (OMPL says an error then, which is switched off).
"""

import math
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from angler_mjx.errors import ConfigError

type Edge = Callable[[np.ndarray, np.ndarray], bool]
type State = Callable[[np.ndarray], bool]

ANYTIME = ("AORRTC", "BITstar", "RRTstar", "InformedRRTstar", "SORRTstar")
"""Go on improving until they are stopped, and tell their best cost meanwhile."""

ROADMAPS = ("PRM", "PRMstar")
"""Look for the solution in a thread of their own: no Python may say when they end."""

ONE_BATCH = ("FMT", "BFMT")
"""Draw all samples at once, and have no more to do when these gave no path."""

SAMPLES = 1000
"""Of FMT and BFMT at first, in OMPL."""

LOOKS = 64
"""Edges between two looks at the clock."""

MOST_TOLD = 1000
"""Better paths that are told of; of more, every other one between the first and the last."""

SHORTEST_S = 1e-4
"""A search is not begun with less left."""


@dataclass(frozen=True, kw_only=True)
class Space:
    """Where a search goes on."""

    low: np.ndarray
    """[d] lower bounds."""
    high: np.ndarray
    """[d]."""
    looked_at: list[int]
    """Columns that the checks are given, in order: all but headings."""
    edge: Edge
    state: State


@dataclass
class SearchResult:
    """What a search found."""

    points: np.ndarray | None
    """[k, d] of the path; None where there is none."""
    extras: dict[str, float] = field(default_factory=dict)
    """``search_s``, ``first_s`` (to the first path), ``best_s`` (to the last that was better),
    ``best_cost`` (of OMPL's objective: length in the space), ``edges`` looked at."""
    progress: list[tuple[float, float]] = field(default_factory=list)
    """Each time that there was a better path: seconds since the search began, and its cost."""


@dataclass(frozen=True, kw_only=True)
class PlanningOrder:
    """How to search."""

    planner: str
    """OMPL's name."""
    parameters: dict[str, Any]
    """Setters and their values."""
    seed: tuple[int, ...]
    """Each other row of numbers is another search."""
    limit_s: float
    edge_limit: int | None = None
    first: bool = False
    simplify_s: float = 0.0
    """Time for OMPL's simplifier; 0: none."""


class _Motions(ob.MotionValidator):
    """The compiled check, as OMPL asks for it."""

    def __init__(self, info: Any, space: Space) -> None:
        super().__init__(info)
        self.count = 0
        self.end = math.inf
        self._late = False
        self._edge = space.edge
        self._columns = space.looked_at
        self._a = np.zeros(len(space.looked_at))
        self._b = np.zeros(len(space.looked_at))

    def checkMotion(self, a: Any, b: Any, *last: Any) -> bool:  # noqa: N802
        """Whether the team can go from a to b; where it could last be is not told.

        After the search's end nothing is free: LBKPIECE1 asks on for a while before it looks at
        the clock.
        """
        self.count += 1
        if self.count % LOOKS == 0:
            self._late = time.perf_counter() > self.end
        if self._late:
            return False
        self._a[:] = [a[i] for i in self._columns]
        self._b[:] = [b[i] for i in self._columns]
        return self._edge(self._a, self._b)


class _States(ob.StateValidityChecker):
    def __init__(self, info: Any, space: Space) -> None:
        super().__init__(info)
        self._state = space.state
        self._columns = space.looked_at
        self._p = np.zeros(len(space.looked_at))

    def isValid(self, p: Any) -> bool:  # noqa: N802
        """Whether the team can be there."""
        self._p[:] = [p[i] for i in self._columns]
        return self._state(self._p)


class _Setup:
    """The objects of one search, which hold on to each other."""

    def __init__(self, space: Space, start: np.ndarray, goal: np.ndarray, first: bool) -> None:
        size = len(space.low)
        self.real = ob.RealVectorStateSpace(size)
        bounds = ob.RealVectorBounds(size)
        for i in range(size):
            bounds.setLow(i, float(space.low[i]))
            bounds.setHigh(i, float(space.high[i]))
        self.real.setBounds(bounds)
        self.info = ob.SpaceInformation(self.real)
        self.motions, self.states = _Motions(self.info, space), _States(self.info, space)
        self.info.setMotionValidator(self.motions)
        self.info.setStateValidityChecker(self.states)
        self.info.setup()
        self.problem = ob.ProblemDefinition(self.info)
        self.ends = [self.info.allocState(), self.info.allocState()]
        for end, values in zip(self.ends, (start, goal), strict=True):
            for i in range(size):
                end[i] = float(values[i])
        self.problem.setStartAndGoalStates(*self.ends)
        self.objective = ob.PathLengthOptimizationObjective(self.info)
        if first:
            self.objective.setCostThreshold(self.objective.infiniteCost())
        self.problem.setOptimizationObjective(self.objective)
        self.size = size

    def points(self, path: Any) -> np.ndarray:
        """States [k, d] of a path."""
        return np.array([[state[i] for i in range(self.size)] for state in path.getStates()])


def quiet() -> None:
    """Has OMPL say nothing."""
    ou.setLogLevel(ou.LOG_NONE)


def make(planner: str, info: Any, parameters: dict[str, Any]) -> Any:
    """One of OMPL's planners with its parameters.

    Raises:
        ConfigError: OMPL does not take one.
    """
    made = getattr(og, planner)(info)
    for setter, value in parameters.items():
        getattr(made, setter)(value)
        getter = getattr(made, "g" + setter[1:], None)
        if getter is not None and getter() != value:
            raise ConfigError(
                f"OMPL's {planner} does not take {value} in {setter}: it keeps {getter()}"
            )
    return made


def search(space: Space, start: np.ndarray, goal: np.ndarray, order: PlanningOrder) -> SearchResult:
    """A path from start to goal.

    Args:
        space: where.
        start: [d].
        goal: [d].
        order: how.
    """
    begin = time.perf_counter()
    ou.RNG.setSeed(max(1, zlib.crc32(repr(order.seed).encode())))
    setup = _Setup(space, start, goal, order.first or order.planner == "PRM")
    setup.motions.end = begin + order.limit_s
    progress: list[tuple[float, float]] = []
    if order.planner in ANYTIME:
        progress = _improving(setup, order, begin)
    else:
        _once(setup, order, begin)
    taken = time.perf_counter() - begin
    extras = {"search_s": taken, "edges": float(setup.motions.count)}
    if not setup.problem.hasExactSolution():
        return SearchResult(None, extras)
    path = setup.problem.getSolutionPath()
    progress = progress or [(taken, float(path.length()))]
    best_s, best_cost = progress[-1]
    extras |= {"first_s": progress[0][0], "best_s": best_s, "best_cost": best_cost}
    if order.simplify_s > 0.0:
        setup.motions.end = math.inf
        og.PathSimplifier(setup.info).simplify(path, order.simplify_s)
    return SearchResult(setup.points(path), extras, progress)


def _improving(setup: _Setup, order: PlanningOrder, begin: float) -> list[tuple[float, float]]:
    """Runs a planner that improves; when there was a better path, and its cost.

    It is asked each time that it asks whether to stop.
    """
    planner = make(order.planner, setup.info, order.parameters)
    planner.setProblemDefinition(setup.problem)
    planner.setup()
    end = begin + order.limit_s
    most = math.inf if order.edge_limit is None else order.edge_limit
    clock, motions = time.perf_counter, setup.motions
    asked = [planner.bestCost]
    told: list[tuple[float, float]] = []
    best = math.inf

    def look() -> float:
        nonlocal best
        cost, now = asked[0]().value(), clock()
        if cost < best:
            best = cost
            told.append((now - begin, cost))
            if len(told) > MOST_TOLD:
                del told[1:-1:2]
        return now

    def stop() -> bool:
        return look() >= end or motions.count >= most

    planner.solve(ob.PlannerTerminationCondition(stop))
    look()
    asked.clear()  # AORRTC keeps the condition: it must not keep the planner in turn.
    return told


def _once(setup: _Setup, order: PlanningOrder, begin: float) -> None:
    """Runs a planner that ends with its first path, or a roadmap."""
    end = begin + order.limit_s
    most, clock, motions = order.edge_limit or math.inf, time.perf_counter, setup.motions
    samples = order.parameters.get("setNumSamples", SAMPLES)

    def stop() -> bool:
        return motions.count >= most or clock() >= end

    while True:
        batch = {"setNumSamples": samples} if order.planner in ONE_BATCH else {}
        planner = make(order.planner, setup.info, order.parameters | batch)
        planner.setProblemDefinition(setup.problem)
        planner.setup()
        left = end - clock()
        if left > SHORTEST_S:
            planner.solve(
                left if order.edge_limit is None else ob.PlannerTerminationCondition(stop)
            )
        if not batch or stop() or left <= SHORTEST_S or setup.problem.hasExactSolution():
            return
        setup.problem.clearSolutionPaths()
        samples *= 2
