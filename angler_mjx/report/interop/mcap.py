"""Some worlds of a run as a bag of ROS 2: plans, motions, frames, obstacles, tasks and currents.

Times are simulated times from 0, and ``/clock`` tells them. Each world has its own names: topics
``/world_3/...`` and frames ``world_3``, ``world_3/robot_0/base_link``; ``/tf_static`` hangs all
worlds on the frame ``map``, so that a viewer with that as its fixed frame shows any of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc

from angler_mjx.errors import ConfigError
from angler_mjx.report.interop import current_markers, task_markers
from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.report.interop.bag import Bag
from angler_mjx.robot.control.plans import Plan, course, message, of_robot
from angler_mjx.runs.storage import environments as store
from angler_mjx.runs.storage import layout
from angler_mjx.runs.storage.atomic import replacing, require_free
from angler_mjx.runs.storage.damage import reading
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run
from angler_mjx.runs.storage.results import end_time_s
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE, STATIC
from angler_mjx.world.slices import Slices, through
from angler_mjx.world.tasks.history import TaskHistory
from angler_mjx.world.tasks.surface_quads import SurfaceQuads, surface

MAP = "map"
"""Frame of all worlds."""

_ROCK, _STILL, _MOVING, _GOAL = (
    (0.55, 0.50, 0.42, 1.0),
    (0.62, 0.62, 0.62, 1.0),
    (0.70, 0.60, 0.84, 1.0),
    (0.31, 0.84, 0.65, 1.0),
)
"""Colours, RGBA."""

type Progress = Callable[[int, int], None]
"""Told how many samples are written, and how many there are."""


@dataclass(frozen=True, kw_only=True)
class _World:
    """One world of a run, on the host."""

    index: int
    time_s: np.ndarray
    """[T] until its last robot's end."""
    environment: Environment
    plan: Plan
    """Of all robots, [robot] leading."""
    p_m: np.ndarray
    """[T, robot, 3]."""
    q: np.ndarray
    """[T, robot, 4]."""
    nu: np.ndarray
    """[T, robot, 6]."""
    pwm_us: np.ndarray
    """[T, robot, thruster]."""
    obstacle_p_m: np.ndarray
    """[T, n, 3]."""
    obstacle_q: np.ndarray
    """[T, n, 4]."""
    outcome: list[str]
    """[robot]"""
    task: TaskHistory | None
    """None: each robot has its goal."""
    surface: SurfaceQuads | None
    """What a survey sees; None where there is none."""
    flow: Slices | None
    """None where the water is still."""

    @property
    def name(self) -> str:
        """Its frame, and the root of its topics."""
        return f"world_{self.index}"

    @property
    def robots(self) -> list[str]:
        """Root of each robot's frames and topics."""
        return [f"{self.name}/robot_{i}" for i in range(self.p_m.shape[1])]

    def obstacles(self, *, still: bool) -> list[int]:
        """Rows of the obstacles that stay where they are, or of the others."""
        given = self.environment.obstacles
        there = np.asarray(given.exists) & ((np.asarray(given.motion) == STATIC) == still)
        rows: list[int] = np.flatnonzero(there).tolist()
        return rows


def export(
    run: Run,
    out: Path,
    worlds: Sequence[int],
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write some worlds of a run into a bag.

    Args:
        run: run folder.
        out: the bag.
        worlds: global indices; one that is given twice is written once.
        force: replace an older file.
        progress: told how far the writing is.

    Raises:
        ConfigError: the run stored no trajectories or does not hold a world; or the file exists or
            cannot be written.
        RunError: the disk gave out.
    """
    require_free(out, flag="--mcap", force=force)
    held = [_read(run, world) for world in sorted(set(worlds))]
    with replacing(out, flag="--mcap", force=force) as writing, Bag(writing) as bag:
        _begin(bag, held)
        _samples(bag, held, progress)


def _read(run: Run, world: int) -> _World:
    rows = run.episodes.filter(pc.field("world") == world).to_pylist()
    if not rows:
        there = sorted(set(run.episodes["world"].to_pylist()))
        raise ConfigError(
            f"--worlds {world}: {run.path} holds worlds {there[0]} to {there[-1]}"
            if there
            else f"--worlds {world}: {run.path} holds no finished world"
        )
    with reading(run.path / TRAJECTORIES):
        return _stored(run, world, rows)


def _stored(run: Run, world: int, rows: list[dict[str, Any]]) -> _World:
    stored: Any = run.trajectories
    time = np.asarray(stored["time_s"])
    ends = np.array([end_time_s(row) for row in rows])
    count = min(time.size, int(np.searchsorted(time, max(ends))) + 1)
    sampled = {name: stored[name][world, :count] for name in ("p_m", "q", "nu")}
    moving = "obstacle_p_m" in stored
    environment, spec = store.read(stored["environment"], world), run.scenario.task_spec()
    task = None
    if spec is not None:
        done_s = rows[0]["task_completed_s"]
        task = layout.read_task(
            stored, world, spec, samples=count, ended_s=ends, completed_s=done_s
        )
    running = time[:count, None] < ends
    return _World(
        index=world,
        time_s=time[:count],
        environment=environment,
        outcome=[row["outcome"] for row in rows],
        task=task,
        surface=None if task is None else surface(task, environment),
        flow=through(environment, time[:count], sampled["p_m"], running)
        if environment.current
        else None,
        pwm_us=np.rint(stored["pwm_us"][world, :count]).astype(np.uint16),
        plan=layout.read_plan(stored, world, np.array([row["planned"] for row in rows])),
        obstacle_p_m=stored["obstacle_p_m"][world, :count] if moving else np.zeros((count, 0, 3)),
        obstacle_q=stored["obstacle_q"][world, :count] if moving else np.zeros((count, 0, 4)),
        **sampled,
    )


def _begin(bag: Bag, worlds: Sequence[_World]) -> None:
    """Declare the topics, and write what holds from the start: frames, plans, scenery."""
    bag.topic("/clock", "rosgraph_msgs/Clock")
    bag.topic("/tf", "tf2_msgs/TFMessage")
    bag.topic("/tf_static", "tf2_msgs/TFMessage", latched=True)
    origin = np.zeros(3)
    frames = [ros.transform(0.0, MAP, world.name, origin) for world in worlds]
    bag.write("/tf_static", 0, {"transforms": frames})
    for world in worlds:
        bag.topic(f"/{world.name}/scenery", "visualization_msgs/MarkerArray", latched=True)
        bag.topic(f"/{world.name}/obstacles", "visualization_msgs/MarkerArray")
        bag.write(f"/{world.name}/scenery", 0, {"markers": _scenery(world)})
        if world.task is not None:
            bag.topic(f"/{world.name}/task", "visualization_msgs/MarkerArray")
        if world.flow is not None:
            bag.topic(f"/{world.name}/current", "visualization_msgs/MarkerArray")
        for i, robot in enumerate(world.robots):
            plan = of_robot(world.plan, i)
            bag.topic(f"/{robot}/joint_trajectory", "trajectory_msgs/JointTrajectory", latched=True)
            bag.topic(f"/{robot}/plan", "nav_msgs/Path", latched=True)
            bag.topic(f"/{robot}/odometry", "nav_msgs/Odometry")
            bag.topic(f"/{robot}/thruster_pwm_us", "std_msgs/UInt16MultiArray")
            told = ros.joint_trajectory(message(plan), world.name)
            bag.write(f"/{robot}/joint_trajectory", 0, told)
            bag.write(f"/{robot}/plan", 0, ros.path(world.name, *course(plan)))


def _samples(bag: Bag, worlds: Sequence[_World], progress: Progress | None) -> None:
    """Write what moves, in the order of time."""
    longest = max(worlds, key=lambda world: world.time_s.size).time_s
    for k, time in enumerate(longest.tolist()):
        now = ros.nanoseconds(time)
        bag.write("/clock", now, {"clock": ros.stamp(time)})
        for world in worlds:
            if k < world.time_s.size:
                _sample(bag, world, k)
        if progress is not None:
            progress(k + 1, longest.size)


def _sample(bag: Bag, world: _World, k: int) -> None:
    """One sample of a world; a robot that diverged has none from then on."""
    time = float(world.time_s[k])
    now, frames = ros.nanoseconds(time), []
    for i, robot in enumerate(world.robots):
        p, q, nu = world.p_m[k, i], world.q[k, i], world.nu[k, i]
        if not np.isfinite(np.concatenate([p, q, nu])).all():
            continue
        base = f"{robot}/base_link"
        frames.append(ros.transform(time, world.name, base, p, q))
        bag.write(f"/{robot}/odometry", now, ros.odometry(time, world.name, base, p, q, nu))
        bag.write(f"/{robot}/thruster_pwm_us", now, ros.thruster_pwm(world.pwm_us[k, i]))
    if frames:
        bag.write("/tf", now, {"transforms": frames})
    p, q = world.obstacle_p_m[k], world.obstacle_q[k]
    rows = [row for row in world.obstacles(still=False) if np.isfinite(p[row]).all()]
    if rows:
        markers = [one for row in rows for one in _obstacle(world, time, row, p[row], q[row])]
        bag.write(f"/{world.name}/obstacles", now, {"markers": markers})
    if (task := world.task) is not None:
        markers = task_markers.markers(
            task, world.environment, world.surface, world.p_m, world.name, k
        )
        for i, robot in enumerate(world.robots):
            markers += task_markers.doing(task, i, f"{robot}/base_link", world.outcome[i], k)
        bag.write(f"/{world.name}/task", now, {"markers": markers})
    if (flow := world.flow) is not None:
        for row in np.flatnonzero(flow.sample == k).tolist():
            markers = current_markers.markers(flow, world.name, row)
            bag.write(f"/{world.name}/current", now, {"markers": markers})


def _scenery(world: _World) -> list[ros.Message]:
    """Markers of what stays: cells, still obstacles, goals."""
    head = ros.header(0.0, world.name)
    grid, given = world.environment.grid, world.environment.obstacles
    cell = float(grid.cell_m)
    centers = np.asarray(grid.origin_m) + cell * (np.argwhere(np.asarray(grid.occupied)) + 0.5)
    here = ros.pose(np.zeros(3))
    markers = []
    if len(centers):
        markers.append(
            ros.marker(head, "cells", 0, ros.CUBE_LIST, here, [cell] * 3, _ROCK, centers)
        )
    p, q = np.asarray(given.p0), np.asarray(given.q0)
    for row in world.obstacles(still=True):
        markers += _obstacle(world, 0.0, row, p[row], q[row])
    goals = np.asarray(world.environment.goal_m)[: None if world.task is None else 0]
    markers += [
        ros.marker(head, "goals", i, ros.SPHERE, ros.pose(goal), [0.5] * 3, _GOAL)
        for i, goal in enumerate(goals)
    ]
    return markers


def _obstacle(
    world: _World, time_s: float, row: int, p: np.ndarray, q: np.ndarray
) -> list[ros.Message]:
    """Markers of one obstacle: one, and for a capsule its two ends."""
    given = world.environment.obstacles
    kind, (a, b, c) = int(given.kind[row]), np.asarray(given.size_m[row]).tolist()
    color = _STILL if int(given.motion[row]) == STATIC else _MOVING
    head, where = ros.header(time_s, world.name), ros.pose(p, q)
    shape, scale = {
        SPHERE: (ros.SPHERE, [2 * a] * 3),
        BOX: (ros.CUBE, [2 * a, 2 * b, 2 * c]),
        CAPSULE: (ros.CYLINDER, [2 * a, 2 * a, 2 * b]),
    }[kind]
    markers = [ros.marker(head, "obstacles", row, shape, where, scale, color)]
    if kind == CAPSULE:
        ends, ball = np.array([[0.0, 0.0, b], [0.0, 0.0, -b]]), [2 * a] * 3
        markers.append(
            ros.marker(head, "capsule_ends", row, ros.SPHERE_LIST, where, ball, color, ends)
        )
    return markers
