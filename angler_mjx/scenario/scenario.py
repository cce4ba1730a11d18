"""Scenario files: everything that a run needs to know, checked before anything is computed."""

import importlib.resources
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from angler_mjx.control import stack, stages
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse, read_toml
from angler_mjx.physics.step import Water
from angler_mjx.scenario import instrumented
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.sensing.params import check
from angler_mjx.sim.fleet import Member
from angler_mjx.sim.state import SimSpec
from angler_mjx.world.config import WorldConfig


class WaterConfig(FileModel):
    """The sea as a medium."""

    density_kgpm3: float = Field(default=1000.0, ge=900.0, le=1100.0)
    """Fresh water by default: the published parameter sets were measured in it."""


class TimeConfig(FileModel):
    """Time steps."""

    horizon_s: float = Field(default=120.0, gt=0.0, le=86400.0)
    physics_dt_s: float = Field(default=0.01, gt=0.0, le=0.05)
    control_dt_s: float = Field(default=0.05, gt=0.0, le=1.0)
    record_hz: float = Field(default=5.0, ge=0.0)
    """Rate of the stored trajectories; 0 stores none."""

    @model_validator(mode="after")
    def _commensurate(self) -> Self:
        _whole("control_dt_s / physics_dt_s", self.control_dt_s / self.physics_dt_s)
        _whole("horizon_s / control_dt_s", self.horizon_s / self.control_dt_s)
        if self.record_hz > 0:
            _whole("1 / (record_hz control_dt_s)", 1.0 / (self.record_hz * self.control_dt_s))
            _whole("horizon_s record_hz", self.horizon_s * self.record_hz)
        return self

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
        """Control steps from one stored sample to the next; the whole horizon if none is stored."""
        return round(1.0 / (self.record_hz * self.control_dt_s)) if self.record_hz > 0 else 0


def _whole(what: str, ratio: float) -> None:
    if ratio < 0.999999 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise ValueError(f"{what} = {ratio:g} must be a whole number of at least 1")


class ControllerConfig(FileModel):
    """The controllers: a stack by its name or by its stages, and gains that differ from theirs."""

    name: str | None = None
    """One of `angler_mjx.control.stages.CONTROLLERS`; the cascade if nothing is given."""
    stages: tuple[str, ...] | None = Field(default=None, min_length=1)
    """Stages from the highest down, instead of a name."""
    gains: dict[str, dict[str, float]] = Field(default_factory=dict)
    """Of each stage."""

    @property
    def title(self) -> str:
        """Its name, or its stages in a row."""
        return "+".join(self.stages) if self.stages else self.name or "cascade"

    @model_validator(mode="before")
    @classmethod
    def _gains_by_stage(cls, data: Any) -> Any:
        given = data.get("gains") if isinstance(data, dict) else None
        for name, value in (given if isinstance(given, dict) else {}).items():
            if not isinstance(value, dict):
                raise ValueError(
                    f"gains.{name} = {value!r}: gains stand by stage, as in "
                    "[controller.gains.velocity] with velocity_per_s = 2.5"
                )
        return data

    @model_validator(mode="after")
    def _is_a_stack(self) -> Self:
        if self.stages is not None and self.name is not None:
            raise ValueError("give name or stages, not both")
        if self.name is not None and self.name not in stages.CONTROLLERS:
            raise ValueError(
                f"name = {self.name!r}: there is {', '.join(stages.CONTROLLERS)}; or give stages"
            )
        first = self.stack()[0][0]
        if Trajectory not in first.takes:
            raise ValueError(
                f"stages: the first one, {first.name!r}, takes {stack.takes(first)}; the planner "
                "gives a Trajectory: begin with "
                f"{' or '.join(x.name for x in stages.STAGES.values() if Trajectory in x.takes)}"
            )
        return self

    def stack(self) -> tuple[stack.Stages, tuple[Any, ...]]:
        """The stages and the gains of each.

        Raises:
            ConfigError: they are not a stack, or gains make no sense.
        """
        names = self.stages or stages.CONTROLLERS[self.name or "cascade"]
        return stages.build(names, self.gains)


class PlannerConfig(FileModel):
    """The planner that gives each robot its path."""

    name: Literal["grid"] = "grid"
    margin_m: float = Field(default=0.1, ge=0.0)
    """Kept free around each robot beside its own radius."""


class Scenario(FileModel):
    """A whole scenario file."""

    schema_version: Literal[1] = 1
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$")
    description: str = ""
    engine: Literal["mjx", "fused"] = "mjx"
    kernels: Literal["xla", "triton"] | None = None
    """What the engine is compiled by; for fused on a GPU triton if left out, else xla. Part of the
    result's bytes."""
    worlds: int = Field(default=256, ge=1)
    seed: int = Field(default=0, ge=0, lt=2**31)
    tile: int | None = Field(default=None, ge=1)
    """Worlds in one device call; chosen for the device if left out. Part of the result's bytes."""
    goal_tolerance_m: float = Field(default=0.3, gt=0.0)
    time: TimeConfig = TimeConfig()
    water: WaterConfig = WaterConfig()
    world: WorldConfig
    fleet: tuple[FleetEntry, ...] = Field(min_length=1)
    controller: ControllerConfig = ControllerConfig()
    planner: PlannerConfig = PlannerConfig()

    @model_validator(mode="after")
    def _kernels_of_engine(self) -> Self:
        if self.engine == "mjx" and self.kernels == "triton":
            raise ValueError('kernels = "triton": the mjx engine has none; use engine = "fused"')
        return self

    @model_validator(mode="after")
    def _instruments_can_be(self) -> Self:
        for i, entry in enumerate(self.fleet):
            try:
                check(entry.told()[1], self.time.control_dt_s)
            except ConfigError as error:
                raise ValueError(f"fleet.{i}.{error}") from error
        return self

    @property
    def senses(self) -> bool:
        """Whether the controllers of any robot are told something other than the truth."""
        return any(not instrumented.told_truth(*entry.told()) for entry in self.fleet)

    def members(self) -> list[Member]:
        """The fleet, one member a robot."""
        return [entry.member() for entry in self.fleet for _ in range(entry.count)]

    def sim_spec(self) -> SimSpec:
        """The simulator's settings."""
        controllers, gains = self.controller.stack()
        water = Water(density_kgpm3=self.water.density_kgpm3)
        told = [entry.told() for entry in self.fleet for _ in range(entry.count)]
        return SimSpec(
            physics_dt_s=self.time.physics_dt_s,
            physics_steps=self.time.physics_steps,
            goal_tolerance_m=self.goal_tolerance_m,
            water=water,
            stages=controllers,
            gains=gains,
            instrumented=instrumented.build(told, self.time.control_dt_s, water.gravity_mps2),
        )


def shipped() -> dict[str, Path]:
    """Names and files of the scenarios that come with the package."""
    folder = importlib.resources.files("angler_mjx.scenario") / "shipped"
    return {path.stem: path for path in sorted(Path(str(folder)).glob("*.toml"))}


def load_scenario(name_or_path: str | Path, **overrides: Any) -> Scenario:
    """Read a scenario.

    Args:
        name_or_path: name of a shipped scenario, or path of a ``.toml`` file.
        **overrides: top-level keys that replace those of the file, e.g. ``worlds=8``; a table is
            merged into the file's, e.g. ``time={"record_hz": 0.0}``.

    Raises:
        ConfigError: there is no such scenario, or its file has faults (all are listed).
    """
    known = shipped()
    path = Path(name_or_path)
    if str(name_or_path) in known:
        path = known[str(name_or_path)]
    elif path.suffix != ".toml":
        raise ConfigError(
            f"unknown scenario {str(name_or_path)!r}; there is {', '.join(known)}, "
            "or give the path of a .toml file"
        )
    data = read_toml(path)
    for key, value in overrides.items():
        before = data.get(key)
        if isinstance(value, dict) and isinstance(before, dict):
            data[key] = {**before, **value}
        else:
            data[key] = value
    return parse(Scenario, data, source=str(path))
