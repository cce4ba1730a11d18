"""Markers of a task over time, from `world.tasks.history`; replays show the same data."""

import numpy as np

from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.world.environment import Environment
from angler_mjx.world.tasks.history import GoodsStatus, TaskHistory
from angler_mjx.world.tasks.surface_quads import SurfaceQuads

_UNSEEN, _SEEN, _OPEN, _GOODS = (
    (0.78, 0.40, 0.25, 1.0),
    (0.37, 0.83, 0.69, 1.0),
    (1.00, 1.00, 1.00, 1.0),
    (1.00, 0.78, 0.34, 1.0),
)
"""Marker colours, RGBA."""
_EDGE, _THICK = 0.92, 0.04
"""Edge and thickness of faces, in cells."""
_POINT_M, _BOX_M, _LINE_M, _TEXT_M = 0.4, 0.44, 0.03, 0.5
"""Sizes of places, goods, lines to targets and letters."""


def build_markers(
    task: TaskHistory,
    environment: Environment,
    quads: SurfaceQuads | None,
    p_m: np.ndarray,
    frame: str,
    sample: int,
) -> list[ros.Message]:
    """Return the new markers of a task at a sample; each marker stays until its next one.

    Args:
        task: of the world.
        environment: of the world.
        quads: the surveyed surface, for a survey.
        p_m: [T, R, 3] positions of the robots, in W.
        frame: of the world.
        sample: number of the sample.
    """
    head = ros.make_header(float(task.time_s[sample]), frame)
    result = [_target_lines(task, head, p_m[sample], sample)]
    if sample == 0 or task.describe_progress(sample) != task.describe_progress(sample - 1):
        result.append(_progress_marker(task, environment, head, sample))
    if quads is not None and _has_changed(task.seen, sample):
        result += _surface_markers(task, head, quads, float(environment.grid.cell_m), sample)
    if _has_changed(task.done, sample):
        result += _job_markers(task, head, sample)
    if task.spec.kind == "deliver":
        result.append(_goods_marker(task, head, p_m, sample))
    return result


def doing_markers(
    task: TaskHistory, robot: int, frame: str, outcome: str, sample: int
) -> list[ros.Message]:
    """Return a robot's activity as text above it, where it changes.

    Args:
        task: of the world.
        robot: its index.
        frame: the robot's own.
        outcome: its outcome, shown after its end.
        sample: number of the sample.
    """

    def describe_robot(k: int) -> str:
        return task.describe_activity(k, robot) or ("finished" if outcome == "reached" else outcome)

    if sample and describe_robot(sample) == describe_robot(sample - 1):
        return []
    head, above = ros.make_header(float(task.time_s[sample]), frame), np.array([0.0, 0.0, 0.7])
    text = f"{robot}: {describe_robot(sample)}"
    size = [0.0, 0.0, _TEXT_M]
    return [
        ros.make_marker(
            head, "doing", robot, ros.TEXT, ros.make_pose(above), size, _OPEN, text=text
        )
    ]


def _has_changed(rows: np.ndarray, sample: int) -> bool:
    return sample == 0 or bool((rows[sample] != rows[sample - 1]).any())


def _progress_marker(
    task: TaskHistory, environment: Environment, head: ros.Message, sample: int
) -> ros.Message:
    """Return the progress of the task, above the middle of the cells."""
    grid = environment.grid
    size = float(grid.cell_m) * np.array(grid.occupied.shape)
    above = np.asarray(grid.origin_m) + size * [0.5, 0.5, 1.0] + [0.0, 0.0, 2.0 * _TEXT_M]
    height = [0.0, 0.0, 2.0 * _TEXT_M]
    text = task.describe_progress(sample)
    return ros.make_marker(
        head, "progress", 0, ros.TEXT, ros.make_pose(above), height, _OPEN, text=text
    )


def _surface_markers(
    task: TaskHistory, head: ros.Message, quads: SurfaceQuads, cell_m: float, sample: int
) -> list[ros.Message]:
    """Return lists of faces, one for each axis normal to some of them."""
    tint = np.array([_UNSEEN, _SEEN])[task.seen[sample][quads.cell].astype(int)]
    result = []
    for axis in np.unique(quads.axis).tolist():
        size, on_axis = [_EDGE * cell_m] * 3, quads.axis == axis
        size[axis] = _THICK * cell_m
        args = (ros.CUBE_LIST, ros.make_pose(np.zeros(3)), size, _UNSEEN, quads.centre_m[on_axis])
        result.append(ros.make_marker(head, "surface", axis, *args, colors=tint[on_axis]))
    return result


def _job_markers(task: TaskHistory, head: ros.Message, sample: int) -> list[ros.Message]:
    """Return places, viewpoints, or destinations of goods: white until they are done."""
    jobs = np.flatnonzero(task.exists)
    ends = task.spec.jobs if task.spec.kind == "deliver" else 0
    tint = np.array([_OPEN, _SEEN])[task.done[sample][jobs].astype(int)]
    size = [_POINT_M] * 3
    args = (ros.SPHERE_LIST, ros.make_pose(np.zeros(3)), size, _OPEN, task.position_m[ends + jobs])
    return [ros.make_marker(head, "places", 0, *args, colors=tint)]


def _goods_marker(
    task: TaskHistory, head: ros.Message, p_m: np.ndarray, sample: int
) -> ros.Message:
    """Return goods at their positions, without lost ones."""
    at_m = task.goods_m(p_m)[sample]
    is_present = np.isfinite(at_m).all(axis=1)
    goods_state = task.goods[sample]
    at_m[goods_state == GoodsStatus.TRAVEL, 2] -= _BOX_M
    tint = np.array([_GOODS, _SEEN])[(goods_state[is_present] == GoodsStatus.BROUGHT).astype(int)]
    args = (ros.CUBE_LIST, ros.make_pose(np.zeros(3)), [_BOX_M] * 3, _GOODS, at_m[is_present])
    return ros.make_marker(head, "goods", 0, *args, colors=tint)


def _target_lines(
    task: TaskHistory, head: ros.Message, p_m: np.ndarray, sample: int
) -> ros.Message:
    """Return lines from robots to their targets."""
    is_moving = task.is_underway[sample] & np.isfinite(p_m).all(axis=1)
    ends = np.stack([p_m, task.position_m[np.maximum(task.target[sample], 0)]], axis=1)[is_moving]
    args = (
        ros.LINE_LIST,
        ros.make_pose(np.zeros(3)),
        [_LINE_M, 0.0, 0.0],
        _OPEN,
        ends.reshape(-1, 3),
    )
    return ros.make_marker(head, "to", 0, *args)
