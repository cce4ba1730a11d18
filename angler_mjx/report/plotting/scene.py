"""One world of a run, loaded for figures: host arrays, the time axis cut to its end."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow.compute as pc

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import style
from angler_mjx.runs.storage import environments as store
from angler_mjx.runs.storage import trajectory_layout
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.runs.storage.results import end_time_s
from angler_mjx.world import currents
from angler_mjx.world.environment import Environment
from angler_mjx.world.tasks.history import TaskHistory


@dataclass(frozen=True, kw_only=True)
class RobotTrack:
    """Track of one robot: its kind, path and outcome."""

    index: int
    vehicle: str
    vehicle_file: str
    """File name for `robot.vehicles.library.load_vehicle`: the run's copy, where it has one."""
    parameter_set: str
    outcome: str
    end_time_s: float
    """End time of its episode."""
    failure_pair: str
    """Collision partner: cell, floor, obstacle:i, robot:i or none."""
    failure_m: np.ndarray
    """[3] position of the failure; NaN if it arrived."""
    p_m: np.ndarray
    """[T, 3]."""
    q: np.ndarray
    """[T, 4]."""
    current_mps: np.ndarray
    """[T, 3] water velocity at the robot, W."""
    plan_m: np.ndarray
    """[n, 3] points of the polyline: way-points without padding; several for a bent segment."""
    start_m: np.ndarray
    """[3]."""
    goal_m: np.ndarray
    """[3]; NaN where a task has other places."""
    joint_position: np.ndarray | None = None
    """[T, J] rad or m; None where the run recorded no joints, NaN for a robot without any."""

    @property
    def arrived(self) -> bool:
        """Whether the robot reached its goal."""
        return self.outcome == "reached"


@dataclass(frozen=True, kw_only=True)
class ReplayScene:
    """One world of a run."""

    world: int
    time_s: np.ndarray
    """[T] until the last robot's end."""
    environment: Environment
    """Leaves are host arrays."""
    robots: tuple[RobotTrack, ...]
    obstacle_p_m: np.ndarray
    """[T, n, 3]."""
    obstacle_q: np.ndarray
    """[T, n, 4]."""
    replan_hz: float = 0.0
    """Rate of replanning in flight; the plans shown are the first ones."""
    task: TaskHistory | None = None
    """Task of the team with its progress; None: each robot has its goal."""
    cargo: int | None = None
    """Obstacle that all robots carry together by their hulls; None where they carry nothing, and
    where their arms show that they hold it."""

    @property
    def bounds_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner [3] of the cube of cells."""
        grid = self.environment.grid
        low = np.asarray(grid.origin_m)
        return low, low + float(grid.cell_m) * np.asarray(grid.occupied.shape)

    def flown_path(self, robot: RobotTrack) -> np.ndarray:
        """Return a robot's positions [n, 3] until its end; without the last ones if it diverged."""
        until_end = self.time_s <= robot.end_time_s + 1e-6
        path_m: np.ndarray = robot.p_m[until_end & np.isfinite(robot.p_m).all(axis=1)]
        return path_m

    def ended(self, robot: RobotTrack) -> str:
        """Return a robot's outcome in words; with a task it has no goal to reach."""
        if self.task is not None and robot.arrived:
            return "finished"
        return style.OUTCOME_TEXT[robot.outcome]

    def current_at(self, points_m: np.ndarray, time_s: float) -> np.ndarray:
        """Return the water velocity [n, 3] at points [n, 3] and a time, m/s in W."""
        return currents.velocities_at(self.environment.current, points_m, time_s)


def read_scene(run: Run, world: int) -> ReplayScene:
    """Read one world of a run.

    Args:
        run: run folder.
        world: global index.

    Raises:
        ConfigError: the run stored no trajectories, does not hold that world, or is damaged.
    """
    rows = run.episodes.filter(pc.field("world") == world).to_pylist()
    if not rows:
        raise ConfigError(f"world {world} is not in {run.path}")
    with wrap_read_errors(run.path / TRAJECTORIES):
        return _load_scene(run, world, rows)


def _load_scene(run: Run, world: int, rows: list[dict[str, Any]]) -> ReplayScene:
    stored: Any = run.trajectories
    files = {label: run.vehicle_file(label) for label in {row["vehicle"] for row in rows}}
    environment = store.read_environments(stored["environment"], world)
    last = max(end_time_s(row) for row in rows)
    time = np.asarray(stored["time_s"])
    count = min(time.size, int(np.searchsorted(time, last)) + 1)
    names = ("p_m", "q", "current_mps", "joint_position")
    robots = {name: stored[name][world, :count] for name in names if name in stored}
    courses = trajectory_layout.plan_courses(stored, world)
    spec = run.scenario.task_spec()
    tracks = tuple(
        RobotTrack(
            index=i,
            vehicle=row["vehicle"],
            vehicle_file=files[row["vehicle"]],
            parameter_set=row["parameter_set"],
            outcome=row["outcome"],
            end_time_s=end_time_s(row),
            failure_pair=row["failure_pair"],
            failure_m=np.array([row[f"failure_{axis}_m"] for axis in "xyz"], float),
            plan_m=courses[i][1],
            start_m=np.asarray(environment.start_m[i]),
            goal_m=np.full(3, np.nan) if spec else np.asarray(environment.goal_m[i]),
            **{name: values[:, i] for name, values in robots.items()},
        )
        for i, row in enumerate(rows)
    )
    moving, cargo = "obstacle_p_m" in stored, run.scenario.cargo_spec()
    return ReplayScene(
        world=world,
        time_s=time[:count],
        environment=environment,
        robots=tracks,
        obstacle_p_m=stored["obstacle_p_m"][world, :count] if moving else np.zeros((count, 0, 3)),
        obstacle_q=stored["obstacle_q"][world, :count] if moving else np.zeros((count, 0, 4)),
        replan_hz=run.scenario.planner.replan_hz,
        cargo=None if cargo is None or run.scenario.held_body >= 0 else cargo.body,
        task=None
        if spec is None
        else trajectory_layout.read_task(
            stored,
            world,
            spec,
            samples=count,
            ended_s=np.array([end_time_s(row) for row in rows]),
            completed_s=rows[0]["task_completed_s"],
        ),
    )
