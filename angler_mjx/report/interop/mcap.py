"""Selected worlds of a run as a ROS 2 bag: plans, motions, frames, obstacles, tasks and currents.

Times are simulated times from 0, published on ``/clock``. Each world has its own names: topics
``/world_3/...`` and frames ``world_3``, ``world_3/robot_0/base_link``; ``/tf_static`` attaches all
worlds to the frame ``map``, so that a viewer with that fixed frame shows any of them. Links of arms
have frames of their names in the vehicle file, ``world_3/robot_0/wrist``, and their joints the
topic ``/world_3/robot_0/joint_states``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc

from angler_mjx.errors import ConfigError
from angler_mjx.report.interop import current_markers, task_markers, world_markers
from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.report.interop.bag import Bag
from angler_mjx.robot.control.plans import Plan, of_robot, to_joint_goal, trace_path
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.link_params import build_links
from angler_mjx.runs.storage import environments as store
from angler_mjx.runs.storage import trajectory_layout
from angler_mjx.runs.storage.atomic_files import replace_file, require_free
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.runs.storage.results import end_time_s
from angler_mjx.sim.posture import trace_links
from angler_mjx.world.environment import Environment
from angler_mjx.world.slices import CurrentSlices, slice_flight
from angler_mjx.world.tasks.history import TaskHistory
from angler_mjx.world.tasks.surface_quads import SurfaceQuads, survey_surface

MAP_FRAME = "map"
"""Root frame of all worlds."""

type SampleProgress = Callable[[int, int], None]
"""Receiver of the number of written samples and of the total."""


@dataclass(frozen=True, kw_only=True)
class _BagArm:
    """Arm of one robot in one world."""

    joints: list[str]
    """[J] names in the vehicle file, as are those of links."""
    links: list[str]
    """[L] names."""
    parents: list[str]
    """[L] frame that carries each link, below the robot's: ``base_link`` or a link."""
    position: np.ndarray
    """[T, J] rad or m."""
    velocity: np.ndarray
    """[T, J] rad/s or m/s."""
    origin_m: np.ndarray
    """[T, L, 3] of each link in the frame that carries it."""
    q: np.ndarray
    """[T, L, 4] wxyz, likewise."""


@dataclass(frozen=True, kw_only=True)
class _BagWorld:
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
    arms: list[_BagArm | None]
    """[robot] arms; None for a robot without joints, and where the run recorded none."""
    obstacle_p_m: np.ndarray
    """[T, n, 3]."""
    obstacle_q: np.ndarray
    """[T, n, 4]."""
    outcome: list[str]
    """[robot] outcomes."""
    task: TaskHistory | None
    """Task of the team; None if each robot has its goal."""
    surface: SurfaceQuads | None
    """Surveyed surface; None without a survey."""
    flow: CurrentSlices | None
    """Slices of the current; None in still water."""

    @property
    def name(self) -> str:
        """Frame of the world, and the root of its topics."""
        return f"world_{self.index}"

    @property
    def robots(self) -> list[str]:
        """Root of each robot's frames and topics."""
        return [f"{self.name}/robot_{i}" for i in range(self.p_m.shape[1])]


def export_bag(
    run: Run,
    out: Path,
    worlds: Sequence[int],
    *,
    force: bool = False,
    progress: SampleProgress | None = None,
) -> None:
    """Write selected worlds of a run into a bag.

    Args:
        run: run folder.
        out: the bag.
        worlds: global indices; duplicates are written once.
        force: replace an older file.
        progress: receives the progress of writing.

    Raises:
        ConfigError: the run stored no trajectories or does not hold a world; or the file exists or
            cannot be written.
        RunError: writing to the disk failed.
    """
    require_free(out, flag="--mcap", force=force)
    bag_worlds = [_read_world(run, world) for world in sorted(set(worlds))]
    with replace_file(out, flag="--mcap", force=force) as writing, Bag(writing) as bag:
        _write_static(bag, bag_worlds)
        _write_samples(bag, bag_worlds, progress)


def _read_world(run: Run, world: int) -> _BagWorld:
    rows = run.episodes.filter(pc.field("world") == world).to_pylist()
    if not rows:
        indices = sorted(set(run.episodes["world"].to_pylist()))
        raise ConfigError(
            f"--worlds {world}: {run.path} holds worlds {indices[0]} to {indices[-1]}"
            if indices
            else f"--worlds {world}: {run.path} holds no finished world"
        )
    with wrap_read_errors(run.path / TRAJECTORIES):
        return _load_world(run, world, rows)


def _load_world(run: Run, world: int, rows: list[dict[str, Any]]) -> _BagWorld:
    stored: Any = run.trajectories
    time = np.asarray(stored["time_s"])
    ends = np.array([end_time_s(row) for row in rows])
    count = min(time.size, int(np.searchsorted(time, max(ends))) + 1)
    sampled = {name: stored[name][world, :count] for name in ("p_m", "q", "nu")}
    moving = "obstacle_p_m" in stored
    environment, spec = (
        store.read_environments(stored["environment"], world),
        run.scenario.task_spec(),
    )
    task = None
    if spec is not None:
        done_s = rows[0]["task_completed_s"]
        task = trajectory_layout.read_task(
            stored, world, spec, samples=count, ended_s=ends, completed_s=done_s
        )
    running = time[:count, None] < ends
    return _BagWorld(
        index=world,
        time_s=time[:count],
        environment=environment,
        outcome=[row["outcome"] for row in rows],
        task=task,
        surface=None if task is None else survey_surface(task, environment),
        flow=slice_flight(environment, time[:count], sampled["p_m"], running)
        if environment.current
        else None,
        pwm_us=np.rint(stored["pwm_us"][world, :count]).astype(np.uint16),
        plan=trajectory_layout.read_plan(stored, world, np.array([row["planned"] for row in rows])),
        arms=[_load_arm(run, row, stored, world, i, count) for i, row in enumerate(rows)],
        obstacle_p_m=stored["obstacle_p_m"][world, :count] if moving else np.zeros((count, 0, 3)),
        obstacle_q=stored["obstacle_q"][world, :count] if moving else np.zeros((count, 0, 4)),
        **sampled,
    )


def _load_arm(
    run: Run, row: dict[str, Any], stored: Any, world: int, robot: int, count: int
) -> _BagArm | None:
    """Return the arm of a robot in the first ``count`` samples."""
    config = library.load_vehicle(run.vehicle_file(row["vehicle"]))
    links = build_links(config, None)
    if links is None or "joint_position" not in stored:
        return None
    names = [link.name for link in config.find_links(None)]
    position = stored["joint_position"][world, :count, robot]
    origin, rotation = trace_links(links, position)
    origin, rotation = _relate_to_parents(links.tree.parents, origin, rotation)
    return _BagArm(
        joints=[joint.name for joint in config.find_joints()],
        links=names,
        parents=["base_link" if i < 0 else names[i] for i in links.tree.parents],
        position=position,
        velocity=stored["joint_velocity"][world, :count, robot],
        origin_m=origin,
        q=_to_quaternions(rotation),
    )


def _relate_to_parents(
    parents: Sequence[int], origin: np.ndarray, rotation: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return poses of links, [T, L, 3] and [T, L, 3, 3], in the frames of their parents.

    Args:
        parents: [L] number of each link's parent; -1 for the base.
        origin: [T, L, 3] in F.
        rotation: [T, L, 3, 3] to F.
    """
    base = np.zeros_like(origin[:, :1]), np.broadcast_to(np.eye(3), rotation[:, :1].shape)
    rows = np.array(parents) + 1
    center = np.concatenate([base[0], origin], axis=1)[:, rows]
    turn = np.concatenate([base[1], rotation], axis=1)[:, rows]
    relative_m = np.einsum("tlji,tlj->tli", turn, origin - center)
    return relative_m, np.einsum("tlji,tljk->tlik", turn, rotation)


def _to_quaternions(rotation: np.ndarray) -> np.ndarray:
    """Return quaternions [T, L, 4] wxyz of rotations [T, L, 3, 3]; NaN where these are."""
    from scipy.spatial.transform import Rotation  # 1 s, for runs with arms only

    q = np.full((*rotation.shape[:2], 4), np.nan)
    is_finite = np.isfinite(rotation).all(axis=(2, 3))
    q[is_finite] = Rotation.from_matrix(rotation[is_finite]).as_quat(scalar_first=True)
    return q


def _write_static(bag: Bag, worlds: Sequence[_BagWorld]) -> None:
    """Declare the topics, and write the static messages: frames, plans, scenery."""
    bag.declare_topic("/clock", "rosgraph_msgs/Clock")
    bag.declare_topic("/tf", "tf2_msgs/TFMessage")
    bag.declare_topic("/tf_static", "tf2_msgs/TFMessage", latched=True)
    origin = np.zeros(3)
    frames = [ros.make_transform(0.0, MAP_FRAME, world.name, origin) for world in worlds]
    bag.write("/tf_static", 0, {"transforms": frames})
    for world in worlds:
        bag.declare_topic(f"/{world.name}/scenery", "visualization_msgs/MarkerArray", latched=True)
        bag.declare_topic(f"/{world.name}/obstacles", "visualization_msgs/MarkerArray")
        scenery = world_markers.build_scenery(
            world.environment, world.name, has_goals=world.task is None
        )
        bag.write(f"/{world.name}/scenery", 0, {"markers": scenery})
        if world.task is not None:
            bag.declare_topic(f"/{world.name}/task", "visualization_msgs/MarkerArray")
        if world.flow is not None:
            bag.declare_topic(f"/{world.name}/current", "visualization_msgs/MarkerArray")
        for i, robot in enumerate(world.robots):
            plan = of_robot(world.plan, i)
            bag.declare_topic(
                f"/{robot}/joint_trajectory", "trajectory_msgs/JointTrajectory", latched=True
            )
            bag.declare_topic(f"/{robot}/plan", "nav_msgs/Path", latched=True)
            bag.declare_topic(f"/{robot}/odometry", "nav_msgs/Odometry")
            bag.declare_topic(f"/{robot}/thruster_pwm_us", "std_msgs/UInt16MultiArray")
            if world.arms[i] is not None:
                bag.declare_topic(f"/{robot}/joint_states", "sensor_msgs/JointState")
            trajectory = ros.joint_trajectory(to_joint_goal(plan), world.name)
            bag.write(f"/{robot}/joint_trajectory", 0, trajectory)
            bag.write(f"/{robot}/plan", 0, ros.make_path(world.name, *trace_path(plan)))


def _write_samples(bag: Bag, worlds: Sequence[_BagWorld], progress: SampleProgress | None) -> None:
    """Write the dynamic messages, in the order of time."""
    longest = max(worlds, key=lambda world: world.time_s.size).time_s
    for k, time in enumerate(longest.tolist()):
        time_ns = ros.to_nanoseconds(time)
        bag.write("/clock", time_ns, {"clock": ros.make_stamp(time)})
        for world in worlds:
            if k < world.time_s.size:
                _write_sample(bag, world, k)
        if progress is not None:
            progress(k + 1, longest.size)


def _write_sample(bag: Bag, world: _BagWorld, k: int) -> None:
    """Write one sample of a world; a diverged robot has none from then on."""
    time = float(world.time_s[k])
    time_ns, frames = ros.to_nanoseconds(time), []
    for i, robot in enumerate(world.robots):
        p, q, nu = world.p_m[k, i], world.q[k, i], world.nu[k, i]
        if not np.isfinite(np.concatenate([p, q, nu])).all():
            continue
        base = f"{robot}/base_link"
        frames.append(ros.make_transform(time, world.name, base, p, q))
        bag.write(
            f"/{robot}/odometry", time_ns, ros.make_odometry(time, world.name, base, p, q, nu)
        )
        bag.write(f"/{robot}/thruster_pwm_us", time_ns, ros.thruster_pwm(world.pwm_us[k, i]))
        if (arm := world.arms[i]) is not None:
            frames += _link_frames(arm, robot, time, k)
            state = ros.make_joint_state(time, arm.joints, arm.position[k], arm.velocity[k])
            bag.write(f"/{robot}/joint_states", time_ns, state)
    if frames:
        bag.write("/tf", time_ns, {"transforms": frames})
    p, q = world.obstacle_p_m[k], world.obstacle_q[k]
    markers = world_markers.build_moving(world.environment.obstacles, world.name, time, p, q)
    if markers:
        bag.write(f"/{world.name}/obstacles", time_ns, {"markers": markers})
    if (task := world.task) is not None:
        markers = task_markers.build_markers(
            task, world.environment, world.surface, world.p_m, world.name, k
        )
        for i, robot in enumerate(world.robots):
            markers += task_markers.doing_markers(
                task, i, f"{robot}/base_link", world.outcome[i], k
            )
        bag.write(f"/{world.name}/task", time_ns, {"markers": markers})
    if (flow := world.flow) is not None:
        for row in np.flatnonzero(flow.sample == k).tolist():
            markers = current_markers.build_markers(flow, world.name, row)
            bag.write(f"/{world.name}/current", time_ns, {"markers": markers})


def _link_frames(arm: _BagArm, robot: str, time_s: float, k: int) -> list[ros.Message]:
    """Return the transforms of a robot's links at sample ``k``."""
    return [
        ros.make_transform(
            time_s, f"{robot}/{parent}", f"{robot}/{link}", arm.origin_m[k, j], arm.q[k, j]
        )
        for j, (link, parent) in enumerate(zip(arm.links, arm.parents, strict=True))
    ]
