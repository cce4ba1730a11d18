"""Making a file of plans: some worlds at a time, so that it can be interrupted and gone on with."""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import zarr
from zarr.codecs import BloscCodec

from angler_mjx.errors import ConfigError, RunError, shown
from angler_mjx.planning.planner import PathShape
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.joint_trajectory import LINEAR, JointTrajectory
from angler_mjx.robot.control.plans import Plan, points_m
from angler_mjx.runs.simulator.hosted import PlanNotes, SampledBatch, status_of
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.damage import reading
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.plans.read import SCHEMA, SCHEMA_VERSION
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.task_table import refuse_task

_UNPLANNED = -1


class Writer:
    """Makes a file of plans, some worlds at a time; what was written can be gone on with."""

    def __init__(self, claimed: OutputLock, group: zarr.Group) -> None:
        """Use `begin`."""
        self._claimed, self._group = claimed, group
        about: dict[str, Any] = dict(group.attrs)
        self._words: dict[str, dict[str, int]] = {
            name: {str(word): i for i, word in enumerate(about.get(name, []))}
            for name in ("reasons", "statuses")
        }

    def planned(self) -> int:
        """Robots that have a path already."""
        count: Any = self._group["points"]
        return int(np.sum(np.asarray(count[:]) > 0))

    def left(self) -> list[int]:
        """Worlds that are not planned yet."""
        count: Any = self._group["points"]
        return [int(i) for i in np.flatnonzero(np.any(np.asarray(count[:]) < 0, axis=1))]

    def write(self, first: int, path: Plan, notes: PlanNotes) -> None:
        """Write the plans of worlds first, first + 1 and on; the number of points last.

        Args:
            first: of them.
            path: [w, r] leading, arrays of NumPy.
            notes: of the same worlds.
        """
        found, time = np.asarray(plans.found(path)), np.asarray(path.time_s)
        same = time[..., :-1] == time[..., -1:]
        held = np.argmax(np.concatenate([same, np.ones_like(same[..., :1])], -1), -1) + 1
        rows = slice(first, first + len(found))
        group: Any = self._group
        group["time_s"][rows] = time
        group["position_m"][rows] = np.asarray(points_m(path))
        if isinstance(path, JointTrajectory):
            group["yaw_rad"][rows] = np.asarray(path.position)[..., 3]
            for name in ("velocity", "acceleration", "degree"):
                group[name][rows] = np.asarray(getattr(path, name))
        group["planning_s"][rows] = notes.planning_s.astype(np.float32)
        group["reason"][rows] = self._index("reasons", notes.reason)
        group["status"][rows] = self._index("statuses", notes.status)
        group["points"][rows] = np.where(found, np.maximum(held, 2), 0).astype(np.int32)

    def _index(self, name: str, words: np.ndarray) -> np.ndarray:
        known = self._words[name]
        flat = [known.setdefault(w, len(known)) if w else -1 for w in words.reshape(-1)]
        self._group.attrs[name] = list(known)
        return np.array(flat, np.int32).reshape(words.shape)

    def publish(self) -> None:
        """Give the file its name: it is whole."""
        self._claimed.publish()

    def release(self) -> None:
        """Leave it as it is, to be gone on with."""
        self._claimed.release()


def begin(path: Path, scenario: Scenario, shape: PathShape, *, resume: bool, tile: int) -> Writer:
    """A file of plans to be written.

    Args:
        path: of the Zarr group.
        scenario: whose problems are planned.
        shape: of the paths.
        resume: go on with one that was interrupted.
        tile: worlds of a chunk.

    Raises:
        ConfigError: the path exists, or there is nothing to go on with, or it is of others.
        RunError: it cannot be written.
    """
    if resume:
        return _again(path, scenario, shape)
    claimed = output_lock.acquire(
        path, what="file of plans", left=lambda building: output_lock.RESUMABLE
    )
    try:
        group = zarr.open_group(claimed.building, mode="a")
        group.attrs.update({"schema": SCHEMA, "schema_version": SCHEMA_VERSION, **_about(scenario)})
        _arrays(group, scenario.worlds, len(scenario.members()), shape, tile)
    except OSError as error:
        claimed.withdraw()
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error
    return Writer(claimed, group)


def _again(path: Path, scenario: Scenario, shape: PathShape) -> Writer:
    if path.is_dir() and any(path.iterdir()):
        raise ConfigError(f"--resume {path}: this file is complete; nothing is left to do")
    claimed = output_lock.acquire_unfinished(path, what="file of plans")
    if claimed is None:
        raise ConfigError(f"--resume {path}: there is no interrupted file of that name")
    try:
        with reading(claimed.building):
            group = zarr.open_group(claimed.building, mode="r+")
            array: Any = group["time_s"]
            about, there = dict(group.attrs), array.shape
        for key, value in _about(scenario).items():
            if about.get(key) != value:
                raise ConfigError(
                    f"--resume {path}: was begun with another {key} ({shown(about.get(key))}, not "
                    f"{shown(value)}); begin a new file"
                )
        if there != (scenario.worlds, len(scenario.members()), shape.points):
            raise ConfigError(f"--resume {path}: was begun with other worlds or points {there}")
    except BaseException:
        claimed.release()
        raise
    return Writer(claimed, group)


def _about(scenario: Scenario) -> dict[str, Any]:
    return {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "digest": scenario.digest(),
        # Files of older versions lack the keys that are null here.
        "planner": scenario.planner.model_dump(mode="json", exclude_none=True),
    }


def _arrays(group: zarr.Group, worlds: int, robots: int, shape: PathShape, tile: int) -> None:
    rows = (worlds, robots, shape.points)
    made: list[tuple[str, tuple[int, ...], str, float, str]] = [
        ("points", rows[:2], "i4", _UNPLANNED, "1"),
        ("time_s", rows, "f4", 0.0, "s"),
        ("position_m", (*rows, 3), "f4", 0.0, "m"),
        ("planning_s", rows[:1], "f4", np.nan, "s"),
        ("reason", rows[:2], "i4", -1, "1"),
        ("status", rows[:1], "i4", -1, "1"),
    ]
    if shape.joints:
        made += [
            ("yaw_rad", rows, "f4", 0.0, "rad"),
            ("velocity", (*rows, 4), "f4", 0.0, "m/s, rad/s"),
            ("acceleration", (*rows, 4), "f4", 0.0, "m/s^2, rad/s^2"),
            ("degree", rows, "i4", LINEAR, "1"),
        ]
    for name, size, kind, fill, unit in made:
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


def make(
    path: Path,
    scenario: Scenario,
    simulator: Simulator,
    *,
    resume: bool = False,
    advance: Callable[[int, int], None] = lambda done, planned: None,
) -> int:
    """Plan the worlds of a scenario into a file; what was planned before is kept.

    Args:
        path: of the Zarr group.
        scenario: with its planner.
        simulator: of it, on one device.
        resume: go on with a file that was interrupted.
        advance: called with the worlds done, and how many robots of them have a path.

    Returns:
        Number of robots with a path.

    Raises:
        ConfigError: as `begin`.
        RunError: the disk is full, or the planner cannot be made.
    """
    refuse_task(scenario.task, "plans lead to one goal; leave it out to plan for this scenario")
    tile, total = simulator.tile, scenario.worlds
    writer = begin(path, scenario, simulator.paths, resume=resume, tile=tile)
    try:
        left = writer.left()
        tiles = sorted({world - world % tile for world in left})
        done, planned = total - len(left), writer.planned()
        advance(done, planned)
        kept_of = {first: min(tile, total - first) for first in tiles}
        drawn: deque[SampledBatch] = deque()
        for i, first in enumerate(tiles):
            # Two tiles are with the planner, so that no worker waits while one is written.
            for coming in tiles[i + len(drawn) : i + 2]:
                drawn.append(simulator.begin([coming], kept=[kept_of[coming]]))
            worlds, notes = simulator.finish(drawn.popleft())
            kept = kept_of[first]
            flown: Any = jax.tree.map(lambda leaf, n=kept: np.asarray(leaf)[:n], worlds.path)
            found = np.asarray(plans.found(flown))
            notes = notes or _of_device(found)
            writer.write(first, flown, notes.rows(slice(kept)))
            done += kept
            planned += int(found.sum())
            advance(done, planned)
        writer.publish()
    except OSError as error:
        writer.release()
        raise RunError(
            f"{path}: cannot be written ({error.strerror or error}); make room and go on with "
            "--resume"
        ) from error
    except BaseException:
        writer.release()
        raise
    return planned


def _of_device(found: np.ndarray) -> PlanNotes:
    return PlanNotes(
        planning_s=np.full(len(found), np.nan),
        status=status_of(found),
        reason=np.where(found, "", "no way found").astype(object),
    )
