"""Reader of a run folder for the referee: settings, results, and the record of each world."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.types import AnyArray

from angler_mjx.errors import ConfigError
from angler_mjx.testing.referee import carrying, teamwork, vehicles
from angler_mjx.testing.referee.folder import (
    CARRY_NUMBER_COLUMNS,
    CONTACT_NUMBER_COLUMNS,
    TASK_NUMBER_COLUMNS,
    Row,
    read_copies,
    read_json,
    read_rows,
    reporting_damage,
)
from angler_mjx.testing.referee.geometry import Floats
from angler_mjx.testing.referee.vehicles import RefereeRobot, StoredVariant

BLOCK_BYTES = 2**27
"""Approximate size of a block of the record in memory."""

OUTCOMES = (
    "running",
    "reached",
    "collision_static",
    "collision_dynamic",
    "collision_robot",
    "out_of_bounds",
    "timeout",
    "diverged",
    "failed",
    "damaged",
    "dropped",
)
"""Outcomes by their numbers in ``trajectories.zarr``."""


@dataclass(frozen=True, kw_only=True)
class RefereeRun:
    """Run folder, opened for judging."""

    path: Path
    control_dt_s: float
    physics_dt_s: float
    every: int
    """Control steps between samples."""
    horizon_steps: int
    goal_tolerance_m: float
    breakdowns_s: tuple[float, float] | None
    """Time limits of breakdowns; None without breakdowns."""
    task: teamwork.TaskRules | None
    """Rules of the task that decides arrival; None where the distance to a goal does."""
    carry: carrying.CarryRules | None
    """Rules of a body that robots hold together; None where they hold nothing."""
    has_contacts: bool
    """Whether bodies push each other, so that no touch ends an episode."""
    damage_energy_j: float | None
    """Energy of an impact above which a robot is damaged; None for never."""
    by_end_effector: bool
    """Whether the distance of the end effector to the goal decides, and not that of the centre."""
    has_flown_plans: bool
    """Whether robots fly only the stored plans: no plans made in flight, and no commands of another
    policy or of a session."""
    robots: tuple[RefereeRobot, ...]
    variants: Sequence[StoredVariant]
    """Variants of ``variants.json``, by number; empty where vehicles are as their files say."""
    rows: Mapping[int, Sequence[Row]]
    """Rows of each finished world, in the order of the robots."""
    planned_worlds: int
    """Number of planned worlds of the run."""
    is_single_scene: bool
    """Whether it may be a driven scene that was broken off before its horizon."""
    whole_us: bool
    """Whether commands were stored as whole microseconds, and not unrounded."""
    group: zarr.Group

    @property
    def by_task(self) -> bool:
        """Whether a task decides arrival, and not the distance to a goal."""
        return self.task is not None or self.carry is not None

    @property
    def has_older_rows(self) -> bool:
        """Whether some rows are older, from when any state near the goal was an arrival."""
        rows = (row for world in self.rows.values() for row in world)
        return not self.by_task and any(row["passed_goal_early"] is None for row in rows)

    def robot(self, number: int, row: Row) -> RefereeRobot:
        """Return the robot of a row, as sampled for its world."""
        robot = self.robots[number]
        return robot.with_variant(self.variants[int(row["variant"])]) if self.variants else robot


@dataclass(frozen=True, kw_only=True)
class RefereeWorld:
    """Record of one world; T states, R robots, O obstacles. World frame, metres."""

    index: int
    step: NDArray[np.int64]
    """[T] control steps before each state."""
    p: Floats
    """[T, R, 3]."""
    q: Floats
    """[T, R, 4]."""
    nu: Floats
    """[T, R, 6]."""
    outcome: NDArray[np.int64]
    """[T, R]."""
    obstacle_p: Floats
    """[T, O, 3]."""
    obstacle_q: Floats
    """[T, O, 4]."""
    pwm_us: Floats
    """[T, R, n] or [T - 1, R, n]: the last state may come after all commands."""
    environment: Mapping[str, np.ndarray]
    """Static data: arrays of the world's environment by name, and of its task."""
    target: NDArray[np.int64]
    """[T, R] place of the task for each robot, or [T - 1, R] as ``pwm_us``; -1: the robot stays, or
    there is no task."""
    carrying: NDArray[np.int64]
    """[T, R] goods carried by each robot, or [T - 1, R]; -1: none."""
    joints: Floats | None = None
    """[T, R, J] positions of joints, rad or m; NaN for robots without any; None if not recorded."""
    grip_wrench: Floats | None = None
    """[t, R, 6] of the states with a sample, measured by the grips in F; None if not recorded."""

    @property
    def low_m(self) -> Floats:
        """[3] lower corner of the permitted region."""
        return np.asarray(self.environment["grid/origin_m"], float)

    @property
    def high_m(self) -> Floats:
        """[3] upper corner of the permitted region."""
        size = np.array(self.environment["grid/occupied"].shape) * float(
            self.environment["grid/cell_m"]
        )
        high: Floats = self.low_m + size
        return high


ENVIRONMENT_ARRAYS = (
    "grid/occupied",
    "grid/origin_m",
    "grid/cell_m",
    "floor_z_m",
    "start_m",
    "start_yaw_rad",
    "goal_m",
    "obstacles/kind",
    "obstacles/size_m",
    "obstacles/motion",
    "obstacles/exists",
)


TASK_ARRAYS = ("task/place_m", "task/exists", "task/by", "task/done_at_s")
GRIP_WRENCH = "grips/wrench"
SURVEY_ARRAYS = ("task/cells", "task/seen_at_s")

_STEP_KEYS = ("position_mm", "velocity_mmps", "attitude_mrad", "force_mn", "pwm_us")
"""Keys of the scenario's ``[store]`` by which states are rounded."""


class BreakdownsTable(TypedDict, total=False):
    """Table ``breakdowns`` of ``config.json``."""

    fraction: float
    share: float
    """Former name of ``fraction``."""
    earliest_s: float
    latest_s: float | None


def open_run(path: Path) -> RefereeRun:
    """Open a run folder.

    Raises:
        ConfigError: it is no run folder, stored no trajectories, or is damaged; names the file.
    """
    if not (path / "summary.json").is_file():
        unfinished = path.parent / f".{path.name}.partial"
        hint = f"; its run goes on or broke off in {unfinished}" if unfinished.exists() else ""
        raise ConfigError(f"{path}: not a run folder (no summary.json in it){hint}")
    config = read_json(path / "config.json")
    with reporting_damage(path / "config.json"):
        timing = config["time"]
        hz, dt = float(timing["record_hz"]), float(timing["control_dt_s"])
        if hz == 0.0 or not (path / "trajectories.zarr").exists():
            raise ConfigError(
                f"{path}: this run stored no trajectories (record_hz = 0), so there is nothing to "
                f"judge it by; run it again with --record-hz {1.0 / dt:g}"
            )
        steps = {key: step for key, step in config.get("store", {}).items() if key in _STEP_KEYS}
        if any(step is not None for step in steps.values()):
            raise ConfigError(
                f"{path}: its trajectories are stored in steps ([store] "
                f"{', '.join(key for key, step in steps.items() if step is not None)}), too coarse "
                "to judge it by; run it again without them"
            )
        copies = read_copies(path / "inputs")
        fleet = [(vehicles.read_robot(entry, copies), entry["count"]) for entry in config["fleet"]]
        robots = tuple(robot for robot, count in fleet for _ in range(count))
        horizon_s, goal_tolerance_m = float(timing["horizon_s"]), float(config["goal_tolerance_m"])
        acoustics = config.get("acoustics", {}).get("model", "perfect")
        has_contacts = bool(config.get("contacts"))
        damage_j = config.get("contact", {}).get("damage_energy_j") if has_contacts else None
        carry = carrying.read_carry_rules(config.get("task", {}), dt)
        if carry is not None and "obstacle_p_m" not in _group_names(path):
            raise KeyError("obstacle_p_m")
        task = None if carry else teamwork.read_rules(config.get("task", {}), dt, acoustics)
        planned_worlds = int(config["worlds"])
        breakdowns_s = _breakdowns_s(config.get("breakdowns", {}), horizon_s)
    variants: Sequence[StoredVariant] = ()
    randomisation = config.get("randomise", {})
    if randomisation.get("battery_v") or randomisation.get(
        "fault_probability"
    ):  # they determine power
        variants = read_json(path / "variants.json")["variants"]
    with reporting_damage(path / "trajectories.zarr"):
        group = zarr.open_group(path / "trajectories.zarr", mode="r")
        whole = _require_array(group, "pwm_us").dtype.kind in "iu"
    has_task = task is not None or carry is not None
    is_single_scene = _is_single_scene(path / "summary.json")
    more = [
        *(TASK_NUMBER_COLUMNS if task is not None else ()),
        *(CONTACT_NUMBER_COLUMNS if has_contacts else ()),
        *(CARRY_NUMBER_COLUMNS if carry is not None else ()),
        *(("gripped_s",) if carry is not None and carry.is_gripped_in_flight else ()),
    ]
    rows = read_rows(path / "episodes.parquet", len(robots), more)
    return RefereeRun(
        path=path,
        robots=robots,
        variants=variants,
        rows=rows,
        has_flown_plans="plan_time_s" in group
        and not (has_task or is_single_scene)
        and not config.get("planner", {}).get("replan_hz", 0.0)
        and _follows_plans(path / "policy.json"),
        is_single_scene=is_single_scene,
        whole_us=whole,
        group=group,
        control_dt_s=dt,
        physics_dt_s=float(timing.get("physics_dt_s", dt)),
        every=round(1.0 / (hz * dt)),
        horizon_steps=round(horizon_s / dt),
        goal_tolerance_m=goal_tolerance_m,
        planned_worlds=planned_worlds,
        task=task,
        carry=carry,
        has_contacts=has_contacts,
        damage_energy_j=None if damage_j is None else float(damage_j),
        by_end_effector=config.get("task", {}).get("reached_by") == "end_effector",
        breakdowns_s=breakdowns_s,
    )


def _group_names(path: Path) -> set[str]:
    """Return the names of the arrays and groups of a run's trajectories."""
    return set(zarr.open_group(path / "trajectories.zarr", mode="r").keys())


def _follows_plans(policy: Path) -> bool:
    """Return whether the robots of a run follow plans, and no other policy."""
    return not policy.exists() or str(read_json(policy).get("class")).endswith(".Online")


def _breakdowns_s(table: BreakdownsTable, horizon_s: float) -> tuple[float, float] | None:
    if not table.get("fraction", table.get("share")):
        return None
    latest = table["latest_s"]
    return float(table["earliest_s"]), horizon_s if latest is None else float(latest)


def _is_single_scene(path: Path) -> bool:
    summary = read_json(path)
    return summary.get("worlds_done") == 1 and summary.get("tile") == 1


def read_worlds(run: RefereeRun, chosen: Sequence[int]) -> Iterator[RefereeWorld]:
    """Yield the records of worlds, in order.

    Raises:
        ConfigError: an array is missing, damaged or of another shape; names the world.
    """
    with reporting_damage(run.path / "trajectories.zarr"):
        per_world = sum(
            array.nbytes // max(array.shape[0], 1)
            for _, array in run.group.members()
            if isinstance(array, zarr.Array) and array.ndim > 1
        )
    max_worlds = max(1, BLOCK_BYTES // max(per_world, 1))
    block: list[int] = []
    for index in chosen:
        if block and (len(block) == max_worlds or index != block[-1] + 1):
            yield from _read_block(run, block)
            block = []
        block.append(index)
    if block:
        yield from _read_block(run, block)


def _read_block(run: RefereeRun, chosen: Sequence[int]) -> Iterator[RefereeWorld]:
    """Yield neighbouring worlds, read at once: opening a chunk costs as much as a short read."""
    first, last = chosen[0], chosen[-1] + 1
    path = run.path / "trajectories.zarr"

    def read(name: str) -> np.ndarray:
        return np.asarray(_require_array(run.group, name)[first:last])

    with reporting_damage(path):
        names = ["p_m", "q", "nu", "pwm_us", "outcome"]
        moving = ["obstacle_p_m", "obstacle_q"] if "obstacle_p_m" in run.group else []
        moving += ["joint_position"] if "joint_position" in run.group else []
        stored = {name: read(name) for name in [*names, *moving]}
        if GRIP_WRENCH in run.group:
            stored[GRIP_WRENCH] = read(GRIP_WRENCH)
        ends = {}
        if "end" in run.group:
            end_names = ["step", "p_m", "q", "nu", "outcome", *moving]
            ends = {name: read(f"end/{name}") for name in end_names}
        environment = {name: read(f"environment/{name}") for name in ENVIRONMENT_ARRAYS}
        if run.task is not None:
            stored |= {name: read(f"task/{name}") for name in ("target", "carrying")}
            task_names = TASK_ARRAYS + (SURVEY_ARRAYS if run.task.kind == "survey" else ())
            environment |= {name: read(name) for name in task_names}
        if run.has_flown_plans:
            bends = ["plan_degree"] if "plan_degree" in run.group else []
            flown = ["plan_time_s", "plan_m", "target_m", *bends]
            environment |= {name: read(name) for name in flown}
    for index in chosen:
        with reporting_damage(path):
            yield _build_world(
                run,
                index,
                {name: array[index - first] for name, array in stored.items()},
                {name: array[index - first] for name, array in ends.items()},
                {name: array[index - first] for name, array in environment.items()},
            )


def _require_array(group: zarr.Group, name: str) -> AnyArray:
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise TypeError(f"{name} is no array")
    return array


def _build_world(
    run: RefereeRun,
    index: int,
    stored: Mapping[str, np.ndarray],
    end: Mapping[str, np.ndarray],
    environment: Mapping[str, np.ndarray],
) -> RefereeWorld:
    is_stored = np.isfinite(stored["p_m"]).all(axis=-1).any(axis=-1)
    count = int(np.flatnonzero(is_stored)[-1]) + 1 if is_stored.any() else 0
    if count == 0:
        raise ConfigError(f"world {index} has results, but no trajectories")
    step = np.arange(count, dtype=np.int64) * run.every
    bodies = {"obstacle_p_m": (0, 3), "obstacle_q": (0, 4)}
    empty = {name: np.zeros((len(stored["p_m"]), *tail)) for name, tail in bodies.items()}
    states = {name: values[:count] for name, values in {**empty, **stored}.items()}
    if end and int(end["step"]) > step[-1]:
        step = np.append(step, int(end["step"]))
        rest = {**{name: np.zeros(tail) for name, tail in bodies.items()}, **end}
        for name in states:
            if name in rest:
                states[name] = np.concatenate([states[name], rest[name][None]])
    robots = len(run.robots)
    if states["p_m"].shape[1] != robots:
        raise ConfigError(f"holds {states['p_m'].shape[1]} robots, config.json has {robots}")
    nothing = np.full((count, robots), -1)
    return RefereeWorld(
        index=index,
        step=step,
        p=states["p_m"].astype(float),
        q=states["q"].astype(float),
        nu=states["nu"].astype(float),
        outcome=states["outcome"].astype(np.int64),
        obstacle_p=states["obstacle_p_m"].astype(float),
        obstacle_q=states["obstacle_q"].astype(float),
        pwm_us=states["pwm_us"].astype(float),
        environment=environment,
        target=states.get("target", nothing).astype(np.int64),
        carrying=states.get("carrying", nothing).astype(np.int64),
        joints=states["joint_position"].astype(float) if "joint_position" in states else None,
        grip_wrench=states[GRIP_WRENCH].astype(float) if GRIP_WRENCH in states else None,
    )
