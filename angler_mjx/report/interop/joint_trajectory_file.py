"""Trajectories of a fleet in a JSON file, one for each robot, with the keys of the ROS messages.

    {"schema_version": 1,
     "robots": [{"robot": 0,
                 "trajectory": {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
                                "joint_names": ["x", "y", "z", "yaw"],
                                "points": [{"positions": [1.0, 2.0, -3.0, 0.0],
                                            "time_from_start": {"sec": 4, "nanosec": 0}}]}}]}

A point may also have ``velocities`` and ``accelerations``. ``trajectory`` holds the fields of
``trajectory_msgs/JointTrajectory``. Positions are in W: x east, y north, z up, in m; yaw in
rad about z, 0 = east.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, format_faults, format_path, parse_model, read_json
from angler_mjx.quantities import SchemaVersion
from angler_mjx.report.interop.ros_messages import NANO, joint_trajectory
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint, shape_faults
from angler_mjx.runs.storage.atomic_files import replace_file

SCHEMA_VERSION = 1


class _Time(FileModel):
    """Fields of ``builtin_interfaces/Time`` and ``Duration``."""

    sec: Annotated[int, Field(ge=0, lt=2**31)] = 0
    nanosec: Annotated[int, Field(ge=0, lt=NANO)] = 0

    def seconds(self) -> float:
        return self.sec + self.nanosec / NANO


class _Header(FileModel):
    """Fields of ``std_msgs/Header``."""

    stamp: _Time = _Time()
    frame_id: str = ""


class _Point(FileModel):
    """Fields of ``trajectory_msgs/JointTrajectoryPoint``; efforts are not used in plans."""

    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: Annotated[tuple[float, ...], Field(max_length=0)] = ()
    time_from_start: _Time


class _Trajectory(FileModel):
    """Fields of ``trajectory_msgs/JointTrajectory``."""

    header: _Header = _Header()
    joint_names: tuple[str, ...]
    points: tuple[_Point, ...]

    def goal(self) -> JointGoal:
        return JointGoal(
            joint_names=self.joint_names,
            stamp_s=self.header.stamp.seconds(),
            points=tuple(
                JointPoint(
                    time_s=point.time_from_start.seconds(),
                    positions=point.positions,
                    velocities=point.velocities,
                    accelerations=point.accelerations,
                )
                for point in self.points
            ),
        )


class _Robot(FileModel):
    robot: Annotated[int, Field(ge=0)]
    trajectory: _Trajectory


class _File(FileModel):
    schema_version: SchemaVersion
    robots: tuple[_Robot, ...]


def read_trajectories(path: Path, *, robots: int | None = None) -> dict[int, JointGoal]:
    """Read the trajectories of a file.

    Args:
        path: of the file.
        robots: number of robots; not checked if left out.

    Returns:
        Trajectories by robot index.

    Raises:
        ConfigError: the file cannot be read, or one message with all its faults.
    """
    data = read_json(path)
    if not isinstance(data, dict):
        raise ConfigError(
            f"{format_path(path)}: must hold an object with schema_version and robots"
        )
    entries = parse_model(_File, data, source=str(path)).robots
    faults: list[str] = []
    goals: dict[int, JointGoal] = {}
    for i, entry in enumerate(entries):
        goal = entry.trajectory.goal()
        if entry.robot in goals:
            faults.append(f"robots[{i}].robot = {entry.robot}: is there twice; give it once")
        if robots is not None and entry.robot >= robots:
            faults.append(
                f"robots[{i}].robot = {entry.robot}: no such robot; there are 0 to {robots - 1}"
            )
        faults += [f"robots[{i}].trajectory.{fault}" for fault in shape_faults(goal)]
        goals[entry.robot] = goal
    if faults:
        raise ConfigError(format_faults(str(path), faults))
    return goals


def write_trajectories(path: Path, goals: Mapping[int, JointGoal], *, force: bool = False) -> None:
    """Write the trajectories of a fleet.

    Args:
        path: of the file.
        goals: by robot index.
        force: replace an older file.

    Raises:
        ConfigError: the file exists, its folder cannot be written, or a trajectory has faults.
        RunError: writing to the disk failed.
    """
    faults = [f"robot {i}: {fault}" for i, goal in goals.items() for fault in shape_faults(goal)]
    if faults:
        raise ConfigError("\n  ".join([f"{path}: trajectories cannot be written", *faults]))
    table = {
        "schema_version": SCHEMA_VERSION,
        "robots": [
            {"robot": i, "trajectory": joint_trajectory(goal)} for i, goal in sorted(goals.items())
        ],
    }
    text = json.dumps(table, indent=1, allow_nan=False)
    with replace_file(path, flag="file", force=force) as writing:
        writing.write_text(text + "\n", encoding="utf-8")
