"""Progress of a robot along its plan: a plan counts as flown only from its last approach on.

The controller's aim is a point on the plan. A time on the plan never goes back and runs no faster
than the clock, so the successive aims of a flight bound it from both sides.
"""

import numpy as np

from angler_mjx.testing.referee.geometry import Floats

APPROACH_M = 1.0
"""Distance outside the goal's tolerance at which the last approach begins."""
AIM_M = 1e-3
"""Rounding of an aim in float32, and of the plan's time behind it."""


def last_approach_s(time_s: Floats, point_m: Floats, goal_m: Floats, tolerance_m: float) -> float:
    """Return the time at which a plan's last approach to its goal begins, s.

    The time of the last way-point at least the tolerance and `APPROACH_M` from the goal, or of the
    farthest one where none is so far.

    Args:
        time_s: [P] of the way-points.
        point_m: [P, 3].
        goal_m: [3].
        tolerance_m: of the goal.
    """
    distance_m = np.linalg.norm(point_m - goal_m, axis=1)
    return float(time_s[distance_m >= min(tolerance_m + APPROACH_M, distance_m.max())][-1])


def passes_before(
    time_s: Floats, point_m: Floats, goal_m: Floats, within_m: float, until_s: float
) -> bool:
    """Return whether the plan comes within a distance of its goal before a time."""
    for k in np.flatnonzero(time_s[:-1] < until_s):
        leg, offset_m = point_m[k + 1] - point_m[k], goal_m - point_m[k]
        square = float(leg @ leg)
        fraction = np.clip(offset_m @ leg / square, 0.0, 1.0) if square > 0.0 else 0.0
        if np.linalg.norm(offset_m - fraction * leg) < within_m:
            return True
    return False


def progress_s(
    time_s: Floats, point_m: Floats, aim_m: Floats, spans_s: Floats
) -> tuple[Floats, Floats] | None:
    """Return bounds of the time on a plan with each state, [T] and [T] s.

    Args:
        time_s: [P] of the way-points.
        point_m: [P, 3] joined by lines.
        aim_m: [A, 3] aim of the controller with each state; the last state may have none.
        spans_s: [T] time since the state before; the first is not used.

    Returns:
        None where an aim is not on the lines: the plan is bent, or the controller aims elsewhere.
    """
    low, high = np.zeros(len(spans_s)), np.zeros(len(spans_s))
    real = np.flatnonzero(np.diff(time_s) > 0)
    begin, length = time_s[real], np.diff(time_s)[real]
    start, leg = point_m[real], np.diff(point_m, axis=0)[real]
    square = np.sum(leg * leg, axis=1)
    for k, span in enumerate(spans_s):
        earliest, latest = (low[k - 1], high[k - 1] + span) if k else (0.0, 0.0)
        latest += float(np.spacing(np.float32(latest)))  # the clock is a sum in float32
        if k >= len(aim_m):
            low[k], high[k] = earliest, latest
            continue
        # Parts of each line that lie within the rounding of the aim, as fractions of it.
        offset_m = aim_m[k] - start
        middle = np.sum(offset_m * leg, axis=1) / np.where(square > 0.0, square, 1.0)
        miss_sq = np.sum((offset_m - middle[:, None] * leg) ** 2, axis=1)
        is_at_rest = square <= AIM_M**2
        half = np.sqrt(np.maximum(AIM_M**2 - miss_sq, 0.0) / np.where(is_at_rest, 1.0, square))
        first, last = middle - half, middle + half
        is_on_leg = (miss_sq <= AIM_M**2) & (is_at_rest | ((first <= 1.0) & (last >= 0.0)))
        first = np.where(is_at_rest, 0.0, np.clip(first, 0.0, 1.0))
        last = np.where(is_at_rest, 1.0, np.clip(last, 0.0, 1.0))
        # Beyond the last way-point the aim stays there for ever.
        at_end = np.linalg.norm(aim_m[k] - point_m[-1]) <= AIM_M
        since = np.append(begin + first * length, time_s[-1])
        until = np.append(begin + last * length, np.inf)
        is_on_leg = (
            np.append(is_on_leg, at_end) & (since <= latest + 1e-6) & (until >= earliest - 1e-6)
        )
        if not is_on_leg.any():
            return None
        low[k] = max(earliest, float(since[is_on_leg].min()))
        high[k] = min(latest, float(until[is_on_leg].max()))
    return low, high
