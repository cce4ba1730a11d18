"""Markers of the current over time: streaks on a level lattice at the height of the fleet."""

import numpy as np

from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.world.slices import CurrentSlices

_STREAK_S = 4.0
"""Length of a streak, as the time in which the water passes it."""
_TAIL, _HEAD = (0.44, 0.75, 0.88, 0.15), (0.86, 0.94, 0.98, 1.0)
"""Colours of a streak's ends, RGBA: the water flows from dark to light."""
_WIDTH_M = 0.05


def build_markers(slices: CurrentSlices, frame: str, row: int) -> list[ros.Message]:
    """Return the streaks of a slice.

    Args:
        slices: slices of a world.
        frame: of the world.
        row: number of the slice.
    """
    head, wet = ros.make_header(float(slices.time_s[row]), frame), slices.wet[row]
    half = 0.5 * _STREAK_S * slices.velocity_mps[row][wet]
    middle = slices.point_m[row][wet]
    ends = np.stack([middle - half, middle + half], axis=1).reshape(-1, 3)
    tint = np.tile([_TAIL, _HEAD], (len(middle), 1))
    args = (ros.LINE_LIST, ros.make_pose(np.zeros(3)), [_WIDTH_M, 0.0, 0.0], _HEAD, ends)
    return [ros.make_marker(head, "current", 0, *args, colors=tint)]
