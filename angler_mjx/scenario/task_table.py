"""The table of a scenario file on the task of the robots of a world."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, JsonTable, dump_for_digest
from angler_mjx.quantities import MAX_COORDINATE_M
from angler_mjx.scenario.load_table import LoadConfig
from angler_mjx.scenario.policy_tables import PolicyConfig
from angler_mjx.scenario.tables import TimeConfig, check_whole_ratio
from angler_mjx.sim.cargo import CargoSpec, GripNoise
from angler_mjx.sim.physics.contact.grips import GripSpec, friction_limits
from angler_mjx.world.config import Vector, WorldConfig, WorldRecipe, resolve_world
from angler_mjx.world.obstacles.config import ExplicitConfig
from angler_mjx.world.obstacles.explicit import find_gaps_m, longest_axis
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
MAX_CARRIERS = 16
"""Max number of robots that carry one body."""
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


class GripSensorConfig(FileModel):
    """Errors of the force-torque sensors of grips: standard deviations along each axis."""

    force_std_n: float = Field(default=0.0, ge=0.0, le=1e5)
    """Of each reading, once a control period."""
    torque_std_nm: float = Field(default=0.0, ge=0.0, le=1e5)
    """Of each reading of a moment."""
    force_bias_n: float = Field(default=0.0, ge=0.0, le=1e5)
    """Of what a sensor is off by in a whole flight, sampled for each robot of each world."""
    torque_bias_nm: float = Field(default=0.0, ge=0.0, le=1e5)
    """The same of moments."""


class CarryTask(FileModel):
    """One body, which the whole fleet carries to a pose; with ``contacts = true``.

    Each robot holds the body from the start, at the pose that it starts at.
    """

    type: Literal["carry"]
    body: int = Field(default=0, ge=0, le=4095)
    """Index in world.obstacles.explicit of the body, which drifts."""
    grips_m: tuple[Vector, ...] = Field(default=(), max_length=MAX_CARRIERS)
    """Start of each robot's centre of mass from the centre of the body; east, north, up. If left
    out, robots stand side by side along the longest axis of the body, as far apart as it lets
    them, at offset_m from it."""
    offset_m: Vector = (0.0, 0.0, 0.6)
    """Start of the robots' centres of mass from that axis; not with grips_m. Where end effectors
    hold the body it is that of theirs, and 0 if left out."""
    hold: Literal["hull", "end_effector"] = "hull"
    """Part of the robots that holds the body: the hull, or the end effector of the arm."""
    to_m: Vector
    """Centre of the body at the goal, in W."""
    turn_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """Turn of the body about z up, from the start to the goal."""
    tolerance_m: float = Field(default=0.1, gt=0.0, le=MAX_COORDINATE_M)
    """Distance of the body from its goal below which it has arrived."""
    tolerance_deg: float = Field(default=5.0, gt=0.0, le=180.0)
    """Angle from its attitude at the goal below which it has arrived."""
    break_force_n: float | None = Field(default=None, gt=0.0, le=1e6)
    """Force of a grip above which it breaks, and the robot's episode ends as `dropped`; it holds
    any force if left out."""
    closing_force_n: float | None = Field(default=None, gt=0.0, le=1e5)
    """Force with which the jaws of end effectors close, along y of the end effector: the body slips
    in them where it pulls harder than friction (of the materials of robot and obstacle) holds. The
    grip is a weld if left out."""
    jaw_m: float = Field(default=0.015, gt=0.0, le=1.0)
    """Radius of the patch of a jaw on the body; with closing_force_n. The default is our choice."""
    max_slip_m: float = Field(default=0.05, gt=0.0, le=MAX_COORDINATE_M)
    """Slip beyond which jaws have lost the body, and the robot's episode ends as `dropped`."""
    hold_s: float = Field(default=0.0, ge=0.0, le=3600.0)
    """Time without a break for which the body has to be at its goal to have arrived."""
    release: bool = False
    """Whether grips open when the body has arrived; it then sinks, rises or rests."""
    sensor: GripSensorConfig | None = None
    """Errors of what grips measure; none if left out."""

    by_end_effector: ClassVar[bool] = False
    """As of `GoalTask`."""

    @model_validator(mode="before")
    @classmethod
    def _set_offset(cls, table: object) -> object:
        """Set the offset of end effectors from the axis to 0, where the file gives none."""
        if not isinstance(table, dict) or table.get("hold") != "end_effector":
            return table
        if table.get("grips_m") or "offset_m" in table:
            return table
        return {**table, "offset_m": (0.0, 0.0, 0.0)}

    @property
    def cargo(self) -> CargoSpec:
        """Return the settings of the simulator."""
        return CargoSpec(
            body=self.body,
            goal_m=self.to_m,
            turn_rad=math.radians(self.turn_deg),
            tolerance_m=self.tolerance_m,
            tolerance_rad=math.radians(self.tolerance_deg),
            hold_s=self.hold_s,
            release=self.release,
        )

    def problem_table(self) -> JsonTable:
        """Return the table for digests, which stay those from before release existed."""
        table = dump_for_digest(self)
        jaws = self.closing_force_n is not None
        added = {"hold_s": self.hold_s, "release": self.release, "hold": self.hold != "hull"}
        added |= dict.fromkeys(("closing_force_n", "jaw_m", "max_slip_m"), jaws)
        added["sensor"] = False  # of the flight, not of the problem, as all instruments
        return {key: value for key, value in table.items() if added.get(key, True)}

    @property
    def grip_noise(self) -> GripNoise | None:
        """Return the errors of the force-torque sensors of grips; None where there are none."""
        return None if self.sensor is None else GripNoise(**self.sensor.model_dump())

    @model_validator(mode="after")
    def _check_jaws(self) -> Self:
        if self.closing_force_n is None:
            fields = type(self).model_fields
            for key in ("jaw_m", "max_slip_m"):
                if getattr(self, key) != fields[key].default:
                    raise ValueError(f"task.{key}: of jaws; give task.closing_force_n too")
        elif self.hold != "end_effector":
            raise ValueError(
                "task.closing_force_n: jaws are those of end effectors; give task.hold = "
                '"end_effector"'
            )
        elif self.break_force_n is not None:
            raise ValueError(
                "task.break_force_n, task.closing_force_n: a weld breaks and jaws slip; give one"
            )
        return self

    def grip(self, friction: float) -> GripSpec:
        """Return the grips of the simulator.

        Args:
            friction: Coulomb's coefficient of robots on obstacles.
        """
        limits = None
        if self.closing_force_n is not None:
            limits = friction_limits(self.closing_force_n, friction, self.jaw_m)
        return GripSpec(
            body=self.body,
            break_force_n=self.break_force_n,
            by_end_effector=self.hold == "end_effector",
            friction_limits=limits,
            max_slip_m=self.max_slip_m,
        )

    def _grip_offsets(self, body: ExplicitConfig, robots: int) -> np.ndarray:
        """Return the starts [R, 3] of robots from the centre of the body, m, in W."""
        if not self.grips_m:
            if robots > MAX_CARRIERS:
                raise ValueError(
                    f'task.type = "carry": the fleet has {robots} robots; {MAX_CARRIERS} are the '
                    "most that hold one body"
                )
            half_axis_m = longest_axis(body)
            along = np.linspace(-1.0, 1.0, robots) if robots > 1 else np.zeros(1)
            return along[:, None] * half_axis_m + self.offset_m
        if "offset_m" in self.model_fields_set:
            raise ValueError("task.offset_m and task.grips_m: give one of them, not both")
        if len(self.grips_m) != robots:
            raise ValueError(
                f"task.grips_m has {len(self.grips_m)} positions and the fleet {robots} robots: "
                "give one for each"
            )
        return np.array(self.grips_m)

    def position_robots(self, world: WorldConfig, tips_m: np.ndarray) -> WorldConfig:
        """Return the world with the starts and goals of the robots that hold the body.

        Args:
            world: of the scenario.
            tips_m: [R, 3] point of each robot that holds the body, from its centre of mass, m, in
                F, at the start; 0 where hulls hold it.

        Raises:
            ValueError: there is no such body, or the world or the fleet does not fit it.
        """
        explicit = resolve_world(world).obstacles.explicit
        if self.body >= len(explicit):
            raise ValueError(
                f"task.body = {self.body}: world.obstacles.explicit has {len(explicit)} bodies"
            )
        body = explicit[self.body]
        if body.motion.type != "drift":
            raise ValueError(
                f"task.body = {self.body}: its motion is {body.motion.type!r}, so nobody can carry "
                'it; give motion.type = "drift"'
            )
        grips = self._grip_offsets(body, len(tips_m))
        if self.hold == "end_effector":
            _check_reach(body, grips)
        turn = _turn_about_z(math.radians(self.turn_deg))
        travel_m = np.subtract(self.to_m, body.position_m)
        offsets = grips - _aim_tips(grips, tips_m, turn, travel_m)
        starts = (np.array(body.position_m) + offsets).round(9)
        goals = (np.array(self.to_m) + offsets @ turn.T).round(9)
        made = {
            "placement": "given",
            "start_m": tuple(tuple(row) for row in starts.tolist()),
            "goal_m": tuple(tuple(row) for row in goals.tolist()),
        }
        for key, value in made.items():
            if getattr(world, key) not in (None, (), value):
                raise ValueError(
                    f'world.{key}: task.type = "carry" says where robots start and go; leave it out'
                )
        positioned = world.model_copy(update=made)
        # They count as left out: a file edited for another team computes them again.
        positioned.model_fields_set.difference_update(made.keys() - world.model_fields_set)
        return positioned


MAX_GRIP_GAP_M = 0.02
"""Greatest distance of an end effector from the surface of the body that it holds, m: our choice,
somewhat more than the opening of the shipped gripper, 15 mm."""


def _turn_about_z(angle_rad: float) -> np.ndarray:
    """Return the matrix [3, 3] of a turn about z up."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _aim_tips(
    grips: np.ndarray, tips_m: np.ndarray, turn: np.ndarray, travel_m: np.ndarray
) -> np.ndarray:
    """Return the tips [R, 3] in W at the start, where each robot heads for its goal.

    The heading depends on start and goal, and these on the heading: it is found by iteration.

    Args:
        grips: [R, 3] points of the grips from the centre of the body, m, in W.
        tips_m: [R, 3] the same from the centres of mass of the robots, in F.
        turn: [3, 3] turn of the body from start to goal.
        travel_m: [3] from the centre of the body at the start to that at the goal.

    Raises:
        ValueError: a robot has no heading that keeps to that.
    """
    tips = tips_m.copy()
    if not tips_m.any():
        return tips
    for _ in range(100):
        to_goal = travel_m + (grips - tips) @ (turn - np.eye(3)).T
        headings = np.arctan2(to_goal[:, 1], to_goal[:, 0])
        before, tips = (
            tips,
            np.stack([_turn_about_z(yaw) @ tip for yaw, tip in zip(headings, tips_m, strict=True)]),
        )
        if np.abs(tips - before).max() < 1e-12:
            return tips
    raise ValueError(
        "task.to_m, task.turn_deg: no heading of the robots at the start leads them to their goals "
        "with their end effectors at the body; take a longer way or a smaller turn"
    )


def _check_reach(body: ExplicitConfig, grips: np.ndarray) -> None:
    """Refuse grips [R, 3], m from the centre of a body, that are not at its surface or in it.

    Raises:
        ValueError: naming them, with their distances.
    """
    faults = [
        f"grip {i} is {gap:.3g} m from the surface of the body"
        for i, gap in enumerate(find_gaps_m(body, grips))
        if gap > MAX_GRIP_GAP_M
    ]
    if faults:
        raise ValueError(
            f"task.grips_m or task.offset_m: {'; '.join(faults)}, and end effectors hold at most "
            f"{MAX_GRIP_GAP_M:g} m from it; give points of the body"
        )


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
