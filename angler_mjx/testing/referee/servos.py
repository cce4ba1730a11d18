"""Pumps of tanks and drives of moving masses, for the referee: motion and energy by signals."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

type Floats = NDArray[np.float64]

_TABLES = (("ballast", "limit_m3", "rate_m3ps"), ("moving_masses", "limit_m", "rate_mps"))


@dataclass(frozen=True, kw_only=True)
class RefereeServos:
    """Servos of one robot [s], which follow its other actuators."""

    first: int
    """Column of signals of the first one."""
    limit: Floats
    """[s] m^3 or m."""
    rate: Floats
    """[s] per second."""
    lag_s: Floats
    """[s]"""
    power_w: Floats
    """[s] at the fastest motion."""

    @property
    def columns(self) -> slice:
        """Return the columns of their signals."""
        return slice(self.first, self.first + self.limit.size)

    def energy_j(self, pwm_us: Floats, control_dt_s: float, physics_dt_s: float) -> float:
        """Return the energy of signals [t, columns] from the middle on.

        Each takes its power in proportion to the speed at the beginning of a control period.
        """
        value, total = np.zeros(self.limit.size), 0.0
        substeps = round(control_dt_s / physics_dt_s)
        for signal in pwm_us[:, self.columns]:
            goal = self.limit * np.clip((signal - 1500.0) / 400.0, -1.0, 1.0)
            speed = np.minimum(np.abs(goal - value) / self.lag_s, self.rate)
            total += float(np.sum(self.power_w * speed / self.rate)) * control_dt_s
            for _ in range(substeps):
                change = (goal - value) * -np.expm1(-physics_dt_s / self.lag_s)
                value = value + np.clip(change, -self.rate * physics_dt_s, self.rate * physics_dt_s)
        return total

    def rounding_w(self, half_us: float) -> float:
        """Return the most that signals off by ``half_us`` change the power."""
        off = self.limit * half_us / 400.0 / (self.lag_s * self.rate)
        return float(np.sum(self.power_w * np.minimum(off, 1.0)))


def read_servos(file: Mapping[str, Any]) -> RefereeServos:
    """Read the tanks and moving masses of a vehicle file; none where it has none."""
    fins = file.get("fins") or {"layout": ()}
    rows = [
        (item[limit], item[rate], item["time_constant_s"], item.get("power_w", 0.0))
        for table, limit, rate in _TABLES
        for item in (file.get(table) or {"layout": ()})["layout"]
    ]
    numbers = np.array(rows, float).reshape(-1, 4)
    return RefereeServos(
        first=len(file["thrusters"]["layout"]) + len(fins["layout"]),
        limit=numbers[:, 0],
        rate=numbers[:, 1],
        lag_s=numbers[:, 2],
        power_w=numbers[:, 3],
    )
