"""Thrust and power of a thruster at one battery voltage, on the PWM grid that the simulator uses.

Static (bollard) values: the fall of thrust with the speed of advance is in no published table and
is left out.
"""

import numpy as np
from numpy.typing import NDArray

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable

PWM_LOW_US, PWM_HIGH_US = checks.PWM_LOW_US, checks.PWM_HIGH_US
PWM_STEP_US = 4
PWM_GRID_US = np.arange(PWM_LOW_US, PWM_HIGH_US + PWM_STEP_US, PWM_STEP_US)
"""[201] grid of every thrust and power table; every PWM value of the T200 data lies on it."""

type FloatArray = NDArray[np.float64]


def tables_at(table: ThrusterTable, voltage_v: float) -> tuple[FloatArray, FloatArray]:
    """Return thrust and electrical power on the PWM grid, bilinear in PWM and voltage.

    Args:
        table: Data of one thruster.
        voltage_v: Battery voltage, V.

    Returns:
        Thrust [201] N and power [201] W.

    Raises:
        ConfigError: the voltage lies outside the data.
    """
    volts = np.asarray(table.voltage_v, dtype=np.float64)
    if not volts[0] <= voltage_v <= volts[-1]:
        raise ConfigError(
            f"voltage {voltage_v:g} V: thruster {table.name!r} has data from {volts[0]:g} V "
            f"to {volts[-1]:g} V; choose a voltage in between"
        )
    pwm = np.asarray(table.pwm_us, dtype=np.float64)
    return (
        _interpolate_table(pwm, volts, np.asarray(table.thrust_n, dtype=np.float64), voltage_v),
        _interpolate_table(pwm, volts, np.asarray(table.power_w, dtype=np.float64), voltage_v),
    )


def _interpolate_table(
    pwm: FloatArray, volts: FloatArray, values: FloatArray, voltage_v: float
) -> FloatArray:
    column = np.array([np.interp(voltage_v, volts, row) for row in values])
    on_grid: FloatArray = np.interp(PWM_GRID_US, pwm, column)
    return on_grid
