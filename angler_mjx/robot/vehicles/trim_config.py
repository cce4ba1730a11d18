"""Models of ballast tanks and moving masses in a vehicle file."""

import itertools
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.hull import Name, Vector3
from angler_mjx.robot.vehicles.rotor_config import Positive, Source


class Tank(FileModel):
    """Ballast tank in the base frame that takes in water of the sea and pumps it out again.

    The parameter sets describe the vehicle with the tank half full.
    """

    name: Name
    """Name for tables."""
    position_m: Vector3
    """[3] centre of its water, m."""
    limit_m3: Positive
    """Half of its volume: water in it is between -limit_m3 and limit_m3 of half full."""
    rate_m3ps: Positive
    """Fastest change of the volume of water."""
    time_constant_s: Positive
    """Lag of the volume behind its command."""
    power_w: Annotated[float, Field(ge=0, le=1e5)] = 0.0
    """Electrical power at the fastest change; in proportion at slower ones."""


class Ballast(FileModel):
    """Ballast tanks; their signals follow those of thrusters and fins."""

    layout: Annotated[tuple[Tank, ...], Field(min_length=1, max_length=8)]
    """Tanks in the order of the signals: 1100 us is empty, 1500 us half full, 1900 us full."""
    source: Source

    @field_validator("layout")
    @classmethod
    def _check_distinct(cls, value: tuple[Tank, ...]) -> tuple[Tank, ...]:
        checks.check_distinct_names("tank", [tank.name for tank in value])
        return value


class MovingMass(FileModel):
    """Mass in the base frame that moves along an axis, such as a battery pack.

    The parameter sets describe the vehicle with the mass in the middle of its way.
    """

    name: Name
    """Name for tables."""
    mass_kg: Positive
    """Mass that moves; part of that of ``rigid_body``."""
    position_m: Vector3
    """[3] its centre of mass in the middle of its way, m."""
    axis: Annotated[tuple[float, float, float], AfterValidator(checks.check_unit_vector)]
    """Unit vector along which it moves at signals above 1500 us."""
    limit_m: Positive
    """Way to either side of the middle."""
    rate_mps: Positive
    """Fastest motion."""
    time_constant_s: Positive
    """Lag of its position behind its command."""
    power_w: Annotated[float, Field(ge=0, le=1e5)] = 0.0
    """Electrical power at the fastest motion; in proportion at slower ones."""


class MovingMasses(FileModel):
    """Moving masses; their signals follow those of thrusters, fins and tanks."""

    layout: Annotated[tuple[MovingMass, ...], Field(min_length=1, max_length=8)]
    """Masses in the order of the signals: 1100 us is -limit_m, 1500 us the middle, 1900 us
    limit_m."""
    source: Source

    @field_validator("layout")
    @classmethod
    def _check_distinct(cls, value: tuple[MovingMass, ...]) -> tuple[MovingMass, ...]:
        checks.check_distinct_names("moving mass", [mass.name for mass in value])
        return value


_SEA_WATER_KGPM3 = 1025.0
"""Density at which the inertia with full and empty tanks is checked."""


def check_inertia(
    tanks: Sequence[Tank],
    masses: Sequence[MovingMass],
    center_m: Sequence[float],
    mass_kg: float,
    inertia_kgm2: Sequence[Sequence[float]],
) -> None:
    """Refuse tanks and masses that leave a vehicle without mass or inertia at some of their ends.

    Args:
        tanks: of the vehicle.
        masses: of the vehicle.
        center_m: [3] its centre of mass in the base frame, m.
        mass_kg: its dry mass.
        inertia_kgm2: [3, 3] its inertia about the centre of mass.

    Raises:
        ValueError: with the reason.
    """
    moved = sum(mass.mass_kg for mass in masses)
    if moved >= mass_kg:
        raise ValueError(f"moving_masses: {moved:g} kg move of {mass_kg:g} kg in all")
    for ends in itertools.product((-1.0, 1.0), repeat=len(tanks) + len(masses)):
        matrix = np.zeros((6, 6))
        matrix[:3, :3] = mass_kg * np.eye(3)
        matrix[3:, 3:] = inertia_kgm2
        for tank, end in zip(tanks, ends, strict=False):
            r = np.subtract(tank.position_m, center_m)
            matrix += _SEA_WATER_KGPM3 * end * tank.limit_m3 * _point_matrix(r)
        for mass, end in zip(masses, ends[len(tanks) :], strict=True):
            r = np.subtract(mass.position_m, center_m)
            there = r + end * mass.limit_m * np.asarray(mass.axis)
            matrix += mass.mass_kg * (_point_matrix(there) - _point_matrix(r))
        if np.linalg.eigvalsh(matrix)[0] <= 0.0:
            raise ValueError(
                "ballast and moving_masses: at some ends of their limits the vehicle would have no "
                "inertia about some axis; give smaller limits, or the inertia that the mass and "
                "inertia of rigid_body include"
            )


def _point_matrix(r: np.ndarray) -> np.ndarray:
    """Return the inertia [6, 6] of one kilogram at r [3]."""
    x, y, z = r
    lever = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return np.block([[np.eye(3), lever], [lever.T, lever.T @ lever]])
