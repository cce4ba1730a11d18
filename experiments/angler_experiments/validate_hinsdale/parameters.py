"""Identified parameters: how they change a vehicle, and their priors.

Every parameter is a number of prior mean 0 and prior standard deviation 1. Positive quantities are
scaled by the exponential of the parameter times a spread, others shifted by it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_experiments.validate_hinsdale.vehicle import CampaignVehicle
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.robot.vehicles.params import VehicleParams


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Group of parameters that one function applies."""

    name: str
    labels: tuple[str, ...]
    """Names of the components."""
    spread: tuple[float, ...]
    """Prior standard deviation of each: of the logarithm, or in the unit of ``unit``."""
    unit: str
    """``log`` for factors."""
    apply: Callable[[CampaignVehicle, jax.Array], CampaignVehicle]
    """Vehicle with the group's numbers, spread included, [k] applied."""


_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def _with_params(vehicle: CampaignVehicle, params: VehicleParams) -> CampaignVehicle:
    return replace(vehicle, params=params)


def _with_links(vehicle: CampaignVehicle, links: LinkParams) -> CampaignVehicle:
    return replace(vehicle, params=replace(vehicle.params, links=links))


def _shift_center(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    params = vehicle.params
    return _with_params(vehicle, replace(params, p_cb_m=params.p_cb_m + x))


def _shift_volume(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    params = vehicle.params
    return _with_params(vehicle, replace(params, volume_m3=params.volume_m3 + 1e-3 * x[0]))


def _scale_added_mass(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    params, factor = vehicle.params, jnp.exp(0.5 * x)
    added = params.M_A * factor[:, None] * factor[None, :]
    return _with_params(vehicle, replace(params, M_A=added))


def _scale_linear(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    params = vehicle.params
    return _with_params(vehicle, replace(params, D_l=params.D_l * jnp.exp(x)))


def _scale_quadratic(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    params = vehicle.params
    return _with_params(vehicle, replace(params, D_q=params.D_q * jnp.exp(x)))


def _scale_inertia(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    params, factor = vehicle.params, jnp.exp(0.5 * x)
    inertia = params.inertia_kgm2 * factor[:, None] * factor[None, :]
    return _with_params(vehicle, replace(params, inertia_kgm2=inertia))


def _scale_arm_mass(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    """Scale masses of upper arm, and of wrist and jaws."""
    links, zero = vehicle.links, jnp.zeros_like(x[0])
    factor = jnp.exp(jnp.stack([zero, zero, x[0], zero, x[1], x[1]]))
    return _with_links(vehicle, replace(links, mass_kg=links.mass_kg * factor))


def _scale_arm_water(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    """Scale the links' added mass and drag."""
    links, drag = vehicle.links, jnp.exp(x[1])
    scaled = replace(
        links,
        added_volume=links.added_volume * jnp.exp(x[0]),
        normal_area_m2=links.normal_area_m2 * drag,
        axial_area_m2=links.axial_area_m2 * drag,
    )
    return _with_links(vehicle, scaled)


def _shift_zeros(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    links = vehicle.links
    zero = links.zero + jnp.append(x, jnp.zeros(2))
    return _with_links(vehicle, replace(links, zero=zero))


def _turn_markers(vehicle: CampaignVehicle, x: jax.Array) -> CampaignVehicle:
    return replace(vehicle, marker_yaw_rad=vehicle.marker_yaw_rad + x[0])


PARAMETERS = (
    Parameter(
        name="center_of_buoyancy",
        labels=("x", "y", "z"),
        spread=(0.005, 0.005, 0.012),  # published heights: 10 to 49 mm
        unit="m",
        apply=_shift_center,
    ),
    Parameter(
        name="volume",
        labels=("hull",),
        spread=(0.03,),  # 0.3 N
        unit="l",
        apply=_shift_volume,
    ),
    Parameter(
        name="added_mass",
        labels=_AXES,
        spread=(0.6,) * 6,
        unit="log",
        apply=_scale_added_mass,
    ),
    Parameter(
        name="linear_damping",
        labels=_AXES,
        spread=(1.0,) * 6,
        unit="log",
        apply=_scale_linear,
    ),
    Parameter(
        name="quadratic_damping",
        labels=_AXES,
        spread=(1.0,) * 6,
        unit="log",
        apply=_scale_quadratic,
    ),
    Parameter(
        name="inertia",
        labels=_AXES[3:],
        spread=(0.3,) * 3,
        unit="log",
        apply=_scale_inertia,
    ),
    Parameter(
        name="arm_mass",
        labels=("upper arm", "wrist and jaw"),
        spread=(0.1, 0.1),  # the manufacturer's two tables differ by as much
        unit="log",
        apply=_scale_arm_mass,
    ),
    Parameter(
        name="arm_water",
        labels=("added mass", "drag"),
        spread=(0.3, 0.5),
        unit="log",
        apply=_scale_arm_water,
    ),
    Parameter(
        name="joint_zero",
        labels=("axis_e", "axis_d", "axis_c"),
        spread=(0.07, 0.03, 0.03),  # the authors' zero of axis_e is 0.07 rad off the maker's
        unit="rad",
        apply=_shift_zeros,
    ),
    Parameter(
        name="marker_yaw",
        labels=("yaw",),
        spread=(0.1,),
        unit="rad",
        apply=_turn_markers,
    ),
)
"""All identified parameters, in the order of the vector. Log spreads are those of the published
sets, rounded up; von Benzon's tether and Gazebo's absent added mass are not counted."""

LABELS = tuple(f"{group.name} {label}" for group in PARAMETERS for label in group.labels)
"""Names of the vector's components."""

SPREAD = tuple(spread for group in PARAMETERS for spread in group.spread)
"""Prior standard deviations of the components, in their units."""


def apply_parameters(vehicle: CampaignVehicle, vector: jax.Array) -> CampaignVehicle:
    """Return the vehicle with a vector [k] of standardised parameters applied."""
    first = 0
    for group in PARAMETERS:
        after = first + len(group.labels)
        vehicle = group.apply(vehicle, vector[first:after] * jnp.array(group.spread))
        first = after
    return vehicle
