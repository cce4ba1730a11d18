"""Numbers of a vehicle to inspect before a flight: all closed forms."""

import math
from dataclasses import dataclass

import numpy as np

from angler_mjx.robot.vehicles.abilities import compute_abilities
from angler_mjx.robot.vehicles.config import ParameterSet, VehicleConfig
from angler_mjx.robot.vehicles.damping import largest_gain_w
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.thrust_curves import build_thrust_tables
from angler_mjx.robot.vehicles.thrusters import FloatArray

GRAVITY_MPS2 = 9.81
FRESH_WATER_KGPM3 = 1000.0
"""Density of fresh water, in which the published sets were identified; weight and buoyancy are
compared in it."""

_NO_ARM_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class VehicleProperties:
    """Properties of a vehicle with one parameter set at one voltage, in still fresh water."""

    parameter_set: str
    mass_kg: float
    """Dry mass, links included; so are weight and buoyancy."""
    weight_n: float
    buoyancy_n: float
    wrench_matrix: FloatArray
    """[6, n_t] wrench at the centre of mass, in F, per newton of each thruster; 1 and m."""
    terminal_speed_mps: FloatArray
    """[3] surge, sway, heave; the slower of the two directions."""
    speed_time_constant_s: FloatArray
    """[3] time constant with which a small deviation from the terminal speed decays."""
    roll_period_s: float | None
    """Undamped period in roll; None without a righting moment."""
    pitch_period_s: float | None
    trim_rad: tuple[float, float] | None
    """Roll and pitch at rest, links left out; None without an arm of buoyancy, and of planar
    vehicles."""
    rotor_time_constant_s: float | None
    """None of a vehicle without thrusters."""
    damping_gain_w: float | None
    """Largest power that damping between axes gives the vehicle in still water, see
    `damping.largest_gain_w`; above zero the file is wrong somewhere. None of diagonal damping."""


def describe_vehicle(
    config: VehicleConfig, parameter_set: str | None, voltage_v: float
) -> VehicleProperties:
    """Compute the properties of a vehicle; speeds and periods are those of its base alone.

    Raises:
        ConfigError: unknown set or thruster, or a voltage outside the thruster's data.
    """
    chosen = config.find_set(parameter_set)
    thrust_n, _ = build_thrust_tables(config, voltage_v)
    B = wrench_matrix(config)
    linear = np.asarray(chosen.damping.linear_diagonal[:3])
    quadratic = np.asarray(chosen.damping.quadratic_diagonal[:3])
    speed = compute_abilities(config, chosen, thrust_n).terminal_speed_mps
    slope = linear + 2 * quadratic * speed
    M_A = np.asarray(chosen.added_mass.coefficients)
    links = config.find_links(parameter_set)
    mass_kg = chosen.rigid_body.mass_kg + sum(link.rigid_body.mass_kg for link in links)
    links_m3 = sum(link.buoyancy.volume_m3 for link in links)
    virtual_mass = chosen.rigid_body.mass_kg + np.diag(M_A)[:3]
    return VehicleProperties(
        parameter_set=config.default_set if parameter_set is None else parameter_set,
        mass_kg=mass_kg,
        weight_n=mass_kg * GRAVITY_MPS2,
        buoyancy_n=_buoyancy_n(chosen) + FRESH_WATER_KGPM3 * links_m3 * GRAVITY_MPS2,
        wrench_matrix=B,
        terminal_speed_mps=speed,
        speed_time_constant_s=np.divide(
            virtual_mass, slope, out=np.full(3, np.inf), where=slope > 0
        ),
        roll_period_s=_period_s(chosen, 0),
        pitch_period_s=_period_s(chosen, 1),
        trim_rad=None
        if config.planar
        else compute_trim_rad(np.asarray(chosen.buoyancy.center_of_buoyancy_m)),
        rotor_time_constant_s=config.rotor.lag.time_constant_s if config.rotor else None,
        damping_gain_w=largest_gain_w(chosen.damping) if chosen.damping.couples_axes else None,
    )


def compute_trim_rad(center_of_buoyancy_m: FloatArray) -> tuple[float, float] | None:
    """Return roll and pitch at which the centre of buoyancy is above the centre of mass.

    The world's up in F is then e = (-sin pitch, sin roll cos pitch, cos roll cos pitch).

    Args:
        center_of_buoyancy_m: [3] from the centre of mass, in F.

    Returns:
        rad; None where the centres coincide.
    """
    arm = float(np.linalg.norm(center_of_buoyancy_m))
    if arm < _NO_ARM_M:
        return None
    x, y, z = center_of_buoyancy_m / arm
    return math.atan2(y, z), -math.asin(x)


def _buoyancy_n(chosen: ParameterSet) -> float:
    return FRESH_WATER_KGPM3 * chosen.buoyancy.volume_m3 * GRAVITY_MPS2


def _period_s(chosen: ParameterSet, axis: int) -> float | None:
    """Return undamped small-angle period, diagonal terms.

    T = 2 pi sqrt((I + M_A) / (rho g V z_cb)).
    """
    stiffness = _buoyancy_n(chosen) * chosen.buoyancy.center_of_buoyancy_m[2]
    if stiffness <= 0:
        return None
    inertia = chosen.rigid_body.inertia_kgm2[axis][axis]
    added = chosen.added_mass.coefficients[3 + axis][3 + axis]
    return 2 * math.pi * math.sqrt((inertia + added) / stiffness)
