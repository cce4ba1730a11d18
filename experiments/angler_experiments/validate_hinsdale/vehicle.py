"""Vehicle of the campaign: a parameter set with the campaign's ballast, foam and sensors."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.link_motion import locate_links
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.robot.vehicles.params import VehicleParams, build_vehicle
from angler_mjx.sim.physics.step import Water

type Array = np.ndarray

FILE, SOURCE_SET = "bluerov2_heavy_alpha5", "hinsdale2023_authors"
"""Vehicle file, and name of the vehicle as the campaign's authors set it."""
WATER = Water(density_kgpm3=997.0, gravity_mps2=9.81)
"""Water and gravity of the campaign."""
MASS_KG, DISPLACED_KG = 13.17, 13.082
"""Weight and displaced water of the vehicle without extras and arm, by the authors."""
CENTER_M = (0.0074, 0.0, 0.02)
"""Centre of buoyancy, by the authors, who fitted its x to the mean pitch of recordings."""
TOTAL_INERTIA_KGM2 = (0.295, 0.382, 0.600)
"""Inertia with added mass, by the authors."""
JOINT_ZERO_RAD = (3.07, 0.0, 0.0, 2.879)
"""Recorded positions of axis_e, d, c, b at which the authors' chain is at zero."""
FOLDED_RAD = (3.07, 0.08, 0.03, 1.61)
"""Folded arm, as recorded before most runs."""
JAW_OFFSET_M = -0.05035
"""From the jaws' frame of the vehicle file to the authors' centre of the jaw, along the wrist."""


@dataclass(frozen=True, kw_only=True)
class Extra:
    """Part bolted to the vehicle."""

    lift_n: float
    """Net lift in water; negative for a weight."""
    position_m: tuple[float, float, float]
    """From the centre of mass of the bare vehicle."""
    density_kgpm3: float
    """For its mass; our estimate, as the campaign gives weights in water alone."""


LEAD, ALUMINIUM, FOAM = 11_340.0, 2_700.0, 192.0
"""Densities, kg/m^3; foam: subsea buoyancy foam of the vehicle's manufacturer."""
EXTRAS = (
    Extra(lift_n=-3.24, position_m=(-0.20, 0.165, -0.075), density_kgpm3=LEAD),
    Extra(lift_n=-1.62, position_m=(-0.0975, 0.1275, -0.1325), density_kgpm3=LEAD),
    Extra(lift_n=-1.62, position_m=(-0.0975, -0.1275, -0.1325), density_kgpm3=LEAD),
    Extra(lift_n=-0.69, position_m=(-0.1887, 0.0439, -0.0595), density_kgpm3=ALUMINIUM),
    Extra(lift_n=-1.01, position_m=(-0.1542, 0.0439, -0.0795), density_kgpm3=ALUMINIUM),
    Extra(lift_n=8.46, position_m=(0.0, 0.11, 0.027), density_kgpm3=FOAM),
    Extra(lift_n=8.86, position_m=(0.0, -0.11, 0.027), density_kgpm3=FOAM),
)
"""Counterweight, two weights, velocity log, bracket and two foams of the campaign."""

_LINK_MASS_KG = (0.341, 0.194, 0.429, 0.115, 0.333, 0.05)
_LINK_VOLUME_M3 = (0.202e-3, 0.018e-3, 0.203e-3, 0.025e-3, 0.155e-3, 0.02e-3)
_LINK_MASS_CENTER_M = (
    (-0.075, -0.006, -0.003),
    (0.005, -0.001, 0.016),
    (0.073, 0.0, 0.0),
    (0.017, -0.026, -0.002),
    (0.0, 0.0, -0.098),
    (0.0, 0.0, JAW_OFFSET_M),
)
_LINK_BUOYANCY_CENTER_M = (
    (-0.075, -0.006, -0.003),
    (-0.001, -0.003, 0.032),
    (0.073, 0.0, -0.002),
    (0.003, 0.001, -0.017),
    (0.0, 0.0, -0.098),
    (0.0, 0.0, JAW_OFFSET_M),
)
"""The authors' arm: base, shoulder, upper arm, elbow, wrist, jaw, in the frames of the vehicle
file, which are the same (src/julia-sim/ConfigFiles/MagicNumAlpha.jl of their repository)."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CampaignVehicle:
    """Vehicle with extras and arm."""

    params: VehicleParams
    """Extras are part of the base; F has its origin at the centre of mass of both."""
    marker_yaw_rad: jax.Array
    """[] yaw of the marker body in the vehicle."""

    @property
    def links(self) -> LinkParams:
        """Return the links of the arm."""
        if self.params.links is None:
            raise ValueError(f"{FILE}: no links")
        return self.params.links


def build_campaign_vehicle(name: str) -> CampaignVehicle:
    """Return the vehicle of a set: one of the vehicle file, or `SOURCE_SET`.

    Sets of the file keep their mass, inertia, added mass, damping, height of the centre of buoyancy
    and arm. The volume and the horizontal position of that centre are trimmed so that the vehicle
    with its arm folded has the net lift and the moment of the authors' vehicle, as every vehicle is
    trimmed before a dive: untrimmed they hang 0.3 rad nose down. Joints have the authors' zeros.
    """
    config = load_vehicle(FILE)
    is_source = name == SOURCE_SET
    params = build_vehicle(config, "wu2018" if is_source else name, 16.0)
    # The file's centres of buoyancy hold a float for the arm; heights are those of the bare one.
    bare = load_vehicle("bluerov2_heavy").find_set("wu2018" if is_source else name)
    height = bare.buoyancy.center_of_buoyancy_m[2]
    mass, inertia = float(params.mass_kg), np.asarray(params.inertia_kgm2, float)
    if is_source:
        mass, height = MASS_KG, CENTER_M[2]
        inertia = np.diag(TOTAL_INERTIA_KGM2) - np.asarray(params.M_A, float)[3:, 3:]
    vehicle = CampaignVehicle(params=params, marker_yaw_rad=jnp.zeros(()))
    vehicle = _add_extras(_set_arm(vehicle, is_source=is_source), mass, inertia, height)
    return vehicle if is_source else _trim(vehicle, build_campaign_vehicle(SOURCE_SET))


def _set_arm(vehicle: CampaignVehicle, *, is_source: bool) -> CampaignVehicle:
    """Return the vehicle with the authors' zeros of joints and, for their set, their arm."""
    zero = jnp.append(jnp.array(JOINT_ZERO_RAD), 0.0)
    links = replace(vehicle.links, zero=zero)
    if is_source:
        links = replace(
            links,
            mass_kg=jnp.array(_LINK_MASS_KG),
            volume_m3=jnp.array(_LINK_VOLUME_M3),
            center_of_mass_m=jnp.array(_LINK_MASS_CENTER_M),
            center_of_buoyancy_m=jnp.array(_LINK_BUOYANCY_CENTER_M),
        )
    return replace(vehicle, params=replace(vehicle.params, links=links))


def _add_extras(
    vehicle: CampaignVehicle, mass_kg: float, inertia: Array, height_m: float
) -> CampaignVehicle:
    """Return the vehicle with the authors' net weight and the extras as part of its base.

    Damping and added mass stay as they are about the new centre of mass, 15 mm away.

    Args:
        vehicle: with the arm.
        mass_kg: of the bare vehicle.
        inertia: [3, 3] of the bare vehicle about its centre of mass.
        height_m: of the centre of buoyancy of the bare vehicle.
    """
    displaced = mass_kg - MASS_KG + DISPLACED_KG
    center = np.array([CENTER_M[0] * DISPLACED_KG / displaced, 0.0, height_m])
    extras = extra_bodies(mass_kg)
    volumes = np.append(displaced / WATER.density_kgpm3, extras.volume_m3)
    buoyancy_center = volumes @ np.vstack([center, extras.position_m]) / volumes.sum()
    middle = extras.center_of_mass_m
    links = vehicle.links
    # Only the arm's base is mounted on the vehicle.
    mounts = links.position_m - jnp.asarray(middle) * jnp.eye(len(links.mass_kg))[:, :1]
    params = replace(
        vehicle.params,
        mass_kg=jnp.asarray(mass_kg + extras.mass_kg.sum()),
        inertia_kgm2=jnp.asarray(inertia + extras.inertia_kgm2),
        volume_m3=jnp.asarray(volumes.sum()),
        p_cb_m=jnp.asarray(buoyancy_center - middle),
        links=replace(links, position_m=mounts),
    )
    return replace(vehicle, params=params)


@dataclass(frozen=True, kw_only=True)
class ExtraBodies:
    """The extras as bodies on a vehicle whose own centre of mass is the origin."""

    mass_kg: Array
    """[n]."""
    volume_m3: Array
    """[n]."""
    position_m: Array
    """[n, 3]."""
    center_of_mass_m: Array
    """[3] of vehicle and extras."""
    inertia_kgm2: Array
    """[3, 3] added to the vehicle's by taking both about their common centre of mass."""


def extra_bodies(mass_kg: float) -> ExtraBodies:
    """Return the extras on a vehicle of a mass [kg]."""
    masses = np.array([mass_kg, *(_mass_kg(extra) for extra in EXTRAS)])
    lifts = np.array([extra.lift_n for extra in EXTRAS]) / WATER.gravity_mps2
    points = np.array([extra.position_m for extra in EXTRAS])
    all_points = np.concatenate([np.zeros((1, 3)), points])
    middle = masses @ all_points / masses.sum()
    inertia = sum(
        mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        for mass, arm in zip(masses, all_points - middle, strict=True)
    )
    return ExtraBodies(
        mass_kg=masses[1:],
        volume_m3=(lifts + masses[1:]) / WATER.density_kgpm3,
        position_m=points,
        center_of_mass_m=middle,
        inertia_kgm2=np.asarray(inertia),
    )


def _mass_kg(extra: Extra) -> float:
    """Return the mass [kg] of a part from its lift and density."""
    return extra.lift_n / WATER.gravity_mps2 / (WATER.density_kgpm3 / extra.density_kgpm3 - 1.0)


def _trim(vehicle: CampaignVehicle, other: CampaignVehicle) -> CampaignVehicle:
    """Return the vehicle with the net lift and horizontal moment of another, arm folded."""
    folded = jnp.array(FOLDED_RAD)
    (lift, moment), (other_lift, other_moment) = (lift_moment(x, folded) for x in (vehicle, other))
    rho_g = WATER.density_kgpm3 * WATER.gravity_mps2
    volume, center = vehicle.params.volume_m3, vehicle.params.p_cb_m
    trimmed = volume + (other_lift - lift) / rho_g
    first = volume * center[:2] + (other_moment - moment)[:2] / rho_g
    center = jnp.append(first / trimmed, center[2])
    return replace(vehicle, params=replace(vehicle.params, volume_m3=trimmed, p_cb_m=center))


def lift_moment(vehicle: CampaignVehicle, joint_rad: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return net lift [] N and its first moment [3] N m about the origin, of vehicle and arm.

    Args:
        vehicle: parameters.
        joint_rad: [4] positions of axis_e, d, c, b, as recorded.
    """
    params, links = vehicle.params, vehicle.links
    poses = locate_links(links, jnp.append(joint_rad, 0.0))
    to_buoyancy = links.center_of_buoyancy_m[:, None, :]
    buoyancy = poses.origin + jnp.sum(poses.rotation * to_buoyancy, axis=2)
    rho_g = WATER.density_kgpm3 * WATER.gravity_mps2
    weight, lift = WATER.gravity_mps2 * links.mass_kg, rho_g * links.volume_m3
    hull = rho_g * params.volume_m3
    net = hull - WATER.gravity_mps2 * params.mass_kg + jnp.sum(lift - weight)
    arm = jnp.sum(lift[:, None] * buoyancy - weight[:, None] * poses.center, axis=0)
    return net, hull * params.p_cb_m + arm
