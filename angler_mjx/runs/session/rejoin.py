"""The way back to a plan, for a robot that was driven away from it.

It goes straight to the nearest later point of the plan if nothing that does not move is in the way,
and else over free cells, pulled straight. What moves (other robots, drifting obstacles) is not
looked at: the plan's own times do not hold any more either. The robot sets out at the speed that it
has along its way, and takes up the plan's from there.
"""

from functools import cached_property
from typing import Any

import jax
import numpy as np

from angler_mjx.planning.path_search import lattice
from angler_mjx.runs.session.interface import Floats
from angler_mjx.runs.session.plan import Plan
from angler_mjx.world.environment import Environment

LOOKS = 64
"""Points that are looked at together; their number is fixed, so that nothing compiles anew."""
SHARES = (1.0, 0.75, 0.5)
"""Of the clearance, that the first straight piece must keep: a robot that was driven close to rock
may leave it at its own distance. Half a bounding sphere is more than half a hull's width."""


class RejoinPaths:
    """What a robot of one world can go past."""

    def __init__(self, environment: Environment) -> None:
        """Take what does not move of one world; nothing is compiled until a way is asked for."""
        self._environment = environment

    def back(
        self,
        p: Floats,
        velocity: Floats,
        plan: Plan,
        left_s: float,
        clearance_m: float,
        speed_mps: float,
        yaw_rad: float = 0.0,
    ) -> Plan | None:
        """From a point back to a plan and on along it; None where no way is found.

        Args:
            p: [3] where the robot is.
            velocity: [3] m/s over ground, in W.
            plan: its plan.
            left_s: how far along it was when it left, s of the plan's time.
            clearance_m: to keep from everything that does not move.
            speed_mps: on the way back.
            yaw_rad: the robot's heading, for plans that have headings.
        """
        end = float(plan.time_s[-1])
        times = np.linspace(min(left_s, end), end, LOOKS)
        points = plan.at(times)
        straight = self._nearest_seen(p, points, clearance_m)
        if straight is not None:
            corners: list[Floats] = []
            join = straight
        else:
            around = self._around(p, points, clearance_m)
            if around is None:
                return None
            corners, join = around
        way = np.array([p, *corners, points[join]])
        legs = np.linalg.norm(np.diff(way, axis=0), axis=1) / speed_mps
        arrive = np.concatenate([[0.0], np.cumsum(legs)])
        whole = plan.after(way, arrive, float(times[join]), yaw_rad)
        ahead = (whole.at(0.1) - p) / 0.1
        along = float(velocity @ ahead) / max(float(ahead @ ahead), 1e-6)
        return whole.eased(float(np.clip(along, 0.0, 1.0)), speed_mps)

    def compile(self) -> None:
        """Have compiled now what `back` needs."""
        self._seen(np.zeros(3), np.zeros((1, 3)), 0.0)

    @cached_property
    def _land(self) -> lattice.Terrain:
        land: lattice.Terrain = _terrain(self._environment)
        return land

    @cached_property
    def _gap_m(self) -> Floats:
        """[nx, ny, nz] from cells' centres to everything that does not move."""
        gap = np.asarray(self._land.gap_m, float)
        if self._land.cell_gap_m is None:
            return gap
        least: Floats = np.minimum(gap, np.asarray(self._land.cell_gap_m, float))
        return least

    def _seen(self, a: Floats, points: Floats, clearance_m: float) -> Any:
        """Bool [n] which of up to `LOOKS` points can be gone to in a straight line."""
        more = LOOKS - len(points)
        padded = np.pad(points, ((0, more), (0, 0)), mode="edge")
        number = np.asarray(clearance_m, padded.dtype)
        return np.asarray(_seen(self._land, a, padded, number))[: len(points)]

    def _nearest_seen(self, a: Floats, points: Floats, clearance_m: float) -> int | None:
        """Of points on the plan the nearest that can be gone to, with less clearance if need be."""
        away = np.linalg.norm(points - a, axis=1)
        for share in SHARES:
            seen = self._seen(a, points, share * clearance_m)
            if seen.any():
                return int(np.argmin(np.where(seen, away, np.inf)))
        return None

    def _around(
        self, p: Floats, points: Floats, clearance_m: float
    ) -> tuple[list[Floats], int] | None:
        """Corners of a way over free cells, and the point of the plan that it ends at."""
        grid = self._land.grid
        origin, cell = np.asarray(grid.origin_m, float), float(grid.cell_m)
        free = self._gap_m >= clearance_m
        on_plan = np.floor((points - origin) / cell).astype(int)
        steps = _steps_to(free, on_plan)
        place = np.floor((p - origin) / cell).astype(int)
        near = _neighbourhood(place, free.shape)
        near = near[np.argsort(steps[tuple(near.T)], kind="stable")][:LOOKS]
        for share in SHARES:
            seen = self._seen(p, origin + (near + 0.5) * cell, share * clearance_m)
            open_ = seen & np.isfinite(steps[tuple(near.T)])
            if open_.any():
                chain = _descend(steps, near[int(np.argmax(open_))])
                return self._pulled(origin + (chain + 0.5) * cell, points, clearance_m)
        return None

    def _pulled(
        self, chain: Floats, points: Floats, clearance_m: float
    ) -> tuple[list[Floats], int] | None:
        """A chain of centres with those left out that need not be corners."""
        corners = [chain[0]]
        at = 0
        while True:
            seen = self._seen(chain[at], points, clearance_m)
            if seen.any() and at >= len(chain) - 2:
                away = np.linalg.norm(points - chain[at], axis=1)
                return corners, int(np.argmin(np.where(seen, away, np.inf)))
            ahead = chain[at + 1 : at + 1 + LOOKS]
            if not len(ahead):
                return None
            in_sight = np.flatnonzero(self._seen(chain[at], ahead, clearance_m))
            # The next centre is a step between free cells, whatever rounding says of it.
            at += 1 + (int(in_sight[-1]) if in_sight.size else 0)
            corners.append(chain[at])


@jax.jit
def _terrain(environment: Environment) -> lattice.Terrain:
    return lattice.terrain(environment)


@jax.jit
def _seen(
    land: lattice.Terrain, a: jax.Array, points: jax.Array, clearance_m: jax.Array
) -> jax.Array:
    look = jax.vmap(lattice.line_of_sight, (None, None, 0, None))
    return look(land, a, points, clearance_m)


def _steps_to(free: Any, goals: Any) -> Floats:
    """Steps [nx, ny, nz] between faces of free cells to the nearest goal cell; inf where none."""
    steps = np.full(free.shape, np.inf)
    front = np.zeros(free.shape, bool)
    inside = np.all((goals >= 0) & (goals < free.shape), axis=1)
    front[tuple(goals[inside].T)] = True
    front &= free
    count = 0
    while front.any():
        steps[front] = count
        count += 1
        wide = np.pad(front, 1)
        spread = np.zeros_like(front)
        for axis in range(3):
            for by in (0, 2):
                cut = [slice(1, -1)] * 3
                cut[axis] = slice(by, by + free.shape[axis])
                spread |= wide[tuple(cut)]
        front = spread & free & ~np.isfinite(steps)
    return steps


def _descend(steps: Floats, cell: Any) -> Any:
    """Cells [n, 3] from one to a goal, a step at a time."""
    chain = [cell]
    while steps[tuple(chain[-1])] > 0:
        near = _neighbourhood(chain[-1], steps.shape)
        beside = near[np.abs(near - chain[-1]).sum(axis=1) == 1]
        chain.append(beside[np.argmin(steps[tuple(beside.T)])])
    return np.array(chain)


def _neighbourhood(cell: Any, shape: tuple[int, ...]) -> Any:
    """The cell and its 26 neighbours that are inside, [n, 3]."""
    offsets = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    near = cell + offsets
    return near[np.all((near >= 0) & (near < shape), axis=1)]
