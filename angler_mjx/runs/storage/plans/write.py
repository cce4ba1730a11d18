"""Writing of a file of plans, some worlds at a time; an interruption can be resumed."""

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import jax
import numpy as np
import zarr
from zarr.codecs import BloscCodec
from zarr.types import JSON

from angler_mjx.errors import ConfigError
from angler_mjx.planning.planner import PathShape
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.commands.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.plans import Plan, points_m
from angler_mjx.runs.simulator.host_planning import PlanNotes, SampledBatch, planning_status
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import output_lock, results_folder
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.plans.read import SCHEMA, SCHEMA_VERSION, read_texts
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.task_table import require_goal_task

_UNPLANNED = -1


def _joint_arrays(path: JointTrajectory) -> dict[str, np.ndarray]:
    """Return headings, velocities, accelerations and degrees, and what joints of arms do."""
    base = len(VEHICLE_JOINTS)
    arrays = {"yaw_rad": np.asarray(path.position)[..., 3], "degree": np.asarray(path.degree)}
    for name in ("velocity", "acceleration"):
        arrays[name] = np.asarray(getattr(path, name))[..., :base]
    if len(path.joints) > base:
        for name in ("position", "velocity", "acceleration"):
            arrays[f"joint_{name}"] = np.asarray(getattr(path, name))[..., base:]
    return arrays


class PlanWriter:
    """Writes a file of plans, some worlds at a time; it can be resumed."""

    def __init__(self, lock: OutputLock, group: zarr.Group) -> None:
        """Use `open_writer`."""
        self._lock, self._group = lock, group
        self._texts: dict[str, dict[str, int]] = {
            name: {text: i for i, text in enumerate(read_texts(group, name))}
            for name in ("reasons", "statuses")
        }

    def planned(self) -> int:
        """Number of robots that have a path."""
        return int(np.sum(self._point_counts() > 0))

    def left(self) -> list[int]:
        """Worlds that are not planned yet."""
        return [int(i) for i in np.flatnonzero(np.any(self._point_counts() < 0, axis=1))]

    def _point_counts(self) -> np.ndarray:
        """Return the number of points of each path, int [world, robot]."""
        return np.asarray(self._group.get_array("points")[:])

    def write(self, first: int, path: Plan, notes: PlanNotes) -> None:
        """Write the plans of worlds first, first + 1 and on; the number of points last.

        Args:
            first: of them.
            path: [w, r] leading, arrays of NumPy.
            notes: of the same worlds.
        """
        is_found, time = np.asarray(plans.is_found(path)), np.asarray(path.time_s)
        is_last = time[..., :-1] == time[..., -1:]
        n_points = np.argmax(np.concatenate([is_last, np.ones_like(is_last[..., :1])], -1), -1) + 1
        rows = slice(first, first + len(is_found))
        arrays = {"time_s": time, "position_m": np.asarray(points_m(path))}
        if isinstance(path, JointTrajectory):
            arrays |= _joint_arrays(path)
        arrays["planning_s"] = notes.planning_s.astype(np.float32)
        arrays["reason"] = self._text_indices("reasons", notes.reason)
        arrays["status"] = self._text_indices("statuses", notes.status)
        arrays["points"] = np.where(is_found, np.maximum(n_points, 2), 0).astype(np.int32)
        for name, values in arrays.items():
            self._group.get_array(name)[rows] = values

    def _text_indices(self, name: str, texts: np.ndarray) -> np.ndarray:
        indices = self._texts[name]
        flat = [indices.setdefault(w, len(indices)) if w else -1 for w in texts.reshape(-1)]
        self._group.attrs[name] = list(indices)
        return np.array(flat, np.int32).reshape(texts.shape)

    def publish(self) -> None:
        """Give the file its name: it is whole."""
        self._lock.publish()

    def keeping(self) -> AbstractContextManager[Path]:
        """Write inside; the file is released as it is if that fails, for a resumption.

        Raises:
            RunError: the disk gave out.
        """
        return self._lock.keeping()


def open_writer(
    path: Path,
    scenario: Scenario,
    shape: PathShape,
    *,
    resume: bool,
    tile: int,
    seed: int | None = None,
) -> PlanWriter:
    """Open a file of plans for writing.

    Args:
        path: of the Zarr group.
        scenario: whose problems are planned.
        shape: of the paths.
        resume: go on with one that was interrupted.
        tile: worlds of a chunk.
        seed: that the file states; the scenario's if left out.

    Raises:
        ConfigError: the path exists, or there is nothing to go on with, or it is of others.
        RunError: it cannot be written.
    """
    if resume:
        return _reopen_writer(path, _file_attributes(scenario, seed), scenario, shape)
    lock = output_lock.acquire(
        path, kind="file of plans", advise=lambda building: output_lock.RESUMABLE
    )
    with lock.filling() as building:
        group = zarr.open_group(building, mode="a")
        group.attrs.update(
            {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, **_file_attributes(scenario, seed)}
        )
        _create_arrays(group, scenario.worlds, len(scenario.members()), shape, tile)
    return PlanWriter(lock, group)


def _reopen_writer(
    path: Path, attributes: Mapping[str, JSON], scenario: Scenario, shape: PathShape
) -> PlanWriter:
    lock, _ = results_folder.resume_folder(
        path,
        kind="file of plans",
        file="zarr.json",
        is_complete=path.is_dir() and any(path.iterdir()),
        check=partial(_require_same_plans, path, attributes, scenario, shape),
    )
    with lock.keeping() as building, wrap_read_errors(building):
        group = zarr.open_group(building, mode="r+")
    return PlanWriter(lock, group)


def _require_same_plans(
    path: Path,
    expected: Mapping[str, JSON],
    scenario: Scenario,
    shape: PathShape,
    building: Path,
) -> None:
    """Refuse to resume a file of other problems or paths."""
    with wrap_read_errors(building):
        group = zarr.open_group(building, mode="r")
        attributes, stored_shape = dict(group.attrs), group.get_array("time_s").shape
    results_folder.require_same_keys(building, expected, attributes)
    if stored_shape != (scenario.worlds, len(scenario.members()), shape.points):
        raise ConfigError(f"--resume {path}: was begun with other worlds or points {stored_shape}")
    if attributes.get("joints", []) != list(shape.arm):
        raise ConfigError(f"--resume {path}: was begun with other joints of arms")


def _file_attributes(scenario: Scenario, seed: int | None) -> dict[str, JSON]:
    return {
        "scenario": scenario.name,
        "seed": scenario.seed if seed is None else seed,
        "digest": scenario.digest(),
        # Files of older versions lack the keys that are null here.
        "planner": scenario.planner.model_dump(mode="json", exclude_none=True),
    }


def _create_arrays(
    group: zarr.Group, worlds: int, robots: int, shape: PathShape, tile: int
) -> None:
    rows = (worlds, robots, shape.points)
    array_specs: list[tuple[str, tuple[int, ...], str, float, str]] = [
        ("points", rows[:2], "i4", _UNPLANNED, "1"),
        ("time_s", rows, "f4", 0.0, "s"),
        ("position_m", (*rows, 3), "f4", 0.0, "m"),
        ("planning_s", rows[:1], "f4", np.nan, "s"),
        ("reason", rows[:2], "i4", -1, "1"),
        ("status", rows[:1], "i4", -1, "1"),
    ]
    if shape.joints:
        array_specs += [
            ("yaw_rad", rows, "f4", 0.0, "rad"),
            ("velocity", (*rows, 4), "f4", 0.0, "m/s, rad/s"),
            ("acceleration", (*rows, 4), "f4", 0.0, "m/s^2, rad/s^2"),
            ("degree", rows, "i4", LINEAR, "1"),
        ]
    if shape.arm:
        group.attrs["joints"] = list(shape.arm)
        width = (*rows, len(shape.arm))
        array_specs += [
            ("joint_position", width, "f4", 0.0, "rad or m"),
            ("joint_velocity", width, "f4", 0.0, "rad/s or m/s"),
            ("joint_acceleration", width, "f4", 0.0, "rad/s^2 or m/s^2"),
        ]
    for name, size, kind, fill, unit in array_specs:
        names = ["world", "robot", "point", "xyz" if name == "position_m" else "joint"]
        group.create_array(
            name,
            shape=size,
            chunks=(min(tile, worlds), *size[1:]),
            dtype=kind,
            fill_value=fill,
            compressors=BloscCodec(cname="lz4", shuffle="shuffle", clevel=1),
            attributes={"unit": unit},
            dimension_names=names[: len(size)],
        )


def plan_worlds(
    path: Path,
    scenario: Scenario,
    simulator: Simulator,
    *,
    resume: bool = False,
    advance: Callable[[int, int], None] = lambda done, planned: None,
    seed: int | None = None,
) -> int:
    """Plan the worlds of a scenario into a file; earlier plans are kept.

    Args:
        path: of the Zarr group.
        scenario: with its planner.
        simulator: of it, on one device.
        resume: go on with a file that was interrupted.
        advance: called with the worlds done, and how many robots of them have a path.
        seed: that the file states; the scenario's if left out.

    Returns:
        Number of robots with a path.

    Raises:
        ConfigError: as `open_writer`.
        RunError: the disk is full, or the planner cannot be made.
    """
    require_goal_task(
        scenario.task, "plans lead to one goal; leave it out to plan for this scenario"
    )
    tile, total = simulator.tile, scenario.worlds
    writer = open_writer(path, scenario, simulator.paths, resume=resume, tile=tile, seed=seed)
    with writer.keeping():
        remaining = writer.left()
        tiles = sorted({world - world % tile for world in remaining})
        done, planned = total - len(remaining), writer.planned()
        advance(done, planned)
        counts = {first: min(tile, total - first) for first in tiles}
        sampled: deque[SampledBatch] = deque()
        for i, first in enumerate(tiles):
            # Two tiles are with the planner, so that no worker waits while one is written.
            for next_first in tiles[i + len(sampled) : i + 2]:
                sampled.append(simulator.begin([next_first], counts=[counts[next_first]]))
            worlds, notes = simulator.finish(sampled.popleft())
            count = counts[first]
            paths = jax.tree.map(lambda leaf, n=count: np.asarray(leaf)[:n], worlds.path)
            is_found = np.asarray(plans.is_found(paths))
            notes = notes or _device_notes(is_found)
            writer.write(first, paths, notes.rows(slice(count)))
            done += count
            planned += int(is_found.sum())
            advance(done, planned)
        writer.publish()
    return planned


def _device_notes(is_found: np.ndarray) -> PlanNotes:
    return PlanNotes(
        planning_s=np.full(len(is_found), np.nan),
        status=planning_status(is_found),
        reason=np.where(is_found, "", "no way found").astype(object),
    )
