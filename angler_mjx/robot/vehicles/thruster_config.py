"""Model of a thruster file."""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.hull import Name
from angler_mjx.robot.vehicles.rotor_config import Number, Positive, Source


class ThrusterTable(FileModel):
    """Thruster file: static thrust and electrical power against PWM and supply voltage."""

    name: Name
    """Name of the thruster."""
    description: str
    """Description for people."""
    source: Source
    voltage_v: Annotated[tuple[Positive, ...], Field(min_length=2)]
    """Voltages of the columns; rising."""
    pwm_us: Annotated[tuple[Annotated[int, Field(ge=0, le=10_000)], ...], Field(min_length=2)]
    """PWM values of the rows; rising, 1100 to 1900 at least."""
    thrust_n: tuple[tuple[Number, ...], ...]
    """Thrust: one row per PWM value, one column per voltage."""
    power_w: tuple[tuple[Number, ...], ...]
    """Electrical power, laid out as ``thrust_n``; never negative."""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        shape = (len(self.pwm_us), len(self.voltage_v))
        for key in ("thrust_n", "power_w"):
            rows: tuple[tuple[float, ...], ...] = getattr(self, key)
            if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
                raise ValueError(f"{key} needs {shape[0]} rows of {shape[1]} values")
        if np.any(np.diff(self.voltage_v) <= 0) or np.any(np.diff(self.pwm_us) <= 0):
            raise ValueError("voltage_v and pwm_us must increase")
        if self.pwm_us[0] > checks.PWM_LOW_US or self.pwm_us[-1] < checks.PWM_HIGH_US:
            raise ValueError(
                f"pwm_us runs from {self.pwm_us[0]} to {self.pwm_us[-1]}; it must cover "
                f"{checks.PWM_LOW_US} to {checks.PWM_HIGH_US}"
            )
        if np.any(np.diff(np.asarray(self.thrust_n), axis=0) < 0):
            raise ValueError("thrust_n must not fall as PWM rises")
        if np.any(np.asarray(self.power_w) < 0):
            raise ValueError("power_w must not be negative")
        return self
