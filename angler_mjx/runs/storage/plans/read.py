"""Plans on disk: a Zarr group that any program can write, flown like a planner's answers.

    attributes      schema = "angler_mjx plans", schema_version = 1, digest and seed of the problems
    points          int32 [world, robot]            way-points of a path; 0: there is none
    time_s          float32 [world, robot, point]   from 0, increasing
    position_m      float32 [world, robot, point, 3], W
    yaw_rad         float32 [world, robot, point]   optional: then the paths have headings
    velocity        float32 [world, robot, point, 4]   with it, optional: of x, y, z and heading;
                    then the paths run along cubics
    acceleration    float32 [world, robot, point, 4]   with them, optional
    degree          int32 [world, robot, point]     of each segment, optional: 1, 3 or 5
    joint_position  float32 [world, robot, point, J]   with headings, optional: joints of arms; the
                    attribute ``joints`` has their names
    joint_velocity, joint_acceleration   float32 [world, robot, point, J]   with it, optional
    planning_s      float32 [world]                 optional: the planner's time
    reason          int32 [world, robot]            optional: which of the attribute ``reasons``
    status          int32 [world]                   optional: which of the attribute ``statuses``

The attribute ``speed_limit`` = "ground" makes paths none that exceed the cruise speed over ground
in moving water too.

World i of the arrays is world i of the seed. A number of points below 0 says that a world is not
planned yet. ``docs/reference/plan_files.md`` has a writer of twenty lines.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zarr

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.planning.planner import MAX_POINTS, PathShape
from angler_mjx.quantities import MAX_SPEED_MPS
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs.simulator.host_planning import PlanNotes, planning_status
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import checksums, planning_summary
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.runs.storage.trajectory_layout import host_leaf
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World

SCHEMA, SCHEMA_VERSION = "angler_mjx plans", 1

_ARRAYS = {"points": 2, "time_s": 3, "position_m": 4}
START_TOLERANCE_M, SPEED_TOLERANCE, ROUNDING_TOLERANCE_M = 0.01, 0.01, 1e-4
"""How far from its start a path may begin; by what share it may be too fast, and how much farther
two points may lie apart than that: float32."""
SPEED_LIMIT, GROUND = "speed_limit", "ground"
"""Attribute of a file whose paths may not exceed the cruise speed over ground in moving water."""


@dataclass(frozen=True)
class PlanFile:
    """Plans of a file, for the problems of one scenario and seed."""

    path: Path
    group: zarr.Group
    shape: PathShape
    """Of the paths as they are flown: those of the file, their last point repeated."""
    limits_ground_speed: bool = False
    """Whether the cruise speed limits the speed over ground in moving water too."""

    def of(self, firsts: list[int], worlds: World, simulator: Simulator) -> tuple[Plan, PlanNotes]:
        """Return the paths of some tiles of worlds; a path that cannot be flown is none.

        Args:
            firsts: first world of each device's tile.
            worlds: of them, drawn.
            simulator: whose worlds they are.

        Returns:
            [devices * tile, robot] leading; devices without a tile have paths of the last one's.

        Raises:
            ConfigError: a world of them is not planned, or the file is damaged.
        """
        tiles = [*firsts, *firsts[-1:] * (simulator.devices - len(firsts))]
        last = simulator.scenario.worlds - 1
        indices = np.concatenate([first + np.arange(simulator.tile) for first in tiles])
        rows = np.minimum(indices, last)  # what is past the end of a run is dropped
        with wrap_read_errors(self.path):
            count = self._read_rows("points", rows)
            time, position_m = self._read_rows("time_s", rows), self._read_rows("position_m", rows)
            seconds = self._read_rows("planning_s", rows) if "planning_s" in self.group else None
            motion = self._read_motion(rows)
            reason = self._read_texts("reason", "reasons", rows)
            status = self._read_texts("status", "statuses", rows)
        unplanned = rows[np.any(count < 0, axis=1)]
        if unplanned.size:
            raise ConfigError(
                f"{self.path}: world {unplanned[0]} is not planned; go on with angler plan --resume"
            )
        start = np.asarray(worlds.environment.start_m)
        faults = _path_faults(
            count,
            time,
            position_m,
            start,
            self._speed_limit_mps(worlds, simulator.scenario),
            simulator.scenario.time.horizon_s,
            motion or {},
        )
        is_found = (count > 0) & (faults == "")
        reasons = np.full(count.shape, "", object) if reason is None else reason
        reasons = np.where(faults != "", faults, np.where(reasons == "", "no path", reasons))
        notes = PlanNotes(
            planning_s=np.full(len(count), np.nan) if seconds is None else seconds,
            status=planning_status(is_found, status),
            reason=np.where(is_found, "", reasons).astype(object),
        )
        if motion is not None:
            yaw = np.asarray(worlds.environment.start_yaw_rad)
            joints = np.concatenate([position_m, motion.pop("yaw_rad")], axis=-1)
            start = np.concatenate([start, yaw[..., None]], axis=-1)
            if self.shape.arm and isinstance(worlds.path, JointTrajectory):
                start = np.concatenate([start, np.asarray(worlds.path.position)[:, :, 0, 4:]], -1)
            return _build_joint_paths(
                count, time, joints, motion, is_found, start, self.shape
            ), notes
        time, position_m = _pad_paths(count, time, position_m, is_found, start)
        time, position_m = (_widen_paths(rows, self.shape.points) for rows in (time, position_m))
        paths = {"time_s": time, "position_m": position_m, "found": is_found}
        return Trajectory(**{name: host_leaf(rows) for name, rows in paths.items()}), notes

    def _speed_limit_mps(self, worlds: World, scenario: Scenario) -> np.ndarray:
        """Return the highest speed [w, r] of paths over ground.

        In moving water a robot is carried as well, by water that planners know more or less of.
        """
        cruise = np.asarray(worlds.cruise_speed_mps)
        is_carried = scenario.world.currents and not self.limits_ground_speed
        return cruise + MAX_SPEED_MPS if is_carried else cruise

    def _read_motion(self, rows: np.ndarray) -> dict[str, np.ndarray] | None:
        """Read headings with joints, velocities, accelerations and degrees; None without headings.

        Columns of joints of arms stand behind those of the base.
        """
        if not self.shape.joints:
            return None
        yaw = self._read_rows("yaw_rad", rows)[..., None]
        zeros = np.zeros((*yaw.shape[:-1], 4), np.float32)
        has_velocity = "velocity" in self.group
        degrees = np.full(yaw.shape[:-1], CUBIC if has_velocity else LINEAR, np.int32)
        defaults = {"velocity": zeros, "acceleration": zeros, "degree": degrees}
        stored = {name: self._read_rows(name, rows) for name in defaults if name in self.group}
        motion = {"yaw_rad": yaw, **defaults, **stored}
        if self.shape.arm:
            still = np.zeros((*yaw.shape[:-1], len(self.shape.arm)), np.float32)
            for name, base in (
                ("position", "yaw_rad"),
                ("velocity", "velocity"),
                ("acceleration", "acceleration"),
            ):
                has_rows = f"joint_{name}" in self.group
                joints = self._read_rows(f"joint_{name}", rows) if has_rows else still
                motion[base] = np.concatenate([motion[base], joints], axis=-1)
        return motion

    def sha256(self) -> str:
        """Return the SHA-256 of all bytes of the file, hexadecimal."""
        with wrap_read_errors(self.path):
            return checksums.hash_folder(self.path)

    def _read_rows(self, name: str, rows: np.ndarray) -> np.ndarray:
        array = self.group.get_array(name)
        low, high = int(rows.min()), int(rows.max()) + 1
        values: np.ndarray = np.asarray(array[low:high])[rows - low]
        return values

    def _read_texts(self, name: str, list_name: str, rows: np.ndarray) -> np.ndarray | None:
        if name not in self.group:
            return None
        table = np.array([*read_texts(self.group, list_name), ""], object)
        index = self._read_rows(name, rows)
        is_valid = (index >= 0) & (index < len(table))
        texts: np.ndarray = table[np.where(is_valid, index, -1)]
        return texts


def read_texts(group: zarr.Group, name: str) -> list[str]:
    """Return the texts that an array of a file of plans counts; see ``reasons``."""
    texts = group.attrs.get(name, [])
    if not isinstance(texts, list):
        raise TypeError(f"{name} is no list")
    return [str(text) for text in texts]


def summarise_plan_file(path: Path) -> planning_summary.PlanningSummary:
    """Return how the planning of a file of plans ended; see `runs.storage.planning_summary`."""
    with wrap_read_errors(path):
        group = zarr.open_group(path, mode="r")
        plans = PlanFile(path=path, group=group, shape=PathShape(points=2))
        points = np.asarray(group.get_array("points")[:])
        rows = np.arange(len(points))
        reason = plans._read_texts("reason", "reasons", rows)
        status = plans._read_texts("status", "statuses", rows)
    blank = np.full(points.shape, "", object)
    reasons = blank if reason is None else reason
    statuses = blank if status is None else np.repeat(status[:, None], points.shape[1], axis=1)
    return planning_summary.summarise_robots(
        np.repeat(rows, points.shape[1]),
        (points > 0).reshape(-1),
        statuses.reshape(-1).tolist(),
        reasons.reshape(-1).tolist(),
    )


def open_plans(path: Path, scenario: Scenario) -> PlanFile:
    """Open a file of plans for the worlds of a scenario.

    Raises:
        ConfigError: it is none, is damaged, or was made for other problems.
    """
    with wrap_read_errors(path, "give a file of angler plan; format: docs/reference/plan_files.md"):
        group = zarr.open_group(path, mode="r")
        attributes = dict(group.attrs)
        shapes = {name: np.shape(array) for name, array in group.arrays()}
    if attributes.get("schema") != SCHEMA or attributes.get("schema_version") != SCHEMA_VERSION:
        raise ConfigError(f"{path}: holds no plans of schema version {SCHEMA_VERSION}")
    for name, dims in _ARRAYS.items():
        if len(shapes.get(name, ())) != dims:
            raise ConfigError(
                f"{path}/{name}: must be an array of {dims} dimensions; "
                "see docs/reference/plan_files.md"
            )
    worlds, robots, points = shapes["time_s"]
    if shapes["points"] != (worlds, robots) or shapes["position_m"] != (worlds, robots, points, 3):
        raise ConfigError(
            f"{path}: points {shapes['points']}, time_s {shapes['time_s']} and position_m "
            f"{shapes['position_m']} do not fit each other"
        )
    _require_same_scenario(path, attributes, scenario, worlds, robots)
    if not 2 <= points <= MAX_POINTS:
        raise ConfigError(f"{path}: paths of {points} points; must be 2 to {MAX_POINTS}")
    joints = "yaw_rad" in shapes
    for name, size in (("yaw_rad", 3), ("velocity", 4), ("acceleration", 4), ("degree", 3)):
        expected = (worlds, robots, points, 4)[:size]
        if name in shapes and (not joints or shapes[name] != expected):
            raise ConfigError(
                f"{path}/{name}: has the shape {shapes[name]}; must be {expected}, and yaw_rad "
                "must "
                "be there too"
            )
    arm = _arm_joints(path, attributes, shapes, scenario)
    width = _padded_width(points, scenario.planner.points)
    shape = PathShape(points=width, joints=joints, arm=arm)
    limit = attributes.get(SPEED_LIMIT, "")
    if limit not in ("", GROUND):
        raise ConfigError(
            f'{path}: {SPEED_LIMIT} is {format_value(limit)}; must be "{GROUND}" or left out'
        )
    return PlanFile(path=path, group=group, shape=shape, limits_ground_speed=limit == GROUND)


def _arm_joints(
    path: Path,
    attributes: Mapping[str, object],
    shapes: Mapping[str, tuple[int, ...]],
    scenario: Scenario,
) -> tuple[str, ...]:
    """Return the names of the joints of arms that plans move; none if they do not.

    Raises:
        ConfigError: they are not all joints of the fleet, or an array has another shape.
    """
    names = ("joint_position", "joint_velocity", "joint_acceleration")
    present = [name for name in names if name in shapes]
    if not present:
        return ()
    expected = scenario.joint_names()
    listed = attributes.get("joints")
    if not expected or listed != list(expected):
        raise ConfigError(
            f"{path}: joints = {format_value(listed)}; the arms of {scenario.name} have "
            f"{format_value(list(expected))}, all of them or none"
        )
    wanted = (*shapes["time_s"], len(expected))
    for name in present:
        if shapes[name] != wanted or "yaw_rad" not in shapes or "joint_position" not in shapes:
            raise ConfigError(
                f"{path}/{name}: has the shape {shapes[name]}; must be {wanted}, and yaw_rad and "
                "joint_position must be there too"
            )
    return expected


def _require_same_scenario(
    path: Path, attributes: Mapping[str, object], scenario: Scenario, worlds: int, robots: int
) -> None:
    members = len(scenario.members())
    if robots != members:
        raise ConfigError(
            f"{path}: plans of {robots} robots a world; the fleet of {scenario.name} has {members}"
        )
    for key in ("seed", "digest"):
        if key not in attributes:
            raise ConfigError(
                f"{path}: lacks the attribute {key}; copy it from the file of angler problems that "
                "the plans were made for"
            )
    if attributes["seed"] != scenario.seed:
        raise ConfigError(
            f"{path}: plans for seed {format_value(attributes['seed'])}, not {scenario.seed}; give "
            "--seed, or make plans for this one"
        )
    if attributes["digest"] != scenario.digest():
        source = "the problems that the plans were made for"
        if "scenario" in attributes:
            source = (
                f"the scenario {format_value(attributes['scenario'])} that the plans were made for"
            )
        raise ConfigError(
            f"{path}: plans for other problems (digest "
            f"{format_value(str(attributes['digest'])[:12])}, "
            "not "
            f"{scenario.digest()[:12]}): world, fleet, water or horizon of {scenario.name} differ "
            f"from those of {source}"
        )
    if worlds < scenario.worlds:
        raise ConfigError(
            f"{path}: holds plans of {worlds} worlds, {scenario.worlds} are to be flown; "
            "give --worlds, or plan more"
        )


def _padded_width(points: int, usual: int) -> int:
    """Return the number of points with which paths of a file are flown.

    Programs are compiled for it. Files of a few points more or less are flown by one program: that
    of the scenario's planners where it is wide enough, else of the next power of two.

    Args:
        points: of the file's paths.
        usual: of the scenario's planners (``planner.points``).
    """
    return usual if points <= usual else min(1 << (points - 1).bit_length(), MAX_POINTS)


def _widen_paths(rows: np.ndarray, points: int) -> np.ndarray:
    """Repeat the last point of paths [w, r, n, ...] until they have so many."""
    n_missing = points - rows.shape[2]
    return np.concatenate([rows, np.repeat(rows[:, :, -1:], n_missing, axis=2)], axis=2)


def _pad_paths(
    count: np.ndarray, time: np.ndarray, values: np.ndarray, is_found: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pad times and points by repeating the last; robots without a path hold their start."""
    points = time.shape[-1]
    index = np.minimum(np.arange(points), np.clip(count - 1, 0, points - 1)[..., None])
    time = np.take_along_axis(time, index, 2)
    values = np.take_along_axis(values, index[..., None], 2)
    return (
        np.where(is_found[..., None], time, 0.0).astype(np.float32),
        np.where(is_found[..., None, None], values, start[:, :, None]).astype(np.float32),
    )


def _build_joint_paths(
    count: np.ndarray,
    time: np.ndarray,
    joints: np.ndarray,
    motion: dict[str, np.ndarray],
    is_found: np.ndarray,
    start: np.ndarray,
    shape: PathShape,
) -> JointTrajectory:
    """Build joint paths of a shape from times and points of `_pad_paths`."""
    zeros = np.zeros_like(start)
    padded = {
        name: _pad_paths(count, time, motion[name], is_found, zeros)[1]
        for name in ("velocity", "acceleration")
    }
    degree = np.where(is_found[..., None], motion["degree"], LINEAR).astype(np.int32)
    time, position = _pad_paths(count, time, joints, is_found, start)
    names = (*VEHICLE_JOINTS, *shape.arm)
    commanded = np.ones((*is_found.shape, len(names)), bool)
    by_point = {"time_s": time, "position": position, **padded, "degree": degree}
    arrays = {
        **{name: _widen_paths(rows, shape.points) for name, rows in by_point.items()},
        "commanded": commanded,
        "found": is_found,
    }
    leaves = {name: host_leaf(rows) for name, rows in arrays.items()}
    return JointTrajectory(joints=names, **leaves)


def _path_faults(
    count: np.ndarray,
    time: np.ndarray,
    position_m: np.ndarray,
    start: np.ndarray,
    speed: np.ndarray,
    horizon_s: float,
    motion: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Return the fault of each path, text [w, r]; empty where it can be flown or is missing.

    Args:
        count: points of each path, [w, r].
        time: s, [w, r, point].
        position_m: m, W, [w, r, point, 3].
        start: of the robots, m, W, [w, r, 3].
        speed: greatest speed over ground, m/s, [w, r].
        horizon_s: end of the worlds, s.
        motion: further numbers at the points, [w, r, point, ...] each.
    """
    points = time.shape[-1]
    is_point = np.arange(points) < count[..., None]
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(time) & np.isfinite(position_m).all(axis=-1)
        for values in motion.values():
            finite &= np.isfinite(values).reshape(*time.shape, -1).all(axis=-1)
        span = np.where(is_point[..., 1:], np.diff(time), 0.0)
        distance_m = np.where(
            is_point[..., 1:], np.linalg.norm(np.diff(position_m, axis=2), axis=-1), 0.0
        )
        is_fast = (
            distance_m > (1.0 + SPEED_TOLERANCE) * speed[..., None] * span + ROUNDING_TOLERANCE_M
        )
        faults = (
            ("has too few or too many points", (count != 0) & ((count < 2) | (count > points))),
            ("has NaN or infinite numbers", np.any(is_point & ~finite, axis=-1)),
            ("does not begin at 0 s", time[..., 0] != 0.0),
            (
                "begins elsewhere",
                np.linalg.norm(position_m[:, :, 0] - start, axis=-1) > START_TOLERANCE_M,
            ),
            ("goes back in time", np.any(span < 0.0, axis=-1)),
            ("is faster than its cruise speed, or jumps", np.any(is_fast, axis=-1)),
            (
                "ends after the horizon",
                np.max(np.where(is_point, time, 0.0), axis=-1) > horizon_s + 1e-3,
            ),
        )
    reasons = np.full(count.shape, "", object)
    for text, is_fault in reversed(faults):
        reasons = np.where(is_fault & (count != 0), text, reasons)
    return reasons
