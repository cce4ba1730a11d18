"""The task of a team in a replay: what is covered, places, goods, and who goes where.

Everything lies under ``ROOT/space/task``; what robots do stands in their labels and in the table of
the fleet. All of it is what `world.tasks.history` says of the samples.
"""

import numpy as np
import rerun as rr

from angler_mjx.report.viewing.entities.scenery import (
    DOT,
    MOST_NAMED,
    Rgba,
    color_of,
    ending,
    rgba,
    times,
)
from angler_mjx.report.viewing.scene import ReplayScene, RobotTrack
from angler_mjx.world.tasks.history import Goods, TaskHistory
from angler_mjx.world.tasks.surface_quads import SurfaceQuads, surface

SEEN, UNSEEN = rgba("#5fd3b0"), rgba("#c7663f")
"""Of surfaces: light green and dark orange differ in lightness as well."""
OPEN, GOODS = rgba("#ffffff"), rgba("#ffc857")

_MOST_COLORS = 2_000_000
"""Colours of all faces at all times, at most: 8 MB; of larger surveys looks are left out."""
_FACE, _THIN = 0.46, 0.02
"""Half edge and half thickness of a face, in cells."""
_BOX = 0.22
"""Half edge of goods, m."""


def log_task(
    recording: rr.RecordingStream, scene: ReplayScene, task: TaskHistory, root: str
) -> None:
    """Log the task of a world.

    Args:
        recording: where to.
        scene: the world.
        task: of it.
        root: path of the entities: ``space/task`` of the world.
    """
    _progress(recording, scene, task, f"{root}/progress")
    found = surface(task, scene.environment)
    if found is not None:
        cell_m = float(scene.environment.grid.cell_m)
        _faces(recording, task, found, cell_m, f"{root}/surface")
    if task.spec.kind == "deliver":
        _goods(recording, scene, task, root)
    else:
        _places(recording, task, f"{root}/places")
    for robot in scene.robots:
        _way(recording, task, robot, f"{root}/to/robot_{robot.index}")


def changes(rows: np.ndarray, most: int | None = None) -> np.ndarray:
    """Samples at which an array [T, ...] is another than before, the first one among them.

    Args:
        rows: what may change.
        most: so many at most, evenly chosen, the last one always among them.
    """
    flat = rows.reshape(len(rows), -1)
    found = np.flatnonzero(np.r_[True, np.any(flat[1:] != flat[:-1], axis=1)])
    if most is None or len(found) <= most:
        return found
    chosen: np.ndarray = found[np.unique(np.linspace(0, len(found) - 1, max(most, 2)).astype(int))]
    return chosen


def _progress(
    recording: rr.RecordingStream, scene: ReplayScene, task: TaskHistory, path: str
) -> None:
    """A line of text above the world."""
    low, high = scene.bounds_m
    above = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2]])
    above[2] += 0.06 * float(max(high - low))
    told = [task.words(sample) for sample in range(len(task.time_s))]
    at = [k for k in range(len(told)) if k == 0 or told[k] != told[k - 1]]
    still = rr.Points3D.from_fields(positions=[above], radii=[DOT], colors=[OPEN], show_labels=True)
    recording.log(path, still, static=True)
    recording.send_columns(
        path,
        [times(task.time_s[at])],
        rr.Points3D.columns(labels=[told[k] for k in at]),
    )


def _faces(
    recording: rr.RecordingStream, task: TaskHistory, found: SurfaceQuads, cell_m: float, path: str
) -> None:
    """The surface of a survey: seen or not."""
    half = np.full((len(found.axis), 3), _FACE * cell_m)
    half[np.arange(len(half)), found.axis] = _THIN * cell_m
    still = rr.Boxes3D.from_fields(centers=found.centre_m, half_sizes=half, fill_mode="solid")
    recording.log(path, still, static=True)
    at = changes(task.seen, _MOST_COLORS // max(len(half), 1))
    tint = np.array([UNSEEN, SEEN], np.uint8)[task.seen[at][:, found.cell].astype(int)]
    recording.send_columns(
        path,
        [times(task.time_s[at])],
        rr.Boxes3D.columns(colors=tint.reshape(-1, 4)).partition([len(half)] * len(at)),
    )


def _places(recording: rr.RecordingStream, task: TaskHistory, path: str) -> None:
    """Places of a tour, or viewpoints of a survey: white, then in the colour of who did them."""
    there = np.flatnonzero(task.exists)
    toured = task.spec.kind == "tour"
    still = rr.Points3D.from_fields(
        positions=task.place_m[there],
        radii=[0.3 if toured else 0.12],
        labels=[f"place {job}" for job in there],
        show_labels=toured and len(there) <= MOST_NAMED,
    )
    recording.log(path, still, static=True)
    at = changes(task.done)
    done = np.array([_of_doer(task, job) for job in there.tolist()], np.uint8)
    tint = np.where(task.done[at][:, there, None], done, np.array(OPEN, np.uint8))
    recording.send_columns(
        path,
        [times(task.time_s[at])],
        rr.Points3D.columns(colors=tint.reshape(-1, 4)).partition([len(there)] * len(at)),
    )


def _of_doer(task: TaskHistory, job: int) -> Rgba:
    """Of a place that was done; where all have to come there it is nobody's."""
    return color_of(int(task.by[job])) if task.spec.shared else ending(arrived=True)


def _goods(recording: rr.RecordingStream, scene: ReplayScene, task: TaskHistory, root: str) -> None:
    """Goods where they are, and the ways that they are to go."""
    there, jobs = np.flatnonzero(task.exists), task.spec.jobs
    ends = task.place_m[jobs + there]
    ways = np.stack([task.place_m[there], ends], axis=1)
    recording.log(
        f"{root}/ways", rr.LineStrips3D(ways, colors=[rgba("#7f93a0")], radii=[-0.5]), static=True
    )
    still: rr.AsComponents = rr.Boxes3D.from_fields(
        centers=ends, half_sizes=np.full((len(ends), 3), 1.6 * _BOX), radii=[-1.0]
    )
    recording.log(f"{root}/ends", still, static=True)
    still = rr.Points3D.from_fields(
        radii=[DOT], colors=[OPEN], show_labels=len(there) <= MOST_NAMED
    )
    recording.log(f"{root}/ends/names", still, static=True)
    at = changes(task.goods == Goods.BROUGHT)
    brought = (task.goods[at] == Goods.BROUGHT)[:, there]
    tint = np.array([OPEN, SEEN], np.uint8)[brought.astype(int)]
    recording.send_columns(
        f"{root}/ends",
        [times(task.time_s[at])],
        rr.Boxes3D.columns(colors=tint.reshape(-1, 4)).partition([len(there)] * len(at)),
    )
    waiting = [f"for {job}" for row in brought for job in there[~row]]
    count = (~brought).sum(axis=1)
    recording.send_columns(
        f"{root}/ends/names",
        [times(task.time_s[at])],
        [
            *rr.Points3D.columns(
                positions=np.concatenate([ends[~row] for row in brought])
            ).partition(count),
            *rr.Points3D.columns(labels=waiting).partition(count),
        ],
    )
    at_m = task.goods_m(np.stack([robot.p_m for robot in scene.robots], axis=1))
    moved = changes(np.nan_to_num(at_m, nan=np.inf))
    for job in there:
        _one_good(recording, task, at_m[moved, job], moved, int(job), f"{root}/goods/{job}")


def _one_good(
    recording: rr.RecordingStream,
    task: TaskHistory,
    at_m: np.ndarray,
    samples: np.ndarray,
    job: int,
    path: str,
) -> None:
    """A box that lies, travels below its robot, and lies again; gone when it is lost."""
    still = rr.Boxes3D.from_fields(
        half_sizes=[[_BOX] * 3], labels=[f"goods {job}"], fill_mode="solid"
    )
    recording.log(path, still, static=True)
    where = task.goods[samples, job]
    there = np.isfinite(at_m).all(axis=1)
    below = np.where((where == Goods.TRAVEL)[:, None], [0.0, 0.0, -2.0 * _BOX], 0.0)
    tint = np.where((where == Goods.BROUGHT)[:, None], SEEN, GOODS).astype(np.uint8)
    count, few = there.astype(int), int(task.exists.sum()) <= MOST_NAMED
    recording.send_columns(
        path,
        [times(task.time_s[samples])],
        [
            *rr.Boxes3D.columns(centers=(at_m + below)[there]).partition(count),
            *rr.Boxes3D.columns(colors=tint[there]).partition(count),
            # Its robot's label tells what a robot brings.
            *rr.Boxes3D.columns(show_labels=few & (where != Goods.TRAVEL)),
        ],
    )


def _way(recording: rr.RecordingStream, task: TaskHistory, robot: RobotTrack, path: str) -> None:
    """A thin line from a robot to where it is to go; none where it stays."""
    still = rr.LineStrips3D.from_fields(colors=[color_of(robot.index)], radii=[-0.5])
    recording.log(path, still, static=True)
    target = task.target[:, robot.index]
    goes = task.goes[:, robot.index] & np.isfinite(robot.p_m).all(axis=1)
    lines = np.stack([robot.p_m, task.place_m[np.maximum(target, 0)]], axis=1)
    recording.send_columns(
        path,
        [times(task.time_s)],
        rr.LineStrips3D.columns(strips=list(lines[goes])).partition(goes.astype(int)),
    )
