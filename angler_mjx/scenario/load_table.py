"""The table of a scenario file on the mass and hydrodynamics of goods."""

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.load import Load, add_load
from angler_mjx.robot.vehicles.variation import Variation, heave_forces
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.randomise_table import MAX_HEAVE_FRACTION
from angler_mjx.world.obstacles import Obstacles

SPHERE_CD = 0.47
"""Drag coefficient of a sphere below the drag crisis (Hoerner, Fluid-Dynamic Drag, 1965, ch. 3)."""

type Area = Annotated[float, Field(ge=0.0, le=100.0)]
type Added = Annotated[float, Field(ge=0.0, le=1e4)]


class LoadConfig(FileModel):
    """Compact load at the centre of mass of the robot that carries it; controllers account for it.

    Values left out are those of a sphere of its volume; see `docs/how_to/randomise.md`.
    """

    mass_kg: float = Field(gt=0.0, le=1e4)
    """Mass in air."""
    volume_m3: float = Field(ge=0.0, le=10.0)
    """Displaced volume."""
    drag_area_m2: tuple[Area, Area, Area] | None = None
    """Drag coefficient times area, in surge, sway and heave."""
    added_mass_kg: tuple[Added, Added, Added] | None = None
    """Added mass in surge, sway and heave."""

    def load(self, density_kgpm3: float) -> Load:
        """Return the load in the form that fleets take.

        A sphere's added mass is half the mass of the displaced water (Lamb, Hydrodynamics, 6th ed.
        1932, art. 92).

        Args:
            density_kgpm3: of the water.
        """
        radius = (3.0 * self.volume_m3 / (4.0 * math.pi)) ** (1.0 / 3.0)
        area_m2, added_kg = SPHERE_CD * math.pi * radius**2, 0.5 * density_kgpm3 * self.volume_m3
        return Load(
            mass_kg=self.mass_kg,
            volume_m3=self.volume_m3,
            drag_area_m2=self.drag_area_m2 or (area_m2, area_m2, area_m2),
            added_mass_kg=self.added_mass_kg or (added_kg, added_kg, added_kg),
            density_kgpm3=density_kgpm3,
        )


def split_load(bodies: Obstacles, body: int, headings: np.ndarray, density_kgpm3: float) -> Load:
    """Return the share of each robot in a body that robots carry together.

    Args:
        bodies: explicit obstacles.
        body: index of the carried one.
        headings: [R, 3] directions in which the robots look, in W.
        density_kgpm3: of the water.
    """
    robots = len(headings)
    turn = Rotation.from_quat(np.asarray(bodies.q0[body], float), scalar_first=True).as_matrix()
    yaw = np.arctan2(headings[:, 1], headings[:, 0])
    views = (
        Rotation.from_rotvec(np.outer(yaw, [0.0, 0.0, 1.0])).inv().as_matrix() @ turn
    )  # [R, 3, 3] to robots' frames

    def share(diagonal: np.ndarray) -> tuple[float, float, float]:
        of_axes = np.mean(np.sum(views**2 * diagonal[:3], axis=2), axis=0)
        x, y, z = (of_axes / robots).tolist()
        return x, y, z

    return Load(
        mass_kg=float(bodies.mass_kg[body]) / robots,
        volume_m3=float(bodies.volume_m3[body]) / robots,
        drag_area_m2=share(np.asarray(bodies.D_q[body], float) / (0.5 * density_kgpm3)),
        added_mass_kg=share(np.asarray(bodies.M_A[body], float)),
        density_kgpm3=density_kgpm3,
    )


def check_load(load: Load, fleet: Sequence[FleetEntry], what: str = "task.load") -> None:
    """Refuse a load with which a vehicle cannot hold its depth.

    A vehicle that cannot hold its depth without the load is not checked.

    Args:
        load: of each robot that carries.
        fleet: entries of the scenario.
        what: name of the load in messages.

    Raises:
        ValueError: naming the table and the vehicle.
    """
    for i, entry in enumerate(fleet):
        config = library.load_vehicle(entry.vehicle)
        for name in entry.parameter_set_names():
            conditions = (name, Variation(), entry.battery_v, load.density_kgpm3)
            try:
                unladen_n, force_n = heave_forces(config, *conditions)
                lift_n, _ = heave_forces(add_load(config, name, load), *conditions)
            except ConfigError as error:
                raise ValueError(f"fleet[{i}]: {error}") from error
            if abs(unladen_n) <= MAX_HEAVE_FRACTION * force_n < abs(lift_n):
                raise ValueError(
                    f"{what}: {load.mass_kg:g} kg of {load.volume_m3:g} m3: with it fleet[{i}], "
                    f"vehicle {config.name!r}, parameter set {name!r}, "
                    f"{'rises' if lift_n > 0 else 'sinks'} with {abs(lift_n):.1f} N, and its "
                    f"thrusters give {force_n:.1f} N in heave at {entry.battery_v:g} V; half of "
                    "that may go into holding depth: take a lighter load, or one of more volume"
                )
