"""Compiled: one ball that goes along a line in time, among paths in time."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.compiled.compiling import compile_function
from angler_mjx.planning.host.compiled.packed import unpack_fields
from angler_mjx.planning.host.compiled.segments import segment_point
from angler_mjx.planning.host.compiled.sweeping import (
    is_clear_of_obstacles,
    is_clear_of_rock,
    is_inside,
)


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """Paths of K balls in time, linear between P points; constant before the first, after the last.

    `Traffic.of` builds them from arrays of any real type.
    """

    time_s: np.ndarray
    """float64 [K, P] times of the points, not falling."""
    position_m: np.ndarray
    """float64 [K, P, 3] points in W; where two times are equal, all of the line between counts."""
    radius_m: np.ndarray
    """float64 [K] radii."""

    @classmethod
    def of(cls, time_s: np.ndarray, position_m: np.ndarray, radius_m: np.ndarray) -> Self:
        """Build traffic from arrays of any real type.

        Args:
            time_s: times [K, P] of the points, s, not falling.
            position_m: points [K, P, 3], m, W.
            radius_m: radii [K], m.

        Raises:
            ConfigError: the shapes do not belong together, a time falls, or a number is not finite.
        """
        time, position, radius = (
            np.ascontiguousarray(values, np.float64) for values in (time_s, position_m, radius_m)
        )
        if radius.ndim != 1 or time.ndim != 2 or position.shape != (*time.shape, 3):
            raise ConfigError(
                f"traffic: time_s {time.shape}, position_m {position.shape}, radius_m "
                f"{radius.shape}; "
                "give [K, P], [K, P, 3] and [K]"
            )
        if len(radius) != len(time) or (len(time) and time.shape[1] == 0):
            raise ConfigError(
                f"traffic: {len(radius)} radii for {len(time)} paths of {time.shape[1]} points; "
                "give each path a radius and a point at least"
            )
        if not all(np.isfinite(values).all() for values in (time, position, radius)):
            raise ConfigError("traffic: numbers that are not finite")
        if (np.diff(time, axis=1) < 0.0).any():
            raise ConfigError("traffic: time_s falls along a path")
        return cls(time_s=time, position_m=position, radius_m=radius)

    @classmethod
    def none(cls) -> Self:
        """Build traffic without paths."""
        return cls.of(np.zeros((0, 1)), np.zeros((0, 1, 3)), np.zeros(0))


@compile_function
def _last_index_before(time: np.ndarray, t: float) -> int:
    """Return the index of the last time that is not after t; -1 if there is none."""
    low, high = 0, time.shape[0]
    while low < high:
        middle = (low + high) // 2
        if time[middle] <= t:
            low = middle + 1
        else:
            high = middle
    return low - 1


@compile_function
def _time_fraction(t: float, begin: float, end: float) -> float:
    """Return the fraction of the interval from begin to end that has passed at t."""
    return (t - begin) / (end - begin) if end - begin > 0.0 else 0.0


@compile_function
def _relative_motion(
    a: float,
    b: float,
    fraction: float,
    next_fraction: float,
    p: float,
    q: float,
    path_fraction: float,
    next_path_fraction: float,
) -> tuple[float, float]:
    """Return the difference of two motions a to b and p to q in one coordinate, and its change.

    At first, and how it changes from there.
    """
    first = a + fraction * (b - a) - (p + path_fraction * (q - p))
    return first, a + next_fraction * (b - a) - (p + next_path_fraction * (q - p)) - first


@compile_function
def meets_path(
    time: np.ndarray,
    position: np.ndarray,
    a: np.ndarray,
    t_a: float,
    b: np.ndarray,
    t_b: float,
    min_distance: float,
) -> bool:
    """Return whether a point going from a at t_a to b at t_b is within ``min_distance`` of a path.

    Between two of the path's times both go along lines, and so does their difference.
    """
    last = time.shape[0] - 1
    k, t = _last_index_before(time, t_a), t_a
    is_endless = not t_b < np.inf
    while True:
        end, i, j = t_b, max(k, 0), min(k + 1, last)
        if k < last and time[k + 1] < t_b:
            end = time[k + 1]
        path_fraction, next_path_fraction = 0.0, 1.0
        if 0 <= k < last and time[k + 1] > time[k]:
            path_fraction = _time_fraction(t, time[k], time[k + 1])
            next_path_fraction = (
                1.0 if end == time[k + 1] else _time_fraction(end, time[k], time[k + 1])
            )
        fraction = 0.0 if is_endless else _time_fraction(t, t_a, t_b)
        next_fraction = (
            1.0 if end == t_b else (0.0 if is_endless else _time_fraction(end, t_a, t_b))
        )
        wx, dx = _relative_motion(
            a[0],
            b[0],
            fraction,
            next_fraction,
            position[i, 0],
            position[j, 0],
            path_fraction,
            next_path_fraction,
        )
        wy, dy = _relative_motion(
            a[1],
            b[1],
            fraction,
            next_fraction,
            position[i, 1],
            position[j, 1],
            path_fraction,
            next_path_fraction,
        )
        wz, dz = _relative_motion(
            a[2],
            b[2],
            fraction,
            next_fraction,
            position[i, 2],
            position[j, 2],
            path_fraction,
            next_path_fraction,
        )
        if segment_point(wx, wy, wz, dx, dy, dz, 0.0, 0.0, 0.0) <= min_distance * min_distance:
            return True
        if end >= t_b:
            return False
        t = end
        k += 1


@compile_function
def timed_edge(
    head: np.ndarray,
    reals: np.ndarray,
    cells: np.ndarray,
    time: np.ndarray,
    position: np.ndarray,
    radius: np.ndarray,
    robot: int,
    a: np.ndarray,
    t_a: float,
    b: np.ndarray,
    t_b: float,
) -> bool:
    """Return whether one robot can go from a at t_a to b at t_b; see `edges.EdgeChecker`."""
    world = unpack_fields(head, reals)
    radius_m, keep = world.radius[robot], world.keep[0]
    reach = radius_m + keep
    if not (t_a <= t_b and is_inside(world.box, a, 0, reach) and is_inside(world.box, b, 0, reach)):
        return False
    if t_b == np.inf and not (a[0] == b[0] and a[1] == b[1] and a[2] == b[2]):
        return False
    ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
    if not is_clear_of_rock(world.box, cells, ax, ay, az, bx, by, bz, reach):
        return False
    if not is_clear_of_obstacles(world.still[: head[4]], ax, ay, az, bx, by, bz, reach):
        return False
    for k in range(radius.shape[0]):
        if meets_path(time[k], position[k], a, t_a, b, t_b, reach + radius[k]):
            return False
    for m in range(world.drift_radius.shape[0]):
        min_distance = reach + world.drift_radius[m]
        if meets_path(world.drift_time, world.drift_position[m], a, t_a, b, t_b, min_distance):
            return False
    return True


@compile_function
def timed_edges(
    head: np.ndarray,
    reals: np.ndarray,
    cells: np.ndarray,
    time: np.ndarray,
    position: np.ndarray,
    radius: np.ndarray,
    robot: int,
    a: np.ndarray,
    t_a: np.ndarray,
    b: np.ndarray,
    t_b: np.ndarray,
) -> np.ndarray:
    """Check many timed edges; a and b float64 [n, 3], times float64 [n]."""
    free = np.empty(a.shape[0], np.bool_)
    for n in range(a.shape[0]):
        free[n] = timed_edge(
            head, reals, cells, time, position, radius, robot, a[n], t_a[n], b[n], t_b[n]
        )
    return free
