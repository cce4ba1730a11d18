"""Task of a team in a replay: coverage, places, goods, and targets of the robots.

Everything lies under ``ROOT/space/task``; the robots' activities are in their labels and in the
table of the fleet. All data come from `world.tasks.history` at the samples.
"""

import numpy as np
import rerun as rr

from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.report.viewing.entities.scenery import (
    DOT,
    MAX_NAMED,
    Rgba,
    ending_color,
    robot_rgba,
    time_column,
    to_rgba,
)
from angler_mjx.world.tasks.history import GoodsStatus, TaskHistory
from angler_mjx.world.tasks.surface_quads import SurfaceQuads, survey_surface

SEEN, UNSEEN = to_rgba("#5fd3b0"), to_rgba("#c7663f")
"""Colours of surfaces: light green and dark orange differ in lightness as well."""
OPEN, GOODS = to_rgba("#ffffff"), to_rgba("#ffc857")

_MAX_COLORS = 2_000_000
"""Max face colours over all times: 8 MB; for larger surveys some samples are left out."""
_HALF_EDGE, _THIN = 0.46, 0.02
"""Half edge and half thickness of a face, in cells."""
_BOX = 0.22
"""Half edge of goods, m."""


def log_task(
    recording: rr.RecordingStream, scene: ReplayScene, task: TaskHistory, root: str
) -> None:
    """Log the task of a world.

    Args:
        recording: destination.
        scene: the world.
        task: of the world.
        root: path of the entities: ``space/task`` of the world.
    """
    _log_progress(recording, scene, task, f"{root}/progress")
    quads = survey_surface(task, scene.environment)
    if quads is not None:
        cell_m = float(scene.environment.grid.cell_m)
        _log_surface(recording, task, quads, cell_m, f"{root}/surface")
    if task.spec.kind == "deliver":
        _log_goods(recording, scene, task, root)
    else:
        _log_jobs(recording, task, f"{root}/places")
    for robot in scene.robots:
        _log_target_line(recording, task, robot, f"{root}/to/robot_{robot.index}")


def find_changes(rows: np.ndarray, max_count: int | None = None) -> np.ndarray:
    """Return the samples at which an array [T, ...] changes, including the first.

    Args:
        rows: the array.
        max_count: max number, evenly chosen, always with the last one.
    """
    flat = rows.reshape(len(rows), -1)
    changed = np.flatnonzero(np.r_[True, np.any(flat[1:] != flat[:-1], axis=1)])
    if max_count is None or len(changed) <= max_count:
        return changed
    selected: np.ndarray = changed[
        np.unique(np.linspace(0, len(changed) - 1, max(max_count, 2)).astype(int))
    ]
    return selected


def _log_progress(
    recording: rr.RecordingStream, scene: ReplayScene, task: TaskHistory, path: str
) -> None:
    """Log a line of text above the world."""
    low, high = scene.bounds_m
    above = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2]])
    above[2] += 0.06 * float(max(high - low))
    texts = [task.describe_progress(sample) for sample in range(len(task.time_s))]
    samples = [k for k in range(len(texts)) if k == 0 or texts[k] != texts[k - 1]]
    label = rr.Points3D.from_fields(positions=[above], radii=[DOT], colors=[OPEN], show_labels=True)
    recording.log(path, label, static=True)
    recording.send_columns(
        path,
        [time_column(task.time_s[samples])],
        rr.Points3D.columns(labels=[texts[k] for k in samples]),
    )


def _log_surface(
    recording: rr.RecordingStream, task: TaskHistory, quads: SurfaceQuads, cell_m: float, path: str
) -> None:
    """Log the surface of a survey: seen or not."""
    half = np.full((len(quads.axis), 3), _HALF_EDGE * cell_m)
    half[np.arange(len(half)), quads.axis] = _THIN * cell_m
    boxes = rr.Boxes3D.from_fields(centers=quads.centre_m, half_sizes=half, fill_mode="solid")
    recording.log(path, boxes, static=True)
    samples = find_changes(task.seen, _MAX_COLORS // max(len(half), 1))
    tint = np.array([UNSEEN, SEEN], np.uint8)[task.seen[samples][:, quads.cell].astype(int)]
    recording.send_columns(
        path,
        [time_column(task.time_s[samples])],
        rr.Boxes3D.columns(colors=tint.reshape(-1, 4)).partition([len(half)] * len(samples)),
    )


def _log_jobs(recording: rr.RecordingStream, task: TaskHistory, path: str) -> None:
    """Log places of a tour, or viewpoints of a survey: white, then in the colour of their robot."""
    jobs = np.flatnonzero(task.exists)
    is_tour = task.spec.kind == "tour"
    points = rr.Points3D.from_fields(
        positions=task.position_m[jobs],
        radii=[0.3 if is_tour else 0.12],
        labels=[f"place {job}" for job in jobs],
        show_labels=is_tour and len(jobs) <= MAX_NAMED,
    )
    recording.log(path, points, static=True)
    samples = find_changes(task.done)
    done = np.array([_doer_color(task, job) for job in jobs.tolist()], np.uint8)
    tint = np.where(task.done[samples][:, jobs, None], done, np.array(OPEN, np.uint8))
    recording.send_columns(
        path,
        [time_column(task.time_s[samples])],
        rr.Points3D.columns(colors=tint.reshape(-1, 4)).partition([len(jobs)] * len(samples)),
    )


def _doer_color(task: TaskHistory, job: int) -> Rgba:
    """Return the colour of a finished place; neutral where all robots have to come."""
    return robot_rgba(int(task.by[job])) if task.spec.shared else ending_color(arrived=True)


def _log_goods(
    recording: rr.RecordingStream, scene: ReplayScene, task: TaskHistory, root: str
) -> None:
    """Log the goods at their positions, and their transport paths."""
    present, jobs = np.flatnonzero(task.exists), task.spec.jobs
    ends = task.position_m[jobs + present]
    lines = np.stack([task.position_m[present], ends], axis=1)
    recording.log(
        f"{root}/ways",
        rr.LineStrips3D(lines, colors=[to_rgba("#7f93a0")], radii=[-0.5]),
        static=True,
    )
    marks: rr.AsComponents = rr.Boxes3D.from_fields(
        centers=ends, half_sizes=np.full((len(ends), 3), 1.6 * _BOX), radii=[-1.0]
    )
    recording.log(f"{root}/ends", marks, static=True)
    marks = rr.Points3D.from_fields(
        radii=[DOT], colors=[OPEN], show_labels=len(present) <= MAX_NAMED
    )
    recording.log(f"{root}/ends/names", marks, static=True)
    samples = find_changes(task.goods == GoodsStatus.BROUGHT)
    brought = (task.goods[samples] == GoodsStatus.BROUGHT)[:, present]
    tint = np.array([OPEN, SEEN], np.uint8)[brought.astype(int)]
    recording.send_columns(
        f"{root}/ends",
        [time_column(task.time_s[samples])],
        rr.Boxes3D.columns(colors=tint.reshape(-1, 4)).partition([len(present)] * len(samples)),
    )
    waiting = [f"for {job}" for row in brought for job in present[~row]]
    count = (~brought).sum(axis=1)
    recording.send_columns(
        f"{root}/ends/names",
        [time_column(task.time_s[samples])],
        [
            *rr.Points3D.columns(
                positions=np.concatenate([ends[~row] for row in brought])
            ).partition(count),
            *rr.Points3D.columns(labels=waiting).partition(count),
        ],
    )
    at_m = task.goods_m(np.stack([robot.p_m for robot in scene.robots], axis=1))
    moved = find_changes(np.nan_to_num(at_m, nan=np.inf))
    for job in present:
        _log_good(recording, task, at_m[moved, job], moved, int(job), f"{root}/goods/{job}")


def _log_good(
    recording: rr.RecordingStream,
    task: TaskHistory,
    at_m: np.ndarray,
    samples: np.ndarray,
    job: int,
    path: str,
) -> None:
    """Log a box that lies, travels below its robot, and lies again; removed when it is lost."""
    box = rr.Boxes3D.from_fields(
        half_sizes=[[_BOX] * 3], labels=[f"goods {job}"], fill_mode="solid"
    )
    recording.log(path, box, static=True)
    goods_state = task.goods[samples, job]
    is_present = np.isfinite(at_m).all(axis=1)
    below = np.where((goods_state == GoodsStatus.TRAVEL)[:, None], [0.0, 0.0, -2.0 * _BOX], 0.0)
    tint = np.where((goods_state == GoodsStatus.BROUGHT)[:, None], SEEN, GOODS).astype(np.uint8)
    count, is_named = is_present.astype(int), int(task.exists.sum()) <= MAX_NAMED
    recording.send_columns(
        path,
        [time_column(task.time_s[samples])],
        [
            *rr.Boxes3D.columns(centers=(at_m + below)[is_present]).partition(count),
            *rr.Boxes3D.columns(colors=tint[is_present]).partition(count),
            # The label of the robot shows its load.
            *rr.Boxes3D.columns(show_labels=is_named & (goods_state != GoodsStatus.TRAVEL)),
        ],
    )


def _log_target_line(
    recording: rr.RecordingStream, task: TaskHistory, robot: RobotTrack, path: str
) -> None:
    """Log a thin line from a robot to its target; none where it stays."""
    line = rr.LineStrips3D.from_fields(colors=[robot_rgba(robot.index)], radii=[-0.5])
    recording.log(path, line, static=True)
    target = task.target[:, robot.index]
    is_moving = task.is_underway[:, robot.index] & np.isfinite(robot.p_m).all(axis=1)
    lines = np.stack([robot.p_m, task.position_m[np.maximum(target, 0)]], axis=1)
    recording.send_columns(
        path,
        [time_column(task.time_s)],
        rr.LineStrips3D.columns(strips=list(lines[is_moving])).partition(is_moving.astype(int)),
    )
