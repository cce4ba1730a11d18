"""Compiled: when a team is where, in still water."""

import numpy as np

from angler_mjx.planning.host.compiled.compiling import compile_function

MIN_SPEED_MPS = 1e-3
"""Over ground; a robot that can only be slower cannot go there."""

SPEED_FACTOR = 1.0 - 1e-3
"""Factor of speeds, for the rounding of float32 positions and times."""

LINE_TOLERANCE_M = 1e-6
"""How far a point may lie off the line of its neighbours, in time too, to be left out."""


@compile_function
def time_in_still_water(
    path: np.ndarray, speed: np.ndarray, turn_radps: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a path in time, along each edge of which its slowest robot has its speed.

    Args:
        path: [k, R, d] x, y, z (and heading) of each.
        speed: [R] m/s.
        turn_radps: fastest turn.

    Returns:
        Times [n] from 0, s, which rise, and the path [n, R, d] there.
    """
    time, points, count = np.zeros(path.shape[0]), path.copy(), 1
    for k in range(1, path.shape[0]):
        leg_s = 0.0
        for robot in range(path.shape[1]):
            x = path[k, robot, 0] - path[k - 1, robot, 0]
            y = path[k, robot, 1] - path[k - 1, robot, 1]
            z = path[k, robot, 2] - path[k - 1, robot, 2]
            length = np.sqrt(x * x + y * y + z * z)
            if length > LINE_TOLERANCE_M:
                leg_s = max(leg_s, length / (SPEED_FACTOR * max(speed[robot], MIN_SPEED_MPS)))
            if path.shape[2] == 4:
                turned = abs(path[k, robot, 3] - path[k - 1, robot, 3])
                leg_s = max(leg_s, turned / turn_radps)
        if leg_s > 0.0:
            time[count], points[count] = time[count - 1] + leg_s, path[k]
            count += 1
    return time[:count], points[:count]


@compile_function
def needed_points(time: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return which points [n] of a robot's path [n, d] are off the line of their neighbours.

    The first and the last always are needed.
    """
    last = time.shape[0] - 1
    is_needed = np.ones(last + 1, np.bool_)
    begin = 0
    for k in range(1, last):
        fraction, deviation = (time[k] - time[begin]) / (time[k + 1] - time[begin]), 0.0
        for c in range(path.shape[1]):
            first = path[begin, c]
            deviation = max(
                deviation, abs(first + fraction * (path[k + 1, c] - first) - path[k, c])
            )
        is_needed[k] = deviation > LINE_TOLERANCE_M
        if is_needed[k]:
            begin = k
    return is_needed
