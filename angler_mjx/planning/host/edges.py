"""Collision checks of states and straight edges of a team, compiled and exact.

Each robot is the sphere about its centre of mass that holds its hull, so headings do not matter.
An edge moves all robots at once, each along a straight line, all at the same fraction of it. No
point of an edge is sampled: balls that are swept along lines are tested as a whole.
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
    """Check states and edges of the team of one problem; positions are in m in W.

    Robots are spheres about their centres of mass. They are checked against cells, the faces of the
    cube (the spheres stay within), the sea floor, obstacles that stand, and each other. A state or
    edge nearer than ``margin_m`` is not free; one farther than ``margin_m`` + 1e-5 m is. NaN and
    infinite positions are not free. See `docs/reference/collision.md`.

    Attributes:
        robots: number of checked robots, R.
        edge_flat: check of one edge, from and to float64 [3 R] (contiguous); the fastest entry.
        state_flat: check of one state, float64 [3 R].
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
        """Pack a problem for the compiled functions.

        Args:
            problem: problem with arrays of NumPy.
            margin_m: required distance beyond the radii, to anything and between robots.
            robots: indices of the checked robots in the team, in order; all if left out.
            moving: ``at_start``: checks without a time take moving obstacles of the problem for
                standing at their positions at t = 0; ``ignored``: they leave them out.

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
        """Return whether the team is free at p [R, 3], m, W."""
        return self.state_flat(self._flatten_state(p))

    def states(self, p: np.ndarray) -> np.ndarray:
        """Return whether the team is free at each of p [n, R, 3], m, W; bool [n]."""
        flat = self._flatten_states(p)
        return sweeping.are_edges_free(*self.packed, flat, flat)

    def edge(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Return whether the edge from a [R, 3] to b [R, 3], m, W, is free."""
        return self.edge_flat(self._flatten_state(a), self._flatten_state(b))

    def edges(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return whether the edges from a to b [n, R, 3], m, W, are free; bool [n]."""
        return sweeping.are_edges_free(
            *self.packed, self._flatten_states(a), self._flatten_states(b)
        )

    def clearance(self, p: np.ndarray) -> float:
        """Return the clearance [m] of the team at p [R, 3], m, W; negative on overlap.

        The minimum over all robots of the distance of a sphere to anything.
        """
        return float(self.clearances(np.asarray(p)[None])[0])

    def clearances(self, p: np.ndarray) -> np.ndarray:
        """Return the `clearance` [m] at each of p [n, R, 3], m, W; float64 [n]."""
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
        """Return whether one robot is free from a [3] at t_a to b [3] at t_b, at one speed.

        The robot is checked against cells, faces, floor, obstacles that stand, obstacles that move
        (bounding spheres along lines between the positions of the problem, whatever ``moving`` is),
        and the traffic; other robots count only as traffic.

        Args:
            robot: index among the checked robots.
            a: position [3] at the start, m, W.
            t_a: time of the start, s; 0 or later.
            b: position [3] at the end, m, W; equal to ``a`` for a robot that stays.
            t_b: time of the end, s, not before ``t_a``; inf for a robot that stays for good.
            traffic: paths of the other robots.

        Raises:
            ConfigError: there is no such robot.
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
        """Return `timed_edge` of each of a, b [n, 3], m, W, and t_a, t_b [n], s; bool [n].

        Raises:
            ConfigError: there is no such robot.
        """
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
