"""The table of a scenario file on the task of the robots of a world."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel
from angler_mjx.quantities import MAX_COORDINATE_M
from angler_mjx.scenario.carry_table import CarryTask
from angler_mjx.scenario.load_table import LoadConfig
from angler_mjx.scenario.policy_tables import PolicyConfig
from angler_mjx.scenario.tables import TimeConfig, check_whole_ratio
from angler_mjx.world.config import Vector, WorldRecipe
from angler_mjx.world.rock.rules import OpenRule
from angler_mjx.world.tasks import allocation, visibility
from angler_mjx.world.tasks.sampling import WHOLE, GoalSampling
from angler_mjx.world.tasks.spec import (
    MAX_JOBS,
    Surface,
    SurveySpec,
    TaskSpec,
    WhenDropped,
    WhenFinished,
)

MAX_ROBOTS = 64
"""Max number of robots of a fleet with a task."""
DEFAULT_POSITIONS, DEFAULT_GOODS = 8, 4
"""Number of places and of goods of a task whose file gives none."""
MAX_CELLS = 8192
"""Max number of cells that a robot sees at a time."""

type Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
type Corner = tuple[Fraction, Fraction, Fraction]


class GoalTask(FileModel):
    """One goal for each robot, given by the world."""

    type: Literal["goal"] = "goal"
    reached_by: Literal["center", "end_effector"] = "center"
    """What has to come to the goal: the robot's centre of mass, or its end effector."""

    @property
    def by_end_effector(self) -> bool:
        """Whether end effectors have to come to the goals."""
        return self.reached_by == "end_effector"


class _Task(FileModel):
    """Common settings of all tasks with several jobs."""

    tolerance_m: float = Field(default=0.5, gt=0.0, le=MAX_COORDINATE_M)
    """Distance from a place within which the centre of a robot has reached it."""
    look_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Period of the checks of finished jobs; a whole number of control periods."""
    allocation: str = "nearest"
    """Allocation: nearest, auction, sweep or MODULE:FUNCTION; see `docs/reference/tasks.md`."""
    after: WhenFinished = "hold"
    """Behaviour of a robot without remaining jobs: hold its position, or return to its start. It
    ends its episode then, and not before all jobs that it knows of are done."""

    @field_validator("allocation")
    @classmethod
    def _check_allocation(cls, name: str) -> str:
        allocation.find_allocator(name)
        return name


class TourTask(_Task):
    """Positions to visit."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "places": "positions",
        "places_m": "positions_m",
    }

    type: Literal["tour"]
    positions: int | None = Field(default=None, ge=1, le=MAX_JOBS)
    """Number of positions, sampled for each world among the cells that all robots can reach; 8 if
    left out."""
    within: tuple[Corner, Corner] = WHOLE
    """Part of the cube in which positions are sampled: lower and upper corner, as fractions of its
    edges."""
    positions_m: tuple[Vector, ...] = Field(default=(), max_length=MAX_JOBS)
    """Positions in W, instead of sampling; a position that cannot be reached in a world is moved to
    the nearest reachable cell."""
    shared: bool = True
    """Whether each position is visited by one robot; if not, every robot visits all of them."""
    ordered: bool = False
    """Whether each robot visits the positions in their order; only with shared = false."""

    @model_validator(mode="after")
    def _check_tour(self) -> Self:
        if self.ordered and self.shared:
            raise ValueError(
                "ordered = true: one robot after the other would have to wait; give shared = false"
            )
        if self.positions_m and self.positions is not None:
            raise ValueError("positions and positions_m: give one of them, not both")
        return self

    @property
    def count(self) -> int:
        """Return the number of positions."""
        return len(self.positions_m) or self.positions or DEFAULT_POSITIONS


class SurveyTask(_Task):
    """Surfaces to see."""

    type: Literal["survey"]
    of: Surface = "floor"
    """Surfaces to see: the sea floor and the rock that stands on it, faces of rock, or both."""
    half_angle_deg: float = Field(default=45.0, gt=0.0, le=180.0)
    """Half angle of a robot's cone of view about its downward axis; 180 sees in all directions."""
    range_m: float = Field(default=5.0, gt=0.0, le=MAX_COORDINATE_M)
    """Range of view."""
    altitude_m: float = Field(default=3.0, gt=0.0, le=MAX_COORDINATE_M)
    """Height of viewpoints above the surface; rounded to whole cells."""
    coverage: float = Field(default=0.95, gt=0.0, le=1.0)
    """Fraction of the visible surfaces that must be seen."""
    viewpoints: int = Field(default=64, ge=1, le=MAX_JOBS)
    """Max number of viewpoints of a world; a run ends with an error where they do not see
    enough."""


class DeliverTask(_Task):
    """Goods to deliver; a robot carries one item at a time."""

    type: Literal["deliver"]
    goods: int | None = Field(default=None, ge=1, le=MAX_JOBS)
    """Number of goods; if left out, the number of places of from_m or to_m, or 4."""
    from_within: tuple[Corner, Corner] = WHOLE
    """Part of the cube in which goods lie: lower and upper corner, as fractions of its edges."""
    to_within: tuple[Corner, Corner] = WHOLE
    """Part of the cube in which their destinations lie."""
    from_m: tuple[Vector, ...] = Field(default=(), max_length=MAX_JOBS)
    """Places where the goods lie, instead of sampling; moved as positions_m of a tour are."""
    to_m: tuple[Vector, ...] = Field(default=(), max_length=MAX_JOBS)
    """Destination of each item, instead of sampling."""
    load: LoadConfig | None = None
    """Mass and hydrodynamics of each item; no effect on the robot if left out."""
    dropped: WhenDropped = "lost"
    """State of goods whose robot collides or breaks down: lost, or back at their first place."""

    @model_validator(mode="after")
    def _check_position_counts(self) -> Self:
        for name in ("from_m", "to_m"):
            positions_m = getattr(self, name)
            if positions_m and len(positions_m) != self.count:
                raise ValueError(
                    f"{name} has {len(positions_m)} positions for {self.count} goods: give one for "
                    "each"
                )
        return self

    @property
    def count(self) -> int:
        """Return the number of goods."""
        return self.goods or len(self.from_m) or len(self.to_m) or DEFAULT_GOODS


type TaskConfig = Annotated[
    GoalTask | CarryTask | TourTask | SurveyTask | DeliverTask, Field(discriminator="type")
]


def build_task_spec(
    task: TaskConfig, world: WorldRecipe, robots: int, time: TimeConfig
) -> TaskSpec | None:
    """Compile a task of several jobs; return None of another.

    Raises:
        ValueError: it cannot be done in such worlds, or by that number of robots; names the key.
    """
    if isinstance(task, GoalTask | CarryTask):
        return None
    if robots > MAX_ROBOTS:
        raise ValueError(
            f"task.type = {task.type!r}: the fleet has {robots} robots; {MAX_ROBOTS} are the most"
        )
    dt_s = time.control_dt_s
    check_whole_ratio(f"task.look_s = {task.look_s:g}: look_s / control_dt_s", task.look_s, dt_s)
    for name, sampling, count in task_positions(task):
        _check_positions(f"task.{name}", sampling, count, world)
    spec = TaskSpec(
        kind=task.type,
        jobs=1,
        robots=robots,
        tolerance_m=task.tolerance_m,
        period=round(task.look_s / dt_s),
        allocation=task.allocation,
        after=task.after,
    )
    if isinstance(task, TourTask):
        return replace(spec, jobs=task.count, shared=task.shared, ordered=task.ordered)
    if isinstance(task, DeliverTask):
        return replace(spec, jobs=task.count, dropped=task.dropped)
    is_timed = time.record_hz > 0.0
    return replace(spec, jobs=task.viewpoints, survey=_survey_spec(task, world), timed=is_timed)


def task_positions(task: TaskConfig) -> tuple[tuple[str, GoalSampling, int], ...]:
    """Return the places of a task by the keys that give them, pickup places first."""
    if isinstance(task, TourTask):
        sampling = GoalSampling(within=task.within, fixed_m=task.positions_m)
        return (("positions_m" if task.positions_m else "within", sampling, task.count),)
    if isinstance(task, DeliverTask):
        pickup = GoalSampling(within=task.from_within, fixed_m=task.from_m)
        delivery = GoalSampling(within=task.to_within, fixed_m=task.to_m)
        return (
            ("from_m" if task.from_m else "from_within", pickup, task.count),
            ("to_m" if task.to_m else "to_within", delivery, task.count),
        )
    return ()


def _check_positions(key: str, sampling: GoalSampling, count: int, world: WorldRecipe) -> None:
    low = np.array(world.origin_m)
    high = low + world.size_m
    low[2] = max(low[2], world.floor_z_m)
    for i, position_m in enumerate(sampling.fixed_m):
        if np.any(position_m < low) or np.any(position_m > high):
            raise ValueError(
                f"{key}[{i}] = {position_m}: outside the world, {low.tolist()} to {high.tolist()}"
            )
    if sampling.fixed_m:
        return
    first, last = sampling.within
    if not all(a < b for a, b in zip(first, last, strict=True)):
        raise ValueError(f"{key} = {sampling.within}: the second corner must lie above the first")
    cells = 1
    for n, a, b in zip(world.shape, first, last, strict=True):
        fractions = (np.arange(n) + 0.5) / n
        cells *= int(np.sum((fractions >= a) & (fractions <= b)))
    if count > cells:
        raise ValueError(
            f"{key} = {sampling.within}: {count} positions do not fit {cells} cells; take fewer, "
            "or a larger part of the world"
        )


def _survey_spec(task: SurveyTask, world: WorldRecipe) -> SurveySpec:
    cell_m = world.cell_m
    footprint = visibility.build_footprint(math.radians(task.half_angle_deg), task.range_m, cell_m)
    spec = SurveySpec(
        of=task.of,
        footprint=footprint,
        altitude_cells=max(1, round(task.altitude_m / cell_m)),
        coverage=task.coverage,
    )
    if isinstance(world.rule, OpenRule) and task.of == "rock":
        raise ValueError('task.of = "rock": such worlds have no rock; take "floor"')
    if task.of != "rock" and world.floor_z_m < world.origin_m[2] - cell_m:
        raise ValueError(
            f"task.of = {task.of!r}: the sea floor lies {world.origin_m[2] - world.floor_z_m:g} m "
            "below the world's cells; give world.floor_depth_m of their lower face"
        )
    if spec.altitude_cells >= world.shape[2]:
        raise ValueError(f"task.altitude_m = {task.altitude_m:g}: higher than the world's cells")
    _check_footprint(task, spec, cell_m)
    n_cells = visibility.window_size(spec)
    if n_cells > MAX_CELLS:
        raise ValueError(
            f"task.range_m = {task.range_m:g}: a robot would see {n_cells} cells at a time; "
            f"the maximum is {MAX_CELLS}: take a shorter range, or a larger world.cell_m"
        )
    return spec


def _check_footprint(task: SurveyTask, spec: SurveySpec, cell_m: float) -> None:
    """Refuse a footprint that sees nothing, even from a steadily held viewpoint."""
    half_angle_rad, height_m = math.radians(task.half_angle_deg), spec.altitude_cells * cell_m
    offset_m = (
        task.tolerance_m / math.sin(half_angle_rad) if half_angle_rad < math.pi - 1e-3 else 0.0
    )
    max_height_m = task.range_m - task.tolerance_m
    if height_m > max_height_m or (half_angle_rad < math.pi / 2 and offset_m >= height_m):
        raise ValueError(
            f"task.range_m = {task.range_m:g}, half_angle_deg = {task.half_angle_deg:g}: the "
            f"footprint of a robot {height_m:g} m (altitude_m in whole cells) above a surface and "
            f"up to tolerance_m = {task.tolerance_m:g} beside its viewpoint holds nothing; take a "
            "longer range, a wider cone, a smaller tolerance or another altitude"
        )


def check_task_policy(task: TaskConfig, policy: PolicyConfig, *, online: bool) -> None:
    """Refuse policies and online execution that support a single goal only.

    Raises:
        ValueError: naming the keys.
    """
    if isinstance(task, GoalTask):
        return
    if isinstance(task, CarryTask):
        if policy.name != "none" or online:
            raise ValueError(
                'task.type = "carry": robots that hold a body fly plans made before the flight; '
                "leave out policy.name, planner.replan_hz and execution.order"
            )
        return
    if policy.name == "mppi":
        raise ValueError(
            f"task.type = {task.type!r}: its robots visit several positions, and "
            'policy.name = "mppi" makes its map for one goal; leave it out, or take "routes"'
        )
    if online:
        raise ValueError(
            f"task.type = {task.type!r}: its robots visit several positions, and "
            "planner.replan_hz and execution.order look after plans to one goal; leave them out"
        )


def require_goal_task(
    task: TaskConfig, reason: str, also: tuple[type[CarryTask], ...] = ()
) -> None:
    """Refuse a task where each robot must have a goal of its own.

    Args:
        task: of a scenario.
        reason: text of the message: the limit, and an alternative.
        also: other tasks that are accepted.

    Raises:
        ConfigError: it is another task.
    """
    if not isinstance(task, (GoalTask, *also)):
        raise ConfigError(f"task.type = {task.type!r}: {reason}")
