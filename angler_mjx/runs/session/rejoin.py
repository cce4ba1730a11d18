"""Way back to a plan, for a robot that was driven away from it.

The robot goes straight to the nearest later point of the plan if no static obstacle is in the way,
and else over free cells, shortened by straight lines. Moving obstacles and other robots are
ignored: the plan's own times do not hold any more either. The robot starts at its present speed
along the way, and takes up the plan's from there.
"""

from functools import cached_property

import jax
import numpy as np
from numpy.typing import NDArray

from angler_mjx.planning.path_search import lattice
from angler_mjx.planning.path_search.bodies import select_still
from angler_mjx.runs.session.interface import Floats
from angler_mjx.runs.session.robot_plan import RobotPlan
from angler_mjx.world.environment import Environment

type Ints = NDArray[np.integer]

CHECKED_POINTS = 64
"""Points that are checked together; their number is fixed, so that nothing compiles anew."""
CLEARANCE_FRACTIONS = (1.0, 0.75, 0.5)
"""Fractions of the clearance that the first straight piece must keep: a robot that was driven close
to rock may leave it at its own distance. Half a bounding sphere is more than half a hull's
width."""


class RejoinPaths:
    """Obstacles of one world and paths around them."""

    def __init__(self, environment: Environment) -> None:
        """Set the static obstacles of one world; the first query compiles."""
        self._environment = environment

    def plan_rejoin(
        self,
        p: Floats,
        velocity: Floats,
        plan: RobotPlan,
        left_s: float,
        clearance_m: float,
        speed_mps: float,
        yaw_rad: float = 0.0,
        arm: Floats | None = None,
    ) -> RobotPlan | None:
        """Return a plan from a point back to a plan and on along it; None where no path is found.

        Args:
            p: [3] position of the robot.
            velocity: [3] m/s over ground, in W.
            plan: plan of the robot.
            left_s: progress along the plan when it was left, s of the plan's time.
            clearance_m: clearance from static obstacles.
            speed_mps: speed on the way back.
            yaw_rad: heading of the robot, for plans with headings.
            arm: [J] positions of the joints of its arm, for plans with joints; None without an arm.
        """
        end = float(plan.time_s[-1])
        times = np.linspace(min(left_s, end), end, CHECKED_POINTS)
        points = plan.at(times)
        nearest = self._nearest_reachable(p, points, clearance_m)
        if nearest is not None:
            corners: list[Floats] = []
            join = nearest
        else:
            detour = self._path_around(p, points, clearance_m)
            if detour is None:
                return None
            corners, join = detour
        path_m = np.array([p, *corners, points[join]])
        legs = np.linalg.norm(np.diff(path_m, axis=0), axis=1) / speed_mps
        arrival_s = np.concatenate([[0.0], np.cumsum(legs)])
        rejoined = plan.after(path_m, arrival_s, float(times[join]), yaw_rad, arm)
        velocity_mps = (rejoined.at(0.1) - p) / 0.1
        speed_fraction = float(velocity @ velocity_mps) / max(
            float(velocity_mps @ velocity_mps), 1e-6
        )
        return rejoined.eased(float(np.clip(speed_fraction, 0.0, 1.0)), speed_mps)

    def compile(self) -> None:
        """Compile the functions of `plan_rejoin`."""
        self._reachable_points(np.zeros(3), np.zeros((1, 3)), 0.0)

    @cached_property
    def _terrain(self) -> lattice.Terrain:
        terrain: lattice.Terrain = _build_terrain(self._environment)
        return terrain

    @cached_property
    def _cell_gap_m(self) -> Floats:
        """Return distances [nx, ny, nz] from cells' centres to static obstacles."""
        gap = np.asarray(self._terrain.gap_m, float)
        if self._terrain.cell_gap_m is None:
            return gap
        min_gap_m: Floats = np.minimum(gap, np.asarray(self._terrain.cell_gap_m, float))
        return min_gap_m

    def _reachable_points(self, a: Floats, points: Floats, clearance_m: float) -> NDArray[np.bool_]:
        """Return bool [n] whether straight lines to at most `CHECKED_POINTS` points are free."""
        n_missing = CHECKED_POINTS - len(points)
        padded = np.pad(points, ((0, n_missing), (0, 0)), mode="edge")
        clearance = np.asarray(clearance_m, padded.dtype)
        return np.asarray(_line_of_sight(self._terrain, a, padded, clearance))[: len(points)]

    def _nearest_reachable(self, a: Floats, points: Floats, clearance_m: float) -> int | None:
        """Return the nearest reachable point of the plan, with less clearance if necessary."""
        distances = np.linalg.norm(points - a, axis=1)
        for fraction in CLEARANCE_FRACTIONS:
            reachable = self._reachable_points(a, points, fraction * clearance_m)
            if reachable.any():
                return int(np.argmin(np.where(reachable, distances, np.inf)))
        return None

    def _path_around(
        self, p: Floats, points: Floats, clearance_m: float
    ) -> tuple[list[Floats], int] | None:
        """Return corners of a path over free cells, and the point of the plan at its end."""
        grid = self._terrain.grid
        origin, cell = np.asarray(grid.origin_m, float), float(grid.cell_m)
        free = self._cell_gap_m >= clearance_m
        plan_cells = np.floor((points - origin) / cell).astype(int)
        steps = _count_steps(free, plan_cells)
        start_cell = np.floor((p - origin) / cell).astype(int)
        near = _neighbour_cells(start_cell, free.shape)
        near = near[np.argsort(steps[tuple(near.T)], kind="stable")][:CHECKED_POINTS]
        for fraction in CLEARANCE_FRACTIONS:
            reachable = self._reachable_points(
                p, origin + (near + 0.5) * cell, fraction * clearance_m
            )
            usable = reachable & np.isfinite(steps[tuple(near.T)])
            if usable.any():
                chain = _descend_steps(steps, near[int(np.argmax(usable))])
                return self._shorten_chain(origin + (chain + 0.5) * cell, points, clearance_m)
        return None

    def _shorten_chain(
        self, chain: Floats, points: Floats, clearance_m: float
    ) -> tuple[list[Floats], int] | None:
        """Shorten a chain of centres by leaving out unnecessary corners."""
        corners = [chain[0]]
        at = 0
        while True:
            reachable = self._reachable_points(chain[at], points, clearance_m)
            if reachable.any() and at >= len(chain) - 2:
                distances = np.linalg.norm(points - chain[at], axis=1)
                return corners, int(np.argmin(np.where(reachable, distances, np.inf)))
            ahead = chain[at + 1 : at + 1 + CHECKED_POINTS]
            if not len(ahead):
                return None
            visible = np.flatnonzero(self._reachable_points(chain[at], ahead, clearance_m))
            # The next centre is a step between free cells, regardless of rounding.
            at += 1 + (int(visible[-1]) if visible.size else 0)
            corners.append(chain[at])


@jax.jit
def _build_terrain(environment: Environment) -> lattice.Terrain:
    still = select_still(environment.obstacles)
    return lattice.build_terrain(environment.grid, environment.floor_z_m, still)


@jax.jit
def _line_of_sight(
    terrain: lattice.Terrain, a: jax.Array, points: jax.Array, clearance_m: jax.Array
) -> jax.Array:
    check_sight = jax.vmap(lattice.line_of_sight, (None, None, 0, None))
    return check_sight(terrain, a, points, clearance_m)


def _count_steps(free: NDArray[np.bool_], goals: Ints) -> Floats:
    """Return steps [nx, ny, nz] between faces of free cells to the nearest goal cell.

    Inf where none.
    """
    steps = np.full(free.shape, np.inf)
    front = np.zeros(free.shape, bool)
    inside = np.all((goals >= 0) & (goals < free.shape), axis=1)
    front[tuple(goals[inside].T)] = True
    front &= free
    count = 0
    while front.any():
        steps[front] = count
        count += 1
        padded = np.pad(front, 1)
        spread = np.zeros_like(front)
        for axis in range(3):
            for shift in (0, 2):
                cut = [slice(1, -1)] * 3
                cut[axis] = slice(shift, shift + free.shape[axis])
                spread |= padded[tuple(cut)]
        front = spread & free & ~np.isfinite(steps)
    return steps


def _descend_steps(steps: Floats, cell: Ints) -> Ints:
    """Return cells [n, 3] from a cell to a goal, a step at a time."""
    chain = [cell]
    while steps[tuple(chain[-1])] > 0:
        near = _neighbour_cells(chain[-1], steps.shape)
        adjacent = near[np.abs(near - chain[-1]).sum(axis=1) == 1]
        chain.append(adjacent[np.argmin(steps[tuple(adjacent.T)])])
    return np.array(chain)


def _neighbour_cells(cell: Ints, shape: tuple[int, ...]) -> Ints:
    """Return the cell and its neighbours inside the grid, 27 at most, [n, 3]."""
    offsets = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    near: Ints = cell + offsets
    return near[np.all((near >= 0) & (near < shape), axis=1)]
