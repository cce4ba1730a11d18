"""Search of OMPL on the manifold of a grasp: a body and the robots that hold it.

The space is that of the poses x, y, z and turn of the body and of each robot; the grasp is the
constraint that each robot keeps its pose in the frame of the body. OMPL's `ProjectedStateSpace`
samples the whole space and projects to the manifold (Kingston, Moll and Kavraki, "Exploring
implicit spaces for constrained sampling-based planning", IJRR 38, 2019). A state is free where the
balls of the robots and those that cover the body are; states along a motion are `STEP_M` apart.
"""

import time
import zlib
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from angler_mjx.planning.carry.carriers import PEAK_SPEED, ease, follow_body
from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl.search import silence_log
from angler_mjx.planning.planner import NoPlan, Path, joint_path
from angler_mjx.planning.problem import CargoProblem, Problem

WIDTH = 4
"""Columns of a pose: x, y, z and turn about z up."""

STEP_M = 0.08
"""Distance of checked states along a motion; half of it is kept as an additional margin."""

LIMIT_FRACTION = 0.9
"""Fraction of the limit that a search is given: the rest is for timing its path."""

SIMPLIFY_FRACTION = 0.2
"""Fraction of the time that is left for shortening a path."""

MAX_BALLS = 16
"""Balls that cover a body, at the most."""


class Grasp(ob.Constraint):
    """Constraint that robots keep their poses in the frame of the body, whose pose comes first."""

    def __init__(self, offset_m: np.ndarray) -> None:
        """Keep the offsets [R, 3] of the robots from the body at turn 0, m."""
        robots = len(offset_m)
        super().__init__(WIDTH * (robots + 1), WIDTH * robots, 1e-4)
        self._offset = offset_m

    def function(self, x: np.ndarray, out: np.ndarray) -> None:
        """Write how far robots are from where the body has them, [4 R]."""
        pose = np.asarray(x).reshape(-1, WIDTH)
        out[:] = (pose[1:] - carrier_poses(pose[0], self._offset)).ravel()

    def jacobian(self, x: np.ndarray, out: np.ndarray) -> None:
        """Write the derivative [4 R, 4 (R + 1)] of `function`."""
        turn = float(np.asarray(x)[3])
        c, s = np.cos(turn), np.sin(turn)
        out[:] = 0.0
        for robot, (dx, dy, _) in enumerate(self._offset):
            rows = slice(WIDTH * robot, WIDTH * (robot + 1))
            out[rows, :WIDTH] = -np.eye(WIDTH)
            out[rows, WIDTH * (robot + 1) : WIDTH * (robot + 2)] = np.eye(WIDTH)
            out[WIDTH * robot, 3] = s * dx + c * dy
            out[WIDTH * robot + 1, 3] = -c * dx + s * dy


def carrier_poses(body: np.ndarray, offset_m: np.ndarray) -> np.ndarray:
    """Return the poses [R, 4] of robots that hold a body at a pose [4]."""
    c, s = np.cos(body[3]), np.sin(body[3])
    x, y, z = offset_m.T
    turned = np.stack([c * x - s * y, s * x + c * y, z, np.zeros_like(x)], axis=1)
    poses: np.ndarray = body + turned
    return poses


class _Balls:
    """Balls of the robots and of the body that they hold."""

    def __init__(self, problem: Problem, cargo: CargoProblem, margin_m: float) -> None:
        team = problem.team
        self.offset = np.asarray(team.start_m, float) - np.asarray(cargo.start_m, float)
        axis, thickness = np.asarray(cargo.axis_m, float), float(cargo.thickness_m)
        half = float(np.linalg.norm(axis))
        count = int(np.clip(np.ceil(half / max(thickness, 1e-3)), 1, MAX_BALLS))
        along = (2.0 * np.arange(count) + 1.0) / count - 1.0
        radius = float(np.hypot(thickness, half / count)) if half > 0.0 else thickness
        self.body_offset = along[:, None] * axis
        radii = np.concatenate([np.asarray(team.radius_m, float), np.full(count, radius)])
        centres = np.concatenate([self.offset, self.body_offset]) + np.asarray(cargo.start_m, float)
        repeated: Any = jax.tree.map(
            lambda leaf: np.repeat(np.asarray(leaf)[:1], len(radii), axis=0),
            replace(team, arms=None),
        )
        crowd = replace(
            problem,
            cargo=None,
            team=replace(
                repeated,
                start_m=centres.astype(np.float32),
                goal_m=centres.astype(np.float32),
                radius_m=radii.astype(np.float32),
            ),
        )
        self._checks = [
            EdgeChecker(crowd, margin_m=margin_m, robots=[ball]).state_flat
            for ball in range(len(radii))
        ]

    def is_free(self, body: np.ndarray) -> bool:
        """Return whether all balls are free with the body at a pose [4]."""
        offsets = np.concatenate([self.offset, self.body_offset])
        centres = np.ascontiguousarray(carrier_poses(body, offsets)[:, :3])
        return all(check(center) for check, center in zip(self._checks, centres, strict=True))


def plan_on_grasp(
    problem: Problem, planner: str, limit_s: float
) -> tuple[list[Path | NoPlan], dict[str, float]]:
    """Return the paths of robots that hold a body, and numbers to note.

    Args:
        problem: arrays of NumPy, with cargo.
        planner: name of one of OMPL's planners.
        limit_s: wall time of the search.
    """
    silence_log()
    begin = time.perf_counter()
    cargo = problem.cargo
    assert cargo is not None
    robots = problem.robots
    limit_s *= LIMIT_FRACTION
    balls = _Balls(problem, cargo, problem.margin_m + 0.5 * STEP_M)
    start = np.append(np.asarray(cargo.start_m, float), 0.0)
    goal = np.append(np.asarray(cargo.goal_m, float), float(cargo.turn_rad))
    for name, end in (("start", start), ("goal", goal)):
        if not balls.is_free(end):
            return [NoPlan(f"what they carry has no room at its {name}")] * robots, {}
    poses = _search(problem, balls, start, goal, planner, begin + limit_s)
    extras = {"search_s": time.perf_counter() - begin}
    if poses is None:
        return [NoPlan("no path was found in time")] * robots, extras
    return _time_paths(problem, cargo, poses), extras


def warm_up(problem: Problem) -> None:
    """Compile the functions that such problems need."""
    if problem.cargo is not None:
        cargo = problem.cargo
        pose = np.append(np.asarray(cargo.start_m, float), 0.0)
        _Balls(problem, cargo, STEP_M).is_free(pose)
        _time_paths(problem, cargo, np.stack([pose, pose + np.eye(WIDTH)[0]]))


def _search(
    problem: Problem,
    balls: _Balls,
    start: np.ndarray,
    goal: np.ndarray,
    planner: str,
    end: float,
) -> np.ndarray | None:
    """Return poses [k, 4] of the body from start to goal, STEP_M apart; None without a path."""
    ou.RNG.setSeed(max(1, zlib.crc32(repr(("grasp", int(problem.seed))).encode())))
    size = WIDTH * (problem.robots + 1)
    real, bounds = ob.RealVectorStateSpace(size), ob.RealVectorBounds(size)
    low, high = np.asarray(problem.lower_m, float), np.asarray(problem.upper_m, float)
    turn = np.pi + abs(goal[3])
    for i in range(size):
        column = i % WIDTH
        bounds.setLow(i, float(low[column]) if column < 3 else -turn)
        bounds.setHigh(i, float(high[column]) if column < 3 else turn)
    real.setBounds(bounds)
    space = ob.ProjectedStateSpace(real, Grasp(balls.offset))
    info = ob.ConstrainedSpaceInformation(space)
    space.setDelta(STEP_M)

    def body_pose(state: "ob.State") -> np.ndarray:
        return np.array([space.getValueAddressAtIndex(state, i) for i in range(WIDTH)])

    setup = og.SimpleSetup(info)
    setup.setStateValidityChecker(lambda state: balls.is_free(body_pose(state)))
    ends = []
    for pose in (start, goal):
        state = space.allocState()
        state.copy(np.concatenate([pose, carrier_poses(pose, balls.offset).ravel()]))
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(getattr(og, planner)(info))
    remaining_s = end - time.perf_counter()
    setup.solve(max(0.0, (1.0 - SIMPLIFY_FRACTION) * remaining_s))
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution(max(0.01, SIMPLIFY_FRACTION * remaining_s))
    path = setup.getSolutionPath()
    path.interpolate()
    return np.array([body_pose(path.getState(i)) for i in range(path.getStateCount())])


def _time_paths(problem: Problem, cargo: CargoProblem, poses: np.ndarray) -> list[Path | NoPlan]:
    """Return paths along poses [k, 4] of the body, no robot faster than its cruise speed."""
    team = problem.team
    offset = np.asarray(team.start_m, float) - np.asarray(cargo.start_m, float)
    at = np.stack([carrier_poses(pose, offset)[:, :3] for pose in poses])
    moved_m = np.linalg.norm(np.diff(at, axis=0), axis=2).max(axis=1)
    length_m = np.concatenate([[0.0], np.cumsum(moved_m)])
    cruise = float(np.min(team.cruise_speed_mps))
    eased = np.asarray(ease(jnp.linspace(0.0, 1.0, problem.points)), float) * length_m[-1]
    sampled = np.stack([np.interp(eased, length_m, poses[:, i]) for i in range(WIDTH)], axis=1)
    duration_s = max(PEAK_SPEED * length_m[-1] / cruise, 1e-3)
    base, body = jax.tree.map(jnp.asarray, (replace(team, arms=None), cargo))
    # Cubics between points may be faster than what they go along.
    for _ in range(4):
        paths = follow_body(
            base,
            body,
            jnp.asarray(sampled[:, :3]),
            jnp.asarray(sampled[:, 3]),
            jnp.asarray(duration_s),
        )
        fastest = _max_speed_mps(paths)
        if fastest <= cruise:
            break
        duration_s *= 1.001 * fastest / cruise
    if duration_s > problem.horizon_s:
        return [NoPlan(f"the path takes {duration_s:.0f} s, beyond the horizon")] * problem.robots
    return [
        joint_path(
            paths.time_s[i],
            paths.position[i, :, :3],
            paths.position[i, :, 3],
            velocity=paths.velocity[i],
        )
        for i in range(problem.robots)
    ]


def _max_speed_mps(paths: Any) -> float:
    """Return the greatest speed of cubics [R], from eight points of each segment."""
    p, v = np.asarray(paths.position, float)[..., :3], np.asarray(paths.velocity, float)[..., :3]
    time_s = np.asarray(paths.time_s, float)
    step = np.diff(time_s, axis=1)[..., None]
    s = np.linspace(0.0, 1.0, 9)[:, None, None, None]
    a, b, va, vb = p[:, :-1], p[:, 1:], v[:, :-1] * step, v[:, 1:] * step
    rate = (6 * s * s - 6 * s) * (a - b) + (3 * s * s - 4 * s + 1) * va + (3 * s * s - 2 * s) * vb
    return float(np.linalg.norm(rate / step, axis=-1).max())
