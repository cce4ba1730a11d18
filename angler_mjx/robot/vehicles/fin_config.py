"""Models of fins and control surfaces in a vehicle file."""

import math
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, Field, field_validator, model_validator

from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.hull import Name, Vector3
from angler_mjx.robot.vehicles.rotor_config import Positive, Source

type Direction = Annotated[tuple[float, float, float], AfterValidator(checks.check_unit_vector)]


class Fin(FileModel):
    """Fin in the base frame; a pair that moves together counts as one with the area of both."""

    name: Name
    """Name for tables."""
    position_m: Vector3
    """[3] point at which its force acts, m."""
    span: Direction
    """Unit vector of the axis about which it turns; positive deflections are right-handed."""
    chord: Direction = (1.0, 0.0, 0.0)
    """Unit vector across the span, forward at no deflection."""
    area_m2: Positive
    """Area of the plan form."""
    aspect_ratio: Positive
    """Square of the span over the area, with the mirror image in the hull where there is one."""
    lift_slope_per_rad: Annotated[float, Field(gt=0, le=20)] | None = None
    """Slope of the lift coefficient; None: 1 / (1 / (2 pi 0.9) + 1 / (pi aspect_ratio)) (Hoerner
    and Borst, Fluid-Dynamic Lift 1975)."""
    zero_lift_drag: Annotated[float, Field(ge=0, le=5)] = 0.01
    """Drag coefficient without lift."""
    efficiency: Annotated[float, Field(gt=0, le=1)] = 0.9
    """Of the span: the drag of lift is C_L^2 / (pi efficiency aspect_ratio)."""
    plate_drag: Annotated[float, Field(ge=0, le=5)] = 1.2
    """Drag coefficient across the flow."""
    stall_rad: Annotated[float, Field(gt=0, le=0.7)] = 0.35
    """Angle of attack up to which lift is linear."""
    limit_rad: Annotated[float, Field(ge=0, le=1.5)]
    """Largest deflection, either way; 0 for a fixed fin."""
    rate_radps: Positive
    """Fastest change of the deflection."""
    time_constant_s: Positive
    """Lag of the deflection behind its command."""

    @model_validator(mode="after")
    def _check_chord(self) -> Self:
        if abs(float(np.dot(self.span, self.chord))) > 1e-6:
            raise ValueError(f"fin {self.name}: chord must be at right angles to span")
        return self

    @property
    def lift_slope(self) -> float:
        """Return the slope of the lift coefficient, 1/rad."""
        if self.lift_slope_per_rad is not None:
            return self.lift_slope_per_rad
        return 1.0 / (1.0 / (2.0 * math.pi * 0.9) + 1.0 / (math.pi * self.aspect_ratio))


class Fins(FileModel):
    """Fins and control surfaces; their signals follow those of the thrusters."""

    layout: Annotated[tuple[Fin, ...], Field(min_length=1, max_length=16)]
    """Fins in the order of the signals: 1100 us is -limit_rad, 1500 us none, 1900 us limit_rad."""
    source: Source

    @field_validator("layout")
    @classmethod
    def _check_distinct(cls, value: tuple[Fin, ...]) -> tuple[Fin, ...]:
        checks.check_distinct_names("fin", [fin.name for fin in value])
        return value
