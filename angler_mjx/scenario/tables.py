"""Tables of a scenario file: water, time steps, controller, planner."""

import math
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from angler_mjx.control import stack, stages
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.errors import shown
from angler_mjx.files import FileModel
from angler_mjx.quantities import Length


class WaterConfig(FileModel):
    """The sea as a medium."""

    density_kgpm3: float = Field(default=1000.0, ge=900.0, le=1100.0)
    """Fresh water by default: the published parameter sets were measured in it."""


class TimeConfig(FileModel):
    """Time steps."""

    horizon_s: float = Field(default=120.0, gt=0.0, le=86400.0)
    """Simulated time of an episode; a whole number of control periods."""
    physics_dt_s: float = Field(default=0.01, ge=1e-4, le=0.05)
    """Step of the physics."""
    control_dt_s: float = Field(default=0.05, ge=1e-4, le=1.0)
    """Period of the controllers; a whole number of physics steps."""
    record_hz: float = Field(default=5.0, ge=0.0, le=1e4)
    """Rate of the stored trajectories; 0 stores none."""

    @model_validator(mode="after")
    def _commensurate(self) -> Self:
        _whole("control_dt_s / physics_dt_s", self.control_dt_s, self.physics_dt_s)
        _whole("horizon_s / control_dt_s", self.horizon_s, self.control_dt_s)
        if self.record_hz > 0:
            _whole("1 / (record_hz control_dt_s)", 1.0, self.record_hz * self.control_dt_s)
            _whole("horizon_s record_hz", self.horizon_s * self.record_hz, 1.0)
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


def _whole(what: str, part: float, whole: float) -> None:
    ratio = part / whole if whole > 0 else math.inf
    if not math.isfinite(ratio):
        raise ValueError(f"{what} is too large; take numbers nearer to one another")
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
                f"name = {shown(self.name)}: there is {', '.join(stages.CONTROLLERS)}; "
                "or give stages"
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
    """The only one: search over cells, in space and time."""
    margin_m: Length = 0.1
    """Kept free around each robot beside its own radius."""
