"""Deviation of one robot from its vehicle file: factors on the numbers of a parameter set.

A varied vehicle is a vehicle file with other numbers: models and checks treat it as any other. The
inertia varies with the mass. Added mass keeps its symmetry and stays positive definite: element ij
varies with the root of the product of the factors of i and j.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from angler_mjx.robot.vehicles.checks import Matrix
from angler_mjx.robot.vehicles.config import Damping, ParameterSet, VehicleConfig
from angler_mjx.robot.vehicles.derivatives import read_product
from angler_mjx.robot.vehicles.drive import full_force, wrench_matrix
from angler_mjx.robot.vehicles.links import Link, LinkNumbers
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.robot.vehicles.thrust_curves import build_thrust_tables, thrust_ends

type Six = tuple[float, float, float, float, float, float]
_ONES: Six = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Variation:
    """Factors; 1 for the number of the file."""

    number: int = 0
    """Index in the bank of its parameter set."""
    mass: float = 1.0
    """Factor of dry mass and inertia."""
    buoyancy: float = 1.0
    """Factor of the displaced volume."""
    damping: Six = _ONES
    """Factors of linear and quadratic damping, by axis [u v w p q r]."""
    added_mass: Six = _ONES
    """Factors of added mass, by axis [u v w p q r]."""
    thrust: tuple[float, ...] = ()
    """Fraction of its thrust that each thruster gives, gain and faults together, in the order of
    the file; 1 if left out."""
    battery_v: float | None = None
    """Battery voltage, V; the robot's own if left out."""
    deviations: tuple[float, ...] = ()
    """[k] deviations of the uncertain numbers of the parameter set, in the order of
    `Uncertainty.labels`; empty for the numbers of the file."""


def apply_variation(
    config: VehicleConfig, parameter_set: str, variation: Variation
) -> VehicleConfig:
    """Return the vehicle file of one robot, with its ``parameter_set`` varied.

    Raises:
        ConfigError: the vehicle has no such set.
    """
    parameters = _deviate(config, parameter_set, variation.deviations)
    body, water = parameters.rigid_body, parameters.buoyancy
    root = np.sqrt(np.asarray(variation.added_mass))
    added = np.asarray(parameters.added_mass.coefficients) * np.outer(root, root)
    damping = _scale_damping(parameters.damping, variation.damping, variation.damping)
    inertia = np.asarray(body.inertia_kgm2) * variation.mass
    made = parameters.model_copy(
        update={
            "rigid_body": body.model_copy(
                update={"mass_kg": body.mass_kg * variation.mass, "inertia_kgm2": _to_rows(inertia)}
            ),
            "buoyancy": water.model_copy(
                update={"volume_m3": water.volume_m3 * variation.buoyancy}
            ),
            "added_mass": parameters.added_mass.model_copy(
                update={"coefficients": _to_rows(added)}
            ),
            "damping": damping,
        }
    )
    sets: Mapping[str, object] = {**config.parameter_sets, parameter_set: made}
    return config.model_copy(update={"parameter_sets": sets})


def _deviate(
    config: VehicleConfig, parameter_set: str, deviations: tuple[float, ...]
) -> ParameterSet:
    """Return a parameter set with deviations [k] of its uncertain numbers."""
    chosen = config.find_set(parameter_set)
    if not deviations or chosen.uncertainty is None:
        return chosen
    by_key = chosen.uncertainty.split(deviations)
    water, damping = chosen.buoyancy, chosen.damping
    center = np.asarray(water.center_of_buoyancy_m) + by_key.get("center_of_buoyancy_m", 0.0)
    root = np.exp(0.5 * by_key.get("added_mass", np.zeros(6)))
    added = np.asarray(chosen.added_mass.coefficients) * np.outer(root, root)
    linear, quadratic = (
        np.exp(by_key.get(f"{name}_damping", np.zeros(6))) for name in ("linear", "quadratic")
    )
    return chosen.model_copy(
        update={
            "buoyancy": water.model_copy(
                update={
                    "volume_m3": water.volume_m3 + float(np.sum(by_key.get("volume_m3", 0.0))),
                    "center_of_buoyancy_m": tuple(center.tolist()),
                }
            ),
            "added_mass": chosen.added_mass.model_copy(update={"coefficients": _to_rows(added)}),
            "damping": _scale_damping(damping, linear, quadratic),
            "links": _deviate_links(config, parameter_set, by_key),
        }
    )


def _scale_damping(damping: Damping, linear: ArrayLike, quadratic: ArrayLike) -> Damping:
    """Return damping with factors [6] by axis; between axes the root of the product of two.

    Derivatives by products of velocities take the factor of their force in ``quadratic``.
    """
    factors = np.asarray(quadratic, float)
    return damping.model_copy(
        update={
            "linear": _scale_table(damping.linear, np.asarray(linear, float)),
            "quadratic": _scale_table(damping.quadratic, factors),
            "products": {
                name: value * float(factors[read_product(name)[0]])
                for name, value in damping.products.items()
            },
        }
    )


def _scale_table(
    table: tuple[float, ...] | Matrix, factors: np.ndarray
) -> tuple[float, ...] | Matrix:
    values = np.asarray(table, float)
    if values.ndim == 1:
        return tuple((values * factors).tolist())
    return _to_rows(values * np.sqrt(np.outer(factors, factors)))


def _deviate_links(
    config: VehicleConfig, parameter_set: str, by_key: Mapping[str, np.ndarray]
) -> dict[str, LinkNumbers]:
    """Return the numbers of all links with deviations of masses, added mass and drag by key."""
    uncertainty = config.find_set(parameter_set).uncertainty
    names = uncertainty.link_mass if uncertainty else {}
    mass = dict(zip(names, np.exp(by_key["link_mass"]).tolist(), strict=True))
    added, drag = (
        float(np.exp(np.sum(by_key.get(key, 0.0)))) for key in ("link_added_mass", "link_drag")
    )
    return {
        link.name: _scale_link(link, mass.get(link.name, 1.0), added, drag)
        for link in config.find_links(parameter_set)
    }


def _scale_link(link: Link, mass: float, added: float, drag: float) -> LinkNumbers:
    """Return the numbers of a link with its mass, added mass and drag scaled."""
    cylinders = tuple(
        cylinder.model_copy(
            update={
                "added_mass": added * cylinder.added_mass,
                "normal_drag": drag * cylinder.normal_drag,
                "axial_drag": drag * cylinder.axial_drag,
            }
        )
        for cylinder in link.water.cylinders
    )
    body = link.rigid_body
    return LinkNumbers(
        rigid_body=body.model_copy(update={"mass_kg": mass * body.mass_kg}),
        buoyancy=link.buoyancy,
        water=link.water.model_copy(update={"cylinders": cylinders}),
    )


def _to_rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in matrix)


def heave_forces(
    config: VehicleConfig,
    parameter_set: str,
    variation: Variation,
    battery_v: float,
    density_kgpm3: float,
) -> tuple[float, float]:
    """Return the net buoyancy of a vehicle under water and its available thrust in heave.

    Args:
        config: vehicle file.
        parameter_set: name of one of its sets.
        variation: its variation; ``thrust`` may be one number for all thrusters.
        battery_v: voltage where the variation has none.
        density_kgpm3: density of the water.

    Returns:
        Buoyancy less weight, N, and the heave thrust that is available in both directions, N.

    Raises:
        ConfigError: the vehicle has no such set, or the voltage lies outside the thruster's data.
    """
    chosen = apply_variation(config, parameter_set, variation).find_set(parameter_set)
    volts = battery_v if variation.battery_v is None else variation.battery_v
    thrust_n, _ = build_thrust_tables(config, volts)
    row = wrench_matrix(config)[2:3] * np.asarray(variation.thrust or 1.0)
    force_n = float(full_force(row, *thrust_ends(thrust_n))[0])
    displaced_kg = density_kgpm3 * chosen.buoyancy.volume_m3
    return (displaced_kg - chosen.rigid_body.mass_kg) * GRAVITY_MPS2, force_n
