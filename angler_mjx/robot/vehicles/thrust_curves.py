"""Thrust and power of the thrusters of a vehicle: of one table, or of a curve each.

A thruster with a curve takes the electrical power of the vehicle's thruster file at the same
thrust. Beyond the ends of the file power grows as the 3/2 of the thrust (momentum theory of an
actuator disc at rest).
"""

import numpy as np

from angler_mjx.robot.vehicles.config import ThrustCurve, VehicleConfig
from angler_mjx.robot.vehicles.library import load_thruster
from angler_mjx.robot.vehicles.thrusters import PWM_GRID_US, FloatArray, tables_at


def build_thrust_tables(config: VehicleConfig, voltage_v: float) -> tuple[FloatArray, FloatArray]:
    """Return thrust and electrical power on the PWM grid.

    Args:
        config: vehicle file.
        voltage_v: battery voltage; curves of single thrusters hold at any.

    Returns:
        Thrust [201] N and power [201] W of each thruster; [n_t, 201] where one has a curve, and
        zero where there is no thruster.

    Raises:
        ConfigError: unknown thruster, or a voltage outside its data.
    """
    if config.rotor is None:
        return np.zeros(PWM_GRID_US.size), np.zeros(PWM_GRID_US.size)
    thrust_n, power_w = tables_at(load_thruster(config.rotor.model), voltage_v)
    curves = [thruster.curve for thruster in config.thrusters.layout]
    if all(curve is None for curve in curves):
        return thrust_n, power_w
    thrusts = [thrust_n if curve is None else _sample_curve(curve) for curve in curves]
    powers = [
        power_w if curve is None else _power_at_thrust(thrust, thrust_n, power_w)
        for curve, thrust in zip(curves, thrusts, strict=True)
    ]
    return np.stack(thrusts), np.stack(powers)


def thrust_ends(thrust_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the thrusts at the lowest and at the highest PWM, N.

    Args:
        thrust_n: [201] of `build_thrust_tables`, or [n_t, 201].

    Returns:
        [] each, or [n_t].
    """
    return np.asarray(thrust_n[..., 0]), np.asarray(thrust_n[..., -1])


def _sample_curve(curve: ThrustCurve) -> FloatArray:
    sampled: FloatArray = np.interp(PWM_GRID_US, curve.pwm_us, curve.thrust_n)
    return sampled


def _power_at_thrust(thrust_n: FloatArray, table_n: FloatArray, table_w: FloatArray) -> FloatArray:
    """Return the power [201] at thrusts [201], by a table of both."""
    # Within the dead band, where the table is flat, the least power counts.
    knots = np.unique(table_n)
    least_w = np.array([table_w[table_n == knot].min() for knot in knots])
    power: FloatArray = np.interp(thrust_n, knots, least_w)
    for end in (0, -1):
        beyond = np.sign(knots[end]) * (thrust_n - knots[end]) > 0
        power[beyond] = least_w[end] * np.abs(thrust_n[beyond] / knots[end]) ** 1.5
    return power
