r"""When a team is where on its path: as fast as all can, none faster than it may.

All robots go along each edge of the path together, each along its line at one speed, so where the
edge is free the motion is. An edge takes as long as its slowest robot needs. A robot's speed over
ground $s$ along the unit vector $d$ in a current $c$ is at most its cruise speed, and its motion
through the water, $w = s d - c$, stays in the ellipsoid

$(w_x^2 + w_y^2) / h^2 + w_z^2 / v^2 \le share^2$

where $h$ is the lower of its terminal speeds in surge and sway (surge alone where it cannot sway)
and $v$ that in heave (surge where it cannot heave).
"""

import math
from dataclasses import dataclass

import numpy as np

from angler_mjx.planning.host.ompl.settings import OmplSettings
from angler_mjx.planning.host.ompl.still_water_timing import (
    LINE_TOLERANCE_M,
    MIN_SPEED_MPS,
    SPEED_FACTOR,
    needed_points,
    time_in_still_water,
)
from angler_mjx.planning.problem import Problem

PIECE_M = 1.0
"""An edge is cut into pieces of this length where the current differs from place to place."""

JOINT_SPEED_FRACTION = 0.8
"""Fraction of the highest speeds of joints that may be used, so that they can catch up."""

PASSES = 2
"""How often the current is looked up again, at the times that came out."""

PADDED = 256
"""Points are looked up in multiples of it, so that few programs are compiled."""


class CurrentTooStrongError(Exception):
    """The current is stronger than a robot; its text says which and where."""


@dataclass(frozen=True, kw_only=True)
class TimingLimits:
    """How fast each robot can be; [R]."""

    cruise_mps: np.ndarray
    level_mps: np.ndarray
    """Through the water, in any level direction."""
    upright_mps: np.ndarray
    """Through the water, up and down."""
    turn_radps: float


def timing_limits(
    problem: Problem, robots: list[int], thrust_fraction: float, turn_radps: float
) -> TimingLimits:
    """Return the limits of some robots of a team.

    Args:
        problem: arrays of NumPy.
        robots: which.
        thrust_fraction: of the terminal speeds that may be used.
        turn_radps: of all.
    """
    terminal = np.asarray(problem.team.terminal_speed_mps, float)[robots]
    surge, sway, heave = terminal.T
    return TimingLimits(
        cruise_mps=np.asarray(problem.team.cruise_speed_mps, float)[robots],
        level_mps=thrust_fraction * np.where(sway > 0.0, np.minimum(surge, sway), surge),
        upright_mps=thrust_fraction * np.where(heave > 0.0, heave, surge),
        turn_radps=turn_radps,
    )


def time_path(
    path: np.ndarray, problem: Problem, robots: list[int], settings: OmplSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of a path.

    Args:
        path: [k, R, d] x, y, z (heading, and joints of arms) of the team at each point.
        problem: its current is looked up, where one is known.
        robots: which of the team the path is of.
        settings: ``thrust_share``, ``turn_radps`` and ``points``, of which one less is given.

    Returns:
        Times [n] from 0, s, and the path [n, R, d] there.

    Raises:
        CurrentTooStrongError: a robot cannot go where the path does.
    """
    if not problem.current.components and path.shape[2] <= 4:
        speed = np.asarray(problem.team.cruise_speed_mps, float)[robots]
        return time_in_still_water(np.ascontiguousarray(path), speed, settings.turn_radps)
    bounds = timing_limits(problem, robots, settings.thrust_share, settings.turn_radps)
    if problem.current.components:
        path = _subdivide(path, settings.points - 1)
    steps_m = np.diff(path, axis=0)
    length = np.linalg.norm(steps_m[..., :3], axis=-1)
    ahead = steps_m[..., :3] / np.maximum(length, 1e-12)[..., None]
    slowest = length.max(axis=1) / bounds.cruise_mps.min()
    time = np.concatenate([[0.0], np.cumsum(slowest)])
    for _ in range(PASSES):
        water = [np.zeros_like(ahead)]
        if problem.current.components:
            water = [water_velocity(problem, path, time, fraction) for fraction in (0.0, 0.5, 1.0)]
        speed = np.min(
            [max_ground_speed(ahead, water_velocity_mps, bounds) for water_velocity_mps in water],
            axis=0,
        )
        too_slow = np.argwhere((length > LINE_TOLERANCE_M) & (speed < MIN_SPEED_MPS))
        if len(too_slow):
            at, robot = too_slow[0]
            position_text = ", ".join(f"{x:.1f}" for x in path[at, robot, :3])
            raise CurrentTooStrongError(
                f"the current is too strong for robot {robots[robot]} at ({position_text}) m"
            )
        leg_s = np.where(
            length > LINE_TOLERANCE_M,
            length / (SPEED_FACTOR * np.maximum(speed, MIN_SPEED_MPS)),
            0.0,
        )
        if path.shape[2] == 4:
            leg_s = np.maximum(leg_s, np.abs(steps_m[..., 3]) / bounds.turn_radps)
        elif path.shape[2] > 4:
            rates = column_rates(problem, settings)[robots]
            leg_s = np.maximum(leg_s, (np.abs(steps_m[..., 3:]) / rates).max(axis=-1))
        time = np.concatenate([[0.0], np.cumsum(leg_s.max(axis=1))])
    is_kept = np.concatenate([[True], np.diff(time) > 0.0])
    return time[is_kept], path[is_kept]


def column_rates(problem: Problem, settings: OmplSettings) -> np.ndarray:
    """Return the highest speeds [R, 1 + J] of headings and of the joints of arms, per s."""
    arms = problem.team.arms
    assert arms is not None
    joints = JOINT_SPEED_FRACTION * np.asarray(arms.links.max_speed, float)
    turns = np.full((len(joints), 1), settings.turn_radps)
    # Joints that a robot does not have stay where they are, at any speed.
    return np.concatenate([turns, np.where(joints > 0.0, joints, np.inf)], axis=1)


def max_ground_speed(ahead: np.ndarray, water: np.ndarray, bounds: TimingLimits) -> np.ndarray:
    """Return the highest speed over ground [..., R]; 0 in a direction without headway.

    Args:
        ahead: [..., R, 3] unit vectors.
        water: [..., R, 3] velocity of the water, m/s, W.
        bounds: of the robots.
    """
    scale = np.stack([bounds.level_mps, bounds.level_mps, bounds.upright_mps], axis=-1)
    d, c = ahead / scale, water / scale
    dd, dc, cc = (d * d).sum(-1), (d * c).sum(-1), (c * c).sum(-1)
    dd = np.maximum(dd, 1e-12)
    discriminant = dc * dc - dd * (cc - 1.0)
    max_speed = (dc + np.sqrt(np.maximum(discriminant, 0.0))) / dd
    return np.where(discriminant >= 0.0, np.clip(max_speed, 0.0, bounds.cruise_mps), 0.0)


def robot_waypoints(
    time: np.ndarray, path: np.ndarray, delay_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a robot's way-points, started later, without those on lines of their neighbours.

    Args:
        time: [n] from 0, s.
        path: [n, d].
        delay_s: for which it waits at its start.

    Returns:
        Times [m] and points [m, d]; at least two.
    """
    if delay_s > 0.0:
        time = np.concatenate([[0.0], time + delay_s])
        path = np.concatenate([path[:1], path])
    if len(time) == 1:
        return np.array([0.0, 1.0]), np.concatenate([path, path])
    is_kept = needed_points(time, np.ascontiguousarray(path))
    return time[is_kept], path[is_kept]


def _subdivide(path: np.ndarray, max_points: int) -> np.ndarray:
    """Divide a path into pieces short enough for the current, at most as many as allowed."""
    length = np.linalg.norm(np.diff(path, axis=0)[..., :3], axis=-1).max(axis=1)
    edges = len(length)
    n_spare = max(0, max_points - 2 - edges)
    wanted_pieces = np.maximum(np.ceil(length / PIECE_M), 1.0)
    n_extra = wanted_pieces.sum() - edges
    fraction = min(1.0, n_spare / n_extra) if n_extra > 0 else 0.0
    pieces = (1 + np.floor(fraction * (wanted_pieces - 1.0))).astype(int)
    parts = [
        a + (b - a) * (np.arange(n) / n)[:, None, None]
        for a, b, n in zip(path[:-1], path[1:], pieces, strict=True)
    ]
    return np.concatenate([*parts, path[-1:]])


def water_velocity(
    problem: Problem, path: np.ndarray, time: np.ndarray, fraction: float
) -> np.ndarray:
    """Return the water velocity [n - 1, R, 3] at a fraction of each piece of a path, m/s, W."""
    position_m = (path[:-1] + fraction * np.diff(path, axis=0))[..., :3]
    time_s = np.repeat((time[:-1] + fraction * np.diff(time))[:, None], position_m.shape[1], axis=1)
    count = time_s.size
    padded = PADDED * math.ceil(count / PADDED)
    p, t = np.zeros((padded, 3), np.float32), np.zeros(padded, np.float32)
    p[:count], t[:count] = position_m.reshape(-1, 3), time_s.reshape(-1)
    return problem.current_mps(p, t)[:count].reshape(position_m.shape).astype(float)
