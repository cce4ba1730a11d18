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
from angler_mjx.sim.fleet import Member, Variant
from angler_mjx.sim.state import SimSpec
from angler_mjx.vehicles import library
from angler_mjx.vehicles.rotor_config import RotorResponse
from angler_mjx.world.config import WorldConfig


class FleetEntry(FileModel):
    """One or more robots of a kind."""

    vehicle: str
    """Name of a shipped vehicle, or path of a vehicle file."""
    count: int = Field(default=1, ge=1, le=1024)
    parameter_set: str | None = None
    """Name of one set of the vehicle; its default set if left out."""
    parameter_mix: dict[str, float] = Field(default_factory=dict)
    """Weights of several sets, drawn anew for each robot of each world; instead of one set."""
    battery_v: float = Field(default=16.0, ge=10.0, le=20.0)
    cruise_speed_mps: float = Field(default=0.5, gt=0.0, le=3.0)
    thruster_health: dict[str, float] = Field(default_factory=dict)
    """Share of its thrust that each faulty thruster gives, 0 (dead) to 1 (sound), by its name in
    the vehicle file."""
    fault_known: bool = True
    """Whether the allocation knows thruster_health; if not, it takes all thrusters for sound."""
    rotor_response: RotorResponse | None = None
    """First or third order; what the vehicle file says if left out. The same for a whole fleet."""

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if self.parameter_mix and self.parameter_set is not None:
            raise ValueError("give parameter_set or parameter_mix, not both")
        bad = {name: weight for name, weight in self.parameter_mix.items() if weight <= 0}
        if bad:
            raise ValueError(f"parameter_mix: weights must be positive: {bad}")
        config = _load_vehicle(self.vehicle)
        try:
            config.find_health(self.thruster_health)
            config.find_response(self.rotor_response)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        for name in self._weights(config.default_set):
            if name not in config.parameter_sets:
                raise ValueError(
                    f"parameter set {name!r} is not in vehicle {self.vehicle!r}; "
                    f"there is {', '.join(sorted(config.parameter_sets))}"
                )
        return self

    def _weights(self, default: str) -> dict[str, float]:
        return self.parameter_mix or {self.parameter_set or default: 1.0}

    def member(self) -> Member:
        """The robots of this entry as the simulator takes them."""
        weights = self._weights(library.load(self.vehicle).default_set)
        return Member(
            variants=tuple(
                Variant(
                    vehicle=self.vehicle,
                    parameter_set=name,
                    battery_v=self.battery_v,
                    thruster_health=tuple(self.thruster_health.items()),
                    fault_known=self.fault_known,
                    rotor_response=self.rotor_response,
                )
                for name in weights
            ),
            weights=tuple(weights.values()),
            cruise_speed_mps=self.cruise_speed_mps,
        )


def _load_vehicle(name: str) -> Any:
    try:
        return library.load(name)
    except ConfigError as error:
        raise ValueError(str(error)) from error


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

    def members(self) -> list[Member]:
        """The fleet, one member a robot."""
        return [entry.member() for entry in self.fleet for _ in range(entry.count)]

    def sim_spec(self) -> SimSpec:
        """The simulator's settings."""
        controllers, gains = self.controller.stack()
        return SimSpec(
            physics_dt_s=self.time.physics_dt_s,
            physics_steps=self.time.physics_steps,
            goal_tolerance_m=self.goal_tolerance_m,
            water=Water(density_kgpm3=self.water.density_kgpm3),
            stages=controllers,
            gains=gains,
        )


def shipped() -> dict[str, Path]:
    """Names and files of the scenarios that come with the package."""
    folder = importlib.resources.files("angler_experiments") / "scenarios"
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
