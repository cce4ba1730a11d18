"""Markers of a task over time, from `world.tasks.history`: those that replays show too."""

import numpy as np

from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.world.environment import Environment
from angler_mjx.world.tasks.history import Goods, TaskHistory
from angler_mjx.world.tasks.surface_quads import SurfaceQuads

_UNSEEN, _SEEN, _OPEN, _GOODS = (
    (0.78, 0.40, 0.25, 1.0),
    (0.37, 0.83, 0.69, 1.0),
    (1.00, 1.00, 1.00, 1.0),
    (1.00, 0.78, 0.34, 1.0),
)
"""Colours, RGBA."""
_EDGE, _THICK = 0.92, 0.04
"""Of faces, in cells."""
_PLACE_M, _BOX_M, _LINE_M, _TEXT_M = 0.4, 0.44, 0.03, 0.5
"""Sizes of places, goods, lines to targets and letters."""


def markers(
    task: TaskHistory,
    environment: Environment,
    found: SurfaceQuads | None,
    p_m: np.ndarray,
    frame: str,
    sample: int,
) -> list[ros.Message]:
    """What is new of a task at a sample; each marker stays until its next one.

    Args:
        task: of the world.
        environment: of the world.
        found: the surface that it sees, if it is a survey.
        p_m: [T, R, 3] where the robots are, in W.
        frame: of the world.
        sample: number of the sample.
    """
    head = ros.header(float(task.time_s[sample]), frame)
    made = [_to(task, head, p_m[sample], sample)]
    if sample == 0 or task.words(sample) != task.words(sample - 1):
        made.append(_words(task, environment, head, sample))
    if found is not None and _changed(task.seen, sample):
        made += _surface(task, head, found, float(environment.grid.cell_m), sample)
    if _changed(task.done, sample):
        made += _places(task, head, sample)
    if task.spec.kind == "deliver":
        made.append(_goods(task, head, p_m, sample))
    return made


def doing(
    task: TaskHistory, robot: int, frame: str, outcome: str, sample: int
) -> list[ros.Message]:
    """What a robot does, as text above it, where that is new.

    Args:
        task: of the world.
        robot: its index.
        frame: the robot's own.
        outcome: how it ended, said from then on.
        sample: number of the sample.
    """

    def told(k: int) -> str:
        return task.does(k, robot) or ("finished" if outcome == "reached" else outcome)

    if sample and told(sample) == told(sample - 1):
        return []
    head, above = ros.header(float(task.time_s[sample]), frame), np.array([0.0, 0.0, 0.7])
    text = f"{robot}: {told(sample)}"
    size = [0.0, 0.0, _TEXT_M]
    return [ros.marker(head, "doing", robot, ros.TEXT, ros.pose(above), size, _OPEN, text=text)]


def _changed(rows: np.ndarray, sample: int) -> bool:
    return sample == 0 or bool((rows[sample] != rows[sample - 1]).any())


def _words(
    task: TaskHistory, environment: Environment, head: ros.Message, sample: int
) -> ros.Message:
    """How far the task is, above the middle of the cells."""
    grid = environment.grid
    size = float(grid.cell_m) * np.array(grid.occupied.shape)
    above = np.asarray(grid.origin_m) + size * [0.5, 0.5, 1.0] + [0.0, 0.0, 2.0 * _TEXT_M]
    height = [0.0, 0.0, 2.0 * _TEXT_M]
    text = task.words(sample)
    return ros.marker(head, "progress", 0, ros.TEXT, ros.pose(above), height, _OPEN, text=text)


def _surface(
    task: TaskHistory, head: ros.Message, found: SurfaceQuads, cell_m: float, sample: int
) -> list[ros.Message]:
    """Lists of faces, one for each axis that some are square to."""
    tint = np.array([_UNSEEN, _SEEN])[task.seen[sample][found.cell].astype(int)]
    made = []
    for axis in np.unique(found.axis).tolist():
        size, mine = [_EDGE * cell_m] * 3, found.axis == axis
        size[axis] = _THICK * cell_m
        args = (ros.CUBE_LIST, ros.pose(np.zeros(3)), size, _UNSEEN, found.centre_m[mine])
        made.append(ros.marker(head, "surface", axis, *args, colors=tint[mine]))
    return made


def _places(task: TaskHistory, head: ros.Message, sample: int) -> list[ros.Message]:
    """Places, viewpoints, or where goods go: white until they are done."""
    there = np.flatnonzero(task.exists)
    ends = task.spec.jobs if task.spec.kind == "deliver" else 0
    tint = np.array([_OPEN, _SEEN])[task.done[sample][there].astype(int)]
    size = [_PLACE_M] * 3
    args = (ros.SPHERE_LIST, ros.pose(np.zeros(3)), size, _OPEN, task.place_m[ends + there])
    return [ros.marker(head, "places", 0, *args, colors=tint)]


def _goods(task: TaskHistory, head: ros.Message, p_m: np.ndarray, sample: int) -> ros.Message:
    """Goods where they are; lost ones are gone."""
    at_m = task.goods_m(p_m)[sample]
    there = np.isfinite(at_m).all(axis=1)
    where = task.goods[sample]
    at_m[where == Goods.TRAVEL, 2] -= _BOX_M
    tint = np.array([_GOODS, _SEEN])[(where[there] == Goods.BROUGHT).astype(int)]
    args = (ros.CUBE_LIST, ros.pose(np.zeros(3)), [_BOX_M] * 3, _GOODS, at_m[there])
    return ros.marker(head, "goods", 0, *args, colors=tint)


def _to(task: TaskHistory, head: ros.Message, p_m: np.ndarray, sample: int) -> ros.Message:
    """Lines from robots to where they are to go."""
    goes = task.goes[sample] & np.isfinite(p_m).all(axis=1)
    ends = np.stack([p_m, task.place_m[np.maximum(task.target[sample], 0)]], axis=1)[goes]
    args = (ros.LINE_LIST, ros.pose(np.zeros(3)), [_LINE_M, 0.0, 0.0], _OPEN, ends.reshape(-1, 3))
    return ros.marker(head, "to", 0, *args)
