"""One search of OMPL: from a team's start to its goal, in the space of all its numbers.

The space is RealVector of x, y, z (and heading) of each robot. Its edges are checked whole, by
the compiled check, and never by states between. OMPL takes its seed from a generator that gives
one to each sampler as it is made; setting it before they are made fixes them all, any number of
times in a process (OMPL says an error then, which is switched off).
"""

import itertools
import math
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from angler_mjx.errors import ConfigError

type EdgeCheck = Callable[[np.ndarray, np.ndarray], bool]
type StateCheck = Callable[[np.ndarray], bool]

ANYTIME = ("AORRTC", "BITstar", "RRTstar", "InformedRRTstar", "SORRTstar")
"""Planners that improve until they are stopped, and report their best cost."""

SINGLE_BATCH = ("FMT", "BFMT")
"""Planners that draw all samples at once and end if these give no path."""

DEFAULT_SAMPLES = 1000
"""Of FMT and BFMT at first, in OMPL."""

EDGES_PER_CLOCK_CHECK = 64
"""Edges between two looks at the clock."""

MAX_PROGRESS_POINTS = 1000
"""Limit of reported better paths; of more, every other one between the first and the last."""

MIN_SEARCH_S = 1e-4
"""A search is not begun with less left."""

OPTIMUM_TOLERANCE = 1e-6
"""A path that is longer than the straight line by this part of it is the optimum: the search ends.
Samplers that know the best cost would look for shorter paths where there are none; SORRTstar's does
so without looking at the clock."""


@dataclass(frozen=True, kw_only=True)
class SearchSpace:
    """Where a search goes on."""

    low: np.ndarray
    """[d] lower bounds."""
    high: np.ndarray
    """[d]."""
    checked_columns: list[int]
    """Columns that the checks are given, in order: all but headings."""
    edge: EdgeCheck
    state: StateCheck


@dataclass
class SearchResult:
    """Result of a search."""

    points: np.ndarray | None
    """[k, d] of the path; None where there is none."""
    extras: dict[str, float] = field(default_factory=dict)
    """``search_s``, ``first_s`` (to the first path), ``best_s`` (to the last that was better),
    ``best_cost`` (of OMPL's objective: length in the space), checked ``edges``."""
    progress: list[tuple[float, float]] = field(default_factory=list)
    """Each time that there was a better path: seconds since the search began, and its cost."""


@dataclass(frozen=True, kw_only=True)
class PlanningOrder:
    """How to search."""

    planner: str
    """OMPL's name."""
    parameters: dict[str, int | float | str]
    """Setters and their values."""
    seed: tuple[int, ...]
    """Each other row of numbers is another search."""
    limit_s: float
    edge_limit: int | None = None
    first: bool = False
    simplify_s: float = 0.0
    """Time for OMPL's simplifier; 0: none."""


class _MotionValidator(ob.MotionValidator):
    """The compiled edge check as a motion validator of OMPL."""

    def __init__(self, info: "ob.SpaceInformation", space: SearchSpace) -> None:
        super().__init__(info)
        self.count = 0
        self.end = math.inf
        self._late = False
        self._edge = space.edge
        self._columns = space.checked_columns
        self._a = np.zeros(len(space.checked_columns))
        self._b = np.zeros(len(space.checked_columns))

    def checkMotion(self, a: "ob.State", b: "ob.State", *last: object) -> bool:  # noqa: N802
        """Return whether the team can go from a to b, without its last valid state.

        After the search's end nothing is free: LBKPIECE1 asks on for a while before it looks at
        the clock.
        """
        self.count += 1
        if self.count % EDGES_PER_CLOCK_CHECK == 0:
            self._late = time.perf_counter() > self.end
        if self._late:
            return False
        self._a[:] = [a[i] for i in self._columns]
        self._b[:] = [b[i] for i in self._columns]
        return self._edge(self._a, self._b)


class _StateValidator(ob.StateValidityChecker):
    def __init__(self, info: "ob.SpaceInformation", space: SearchSpace) -> None:
        super().__init__(info)
        self._state = space.state
        self._columns = space.checked_columns
        self._p = np.zeros(len(space.checked_columns))

    def isValid(self, p: "ob.State") -> bool:  # noqa: N802
        """Return whether the team can be at a state."""
        self._p[:] = [p[i] for i in self._columns]
        return self._state(self._p)


class _OmplSetup:
    """The objects of one search, which hold on to each other."""

    def __init__(
        self, space: SearchSpace, start: np.ndarray, goal: np.ndarray, first: bool
    ) -> None:
        size = len(space.low)
        self.real = ob.RealVectorStateSpace(size)
        bounds = ob.RealVectorBounds(size)
        for i in range(size):
            bounds.setLow(i, float(space.low[i]))
            bounds.setHigh(i, float(space.high[i]))
        self.real.setBounds(bounds)
        self.info = ob.SpaceInformation(self.real)
        self.motions, self.states = (
            _MotionValidator(self.info, space),
            _StateValidator(self.info, space),
        )
        self.info.setMotionValidator(self.motions)
        self.info.setStateValidityChecker(self.states)
        self.info.setup()
        self.problem = ob.ProblemDefinition(self.info)
        self.ends = [self.info.allocState() for _ in range(1 + len(np.atleast_2d(goal)))]
        for end, values in zip(self.ends, (start, *np.atleast_2d(goal)), strict=True):
            for i in range(size):
                end[i] = float(values[i])
        if goal.ndim == 1:
            self.problem.setStartAndGoalStates(*self.ends)
        else:
            self.goals = ob.GoalStates(self.info)
            for end in self.ends[1:]:
                self.goals.addState(end)
            self.problem.addStartState(self.ends[0])
            self.problem.setGoal(self.goals)
        self.objective = ob.PathLengthOptimizationObjective(self.info)
        line = np.linalg.norm(np.atleast_2d(goal) - start, axis=-1).min()
        self.objective.setCostThreshold(
            self.objective.infiniteCost()
            if first
            else ob.Cost(float(line) * (1.0 + OPTIMUM_TOLERANCE))
        )
        self.problem.setOptimizationObjective(self.objective)
        self.size = size

    def path_states(self, path: "og.PathGeometric") -> np.ndarray:
        """Return the states [k, d] of a path."""
        return np.array([[state[i] for i in range(self.size)] for state in path.getStates()])


def silence_log() -> None:
    """Disable OMPL's messages."""
    ou.setLogLevel(ou.LOG_NONE)


def make_planner(
    planner: str, info: "ob.SpaceInformation", parameters: dict[str, int | float | str]
) -> "ob.Planner":
    """Return one of OMPL's planners with its parameters.

    Raises:
        ConfigError: OMPL does not take one.
    """
    planner_object = getattr(og, planner)(info)
    for setter, value in parameters.items():
        getattr(planner_object, setter)(value)
        getter = getattr(planner_object, "g" + setter[1:], None)
        if getter is not None and getter() != value:
            raise ConfigError(
                f"OMPL's {planner} does not take {value} in {setter}: it keeps {getter()}"
            )
    return planner_object


def search_path(
    space: SearchSpace, start: np.ndarray, goal: np.ndarray, order: PlanningOrder
) -> SearchResult:
    """Return a path from start to goal.

    Args:
        space: where.
        start: [d].
        goal: [d], or [n, d] of which the path may end at any.
        order: how.
    """
    begin = time.perf_counter()
    ou.RNG.setSeed(max(1, zlib.crc32(repr(order.seed).encode())))
    setup = _OmplSetup(space, start, goal, order.first or order.planner == "PRM")
    setup.motions.end = begin + order.limit_s
    progress: list[tuple[float, float]] = []
    if order.planner in ANYTIME:
        progress = _run_anytime(setup, order, begin)
    else:
        _run_once(setup, order, begin)
    elapsed_s = time.perf_counter() - begin
    extras = {"search_s": elapsed_s, "edges": float(setup.motions.count)}
    if not setup.problem.hasExactSolution():
        return SearchResult(None, extras)
    path = setup.problem.getSolutionPath()
    points = _complete_path(setup.path_states(path), start)
    length = _path_length(points)
    if not progress or length < progress[-1][1] * (1.0 - OPTIMUM_TOLERANCE):
        progress.append((elapsed_s, length))
    best_s, best_cost = progress[-1]
    extras |= {"first_s": progress[0][0], "best_s": best_s, "best_cost": best_cost}
    if order.simplify_s > 0.0:
        setup.motions.end = math.inf
        og.PathSimplifier(setup.info).simplify(path, order.simplify_s)
        points = _complete_path(setup.path_states(path), start)
    columns = space.checked_columns
    is_free = all(
        space.edge(a, b) for a, b in itertools.pairwise(np.ascontiguousarray(points[:, columns]))
    )
    return SearchResult(points if is_free else None, extras, progress)


def _complete_path(points: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the path [k, d] from its start; AORRTC states a straight line as twice the goal."""
    return points if np.allclose(points[0], start) else np.vstack([start, points])


def _path_length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=-1).sum())


def _run_anytime(
    setup: _OmplSetup, order: PlanningOrder, begin: float
) -> list[tuple[float, float]]:
    """Run a planner that improves; return times of better paths and their costs.

    Its best cost is read at each of its checks whether to stop, and is 0 where it has none.
    """
    planner = make_planner(order.planner, setup.info, order.parameters)
    planner.setProblemDefinition(setup.problem)
    planner.setup()
    end = begin + order.limit_s
    max_edges = math.inf if order.edge_limit is None else order.edge_limit
    clock, motions = time.perf_counter, setup.motions
    cost_getters = [planner.bestCost]
    progress: list[tuple[float, float]] = []
    best = math.inf

    def record_cost(cost: float) -> float:
        nonlocal best
        now = clock()
        if 0.0 < cost < best:
            best = cost
            progress.append((now - begin, cost))
            if len(progress) > MAX_PROGRESS_POINTS:
                del progress[1:-1:2]
        return now

    def stop() -> bool:
        return record_cost(cost_getters[0]().value()) >= end or motions.count >= max_edges

    planner.solve(ob.PlannerTerminationCondition(stop))
    cost_getters.clear()  # AORRTC keeps the condition: it must not keep the planner in turn.
    return progress


def _run_once(setup: _OmplSetup, order: PlanningOrder, begin: float) -> None:
    """Run a planner that ends with its first path, or a roadmap."""
    end = begin + order.limit_s
    max_edges, clock, motions = order.edge_limit or math.inf, time.perf_counter, setup.motions
    samples = order.parameters.get("setNumSamples", DEFAULT_SAMPLES)

    def stop() -> bool:
        return motions.count >= max_edges or clock() >= end

    while True:
        batch = {"setNumSamples": samples} if order.planner in SINGLE_BATCH else {}
        planner = make_planner(order.planner, setup.info, order.parameters | batch)
        planner.setProblemDefinition(setup.problem)
        planner.setup()
        remaining_s = end - clock()
        if remaining_s > MIN_SEARCH_S:
            planner.solve(
                remaining_s if order.edge_limit is None else ob.PlannerTerminationCondition(stop)
            )
        if not batch or stop() or remaining_s <= MIN_SEARCH_S or setup.problem.hasExactSolution():
            return
        setup.problem.clearSolutionPaths()
        samples *= 2
