"""Ballast tanks and moving masses of a vehicle: parameters in the order of its actuators.

Their signals, states and settled values stand in arrays of thrusters, behind the fins: the value of
a tank is the water in it beyond half full, m^3, and that of a mass its position along its axis, m.
Vehicles without them have programs without them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import moved_mass
from angler_mjx.robot.vehicles.actuator_rows import pad_fleet, pad_rows, put_columns
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.fins import HALF_RANGE_US, NEUTRAL_US
from angler_mjx.robot.vehicles.trim_config import MovingMass, Tank


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TrimParams:
    """Tanks and moving masses of one robot; rows [n_t] of other actuators move nothing."""

    is_trim: jax.Array
    """bool [n_t]."""
    position_m: jax.Array
    """[n_t, 3] of a tank, or of a mass in the middle, from the centre of mass, in F."""
    axis: jax.Array
    """[n_t, 3] unit vector along which a mass moves, in F; 0 of tanks."""
    mass_kg: jax.Array
    """[n_t] that moves; 0 of tanks."""
    takes_water: jax.Array
    """[n_t] 1 for tanks, else 0."""
    limit: jax.Array
    """[n_t] m^3 of tanks, m of masses, to either side."""
    rate: jax.Array
    """[n_t] m^3/s and m/s."""
    tau_s: jax.Array
    """[n_t]"""
    power_w: jax.Array
    """[n_t] at the fastest change."""


_FILL = {"limit": 1.0, "rate": 1.0, "tau_s": 1.0}
"""Values of rows of other actuators, where zero has no meaning."""


def build_trim(config: VehicleConfig) -> TrimParams | None:
    """Return the tanks and moving masses of a vehicle file; None without (host side)."""
    tanks, masses = config.tanks, config.masses
    if not tanks and not masses:
        return None
    n, n_tank = len(tanks) + len(masses), len(tanks)
    items: tuple[Tank | MovingMass, ...] = (*tanks, *masses)
    center = np.asarray(config.base.center_of_mass_m)
    axis = np.zeros((n, 3))
    axis[n_tank:] = np.array([mass.axis for mass in masses]).reshape(-1, 3)
    columns: dict[str, np.ndarray] = {
        "is_trim": np.ones(n, bool),
        "position_m": np.array([item.position_m for item in items]) - center,
        "axis": axis,
        "mass_kg": np.array([0.0] * n_tank + [mass.mass_kg for mass in masses]),
        "takes_water": np.array([1.0] * n_tank + [0.0] * len(masses)),
        "limit": np.array([t.limit_m3 for t in tanks] + [mass.limit_m for mass in masses]),
        "rate": np.array([t.rate_m3ps for t in tanks] + [mass.rate_mps for mass in masses]),
        "tau_s": np.array([item.time_constant_s for item in items]),
        "power_w": np.array([item.power_w for item in items]),
    }
    made = TrimParams(**put_columns(columns))
    return pad_rows(made, len(config.actuator_names) - n, 0, _FILL)


def pad_trim(
    parts: Sequence[TrimParams | None], rows: Sequence[int], n: int
) -> list[TrimParams | None]:
    """Return tanks and masses of the vehicles of a fleet, each with ``n`` rows; None without any.

    Args:
        parts: of each vehicle.
        rows: actuators of each vehicle.
        n: rows of all.
    """
    return pad_fleet(parts, rows, n, _FILL)


class TrimChange(NamedTuple):
    """What tanks and masses change of a vehicle."""

    M: jax.Array
    """[6, 6] of its inertia."""
    wrench: jax.Array
    """[6] weight and Coriolis forces of that, in F."""


def trim_change(
    trim: TrimParams,
    states: jax.Array,
    q: jax.Array,
    nu: jax.Array,
    density: float,
    gravity: float,
) -> TrimChange:
    """Return what tanks and masses change of the inertia of a vehicle, and the wrench of it.

    Args:
        trim: of one robot.
        states: of its actuators, [n_t] or [3, n_t].
        q: [4] F to W.
        nu: [6] velocity over ground, in F.
        density: of the water, kg/m^3.
        gravity: m/s^2.
    """
    values = jnp.where(trim.is_trim, states if states.ndim == 1 else states[0], 0.0)
    dm, h, dI = moved_mass.mass_change(
        position=trim.position_m,
        axis=trim.axis,
        mass=trim.mass_kg,
        water=density * trim.takes_water,
        value=values,
    )
    M = moved_mass.inertia_matrix(dm, h, dI)
    return TrimChange(M=M, wrench=moved_mass.moved_mass_wrench(M, dm, h, q, nu, gravity))


def settled_trim(trim: TrimParams, pwm_us: jax.Array) -> jax.Array:
    """Return the values [n_t] that signals [n_t] settle at."""
    return jnp.clip((pwm_us - NEUTRAL_US) / HALF_RANGE_US, -1.0, 1.0) * trim.limit


def trim_signals(trim: TrimParams, values: jax.Array) -> jax.Array:
    """Return the signals [n_t] us that settle at values [n_t], within the limits."""
    return NEUTRAL_US + HALF_RANGE_US * jnp.clip(values / trim.limit, -1.0, 1.0)


def trim_power_w(trim: TrimParams, states: jax.Array, settled: jax.Array) -> jax.Array:
    """Return the power [] W of pumps and drives: by their present speed over the fastest.

    A motion over a way s takes ``power_w`` s / ``rate``, however long it takes.

    Args:
        trim: of one robot.
        states: of its actuators, [n_t] or [3, n_t].
        settled: [n_t] values that they move to.
    """
    values = states if states.ndim == 1 else states[0]
    speed = jnp.minimum(jnp.abs(settled - values) / (trim.tau_s * trim.rate), 1.0)
    return jnp.sum(jnp.where(trim.is_trim, trim.power_w * speed, 0.0))
