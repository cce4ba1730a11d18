"""Comparison of runs of the same worlds: the shown world, robot and times."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import scene
from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.runs.storage.folder import Run

BEFORE_S = (8.0, 4.0, 0.0)
"""Default times: seconds before the first failure."""
_SAME = ("start_m", "goal_m", "floor_z_m")


@dataclass(frozen=True, kw_only=True)
class WorldComparison:
    """Data of the comparison map."""

    scenes: tuple[ReplayScene, ...]
    names: tuple[str, ...]
    robot: int
    at_s: tuple[float, ...]


def read_comparison(
    runs: Sequence[Run], world: int | None, robot: int | None, at_s: Sequence[float]
) -> WorldComparison:
    """Read one world of some runs, and select the shown robot and times.

    Args:
        runs: of the same worlds, with trajectories.
        world: global index; the first in which a robot ends differently if left out.
        robot: index; the first that ends differently there.
        at_s: times, s; some before the first failure of that robot if empty.

    Raises:
        ConfigError: the runs are of other worlds, do not hold the world, or there is no such robot
            or time.
    """
    for run in runs:
        if run.scenario.time.record_hz == 0:
            raise ConfigError(f"{run.path}: holds no trajectories (time.record_hz = 0)")
    world_index, differing_robot = _find_differing(runs, world)
    scenes = tuple(scene.read_scene(run, world_index) for run in runs)
    _check_same(runs, scenes, world_index)
    count = len(scenes[0].robots)
    if robot is not None and not 0 <= robot < count:
        raise ConfigError(
            f"--robot {robot}: must be 0 to {count - 1}, the robots of {runs[0].path}"
        )
    index = differing_robot if robot is None else robot
    end = max(float(replay.time_s[-1]) for replay in scenes)
    for t in at_s:
        if not 0.0 <= t <= end + 1e-6:
            raise ConfigError(f"--at {t:g}: must be 0 to {end:g} s, when the last robot ended")
    return WorldComparison(
        scenes=scenes,
        names=tuple(describe_control(run) for run in runs),
        robot=index,
        at_s=tuple(at_s) or _default_times([replay.robots[index] for replay in scenes]),
    )


def describe_control(run: Run) -> str:
    """Return the control of a run's robots, in words."""
    planner, policy = run.scenario.planner, run.scenario.policy
    if policy.name != "none":
        return f"{policy.title}, all the way"
    if planner.replan_hz:
        return f"{planner.name}, planned anew at {planner.replan_hz:g} Hz"
    return f"{planner.name}, planned before the start"


def _find_differing(runs: Sequence[Run], world: int | None) -> tuple[int, int]:
    """Return a world and a robot that end differently in the first two runs; else the first."""
    ends = [
        {(row["world"], row["robot"]): row["outcome"] for row in run.episodes.to_pylist()}
        for run in runs
    ]
    for run, end in zip(runs, ends, strict=True):
        if world is not None and world not in {key[0] for key in end}:
            raise ConfigError(f"world {world} is not in {run.path}")
    shared = sorted(key for key in ends[0] if all(key in end for end in ends[1:]))
    candidates = [key for key in shared if world is None or key[0] == world]
    if not candidates:
        raise ConfigError(f"{runs[0].path} and {runs[1].path}: have no world in common")
    different = [key for key in candidates if len({end[key] for end in ends}) > 1]
    collisions = [key for key in different if any(end[key].startswith("collision") for end in ends)]
    return (collisions or different or candidates)[0]


def _check_same(runs: Sequence[Run], scenes: Sequence[ReplayScene], world: int) -> None:
    first = scenes[0]
    for run, other in zip(runs[1:], scenes[1:], strict=True):
        pairs = {
            key: [getattr(replay.environment, key) for replay in (first, other)] for key in _SAME
        }
        pairs["grid"] = [replay.environment.grid.occupied for replay in (first, other)]
        pairs["obstacles"] = [replay.environment.obstacles.size_m for replay in (first, other)]
        for key, (a, b) in pairs.items():
            if not np.array_equal(np.asarray(a), np.asarray(b)):
                raise ConfigError(
                    f"{runs[0].path} and {run.path}: world {world} differs ({key}); give two runs "
                    "of one scenario and seed"
                )


def _default_times(robots: Sequence[RobotTrack]) -> tuple[float, ...]:
    """Return times before the first failure; if all arrived, quarters of the path."""
    failed = [track.end_time_s for track in robots if not track.arrived]
    if failed:
        return tuple(sorted({max(round(min(failed) - t, 1), 0.0) for t in BEFORE_S}))
    end = min(track.end_time_s for track in robots)
    return tuple(round(0.25 * k * end, 1) for k in (1, 2, 3))
