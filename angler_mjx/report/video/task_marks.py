"""Shapes that show the task of a team: surfaces of a survey, places of a tour, goods."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from matplotlib import colors

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.world.tasks.history import GoodsStatus, TaskHistory
from angler_mjx.world.tasks.surface_quads import survey_surface

BALL, BOX = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_BOX)

_OPEN, _SEEN, _UNSEEN, _GOODS = "#ffffff", "#5fd3b0", "#c7663f", "#ffc857"
_PALETTE = (_OPEN, _SEEN, _UNSEEN, _GOODS)
_TOUR_RADIUS_M, _VIEWPOINT_RADIUS_M = 0.3, 0.12
_HALF_EDGE, _THIN = 0.46, 0.02
"""Half edge and half thickness of a surface, in cells."""
_GOODS_M, _DESTINATION_M = 0.22, 0.35
"""Half edges of goods, and of where they belong, m."""


@dataclass(frozen=True, kw_only=True)
class Marks:
    """K shapes in N frames."""

    kind: np.ndarray
    """int [K] MuJoCo's type of geom."""
    size_m: np.ndarray
    """[K, 3] MuJoCo's sizes: radius, or half edges."""
    position_m: np.ndarray
    """float32 [N, K, 3] in W; NaN where a shape is not there."""
    tint: np.ndarray
    """uint8 [N, K] row of ``palette``."""
    palette: np.ndarray
    """[C, 4]."""


def build_marks(scene: ReplayScene, time_s: np.ndarray) -> Marks:
    """Return the marks of a world at times [N]; none without a task.

    Args:
        scene: the world.
        time_s: [N] s.
    """
    parts: list[Marks] = [_no_marks(scene, len(time_s))]
    task = scene.task
    if task is not None:
        samples = np.searchsorted(task.time_s, time_s + 1e-6, side="right") - 1
        samples = np.clip(samples, 0, len(task.time_s) - 1)
        parts.append(_mark_surface(scene, task, samples))
        if task.spec.kind == "deliver":
            parts += _mark_goods(scene, task, samples)
        else:
            parts.append(_mark_jobs(scene, task, samples))
    return _join(parts)


def _palette(scene: ReplayScene) -> np.ndarray:
    """Return the colours [C, 4]: those of the module, then those of the robots."""
    robots = [style.robot_color(robot.index) for robot in scene.robots]
    return np.array([colors.to_rgba(color) for color in (*_PALETTE, *robots)])


def _no_marks(scene: ReplayScene, count: int) -> Marks:
    return Marks(
        kind=np.zeros(0, int),
        size_m=np.zeros((0, 3)),
        position_m=np.zeros((count, 0, 3), np.float32),
        tint=np.zeros((count, 0), np.uint8),
        palette=_palette(scene),
    )


def _join(parts: Sequence[Marks]) -> Marks:
    return Marks(
        kind=np.concatenate([part.kind for part in parts]),
        size_m=np.concatenate([part.size_m for part in parts]),
        position_m=np.concatenate([part.position_m for part in parts], axis=1),
        tint=np.concatenate([part.tint for part in parts], axis=1),
        palette=parts[0].palette,
    )


def _build(
    scene: ReplayScene, kind: int, size_m: np.ndarray, position_m: np.ndarray, tint: np.ndarray
) -> Marks:
    """Return marks of one kind: sizes [K, 3], positions [K, 3] or [N, K, 3], tints [N, K]."""
    shape = (*tint.shape, 3)
    return Marks(
        kind=np.full(tint.shape[1], kind),
        size_m=size_m,
        position_m=np.broadcast_to(position_m, shape).astype(np.float32),
        tint=tint.astype(np.uint8),
        palette=_palette(scene),
    )


def _mark_surface(scene: ReplayScene, task: TaskHistory, samples: np.ndarray) -> Marks:
    """Mark the surface of a survey: seen or not."""
    quads = survey_surface(task, scene.environment)
    if quads is None:
        return _no_marks(scene, len(samples))
    cell_m = float(scene.environment.grid.cell_m)
    half = np.full((len(quads.axis), 3), _HALF_EDGE * cell_m)
    half[np.arange(len(half)), quads.axis] = _THIN * cell_m
    is_seen = task.seen[samples][:, quads.cell]
    tint = np.where(is_seen, _PALETTE.index(_SEEN), _PALETTE.index(_UNSEEN))
    return _build(scene, BOX, half, np.asarray(quads.centre_m), tint)


def _mark_jobs(scene: ReplayScene, task: TaskHistory, samples: np.ndarray) -> Marks:
    """Mark places of a tour or viewpoints of a survey: white, then in the colour of their robot."""
    jobs = np.flatnonzero(task.exists)
    radius_m = _TOUR_RADIUS_M if task.spec.kind == "tour" else _VIEWPOINT_RADIUS_M
    doer = len(_PALETTE) + task.by[jobs] if task.spec.shared else _PALETTE.index(_SEEN)
    tint = np.where(task.done[samples][:, jobs], doer, _PALETTE.index(_OPEN))
    return _build(scene, BALL, np.full((len(jobs), 3), radius_m), task.position_m[jobs], tint)


def _mark_goods(scene: ReplayScene, task: TaskHistory, samples: np.ndarray) -> list[Marks]:
    """Mark goods where they are, and a flat box where they belong."""
    jobs = np.flatnonzero(task.exists)
    robot_m = np.stack([robot.p_m for robot in scene.robots], axis=1)
    at_m = task.goods_m(robot_m)[samples][:, jobs]
    status = task.goods[samples][:, jobs]
    at_m[..., 2] -= np.where(status == GoodsStatus.TRAVEL, 2.0 * _GOODS_M, 0.0)
    seen, goods = _PALETTE.index(_SEEN), _PALETTE.index(_GOODS)
    tint = np.where(status == GoodsStatus.BROUGHT, seen, goods)
    destination = np.tile([_DESTINATION_M, _DESTINATION_M, _THIN], (len(jobs), 1))
    ends_m = task.position_m[task.spec.jobs + jobs] - np.array([0.0, 0.0, _GOODS_M])
    end_tint = np.where(status == GoodsStatus.BROUGHT, seen, _PALETTE.index(_OPEN))
    return [
        _build(scene, BOX, np.full((len(jobs), 3), _GOODS_M), at_m, tint),
        _build(scene, BOX, destination, ends_m, end_tint),
    ]
