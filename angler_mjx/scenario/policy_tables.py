"""Tables of a scenario file on the policy that commands the robots, if any."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from angler_mjx.errors import format_value
from angler_mjx.files import FileModel
from angler_mjx.planning.mppi.costs import Weights
from angler_mjx.planning.mppi.policy import Output
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, PoseTarget
from angler_mjx.robot.control.commands.whole_body import EndEffectorTarget
from angler_mjx.robot.vehicles import library
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.policy_of_file import build_policy_of_file
from angler_mjx.scenario.tables import (
    ControllerConfig,
    InformationConfig,
    PlannerConfig,
    TimeConfig,
    check_whole_ratio,
    resolve_class,
)
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy
from angler_mjx.user_classes import is_class_of_file

MAX_STEPS = 1000
"""Max number of steps of a sample: 50 s at 50 ms."""


class MppiConfig(FileModel):
    """Settings of model predictive path integral control; see `docs/reference/mppi.md`."""

    output: Output = "twist"
    """Command to the controllers: twist, velocities for the velocity loop; wrench, forces and
    moments for the allocation."""
    hz: float = Field(default=10.0, gt=0.0, le=1e4)
    """Rate of new commands; the period is a whole number of control steps."""
    samples: int = Field(default=512, ge=2, le=2**16)
    """Number of samples of each robot in each period."""
    horizon_s: float = Field(default=3.0, gt=0.0, le=600.0)
    """Horizon of the samples; a whole number of their steps."""
    dt_s: float = Field(default=0.1, ge=1e-3, le=10.0)
    """Time step of the samples."""
    knots: int = Field(default=8, ge=2, le=100)
    """Number of velocities that define a sample, joined by lines; at most one a step."""
    weights: dict[str, float] = Field(default_factory=dict)
    """Cost weights that differ from the defaults; all above 0, or 0 for no cost."""

    @field_validator("weights")
    @classmethod
    def _check_weights(cls, weights: dict[str, float]) -> dict[str, float]:
        defaults = asdict(Weights())
        for key, value in weights.items():
            if key not in defaults:
                raise ValueError(
                    f"{format_value(key)}: no such weight; there is {', '.join(defaults)}"
                )
            is_divisor = key in ("margin_m", "temperature", "noise", "response_s")
            if value < 0.0 or (is_divisor and value == 0.0):
                bound = "above 0" if is_divisor else "0 or more"
                raise ValueError(f"{key} = {value:g}: give a number {bound}")
        return weights

    @model_validator(mode="after")
    def _check_sampling(self) -> Self:
        check_whole_ratio(
            f"horizon_s = {self.horizon_s:g}: horizon_s / dt_s", self.horizon_s, self.dt_s
        )
        if self.steps > MAX_STEPS:
            raise ValueError(
                f"dt_s = {self.dt_s:g}: {self.steps} steps in {self.horizon_s:g} s; {MAX_STEPS} "
                "are the most: take a longer dt_s"
            )
        if self.knots > self.steps + 1:
            raise ValueError(
                f"knots = {self.knots}: samples have {self.steps} steps; take at most "
                f"{self.steps + 1}"
            )
        return self

    @property
    def steps(self) -> int:
        """Return the number of steps of a sample."""
        return round(self.horizon_s / self.dt_s)

    @property
    def command_type(self) -> type:
        """Return the type of the command to the controllers."""
        return BodyTwist if self.output == "twist" else BodyWrench

    def period(self, time: TimeConfig) -> int:
        """Return the number of control steps between two commands.

        Raises:
            ValueError: it is no whole number.
        """
        return _steps_per_period("policy.mppi.hz", self.hz, time)


class RoutesConfig(FileModel):
    """Flight along routes computed before the start; see `docs/reference/routes.md`."""

    hz: float = Field(default=4.0, gt=0.0, le=1e4)
    """Rate of new commands; the period is a whole number of control steps."""
    horizon_s: float = Field(default=5.0, gt=0.0, le=600.0)
    """Time ahead within which contacts with moving obstacles and robots count."""

    def period(self, time: TimeConfig) -> int:
        """Return the number of control steps between two commands.

        Raises:
            ValueError: it is no whole number.
        """
        return _steps_per_period("policy.routes.hz", self.hz, time)


class ReachConfig(FileModel):
    """Placing of end effectors at the goals."""

    begin_m: float = Field(default=1.2, gt=0.0, le=100.0)
    """Distance of the base from its goal within which the end effector is brought there."""


POLICIES = ("none", "mppi", "routes", "reach")
"""Names of policies of the package; none: robots fly their plans."""


def _check_policy_name(name: str) -> str:
    if name not in POLICIES and not is_class_of_file(name):
        raise ValueError(
            f"no such policy; give {', '.join(POLICIES)}, or a class of a file, FILE.py:CLASS"
        )
    return name


type PolicyName = Annotated[
    str,
    Field(max_length=4096),
    AfterValidator(resolve_class),
    AfterValidator(_check_policy_name),
]
"""Name of a policy; the path of FILE.py:CLASS is relative to the folder of the naming file."""


class PolicyConfig(FileModel):
    """Policy that commands the robots instead of plans; see `docs/reference/policies.md`."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"knows": "information"}

    name: PolicyName = "none"
    """none: robots fly their plans. mppi: each robot flies to its goal by path integral control,
    with or without a plan. routes: each robot flies along routes computed for every cell of the
    world, and avoids moving obstacles and other robots. reach: robots fly their plans, and bring
    their end effectors to the goals when they are near. FILE.py:CLASS: a policy of a file of
    yours."""
    information: InformationConfig | None = None
    """Information level on moving obstacles, whenever the policy acts. If left out: that of the
    class of FILE.py:CLASS; else `planner.information` where the file gives that, else
    obstacles = "observed". Set explicitly to "nothing", the policy receives no obstacle, and
    commands print a notice."""
    mppi: MppiConfig = MppiConfig()
    routes: RoutesConfig = RoutesConfig()
    reach: ReachConfig = ReachConfig()
    settings: dict[str, dict[str, object]] = Field(default_factory=dict)
    """The table [policy.CLASS] of FILE.py:CLASS: arguments of the class."""

    @model_validator(mode="before")
    @classmethod
    def _collect_settings(cls, data: object) -> object:
        """Collect the table of a class of a file, whose name is no field of this model.

        It may stand where robots fly their plans (``--policy none``), as that of mppi may.
        """
        settings = data.get("settings", {}) if isinstance(data, Mapping) else None
        if not isinstance(data, Mapping) or not isinstance(settings, Mapping):
            return data
        name = str(data.get("name", "none"))
        if name != "none" and not is_class_of_file(name):
            return data
        field_keys = cls.model_fields.keys() | cls.renamed_keys.keys()
        tables = {
            key: table
            for key, table in data.items()
            if key not in field_keys and isinstance(table, Mapping)
        }
        if not tables:
            return data
        rest = {key: value for key, value in data.items() if key not in tables}
        return {**rest, "settings": {**settings, **tables}}

    @model_validator(mode="after")
    def _check_settings(self) -> Self:
        unused = sorted(set(self.settings) - {self.title})
        if unused and self.name != "none":
            raise ValueError(
                f"{unused[0]}: policy.name is {format_value(self.name)}, whose settings stand in "
                f"[policy.{self.title}]"
            )
        return self

    @property
    def title(self) -> str:
        """Return the name, of a class of a file without the file."""
        return self.name.rpartition(":")[2]

    @property
    def file(self) -> Path | None:
        """Return the file of a user's policy; None of the package's."""
        is_of_file = is_class_of_file(self.name)
        return Path(self.name.rpartition(":")[0]) if is_of_file else None

    def build_of_file(self) -> Policy:
        """Build the policy of a user's file.

        Raises:
            ConfigError: as `build_policy_of_file`.
        """
        information = None if self.information is None else self.information.to_information()
        return build_policy_of_file(self.name, self.settings.get(self.title, {}), information)


def default_information(policy: PolicyConfig, planner: PlannerConfig) -> InformationConfig:
    """Return the information level of a policy whose own table gives none, or of a user's file.

    A policy that steers in flight observes obstacles unless ``planner.information`` gives a level.
    Run folders of older versions store null: their level is kept.
    """
    if policy.file is not None:
        level = policy.build_of_file().information or Information()
        return InformationConfig(obstacles=level.obstacles, current=level.current)
    if "information" in policy.model_fields_set:  # null, which a TOML file cannot hold
        observes_obstacles = policy.name == "routes" and planner.information == InformationConfig()
    else:
        observes_obstacles = not planner.information.model_fields_set
    return InformationConfig(obstacles="observed") if observes_obstacles else planner.information


def _steps_per_period(key: str, hz: float, time: TimeConfig) -> int:
    """Return the control steps of a period at ``hz``; raise ValueError if not a whole number."""
    dt_s = time.control_dt_s
    check_whole_ratio(f"{key} = {hz:g}: 1 / (hz control_dt_s)", 1.0, hz * dt_s)
    return round(1.0 / (hz * dt_s))


def check_end_effectors(controller: ControllerConfig, fleet: Sequence[FleetEntry]) -> None:
    """Refuse controllers and vehicles that take no targets of an end effector.

    Raises:
        ValueError: naming the key and its value.
    """
    if not any(EndEffectorTarget in stage.takes for stage in controller.stack()[0]):
        raise ValueError(
            f'policy.name = "reach": no stage of controller {controller.title!r} takes an '
            'EndEffectorTarget; take controller = "arm", or one with the stage whole_body'
        )
    for i, entry in enumerate(fleet):
        config = library.load_vehicle(entry.vehicle)
        if config.end_effector is None:
            raise ValueError(
                f'policy.name = "reach": fleet[{i}], vehicle {config.name!r}, has no table '
                "[end_effector]; fly vehicles with an arm"
            )


def check_policy(
    policy: PolicyConfig,
    time: TimeConfig,
    controller: ControllerConfig,
    fleet: Sequence[FleetEntry],
) -> None:
    """Refuse commands that the controllers or the fleet cannot take, or not at that rate.

    Raises:
        ValueError: naming the key and its value.
    """
    if policy.file is not None:  # built for its information level; the engine checks its command
        return
    if policy.name == "reach":
        check_end_effectors(controller, fleet)
        return
    if policy.name == "routes":
        policy.routes.period(time)
        if not any(PoseTarget in stage.takes for stage in controller.stack()[0]):
            raise ValueError(
                f'policy.name = "routes": guides robots by poses, and no stage of controller '
                f"{controller.title!r} takes one; take another, such as cascade"
            )
        return
    settings = policy.mppi
    settings.period(time)
    if not any(settings.command_type in stage.takes for stage in controller.stack()[0]):
        raise ValueError(
            f"policy.mppi.output = {settings.output!r}: no stage of controller "
            f"{controller.title!r} takes a {settings.command_type.__name__}; take another, "
            "such as cascade"
        )
    for i, entry in enumerate(fleet if settings.output == "wrench" else ()):
        if any("sway" in drive.missing_axes for drive in entry.drive_limits()):
            raise ValueError(
                f"policy.mppi.output = 'wrench': pushes to the side, and fleet[{i}], vehicle "
                f'{library.load_vehicle(entry.vehicle).name!r}, has no sway; take output = "twist"'
            )
