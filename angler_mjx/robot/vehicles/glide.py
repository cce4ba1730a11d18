"""Steady glides of a vehicle without thrust: speeds, and where its moving mass has to be.

In the vertical plane, at a pitch theta (bow up) and with a net weight W (heavy: positive), the
velocity (u, 0, w) through still water, in F, balances::

    X(u, w) = W sin theta,   Z(u, w) = W cos theta

with X and Z of the damping; the moments about y then say where along its axis the mass is. Such
glides are the equilibria of Graver (PhD thesis, Princeton 2005, chapter 5) and of Leonard and
Graver (IEEE J. Oceanic Eng. 26(4), 2001). Fins are left out (host side).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import root

from angler_kernels.cross_damping import PRODUCT_PAIRS
from angler_mjx.robot.vehicles.config import ParameterSet, VehicleConfig
from angler_mjx.robot.vehicles.derivatives import read_product
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.robot.vehicles.trim_config import MovingMass, Tank

_GRAVITY_MPS2 = 9.81
_DENSITY_KGPM3 = 1025.0
"""Of sea water, in which gliders are trimmed."""
_PITCHES_RAD = np.radians(np.arange(10.0, 61.0, 2.5))
"""Pitches of the glides that are looked at, bow down."""


@dataclass(frozen=True, kw_only=True)
class Glide:
    """Steady glide in still water."""

    pitch_rad: float
    """Bow up: negative where the vehicle sinks."""
    velocity_mps: FloatArray
    """[2] u and w through the water, in F."""
    mass_m: float
    """Position of the moving mass along its axis."""

    @property
    def horizontal_mps(self) -> float:
        """Return the speed over ground."""
        u, w = self.velocity_mps
        return float(u * np.cos(self.pitch_rad) - w * np.sin(self.pitch_rad))

    @property
    def vertical_mps(self) -> float:
        """Return the speed upward."""
        u, w = self.velocity_mps
        return float(u * np.sin(self.pitch_rad) + w * np.cos(self.pitch_rad))


def find_mass(config: VehicleConfig, axis: int) -> MovingMass | None:
    """Return the mass of a vehicle that moves along axis 0, 1 or 2 of F; None without one."""
    along = [mass for mass in config.masses if abs(mass.axis[axis]) > 0.9]
    return max(along, key=lambda mass: mass.mass_kg * mass.limit_m, default=None)


def solve_glide(
    config: VehicleConfig, chosen: ParameterSet, water_m3: float, pitch_rad: float
) -> Glide | None:
    """Return the glide at a pitch with so much water beyond half full in the largest tank.

    The vehicle weighs as much as the water that it displaces when the tank is half full.

    Args:
        config: of the vehicle.
        chosen: parameter set.
        water_m3: in the tank; positive sinks.
        pitch_rad: bow up.

    Returns:
        The glide; None where there is none ahead, or no tank or moving mass along x.
    """
    tank, mass = find_tank(config), find_mass(config, 0)
    if tank is None or mass is None:
        return None
    heavy_n = _DENSITY_KGPM3 * water_m3 * _GRAVITY_MPS2
    up = np.array([np.sin(pitch_rad), 0.0, np.cos(pitch_rad)])

    def excess(uw: FloatArray) -> FloatArray:
        missing: FloatArray = (_damping(chosen, uw)[:3] - heavy_n * up)[[0, 2]]
        return missing

    start = np.sqrt(abs(heavy_n * up[0]) / max(chosen.damping.quadratic_diagonal[0], 1e-3))
    solution = root(excess, np.array([start, -0.02 * start * np.sign(heavy_n)]))
    if not solution.success or solution.x[0] <= 0.0:
        return None
    velocity = np.array([solution.x[0], 0.0, solution.x[1]])
    momentum = np.asarray(chosen.added_mass.coefficients)[:3, :3] @ velocity
    moment = _damping(chosen, solution.x)[3:] - np.cross(velocity, momentum)
    lift_n = (chosen.rigid_body.mass_kg * _GRAVITY_MPS2) * up
    moment += np.cross(chosen.buoyancy.center_of_buoyancy_m, lift_n)
    arm = np.subtract(tank.position_m, config.base.center_of_mass_m)
    moment -= np.cross(arm, heavy_n * up)
    per_metre = -mass.mass_kg * _GRAVITY_MPS2 * np.cross(mass.axis, up)
    return Glide(
        pitch_rad=pitch_rad,
        velocity_mps=solution.x,
        mass_m=float(-moment[1] / per_metre[1]),
    )


def find_tank(config: VehicleConfig) -> Tank | None:
    """Return the largest tank of a vehicle; None without one."""
    return max(config.tanks, key=lambda tank: tank.limit_m3, default=None)


def best_glide(config: VehicleConfig, chosen: ParameterSet) -> tuple[Glide, Glide] | None:
    """Return the fastest glides over ground down and up, at one angle of pitch.

    With the tank full and empty; None where no such glide is within the way of the moving mass.
    """
    tank, mass = find_tank(config), find_mass(config, 0)
    if tank is None or mass is None:
        return None
    best: tuple[Glide, Glide] | None = None
    for pitch in _PITCHES_RAD:
        down = solve_glide(config, chosen, tank.limit_m3, -pitch)
        up = solve_glide(config, chosen, -tank.limit_m3, pitch)
        if down is None or up is None or max(abs(down.mass_m), abs(up.mass_m)) > mass.limit_m:
            continue
        if best is None or slower_mps(down, up) > slower_mps(*best):
            best = down, up
    return best


def slower_mps(down: Glide, up: Glide) -> float:
    """Return the speed over ground of the slower of two glides."""
    return min(down.horizontal_mps, up.horizontal_mps)


def _damping(chosen: ParameterSet, uw: FloatArray) -> FloatArray:
    """Return the wrench [6] of damping at u and w [2]."""
    nu = np.array([uw[0], 0.0, uw[1], 0.0, 0.0, 0.0])
    damping = chosen.damping
    wrench = -damping.linear_matrix @ nu - damping.quadratic_matrix @ (np.abs(nu) * nu)
    for name, value in damping.products.items():
        row, column = read_product(name)
        j, k = PRODUCT_PAIRS[column]
        wrench[row] += value * nu[j] * nu[k]
    result: FloatArray = wrench
    return result
