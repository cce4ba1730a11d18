"""Export of plans as mission files: way-points, holds and changes of speed."""

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import zarr

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.frames import GeodeticOrigin, local_to_geodetic
from angler_mjx.host_arrays import as_leaf
from angler_mjx.report.interop import joint_trajectory_file
from angler_mjx.report.interop.mission_files import items as mav
from angler_mjx.report.interop.mission_files.read_waypoints import HEADER
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.commands import joint_goal
from angler_mjx.robot.control.commands.joint_trajectory import LINEAR, VEHICLE_JOINTS
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs.storage import trajectory_layout
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.plans.read import SCHEMA
from angler_mjx.runs.storage.read_errors import wrap_read_errors

type MissionFormat = Literal["plan", "waypoints"]

DEVIATION_M = 0.05
"""Max distance of the written lines from the path."""
MIN_HOLD_S = 0.5
"""Stays shorter than this are no holds; the firmware counts whole seconds."""
_HOME_RADIUS_M = 1.0
"""Horizontal distance from home within which the start of a path is no way-point."""
_STILL_MPS = 0.01
_SUBMARINE, _ARDUPILOT = 12, 3
"""MAV_TYPE and MAV_AUTOPILOT in a plan of QGroundControl."""
_PLAN_SPEED_MPS = 1.0


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """Way-point of an exported mission."""

    position_m: tuple[float, float, float]
    """In W."""
    speed_mps: float | None
    """Horizontal speed on the leg to it; None where the leg has none."""
    hold_s: int


@dataclass(frozen=True, kw_only=True)
class ExportItem:
    """Mission item to be written."""

    command: int
    frame: int
    numbers: tuple[float | None, ...]
    """Seven parameters, the last three latitude, longitude and altitude."""


def read_path(source: Path, world: int, robot: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the planned path of one robot.

    Args:
        source: run folder, file of plans (Zarr) or file of JointTrajectories (JSON).
        world: index of the world; 0 alone in a file of JointTrajectories.
        robot: index of the robot.

    Returns:
        Times [n] s and positions [n, 3] m in W; bent segments as lines.

    Raises:
        ConfigError: there is no such source, world, robot or path.
    """
    if source.is_file():
        if world:
            raise ConfigError(f"--world {world}: a file of JointTrajectories has no worlds")
        goals = joint_trajectory_file.read_trajectories(source)
        if robot not in goals:
            raise ConfigError(f"--robot {robot}: not in {format_path(source)}")
        goal = goals[robot]
        missing = [name for name in "xyz" if name not in goal.joint_names]
        if missing:
            raise ConfigError(
                f"{format_path(source)}: robot {robot} names no joint {missing[0]!r}; a mission "
                "needs x, y and z"
            )
        start = dict(zip(goal.joint_names, goal.points[0].positions, strict=True))
        plan: Plan = joint_goal.build_trajectory(
            goal, joints=VEHICLE_JOINTS, position=[start.get(name, 0.0) for name in VEHICLE_JOINTS]
        )
    elif (source / "zarr.json").is_file():
        plan = _read_plan_file(source, world, robot)
    else:
        plan = _read_run(Run(source), world, robot)
    return plans.trace_path(plan)


def build_waypoints(time_s: np.ndarray, position_m: np.ndarray) -> list[Waypoint]:
    """Return the way-points of a path; the first is its start.

    Args:
        time_s: [n] increasing.
        position_m: [n, 3] in W.
    """
    still = np.linalg.norm(np.diff(position_m, axis=0), axis=1) < _STILL_MPS * np.diff(time_s)
    runs = _find_runs(still)
    # Stays split the path into stretches, each of which is simplified alone.
    stays = [run for run in runs if time_s[run[1]] - time_s[run[0]] >= MIN_HOLD_S]
    edges = sorted({0, len(time_s) - 1, *(i for run in stays for i in run)})
    kept = {0, len(time_s) - 1}
    for begin, end in pairwise(edges):
        if (begin, end) not in stays:
            kept |= _simplify(position_m, begin, end)
    indices = sorted(kept)
    holds = {run[0]: float(time_s[run[1]] - time_s[run[0]]) for run in stays}
    stay_ends = dict(stays)
    ends = set(stay_ends.values())
    waypoints: list[Waypoint] = []
    before = 0
    for i in indices:
        if i in ends and i not in holds:
            before = i
            continue
        # A stay begins and ends in slow motion: its middle is where the vehicle is at rest.
        middle = (i + stay_ends[i]) // 2 if i in holds else i
        x, y, z = position_m[middle].tolist()
        waypoints.append(
            Waypoint(
                position_m=(x, y, z),
                speed_mps=_level_speed(time_s, position_m, before, i),
                hold_s=round(holds.get(i, 0.0)),
            )
        )
        before = i
    return waypoints


def build_items(waypoints: list[Waypoint], origin: GeodeticOrigin) -> list[ExportItem]:
    """Return the mission items of way-points, without home.

    The first way-point is left out where home is above it: the vehicle begins there.
    """
    result: list[ExportItem] = []
    speed = None
    for i, waypoint in enumerate(waypoints):
        x, y, z = waypoint.position_m
        if i == 0 and math.hypot(x, y) < _HOME_RADIUS_M and not waypoint.hold_s:
            continue
        stated = None if waypoint.speed_mps is None else max(round(waypoint.speed_mps, 2), 0.01)
        if stated is not None and stated != speed:
            speed = stated
            result.append(
                ExportItem(
                    command=mav.CHANGE_SPEED,
                    frame=mav.MISSION_FRAME,
                    numbers=(1.0, speed, -1.0, 0.0, 0.0, 0.0, 0.0),
                )
            )
        latitude, longitude = local_to_geodetic(origin, x, y)
        result.append(
            ExportItem(
                command=mav.WAYPOINT,
                frame=mav.RELATIVE_FRAME,
                numbers=(
                    float(waypoint.hold_s),
                    0.0,
                    0.0,
                    None,
                    round(latitude, 9),
                    round(longitude, 9),
                    round(z, 4),
                ),
            )
        )
    return result


def format_plan(items: list[ExportItem], origin: GeodeticOrigin) -> str:
    """Return the text of a ``.plan`` file of QGroundControl."""
    speeds = [item.numbers[1] for item in items if item.command == mav.CHANGE_SPEED]
    speed = speeds[0] if speeds else _PLAN_SPEED_MPS
    table = {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "groundStation": "QGroundControl",
        "mission": {
            "cruiseSpeed": speed,
            "firmwareType": _ARDUPILOT,
            "globalPlanAltitudeMode": 1,
            "hoverSpeed": speed,
            "items": [_plan_item(item, number) for number, item in enumerate(items, 1)],
            "plannedHomePosition": [
                origin.latitude_deg,
                origin.longitude_deg,
                origin.altitude_m,
            ],
            "vehicleType": _SUBMARINE,
            "version": 2,
        },
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }
    return json.dumps(table, indent=4, allow_nan=False) + "\n"


def format_waypoints(items: list[ExportItem], origin: GeodeticOrigin) -> str:
    """Return the text of a way-point file, QGC WPL 110; line 0 is home."""
    home = ExportItem(
        command=mav.WAYPOINT,
        frame=mav.SEA_LEVEL_FRAMES[0],
        numbers=(
            *(0.0,) * 4,
            origin.latitude_deg,
            origin.longitude_deg,
            origin.altitude_m,
        ),
    )
    lines = [HEADER]
    for number, item in enumerate([home, *items]):
        p1, p2, p3, p4, latitude, longitude, altitude = (x or 0.0 for x in item.numbers)
        columns = [
            *(str(number), str(int(number == 0)), str(item.frame), str(item.command)),
            *(f"{value:.8f}" for value in (p1, p2, p3, p4)),
            *(f"{latitude:.9f}", f"{longitude:.9f}", f"{altitude:.6f}", "1"),
        ]
        lines.append("\t".join(columns))
    return "\n".join(lines) + "\n"


def _plan_item(item: ExportItem, number: int) -> dict[str, object]:
    table: dict[str, object] = {
        "autoContinue": True,
        "command": item.command,
        "doJumpId": number,
        "frame": item.frame,
        "params": list(item.numbers),
        "type": "SimpleItem",
    }
    if item.command == mav.WAYPOINT:
        table |= {
            "AMSLAltAboveTerrain": None,
            "Altitude": item.numbers[6],
            "AltitudeMode": 1,
        }
    return table


def _read_plan_file(source: Path, world: int, robot: int) -> Plan:
    with wrap_read_errors(source):
        group = zarr.open_group(source, mode="r")
        if group.attrs.get("schema") != SCHEMA:
            raise ConfigError(f"{format_path(source)}: holds no plans")
        counts = np.asarray(group.get_array("points")[:])
        _require_index("world", world, counts.shape[0], source)
        _require_index("robot", robot, counts.shape[1], source)
        count = int(counts[world, robot])
        if count <= 0:
            raise ConfigError(f"{format_path(source)}: robot {robot} of world {world} has no path")
        names = ("time_s", "position_m", "yaw_rad", "velocity", "acceleration", "degree")
        rows = {
            name: np.asarray(group.get_array(name)[world, robot, :count], float)
            for name in names
            if name in group
        }
    points = [
        joint_goal.JointPoint(
            time_s=float(rows["time_s"][i]),
            positions=(*rows["position_m"][i].tolist(), float(rows["yaw_rad"][i])),
            velocities=tuple(rows["velocity"][i].tolist()) if "velocity" in rows else (),
        )
        for i in range(count)
        if "yaw_rad" in rows
    ]
    is_bent = "velocity" in rows and np.any(rows.get("degree", np.array([3])) != LINEAR)
    if points and is_bent:
        goal = joint_goal.JointGoal(joint_names=VEHICLE_JOINTS, points=tuple(points))
        return joint_goal.build_trajectory(
            goal, joints=VEHICLE_JOINTS, position=points[0].positions
        )
    time, position = rows["time_s"], rows["position_m"]
    return Trajectory(
        time_s=as_leaf(time), position_m=as_leaf(position), found=as_leaf(np.array(True))
    )


def _read_run(run: Run, world: int, robot: int) -> Plan:
    scenario = run.scenario
    _require_index("world", world, scenario.worlds, run.path)
    _require_index("robot", robot, len(scenario.members()), run.path)
    robots = len(scenario.members())
    planned = np.asarray(run.episodes.column("planned"))[world * robots : (world + 1) * robots]
    if not planned[robot]:
        raise ConfigError(f"{run.path}: robot {robot} of world {world} has no plan")
    return plans.of_robot(trajectory_layout.read_plan(run.trajectories, world, planned), robot)


def _require_index(name: str, index: int, count: int, source: Path) -> None:
    if not 0 <= index < count:
        raise ConfigError(f"--{name} {index}: {format_path(source)} has {name}s 0 to {count - 1}")


def _find_runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last point of each run of segments that are flagged."""
    padded = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    begins, ends = np.flatnonzero(padded == 1), np.flatnonzero(padded == -1)
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def _simplify(position_m: np.ndarray, begin: int, end: int) -> set[int]:
    """Return the points of a stretch that lines have to keep (Douglas and Peucker 1973)."""
    kept, pending = {begin, end}, [(begin, end)]
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        line = position_m[last] - position_m[first]
        offset = position_m[first + 1 : last] - position_m[first]
        length = float(line @ line)
        fraction = (
            np.clip(offset @ line / length, 0.0, 1.0) if length > 0 else np.zeros(len(offset))
        )
        distance = np.linalg.norm(offset - fraction[:, None] * line, axis=1)
        worst = int(np.argmax(distance))
        if distance[worst] > DEVIATION_M:
            split = first + 1 + worst
            kept.add(split)
            pending += [(first, split), (split, last)]
    return kept


def _level_speed(time_s: np.ndarray, position_m: np.ndarray, begin: int, end: int) -> float | None:
    """Return the max horizontal speed between two points; None on a vertical leg."""
    if end <= begin:
        return None
    path = position_m[begin : end + 1]
    level = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)
    if level.sum() < 0.1 * np.linalg.norm(path[-1] - path[0]) or level.sum() < DEVIATION_M:
        return None
    return float(np.max(level / np.diff(time_s[begin : end + 1])))
