"""Load that a vehicle carries: its additions to the vehicle's parameters.

A compact body that is held at the vehicle's centre of mass, so that centre does not move and the
load's weight and drag exert no moment. Its parameters are added to the vehicle's: the hydrodynamic
interaction of load and vehicle is left out, as in the sum of parts of Fossen (Handbook of Marine
Craft Hydrodynamics and Motion Control, 2nd ed. 2021, 8.4.2: drag of a body from drag areas, F = 1/2
rho Cd A |u| u).
"""

from dataclasses import dataclass

import numpy as np

from angler_mjx.robot.vehicles.checks import Matrix
from angler_mjx.robot.vehicles.config import VehicleConfig

type Three = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Load:
    """Carried body; axes are those of F."""

    mass_kg: float
    volume_m3: float
    """Displaced volume, fully submerged."""
    drag_area_m2: Three
    """Cd A in surge, sway and heave."""
    added_mass_kg: Three
    """Added mass in surge, sway and heave."""
    density_kgpm3: float
    """Density of the water, for the drag."""


def add_load(config: VehicleConfig, parameter_set: str, load: Load) -> VehicleConfig:
    """Return vehicle file of a robot that carries a load: the sum of a parameter set and the load.

    The load's mass has no inertia about the centre of mass; its buoyancy acts there too, so the
    centre of buoyancy of both lies between it and the vehicle's own.

    Raises:
        ConfigError: the vehicle has no such set.
    """
    parameters = config.find_set(parameter_set)
    body, water, damping = parameters.rigid_body, parameters.buoyancy, parameters.damping
    volume = water.volume_m3 + load.volume_m3
    center = np.asarray(water.center_of_buoyancy_m) * (water.volume_m3 / volume)
    drag = 0.5 * load.density_kgpm3 * np.array([*load.drag_area_m2, 0.0, 0.0, 0.0])
    added = np.asarray(parameters.added_mass.coefficients) + np.diag([*load.added_mass_kg, 0, 0, 0])
    made = parameters.model_copy(
        update={
            "rigid_body": body.model_copy(update={"mass_kg": body.mass_kg + load.mass_kg}),
            "buoyancy": water.model_copy(
                update={"volume_m3": volume, "center_of_buoyancy_m": tuple(center.tolist())}
            ),
            "added_mass": parameters.added_mass.model_copy(
                update={"coefficients": tuple(map(tuple, added.tolist()))}
            ),
            "damping": damping.model_copy(
                update={"quadratic": _add_diagonal(damping.quadratic, drag)}
            ),
        }
    )
    return config.model_copy(
        update={"parameter_sets": {**config.parameter_sets, parameter_set: made}}
    )


def _add_diagonal(table: tuple[float, ...] | Matrix, diagonal: np.ndarray) -> tuple[object, ...]:
    """Return six values of damping or six rows of them with a diagonal [6] added."""
    values = np.asarray(table)
    if values.ndim == 1:
        return tuple((values + diagonal).tolist())
    return tuple(map(tuple, (values + np.diag(diagonal)).tolist()))
