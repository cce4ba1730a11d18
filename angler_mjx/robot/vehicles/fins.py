"""Fins of a vehicle: parameters in the order of its actuators, thrusters first.

Signals, states and settled values of a fin stand in arrays of thrusters: its value is the
deflection, rad, where theirs is a thrust. Vehicles without fins have programs without them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import fin as fin_kernel
from angler_mjx.robot.vehicles.actuator_rows import pad_fleet, pad_rows, put_columns
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.thrusters import PWM_HIGH_US, PWM_LOW_US, FloatArray

NEUTRAL_US = 0.5 * (PWM_LOW_US + PWM_HIGH_US)
HALF_RANGE_US = 0.5 * (PWM_HIGH_US - PWM_LOW_US)
_RANK = 1e-2


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FinParams:
    """Fins of one robot; rows [n_t] of thrusters are no fins and have no area."""

    is_fin: jax.Array
    """bool [n_t]."""
    chord: jax.Array
    """[n_t, 6] chord and its moment about the centre of mass, in F."""
    normal: jax.Array
    """[n_t, 6] normal of the foil, span x chord, and its moment."""
    area_m2: jax.Array
    """[n_t]"""
    lift_slope: jax.Array
    """[n_t] 1/rad."""
    zero_drag: jax.Array
    """[n_t]"""
    induced_drag: jax.Array
    """[n_t] drag coefficient per square of the lift coefficient."""
    plate_drag: jax.Array
    """[n_t]"""
    stall_rad: jax.Array
    """[n_t]"""
    limit_rad: jax.Array
    """[n_t]"""
    rate_radps: jax.Array
    """[n_t]"""
    tau_s: jax.Array
    """[n_t]"""


class FinnedBody(Protocol):
    """Vehicle, as far as its fins go."""

    @property
    def fins(self) -> FinParams | None:
        """Fins."""

    @property
    def terminal_speed_mps(self) -> jax.Array:
        """[3] of thrusters alone."""


_FILL = {"stall_rad": 0.3, "rate_radps": 1.0, "tau_s": 1.0}
"""Values of rows that are no fin, where zero has no meaning."""


def build_fins(config: VehicleConfig) -> FinParams | None:
    """Return the fins of a vehicle file; None without (host side)."""
    if config.fins is None:
        return None
    layout = config.fins.layout
    n_thruster = len(config.thrusters.layout)
    center = np.asarray(config.base.center_of_mass_m)
    arm = np.array([fin.position_m for fin in layout]) - center
    chord = np.array([fin.chord for fin in layout])
    normal = np.cross([fin.span for fin in layout], chord)
    columns: dict[str, np.ndarray] = {
        "is_fin": np.ones(len(layout), bool),
        "chord": np.concatenate([chord, np.cross(arm, chord)], axis=1),
        "normal": np.concatenate([normal, np.cross(arm, normal)], axis=1),
        "area_m2": np.array([fin.area_m2 for fin in layout]),
        "lift_slope": np.array([fin.lift_slope for fin in layout]),
        "zero_drag": np.array([fin.zero_lift_drag for fin in layout]),
        "induced_drag": np.array(
            [1.0 / (math.pi * fin.efficiency * fin.aspect_ratio) for fin in layout]
        ),
        "plate_drag": np.array([fin.plate_drag for fin in layout]),
        "stall_rad": np.array([fin.stall_rad for fin in layout]),
        "limit_rad": np.array([fin.limit_rad for fin in layout]),
        "rate_radps": np.array([fin.rate_radps for fin in layout]),
        "tau_s": np.array([fin.time_constant_s for fin in layout]),
    }
    made = FinParams(**put_columns(columns))
    behind = len(config.actuator_names) - n_thruster - len(layout)
    return pad_rows(made, n_thruster, behind, _FILL)


def pad_fins(
    parts: Sequence[FinParams | None], rows: Sequence[int], n: int
) -> list[FinParams | None]:
    """Return the fins of the vehicles of a fleet, each with ``n`` rows; None where none has any.

    Args:
        parts: of each vehicle.
        rows: actuators of each vehicle.
        n: rows of all.
    """
    return pad_fleet(parts, rows, n, _FILL)


def fin_wrench(fins: FinParams, states: jax.Array, nu_r: jax.Array, density: float) -> jax.Array:
    """Return the wrench [6] of fins, in F.

    Args:
        fins: of one robot.
        states: of its actuators, [n_t] or [3, n_t].
        nu_r: [6] velocity through the water, in F.
        density: of the water, kg/m^3.
    """
    actuators = states if states.ndim == 1 else states[0]
    return fin_kernel.fin_wrench(
        chord=fins.chord,
        normal=fins.normal,
        area=fins.area_m2,
        lift_slope=fins.lift_slope,
        zero_drag=fins.zero_drag,
        induced_drag=fins.induced_drag,
        plate_drag=fins.plate_drag,
        stall=fins.stall_rad,
        deflection=jnp.where(fins.is_fin, actuators, 0.0),
        nu_r=nu_r,
        density=density,
    )


def settled_deflection(fins: FinParams, pwm_us: jax.Array) -> jax.Array:
    """Return the deflections [n_t] rad that signals [n_t] settle at."""
    travel = jnp.clip((pwm_us - NEUTRAL_US) / HALF_RANGE_US, -1.0, 1.0)
    return travel * fins.limit_rad


def fin_matrix(config: VehicleConfig) -> FloatArray:
    """Return the wrench [6, n_t] per radian and unit of dynamic pressure of a flow ahead.

    Columns of thrusters are zero (host side).
    """
    fins = build_fins(config)
    if fins is None:
        return np.zeros((6, len(config.actuator_names)))
    return lift_matrix(fins)


def lift_matrix(fins: FinParams) -> FloatArray:
    """Return `fin_matrix` of compiled fins; any leading axes (host side)."""
    force = np.asarray(fins.area_m2, float) * np.asarray(fins.lift_slope, float)
    force = force * (np.asarray(fins.limit_rad) > 0)
    matrix: FloatArray = np.swapaxes(np.asarray(fins.normal, float) * force[..., None], -1, -2)
    return matrix


def steers_by_fins(config: VehicleConfig) -> bool:
    """Return whether fins turn a vehicle about its pitch and its yaw axis, each alone."""
    turning = fin_matrix(config)[4:]
    if not np.any(turning):
        return False
    return bool(np.all(np.diag(turning @ np.linalg.pinv(turning, rcond=_RANK)) > 0.5))


def flies_by_fins(vehicle: FinnedBody) -> jax.Array:
    """Return bool [] whether a vehicle has fins and no heave of thrusters: it climbs by pitch."""
    if vehicle.fins is None:
        return jnp.zeros((), bool)
    return jnp.any(vehicle.fins.is_fin) & (vehicle.terminal_speed_mps[2] <= 0.0)
