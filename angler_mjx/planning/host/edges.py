"""Whether a team can be somewhere, and go straight from there to elsewhere: compiled and exact.

Each robot is the sphere about its centre of mass that holds its hull, so headings do not matter.
An edge moves all robots at once, each along a straight line, all at the same share of it. No point
of an edge is sampled: balls that are swept along lines are tested as a whole.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.compiled import sweeping
from angler_mjx.planning.host.compiled.cell_map import measure_rings
from angler_mjx.planning.host.compiled.packed import Moving, PackedProblem, pack_problem
from angler_mjx.planning.host.timed import Traffic, timed_edge, timed_edges
from angler_mjx.planning.problem import Problem

MAX_NEAR_REACH = 0.99
"""Reach in edges of a cell; larger spheres use the distance to rock."""


class EdgeChecker:
    """Checks states and edges of the team of one problem.

    Cells, the faces of the cube (the spheres stay within), the sea floor, obstacles that stand, and
    the robots among each other. A state or edge nearer than ``margin_m`` is not free; one farther
    than ``margin_m + SLACK_M`` is.

    Attributes:
        robots: number of checked robots, R.
        edge_flat: one edge, from and to float64 [3 R] (contiguous); the fastest entry.
        state_flat: one state, float64 [3 R].
        packed: the problem as arguments of compiled functions.
    """

    robots: int
    edge_flat: Callable[[np.ndarray, np.ndarray], bool]
    state_flat: Callable[[np.ndarray], bool]
    packed: PackedProblem

    def __init__(
        self,
        problem: Problem,
        *,
        margin_m: float = 0.0,
        robots: Sequence[int] | None = None,
        moving: Moving = "ignored",
    ) -> None:
        """Make a problem ready.

        Args:
            problem: arrays of NumPy.
            margin_m: to be kept beyond the radii, to anything and between robots.
            robots: which of the team, in which order; all of it where left out.
            moving: whether checks without a time take obstacles that move, as far as they are
                known, for standing where they are at t = 0.

        Raises:
            ConfigError: the margin is negative, there is no such robot, or a number of the problem
                is not finite.
        """
        self.packed = pack_problem(problem, margin_m, robots, moving, far=False)
        reach = float(np.max(problem.team.radius_m)) + margin_m
        self._has_rings = False
        if reach >= MAX_NEAR_REACH * float(problem.grid.cell_m):
            self._measure_rings()
        self.robots = int(self.packed.head[0])
        self.edge_flat = partial(sweeping.is_edge_free, *self.packed)
        self.state_flat = partial(sweeping.is_state_free, *self.packed)

    def state(self, p: np.ndarray) -> bool:
        """Return whether the team can be at p [R, 3], m, W."""
        return self.state_flat(self._flatten_state(p))

    def states(self, p: np.ndarray) -> np.ndarray:
        """Return whether the team can be at each of p [n, R, 3]; bool [n]."""
        flat = self._flatten_states(p)
        return sweeping.are_edges_free(*self.packed, flat, flat)

    def edge(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Return whether the team can go from a [R, 3] to b [R, 3], m, W."""
        return self.edge_flat(self._flatten_state(a), self._flatten_state(b))

    def edges(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return whether the team can go from each of a to each of b [n, R, 3]; bool [n]."""
        return sweeping.are_edges_free(
            *self.packed, self._flatten_states(a), self._flatten_states(b)
        )

    def clearance(self, p: np.ndarray) -> float:
        """Return the least distance of any robot's sphere to anything, m; negative on overlap."""
        return float(self.clearances(np.asarray(p)[None])[0])

    def clearances(self, p: np.ndarray) -> np.ndarray:
        """Return `clearance` of each of p [n, R, 3]; float64 [n]."""
        self._measure_rings()
        return sweeping.team_clearances(*self.packed, self._flatten_states(p))

    def timed_edge(
        self,
        robot: int,
        a: np.ndarray,
        t_a: float,
        b: np.ndarray,
        t_b: float,
        traffic: Traffic,
    ) -> bool:
        """Return whether one robot can go from a [3] at t_a to b [3] at t_b, s, at one speed.

        Looked at are cells, faces, floor, obstacles that stand, those that move (their bounding
        spheres along lines between the places that are known, whatever ``moving`` says), and the
        traffic; no robot that is not in the traffic.

        Args:
            robot: its place among those that are checked.
            a: m, W.
            t_a: 0 or later.
            b: where it stays the whole time, if it is a.
            t_b: not before t_a; inf for a robot that stays.
            traffic: the other robots' paths.
        """
        robot_index = self._check_robot_index(robot)
        start_m, goal_m = (np.ascontiguousarray(p, np.float64).reshape(3) for p in (a, b))
        return timed_edge(
            *self.packed,
            *_traffic_arrays(traffic),
            robot_index,
            start_m,
            float(t_a),
            goal_m,
            float(t_b),
        )

    def timed_edges(
        self,
        robot: int,
        a: np.ndarray,
        t_a: np.ndarray,
        b: np.ndarray,
        t_b: np.ndarray,
        traffic: Traffic,
    ) -> np.ndarray:
        """Return `timed_edge` of each of a, b [n, 3] and t_a, t_b [n]; bool [n]."""
        robot_index = self._check_robot_index(robot)
        starts_m, goals_m = (np.ascontiguousarray(p, np.float64).reshape(-1, 3) for p in (a, b))
        begin, end = (np.ascontiguousarray(t, np.float64).reshape(-1) for t in (t_a, t_b))
        return timed_edges(
            *self.packed, *_traffic_arrays(traffic), robot_index, starts_m, begin, goals_m, end
        )

    def _measure_rings(self) -> None:
        if not self._has_rings:
            measure_rings(self.packed.cells)
        self._has_rings = True

    def _check_robot_index(self, robot: int) -> int:
        if not 0 <= robot < self.robots:
            raise ConfigError(f"robot = {robot}: give one of 0 to {self.robots - 1}")
        return int(robot)

    def _flatten_state(self, p: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(p, np.float64).reshape(3 * self.robots)

    def _flatten_states(self, p: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(p, np.float64).reshape(-1, 3 * self.robots)


def _traffic_arrays(traffic: Traffic) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return traffic.time_s, traffic.position_m, traffic.radius_m
