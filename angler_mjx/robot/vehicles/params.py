"""Physical parameters of one robot: a pytree of arrays, compiled from a vehicle file.

Everything is about the robot's centre of mass, in F (x forward, y left, z up). Compilation runs
once, on the host, in float64; the arrays have JAX's default float type.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from angler_mjx.robot.vehicles.abilities import compute_abilities
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.damping import (
    CrossDamping,
    build_cross_damping,
    pad_cross_damping,
)
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.fins import FinParams, build_fins, pad_fins
from angler_mjx.robot.vehicles.hull_bodies import (
    HullBodies,
    build_hull_bodies,
    pad_hull_bodies,
)
from angler_mjx.robot.vehicles.link_hull import (
    LinkCapsules,
    build_link_capsules,
    home_link_reach_m,
    pad_link_capsules,
)
from angler_mjx.robot.vehicles.link_params import LinkParams, build_links, pad_links
from angler_mjx.robot.vehicles.rotor import RotorFilter
from angler_mjx.robot.vehicles.rotor_config import RotorResponse
from angler_mjx.robot.vehicles.thrust_curves import build_thrust_tables
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.robot.vehicles.trim import TrimParams, build_trim, pad_trim

_PLANAR_AXES = (1.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class VehicleParams:
    """Parameters of one robot; ``n_t`` and ``c`` include padding after ``stack_vehicles``."""

    mass_kg: jax.Array
    """[] dry mass."""
    inertia_kgm2: jax.Array
    """[3, 3] about the centre of mass, in F."""
    M_A: jax.Array
    """[6, 6] added mass, positive; kg, kg m, kg m^2."""
    D_l: jax.Array
    """[6] linear damping, positive; N s/m, N m s/rad."""
    D_q: jax.Array
    """[6] quadratic damping, positive; N s^2/m^2, N m s^2/rad^2."""
    volume_m3: jax.Array
    """[] displaced volume, fully submerged."""
    p_cb_m: jax.Array
    """[3] centre of buoyancy from the centre of mass."""
    hull_height_m: jax.Array
    """[] height over which buoyancy fades at the surface."""
    B: jax.Array
    """[6, n_t] wrench per newton of thrust, reaction torque included; zero in columns of padding
    and of fins, tanks and moving masses, which stand behind the thrusters."""
    thrust_n: jax.Array
    """[201] thrust on the PWM grid 1100, 1104 ... 1900 us, at the robot's voltage; [n_t, 201] where
    a thruster of one vehicle of the fleet has a curve of its file."""
    power_w: jax.Array
    """[201] electrical power on the same grid, or [n_t, 201]."""
    tau_s: jax.Array
    """[] time constant of the rotors, of first order; [n_t] where those of one vehicle of the fleet
    differ."""
    capsule_a_m: jax.Array
    """[c, 3] first end of each hull capsule's axis; padding repeats the last capsule."""
    capsule_b_m: jax.Array
    """[c, 3] second end."""
    capsule_r_m: jax.Array
    """[c] radius of each capsule."""
    radius_m: jax.Array
    """[] smallest sphere about the centre of mass that holds the hull, links in their home
    posture."""
    terminal_speed_mps: jax.Array
    """[3] surge, sway, heave at full thrust in still water; the slower of the two directions. 0 for
    an axis along which thrusters cannot push alone (see
    `angler_mjx.robot.vehicles.drive.compute_drive`). Of a glider, over ground, 0 and in depth."""
    thruster_exists: jax.Array
    """bool [n_t] whether the thruster draws power: False for padding, fins and for dead
    thrusters."""
    thruster_health: jax.Array
    """[n_t] fraction of the table's thrust that each thruster gives: 1 as in the table, 0 dead."""
    cross_damping: CrossDamping | None = None
    """Damping between axes; None where no vehicle of the fleet has any."""
    free_axes: jax.Array | None = None
    """[6] 1 for axes of nu that move, 0 for held ones; None where no vehicle of the fleet is
    planar."""
    hull_bodies: HullBodies | None = None
    """Bodies of the hull that leave the water by themselves; None where no vehicle of the fleet has
    several."""
    fins: FinParams | None = None
    """Fins, in rows behind the thrusters; None where no vehicle of the fleet has any."""
    trim: TrimParams | None = None
    """Ballast tanks and moving masses, in rows behind the fins; None where no vehicle of the fleet
    has any."""
    links: LinkParams | None = None
    """Links and joints; None where no vehicle of the fleet has any."""
    link_capsules: LinkCapsules | None = None
    """Capsules of the links; the hull is these and the capsules of the base."""
    rotor: RotorFilter | None = field(default=None, metadata={"static": True})
    """Response of thrusts to their commands; None for a lag of first order."""
    steered: bool = field(default=False, metadata={"static": True})
    """Whether some of these vehicles have no sway, so that controllers must turn the bow."""


def build_vehicle(
    config: VehicleConfig,
    parameter_set: str | None,
    voltage_v: float,
    *,
    thruster_health: Mapping[str, float] | None = None,
    thrust_gain: Sequence[float] = (),
    rotor_response: RotorResponse | None = None,
) -> VehicleParams:
    """Compile a vehicle file to the parameters of one robot.

    Args:
        config: Vehicle file.
        parameter_set: Name of one of its sets; None for its default.
        voltage_v: Battery voltage, V.
        thruster_health: Fraction of its thrust, in [0, 1], of each faulty thruster, by name.
            Terminal speeds are those of a sound vehicle.
        thrust_gain: Factor on the fraction of each thruster, in the order of the file; 1 if left
            out.
        rotor_response: First or third order; None for the response of the file.

    Raises:
        ConfigError: unknown set or thruster, a voltage outside the thruster's data, a fraction out
            of range, or a response without numbers in the file.
    """
    chosen = config.find_set(parameter_set)
    health = np.array(config.find_health(thruster_health or {}))
    health = health * np.asarray(thrust_gain) if len(thrust_gain) else health
    thrust_n, power_w = build_thrust_tables(config, voltage_v)
    B = wrench_matrix(config)
    n_behind = len(config.actuator_names) - B.shape[1]
    health = np.concatenate([health, np.ones(n_behind)]) if n_behind else health
    exists = (health > 0.0) & (np.arange(len(health)) < B.shape[1])
    D_l = np.asarray(chosen.damping.linear_diagonal)
    D_q = np.asarray(chosen.damping.quadratic_diagonal)
    speed = compute_abilities(config, chosen, thrust_n).terminal_speed_mps
    center = np.asarray(config.base.center_of_mass_m)
    capsules = config.hull.capsules
    start = np.array([capsule.from_m for capsule in capsules]) - center
    end = np.array([capsule.to_m for capsule in capsules]) - center
    radius = np.array([capsule.radius_m for capsule in capsules])
    reach = np.maximum(np.linalg.norm(start, axis=1), np.linalg.norm(end, axis=1)) + radius
    return VehicleParams(
        mass_kg=_device_array(chosen.rigid_body.mass_kg),
        inertia_kgm2=_device_array(chosen.rigid_body.inertia_kgm2),
        M_A=_device_array(chosen.added_mass.coefficients),
        D_l=_device_array(D_l),
        D_q=_device_array(D_q),
        volume_m3=_device_array(chosen.buoyancy.volume_m3),
        p_cb_m=_device_array(chosen.buoyancy.center_of_buoyancy_m),
        hull_height_m=_device_array(config.hull.height_m),
        B=_device_array(np.pad(B, ((0, 0), (0, n_behind)))),
        thrust_n=_device_array(_pad_tables(thrust_n, len(health))),
        power_w=_device_array(_pad_tables(power_w, len(health))),
        tau_s=_device_array(_find_lags(config, n_behind)),
        capsule_a_m=_device_array(start),
        capsule_b_m=_device_array(end),
        capsule_r_m=_device_array(radius),
        radius_m=_device_array(max(reach.max(), home_link_reach_m(config))),
        terminal_speed_mps=_device_array(speed),
        thruster_exists=jnp.asarray(exists),
        thruster_health=_device_array(health),
        cross_damping=build_cross_damping(chosen.damping),
        free_axes=_device_array(_PLANAR_AXES) if config.planar else None,
        hull_bodies=build_hull_bodies(chosen.buoyancy),
        fins=build_fins(config),
        trim=build_trim(config),
        links=build_links(config, parameter_set),
        link_capsules=build_link_capsules(config),
        rotor=_build_rotor(config, rotor_response),
        steered=bool(speed[1] == 0),
    )


def stack_vehicles(variants: list[VehicleParams]) -> VehicleParams:
    """Stack robots of any kind, padded to common numbers of thrusters and capsules.

    Args:
        variants: At least one robot; their rotors must be alike, and the topology of their links
            where they have any.

    Returns:
        The same fields with one more leading axis, the variant.
    """
    n_t = max(variant.B.shape[1] for variant in variants)
    n_capsule = max(variant.capsule_r_m.shape[0] for variant in variants)
    steered = any(variant.steered for variant in variants)
    links = pad_links([v.links for v in variants])
    link_capsules = pad_link_capsules(
        [v.link_capsules for v in variants],
        [(v.capsule_a_m[0], v.capsule_b_m[0], v.capsule_r_m[0]) for v in variants],
    )
    has_curves = any(variant.thrust_n.ndim > 1 for variant in variants)
    has_lags = any(variant.tau_s.ndim for variant in variants)
    is_held = any(variant.free_axes is not None for variant in variants)
    fins = pad_fins([v.fins for v in variants], [v.B.shape[1] for v in variants], n_t)
    trim = pad_trim([v.trim for v in variants], [v.B.shape[1] for v in variants], n_t)
    cross_damping = pad_cross_damping([v.cross_damping for v in variants])
    hull_bodies = pad_hull_bodies(
        [v.hull_bodies for v in variants], [v.hull_height_m for v in variants]
    )
    padded = [
        replace(
            _pad_vehicle(robot, n_t, n_capsule),
            steered=steered,
            cross_damping=cross,
            hull_bodies=bodies,
            free_axes=_pad_axes(robot) if is_held else None,
            tau_s=_pad_lags(robot, n_t) if has_lags else robot.tau_s,
            thrust_n=_spread_tables(robot.thrust_n, n_t) if has_curves else robot.thrust_n,
            power_w=_spread_tables(robot.power_w, n_t) if has_curves else robot.power_w,
            fins=robot_fins,
            trim=robot_trim,
            links=robot_links,
            link_capsules=capsules,
        )
        for robot, cross, bodies, robot_fins, robot_trim, robot_links, capsules in zip(
            variants, cross_damping, hull_bodies, fins, trim, links, link_capsules, strict=True
        )
    ]
    stacked: VehicleParams = jax.device_put(jax.tree.map(lambda *rows: np.stack(rows), *padded))
    return stacked


def _find_lags(config: VehicleConfig, n_behind: int) -> ArrayLike:
    """Return the time constant [] of all rotors, s; [n_t] where they differ."""
    if config.rotor is None:
        return 1.0
    common = config.rotor.lag.time_constant_s
    lags = [thruster.time_constant_s or common for thruster in config.thrusters.layout]
    if all(lag == common for lag in lags):
        return common
    return np.array([*lags, *[common] * n_behind])


def _pad_lags(params: VehicleParams, n_t: int) -> Any:
    """Return the time constants [n_t] of a vehicle in a fleet of which one has different ones."""
    lags = np.asarray(params.tau_s)
    if lags.ndim == 0:
        return np.full(n_t, lags)
    return np.pad(lags, (0, n_t - lags.size), mode="edge")


def _pad_tables(tables: FloatArray, count: int) -> FloatArray:
    """Return tables [n_t, 201] with rows for fins; those [201] of all thrusters as they are."""
    if tables.ndim == 1:
        return tables
    return np.pad(tables, ((0, count - len(tables)), (0, 0)), mode="edge")


def _spread_tables(tables: jax.Array, n_t: int) -> Any:
    """Return the tables [n_t, 201] of a vehicle in a fleet of which one has curves."""
    rows = np.asarray(tables)
    if rows.ndim == 1:
        return np.tile(rows, (n_t, 1))
    return _pad_tables(rows, n_t)


def _build_rotor(config: VehicleConfig, response: RotorResponse | None) -> RotorFilter | None:
    third_order = None if config.rotor is None else config.rotor.third_order
    if config.find_response(response) == "first_order" or third_order is None:
        return None
    lead, *a = third_order.denominator
    b_2, b_1, b_0 = (value / lead for value in third_order.numerator)
    a_2, a_1, a_0 = (value / lead for value in a)
    return RotorFilter(numerator=(b_2, b_1, b_0), denominator=(a_2, a_1, a_0))


def _device_array(value: ArrayLike) -> jax.Array:
    # Rounded by NumPy: for JAX each shape is a program to compile, and so for the padding below.
    array: jax.Array = jax.device_put(np.asarray(value, jnp.result_type(float)))
    return array


def _pad_axes(params: VehicleParams) -> Any:
    """Return the free axes [6] of a vehicle in a fleet of which some are held."""
    if params.free_axes is not None:
        return params.free_axes
    return np.ones(6, params.mass_kg.dtype)


def _pad_vehicle(params: VehicleParams, n_t: int, n_capsule: int) -> VehicleParams:
    more_t = n_t - params.B.shape[1]
    more_c = n_capsule - params.capsule_r_m.shape[0]
    padded: dict[str, Any] = {
        "B": np.pad(params.B, ((0, 0), (0, more_t))),
        "thruster_exists": np.pad(params.thruster_exists, (0, more_t)),
        "thruster_health": np.pad(params.thruster_health, (0, more_t), constant_values=1.0),
        "capsule_a_m": np.pad(params.capsule_a_m, ((0, more_c), (0, 0)), mode="edge"),
        "capsule_b_m": np.pad(params.capsule_b_m, ((0, more_c), (0, 0)), mode="edge"),
        "capsule_r_m": np.pad(params.capsule_r_m, (0, more_c), mode="edge"),
    }
    return replace(params, **padded)


def joint_names(params: VehicleParams) -> tuple[str, ...]:
    """Return the names of the joints of a fleet's links, in the order of states; none without."""
    return () if params.links is None else params.links.tree.joint_names
