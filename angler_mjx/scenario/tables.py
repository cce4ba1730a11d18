"""Tables of a scenario file: water, time steps, controller, planner, breakdowns."""

import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self, get_type_hints

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel, base_folder
from angler_mjx.planning import register
from angler_mjx.planning.planner import MAX_POINTS
from angler_mjx.planning.planner_choice import AUTO, AUTO_PLANNERS, CARRY, choose_planner
from angler_mjx.planning.register import PlannerReference, PlannerSpec
from angler_mjx.quantities import Length
from angler_mjx.robot.control import stack, stages
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.sim.information import Information, InformationLevel
from angler_mjx.user_classes import is_class_of_file, make_name_absolute


class WaterConfig(FileModel):
    """Properties of the water."""

    density_kgpm3: float = Field(default=1000.0, ge=900.0, le=1100.0)
    """Density; that of fresh water by default, in which the published parameter sets were
    measured."""


class TimeConfig(FileModel):
    """Horizon and time steps."""

    horizon_s: float = Field(default=120.0, gt=0.0, le=86400.0)
    """Simulated time of an episode; a whole number of control periods; the horizon of the world's
    preset if left out."""
    physics_dt_s: float = Field(default=0.01, ge=1e-4, le=0.05)
    """Step of the physics."""
    control_dt_s: float = Field(default=0.05, ge=1e-4, le=1.0)
    """Period of the controllers; a whole number of physics steps."""
    record_hz: float = Field(default=5.0, ge=0.0, le=1e4)
    """Rate of the stored trajectories; 0 stores none."""

    @model_validator(mode="after")
    def _check_commensurate(self) -> Self:
        check_whole_ratio("control_dt_s / physics_dt_s", self.control_dt_s, self.physics_dt_s)
        check_whole_ratio("horizon_s / control_dt_s", self.horizon_s, self.control_dt_s)
        if self.record_hz > 0:
            check_whole_ratio(
                "1 / (record_hz control_dt_s)", 1.0, self.record_hz * self.control_dt_s
            )
            check_whole_ratio("horizon_s record_hz", self.horizon_s * self.record_hz, 1.0)
        return self

    def with_default_horizon(self, horizon_s: float) -> Self:
        """Return the table with another horizon, unless the file gives one.

        Raises:
            ValueError: the horizon does not fit the other times.
        """
        if "horizon_s" in self.model_fields_set or horizon_s == self.horizon_s:
            return self
        check_whole_ratio("horizon_s / control_dt_s", horizon_s, self.control_dt_s)
        if self.record_hz > 0:
            check_whole_ratio("horizon_s record_hz", horizon_s * self.record_hz, 1.0)
        changed = self.model_copy(update={"horizon_s": horizon_s})
        changed.model_fields_set.discard("horizon_s")
        return changed

    @property
    def physics_steps(self) -> int:
        """Physics steps in one control step."""
        return round(self.control_dt_s / self.physics_dt_s)

    @property
    def control_steps(self) -> int:
        """Control steps in the horizon."""
        return round(self.horizon_s / self.control_dt_s)

    @property
    def steps_per_sample(self) -> int:
        """Control steps between two stored samples; 0 if none is stored."""
        return round(1.0 / (self.record_hz * self.control_dt_s)) if self.record_hz > 0 else 0


def check_whole_ratio(description: str, dividend: float, divisor: float) -> None:
    """Refuse a ratio that is not a whole number of at least 1.

    Raises:
        ValueError: naming ``description``.
    """
    ratio = dividend / divisor if divisor > 0 else math.inf
    if not math.isfinite(ratio):
        raise ValueError(f"{description} is too large; take numbers nearer to one another")
    if ratio < 0.999999 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise ValueError(f"{description} = {ratio:g} must be a whole number of at least 1")


def resolve_class(name: str, info: ValidationInfo) -> str:
    """Return FILE.py:CLASS with an absolute path, from the folder of the naming file."""
    return make_name_absolute(name, base_folder(info))


type StageName = Annotated[str, Field(max_length=4096), AfterValidator(resolve_class)]
"""Name of a stage; the path of FILE.py:CLASS is relative to the folder of the naming file."""


class ControllerConfig(FileModel):
    """A controller stack by name or by stages, with gains that differ from the defaults."""

    name: str | None = None
    """Name of a stack, one of `angler_mjx.robot.control.stages.named_stacks`; cascade if neither
    name nor stages is given."""
    stages: tuple[StageName, ...] | None = Field(default=None, min_length=1)
    """Stages from the highest to the lowest, instead of a name; FILE.py:CLASS for a control law of
    your own."""
    gains: dict[str, dict[str, float]] = Field(default_factory=dict)
    """Gains of each stage, by stage and gain; a law of FILE.py:CLASS has the name CLASS."""
    leader: int | None = Field(default=None, ge=0, le=4095)
    """Number of the robot that flies the plan while the others follow, with the stage
    leader_follower; 0 if left out."""

    @property
    def title(self) -> str:
        """Return the name, or the stages joined by "+"."""
        if not self.stages:
            return self.name or "cascade"
        return "+".join(name.rpartition(":")[2] for name in self.stages)

    @property
    def files(self) -> tuple[Path, ...]:
        """Return the files of control laws of users."""
        names = [name for name in self.stages or () if is_class_of_file(name)]
        return tuple(dict.fromkeys(Path(name.rpartition(":")[0]) for name in names))

    @model_validator(mode="before")
    @classmethod
    def _check_gains_by_stage(cls, data: object) -> object:
        gains = data.get("gains") if isinstance(data, dict) else None
        for name, value in (gains if isinstance(gains, dict) else {}).items():
            if not isinstance(value, dict):
                raise ValueError(
                    f"gains.{name} = {value!r}: gains stand by stage, as in "
                    "[controller.gains.velocity] with velocity_per_s = 2.5"
                )
        return data

    @model_validator(mode="after")
    def _check_stack(self) -> Self:
        if self.stages is not None and self.name is not None:
            raise ValueError("give name or stages, not both")
        if self.name is not None and self.name not in stages.named_stacks():
            raise ValueError(
                f"name = {format_value(self.name)}: there is {', '.join(stages.named_stacks())}; "
                "or give stages"
            )
        first = self.stack()[0][0]
        if Trajectory not in first.takes:
            names = [stage.name for stage in stages.STAGES.values() if Trajectory in stage.takes]
            raise ValueError(
                f"stages: the first one, {first.name!r}, takes {stack.describe_inputs(first)}; the "
                f"planner gives a Trajectory: begin with {' or '.join(names)}"
            )
        if self.leader is not None and self.find_leader() is None:
            raise ValueError(
                f"leader = {self.leader}: no stage is 'leader_follower'; add it below pose, or "
                "leave leader out"
            )
        return self

    def find_leader(self) -> int | None:
        """Return the number of the robot that others follow; None where nobody follows."""
        follows = any(stage.name == "leader_follower" for stage in self.stack()[0])
        return (self.leader or 0) if follows else None

    def stack(self) -> tuple[stack.Stages, stack.StackGains]:
        """Return the stages and the gains of each.

        Raises:
            ConfigError: the stages form no stack, or gains are not valid.
        """
        names = self.stages or stages.named_stacks()[self.name or "cascade"]
        return stages.build_stack(names, self.gains)


class InformationConfig(FileModel):
    """Information that planners receive; see `docs/reference/planners.md`."""

    obstacles: InformationLevel = "nothing"
    """Level on moving obstacles. nothing: none. observed: positions and velocities at t = 0.
    predicted: the motion that follows from them in the current at the current's level. truth: the
    true motion."""
    current: InformationLevel = "nothing"
    """Level on the current. nothing: none. observed: its mean at the robots' starts at t = 0.
    predicted: the whole field at t = 0, held constant. truth: the whole field at all times."""

    def to_information(self) -> Information:
        """Return the levels in the form that planners take."""
        return Information(obstacles=self.obstacles, current=self.current)


type PlannerName = Annotated[str, Field(max_length=4096), AfterValidator(resolve_class)]
"""Name of a planner; the path of FILE.py:CLASS is relative to the folder of the naming file."""


class PlannerConfig(FileModel):
    """The planner of the robots' paths; its own settings stand in [planner.NAME]."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"knows": "information"}

    name: PlannerName = AUTO
    """A planner of `angler plan --list`, or FILE.py:CLASS of a file of yours. auto: grid or
    priority, by the number of robots; see `docs/reference/planners.md`."""
    requested: Literal["auto"] | None = None
    """Written into run folders beside the name of the planner that auto resolved to; not set by
    hand."""
    margin_m: Length = 0.1
    """Clearance around each robot beside its own radius."""
    points: int = Field(default=32, ge=2, le=MAX_POINTS)
    """Max number of waypoints of a path; a longer path of a planner counts as none. Paths of a
    file of plans (`--plans`) may have up to 1,024, independent of this key. Part of the result's
    bytes."""
    deadline_s: float = Field(default=5.0, gt=0.0, le=86400.0)
    """Wall-clock limit for each world; a planner that exceeds it by a tenth is stopped."""
    information: InformationConfig = InformationConfig()
    replan_hz: float = Field(default=0.0, ge=0.0, le=1e4)
    """Rate of replanning in flight; 0: none. The period is a whole number of control steps; see
    `docs/how_to/online.md`."""
    delay_s: float = Field(default=0.0, ge=0.0, le=86400.0)
    """Delay from the state that a new plan starts from until it is flown: a whole number of control
    steps, at most one replanning period."""
    settings: dict[str, dict[str, object]] = Field(default_factory=dict)
    """The tables [planner.NAME] of planners, by name; that of the chosen planner is checked."""

    @model_validator(mode="before")
    @classmethod
    def _collect_settings(cls, data: object) -> object:
        """Collect the planners' tables from the keys that are no fields of this model."""
        if not isinstance(data, Mapping):
            return data
        field_keys = cls.model_fields.keys() | cls.renamed_keys.keys()
        table_keys = {key: value for key, value in data.items() if key in field_keys}
        tables = {
            key: table
            for key, table in data.items()
            if key not in table_keys and isinstance(table, Mapping)
        }
        unknfield_keys = {
            key: value for key, value in data.items() if key not in table_keys and key not in tables
        }
        if tables:
            settings = table_keys.get("settings", {})
            table_keys["settings"] = {
                **(settings if isinstance(settings, Mapping) else {}),
                **tables,
            }
        return {**table_keys, **unknfield_keys}

    @property
    def by_auto(self) -> bool:
        """Return whether auto chose the planner; False if code replaced the name later."""
        return self.requested is not None and self.name in (*AUTO_PLANNERS, CARRY)

    def resolve_auto(self, robots: int, *, carries: bool = False) -> Self:
        """Return the table with the planner of a team of ``robots`` in place of auto.

        Robots that carry a body together have a planner of their body.

        A table with another name is returned unchanged. The name counts as left out: a table
        rebuilt from the keys of the file, such as for another team, is resolved again.
        """
        if self.name != AUTO:
            return self
        resolved = self.model_copy(
            update={"name": choose_planner(robots, carries=carries), "requested": AUTO}
        )
        resolved.model_fields_set.difference_update(("name", "requested"))
        return resolved

    def title(self, robots: int) -> str:
        """Return the planner's name, with the reason where auto chose it."""
        team = f"{robots} robot{'s' if robots > 1 else ''}"
        return f"{self.name} (auto: {team})" if self.by_auto else self.name

    @property
    def table(self) -> str:
        """Return the name of the chosen planner's own table: for a class in a file, the class."""
        return self.name.rpartition(":")[2]

    @property
    def plans_arms(self) -> bool:
        """Return whether the planner's own table asks for plans of the joints of arms."""
        return self.settings.get(self.table, {}).get("arm") is True

    def planner_spec(self) -> PlannerSpec:
        """Return the planner with its settings.

        Raises:
            ConfigError: there is no such planner, or it has no such settings.
            UnsupportedError: its libraries are not installed.
        """
        reference = register.find(self.name)
        usable = (*AUTO_PLANNERS, CARRY) if self.by_auto else (self.table,)
        unused = sorted(set(self.settings) - set(usable))
        if unused:
            raise ConfigError(
                f"[planner.{unused[0]}]: the planner is {self.name}; its settings stand in "
                f"[planner.{self.table}]"
            )
        for name in usable:
            named = reference if name == self.table else register.find(name)
            _check_settings_table(named, self.settings.get(name, {}), name)
        return PlannerSpec(reference=reference, settings=self.settings.get(self.table, {}))


class ExecutionConfig(FileModel):
    """Joint execution of the plans of a world; see `docs/how_to/online.md`."""

    order: Literal["auto", "free", "kept"] = "auto"
    """free: each robot flies by itself, without regard to delays of others. kept: the robot that
    passes a position first by the plans passes first, and the others wait for it. auto: kept for
    the teams that planner.name = "auto" plans by priority where water or obstacles move, else free;
    see `docs/how_to/online.md`."""
    requested: Literal["auto"] | None = None
    """Written into run folders beside the order that auto resolved to; not set by hand."""

    @property
    def by_auto(self) -> bool:
        """Return whether auto chose the order."""
        return self.requested is not None

    def resolve_auto(self, *, kept: bool) -> Self:
        """Return the table with free or kept in place of auto; another table unchanged.

        The order counts as left out, as in `PlannerConfig.resolve_auto`.
        """
        if self.order != AUTO:
            return self
        order = "kept" if kept else "free"
        resolved = self.model_copy(update={"order": order, "requested": AUTO})
        resolved.model_fields_set.difference_update(("order", "requested"))
        return resolved


def check_replanning(planner: PlannerConfig, time: TimeConfig) -> None:
    """Refuse replanning that does not fit the control period.

    Raises:
        ValueError: naming the key and its value.
    """
    if planner.replan_hz == 0.0:
        if planner.delay_s > 0.0:
            raise ValueError(
                f"planner.delay_s = {planner.delay_s:g}: there is no replanning; "
                "give planner.replan_hz"
            )
        return
    hz, delay = planner.replan_hz, planner.delay_s
    try:
        check_whole_ratio(
            f"planner.replan_hz = {hz:g}: 1 / (replan_hz control_dt_s)", 1.0, hz * time.control_dt_s
        )
    except ValueError as error:
        max_hz = 1.0 / time.control_dt_s
        raise ValueError(
            f"{error}; control_dt_s = {time.control_dt_s:g} allows {max_hz:g} Hz at most, and that "
            f"over whole numbers: {max_hz:g}, {max_hz / 2:g}, {max_hz / 4:g}"
        ) from error
    if delay > 0.0:
        check_whole_ratio(
            f"planner.delay_s = {delay:g}: delay_s / control_dt_s", delay, time.control_dt_s
        )
    if delay * hz > 1.0 + 1e-6:
        raise ValueError(
            f"planner.delay_s = {delay:g}: longer than the {1 / hz:g} s from one plan to the next "
            f"(planner.replan_hz = {hz:g}); take at most that"
        )


_STRICT = ConfigDict(strict=True, allow_inf_nan=False)


def _check_settings_table(
    reference: PlannerReference, settings: Mapping[str, object], table: str
) -> None:
    """Refuse settings that a planner does not have."""
    model = register.settings_class(reference.load())
    if model is None and settings:
        raise ConfigError(f"[planner.{table}]: this planner has no settings")
    if model is not None:
        _check_settings(model, settings, table)


def _check_settings(model: type, settings: Mapping[str, object], table: str) -> None:
    """Refuse settings that a planner does not have, and values that are not valid."""
    names = [setting.name for setting in fields(model)]
    unknown = [key for key in settings if key not in names]
    if unknown:
        raise ConfigError(
            f"[planner.{table}] {format_value(unknown[0])}: no setting of this planner; "
            f"there is {', '.join(names) or 'none'}"
        )
    types = get_type_hints(model)
    for key, value in settings.items():
        try:
            TypeAdapter(types[key], config=_STRICT).validate_python(value)
        except ValidationError as error:
            message = error.errors()[0]["msg"]
            raise ConfigError(
                f"[planner.{table}] {key} = {format_value(value)}: {message}"
            ) from error
    try:
        model(**settings)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"[planner.{table}]: {error}") from error


class BreakdownsConfig(FileModel):
    """Robots that break down in flight, for good; their episode ends as `failed`.

    Each robot is sampled independently: the number of failures varies between worlds, and another
    robot in the fleet changes nothing for those before it. No other sample changes.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "share": "fraction",
    }

    fraction: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a robot breaks down; 0 for none."""
    earliest_s: float = Field(default=0.0, ge=0.0, le=86400.0)
    """Start of the interval in which times are uniformly sampled. A robot ends with the first
    control period that is over at its time or later, if its episode lasts that long."""
    latest_s: float | None = Field(default=None, gt=0.0, le=86400.0)
    """End of the interval; the horizon if left out."""

    @model_validator(mode="after")
    def _check_times_used(self) -> Self:
        unused_keys = self.model_fields_set - {"fraction"}
        if self.fraction == 0.0 and (self.earliest_s > 0.0 or self.latest_s is not None):
            raise ValueError(
                f"{', '.join(sorted(unused_keys))}: no robot breaks down; give fraction"
            )
        return self

    def span_s(self, horizon_s: float) -> tuple[float, float]:
        """Return the earliest and the latest time, s."""
        return self.earliest_s, horizon_s if self.latest_s is None else self.latest_s


def check_breakdowns(breakdowns: BreakdownsConfig, time: TimeConfig) -> None:
    """Refuse an empty interval, and times that no episode reaches.

    Raises:
        ValueError: naming the key and its value.
    """
    earliest, latest = breakdowns.span_s(time.horizon_s)
    if latest > time.horizon_s:
        raise ValueError(
            f"breakdowns.latest_s = {latest:g}: episodes end at time.horizon_s = "
            f"{time.horizon_s:g}; take at most that, or leave it out"
        )
    if earliest > latest:
        key = "time.horizon_s" if breakdowns.latest_s is None else "breakdowns.latest_s"
        raise ValueError(
            f"breakdowns.earliest_s = {earliest:g}: later than {key} = {latest:g}; "
            "the earlier time comes first"
        )
