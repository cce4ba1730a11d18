"""A fleet of mixed vehicles: the variants it can hold, and which one each robot of a world is.

A variant is a vehicle with one parameter set at one voltage, with its faults and what was drawn of
it. A robot of the fleet names one variant or a weighted mix; the mix is drawn anew in every world.
Where robots carry loads, each variant stands there once more, with the load.
"""

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.lanes.planes import is_table
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles import library, mjcf, params
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.link_params import LinkTree
from angler_mjx.robot.vehicles.load import Load, add_load
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.rotor_config import RotorResponse
from angler_mjx.robot.vehicles.variation import Variation, apply_variation
from angler_mjx.sampling import fold_keys
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics.mjx_engine import BodyInertia, MjxPhysics
from angler_mjx.sim.state import FleetWorld, World


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One vehicle with one parameter set at one voltage, with its faults."""

    vehicle: str
    """Name of a shipped vehicle, or path of a vehicle file."""
    parameter_set: str
    battery_v: float
    thruster_health: tuple[tuple[str, float], ...] = ()
    """Names of thrusters that are not sound, and the share of its thrust that each gives."""
    fault_known: bool = True
    """Whether the allocation knows of them; if not, it takes all thrusters for sound."""
    rotor_response: RotorResponse | None = None
    """None for what the vehicle file says."""
    variation: Variation | None = None
    """How it differs from its parameter set."""
    variation_known: bool = False
    """Whether controllers and planners are told so; if not, they take it for its parameter set."""


@dataclass(frozen=True, kw_only=True)
class Member:
    """One robot of the fleet: what it can be, and how fast it goes along its path."""

    variants: tuple[Variant, ...]
    weights: tuple[float, ...]
    cruise_speed_mps: float
    """Upper bound; 60 % of the vehicle's terminal speed in surge is the other one."""


@dataclass(frozen=True)
class VehicleGroup:
    """Neighbouring robots of a fleet that are the same vehicle, if not the same variant of it."""

    first: int
    count: int
    variant: int
    """One of those that they can be: where to read what is the same in all."""
    sameness: tuple[str, ...]
    """For each leaf of ``Fleet.control``, a letter an element of one variant: z where it is zero in
    all variants that these robots can be, s where it is the same in all, v where it varies. Engines
    need not compute with what is zero, nor read for each robot what is the same."""
    shared: tuple[tuple[float, ...], ...]
    """The numbers that ``sameness`` calls s or z, for programs that hold them; 0 where one
    varies. Empty for long tables."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Fleet:
    """All variants of a fleet, stacked, and each member's chances.

    ``groups`` is found by comparing the numbers of ``control``, and programs hold what it says: a
    fleet is not edited but built anew.
    """

    control: ControlParams
    """[n_variant] leads, but for cruise_speed_mps: see ``cruise_mps``. Where robots carry loads,
    so many variants again follow: the same ones, in order, with the load."""
    engine: MjxPhysics | None
    """None where no multibody models were asked for."""
    body: BodyInertia
    """As of ``control``; empty where no multibody models were asked for."""
    cruise_mps: jax.Array
    """[n_robot, n_variant], and so many again as of ``control``."""
    log_weight: jax.Array
    """[n_robot, n_variant], -inf where a robot cannot be that variant."""
    groups: tuple[VehicleGroup, ...] = field(metadata={"static": True})
    """All robots, in order."""

    @property
    def can_carry(self) -> bool:
        """Whether its robots can carry a load."""
        return self.cruise_mps.shape != self.log_weight.shape

    def loaded_variant(self, variant: jax.Array, loaded: jax.Array) -> jax.Array:
        """Variants of robots [...] as they are now, with the load or without."""
        return variant + jnp.where(loaded, self.log_weight.shape[1], 0)


CRUISE_FRACTION = 0.6
"""A robot cruises at no more than this share of its terminal speed: the rest is for control."""


def list_variants(members: Sequence[Member]) -> list[Variant]:
    """The distinct variants of a fleet, in order of first appearance."""
    return list(dict.fromkeys(v for member in members for v in member.variants))


def describe_variants(members: Sequence[Member]) -> list[dict[str, object]]:
    """What each variant of a fleet is, by its number in ``World.variant``; for files."""
    labels = library.label_vehicles(kind.vehicle for kind in list_variants(members))
    rows = []
    for number, kind in enumerate(list_variants(members)):
        row = {"variant": number, **asdict(kind), "vehicle": labels[kind.vehicle]}
        sampled: dict[str, object] = row.pop("variation") or {}
        volts = sampled.pop("battery_v", None)
        if not sampled.get("deviations"):
            sampled.pop("deviations", None)
        rows.append(
            {**row, "battery_v": kind.battery_v if volts is None else volts, "drawn": sampled}
        )
    return rows


@dataclass(frozen=True)
class JointLabel:
    """Name of a joint, as in its vehicle file, and unit of its position."""

    name: str
    unit: str


def label_joints(members: Sequence[Member]) -> dict[str, tuple[JointLabel, ...]]:
    """Return the joints of a fleet's vehicles that have any, by the vehicle's label; for files."""
    labels = library.label_vehicles(kind.vehicle for kind in list_variants(members))
    units = {"revolute": "rad", "prismatic": "m"}
    return {
        label: tuple(JointLabel(joint.name, units[joint.type]) for joint in joints)
        for vehicle, label in labels.items()
        if (joints := library.load_vehicle(vehicle).find_joints())
    }


def count_joints(members: Sequence[Member]) -> int:
    """Return the number of joints of the vehicles of a fleet that have any; 0 if none has."""
    return max(map(len, label_joints(members).values()), default=0)


def build_fleet(
    members: Sequence[Member],
    *,
    multibody: bool = True,
    load: Load | None = None,
    cargo: Load | None = None,
) -> Fleet:
    """Compile a fleet (host side).

    Args:
        members: the robots.
        multibody: keep MuJoCo's models, which only the mjx engine reads.
        load: that robots can carry; controllers know of it.
        cargo: part of each robot in a body that they carry together, for controllers alone.

    Raises:
        ConfigError: unknown vehicle, set or thruster, a file with faults, or rotors or arms of
            more than one kind.
    """
    kinds = list_variants(members)
    robots = [_build_robot(kind) for kind in kinds]
    _refuse_mixed_rotors(kinds, robots)
    _refuse_mixed_links(kinds, robots)
    each: list[tuple[Variant, Load | None]] = [(kind, None) for kind in kinds]
    if load is not None:
        each += [(kind, load) for kind in kinds]
    stacked = params.stack_vehicles([_build_robot(*variant_and_load) for variant_and_load in each])
    nominal = None
    if cargo or any(kind.variation and not kind.variation_known for kind in kinds):
        nominal = params.stack_vehicles(
            [_build_robot(_nominal_variant(kind), cargo or carried) for kind, carried in each]
        )
    believed = stacked if nominal is None else nominal
    fault_mask = np.array([[kind.fault_known] for kind, _ in each])
    configs = [_load_config(*variant_and_load) for variant_and_load in each]
    armed = next((config for config in configs if config.links), None)
    specs = [
        mjcf.to_spec(config, kind.parameter_set, shapes=False, absent_links=armed)
        for config, (kind, _) in zip(configs, each, strict=True)
    ]
    surge = CRUISE_FRACTION * np.asarray(believed.terminal_speed_mps)[:, 0]
    cruise = np.array([np.minimum(member.cruise_speed_mps, surge) for member in members])
    chance = np.zeros((len(members), len(kinds)))
    for row, member in zip(chance, members, strict=True):
        for kind, weight in zip(member.variants, member.weights, strict=True):
            row[kinds.index(kind)] += weight
    with np.errstate(divide="ignore"):
        log_weight = np.log(chance)
    engine, body = (
        mjx_engine.build_engine(specs) if multibody else (None, mjx_engine.empty_inertia(specs))
    )
    control = ControlParams(
        vehicle=stacked,
        allocation=allocation.build_allocation(
            believed, np.where(fault_mask, believed.thruster_health, 1.0)
        ),
        cruise_speed_mps=jnp.zeros(len(each)),
        nominal=nominal,
    )
    return Fleet(
        engine=engine,
        body=body,
        control=control,
        groups=_group_robots(members, kinds, control),
        cruise_mps=jnp.asarray(cruise, float),
        log_weight=jnp.asarray(log_weight, float),
    )


def _load_config(kind: Variant, load: Load | None = None) -> VehicleConfig:
    """The vehicle file of a variant, its parameter set varied, with what it carries."""
    config = library.load_vehicle(kind.vehicle)
    if kind.variation is not None:
        config = apply_variation(config, kind.parameter_set, kind.variation)
    return config if load is None else add_load(config, kind.parameter_set, load)


def _build_robot(kind: Variant, load: Load | None = None) -> VehicleParams:
    """The parameters of a variant as it is, with what it carries."""
    volts = kind.variation.battery_v if kind.variation else None
    return params.build_vehicle(
        _load_config(kind, load),
        kind.parameter_set,
        kind.battery_v if volts is None else volts,
        thruster_health=dict(kind.thruster_health),
        thrust_gain=kind.variation.thrust if kind.variation else (),
        rotor_response=kind.rotor_response,
    )


def _nominal_variant(kind: Variant) -> Variant:
    """What controllers and planners take a variant for."""
    return kind if kind.variation_known else replace(kind, variation=None)


def _refuse_mixed_rotors(kinds: Sequence[Variant], robots: Sequence[VehicleParams]) -> None:
    """Rotors of first and of third order have states of different shapes."""
    first = robots[0].rotor
    for kind, robot in zip(kinds, robots, strict=True):
        if robot.rotor != first:
            raise ConfigError(
                f"fleet: the rotors of {kind.vehicle!r} answer otherwise than those of "
                f"{kinds[0].vehicle!r}; give all robots of a fleet the same rotor_response"
            )


def _refuse_mixed_links(kinds: Sequence[Variant], robots: Sequence[VehicleParams]) -> None:
    """Links that hang together in different ways take programs of their own."""
    first: tuple[Variant, LinkTree] | None = None
    for kind, robot in zip(kinds, robots, strict=True):
        if robot.links is None:
            continue
        first = first or (kind, robot.links.tree)
        if robot.links.tree != first[1]:
            raise ConfigError(
                f"fleet: the links of {kind.vehicle!r} hang together otherwise than those of "
                f"{first[0].vehicle!r}; fly different arms in runs of their own"
            )


def _group_robots(
    members: Sequence[Member], kinds: Sequence[Variant], stacked: ControlParams
) -> tuple[VehicleGroup, ...]:
    """Runs of robots with the same vehicles."""
    vehicles = [{variant.vehicle for variant in member.variants} for member in members]
    groups = []
    for _, run in itertools.groupby(range(len(members)), key=lambda i: vehicles[i]):
        rows = list(run)
        possible = {kinds.index(variant) for i in rows for variant in members[i].variants}
        first_variant, every = min(possible), stacked.cruise_speed_mps.shape[0]
        with_load = [k + more for k in possible for more in range(0, every, len(kinds))]
        letters = _classify_elements(stacked, sorted(with_load))
        groups.append(
            VehicleGroup(
                rows[0],
                len(rows),
                first_variant,
                letters,
                _shared_values(stacked, first_variant, letters),
            )
        )
    return tuple(groups)


def _classify_elements(stacked: ControlParams, possible: Sequence[int]) -> tuple[str, ...]:
    letters = []
    for leaf in jax.tree.leaves(stacked):
        rows = np.asarray(leaf).reshape(leaf.shape[0], -1)[possible]
        same, zero = np.all(rows == rows[0], axis=0), np.all(rows == 0, axis=0)
        letters.append("".join(np.where(zero, "z", np.where(same, "s", "v"))))
    return tuple(letters)


def _shared_values(
    stacked: ControlParams, variant: int, sameness: Sequence[str]
) -> tuple[tuple[float, ...], ...]:
    values = []
    for leaf, letters in zip(jax.tree.leaves(stacked), sameness, strict=True):
        row = np.asarray(leaf)[variant].reshape(-1).tolist()
        long = is_table(leaf.shape[1:])
        kept = [x if letter != "v" else 0.0 for x, letter in zip(row, letters, strict=True)]
        values.append(() if long else tuple(map(float, kept)))
    return tuple(values)


def radius_bound(fleet: Fleet) -> jax.Array:
    """[n_robot] bounding radius of the largest variant that each robot can be, m."""
    possible = jnp.isfinite(fleet.log_weight)
    radius_m = fleet.control.vehicle.radius_m[: possible.shape[1]]  # a load changes no hull
    return jnp.max(jnp.where(possible, radius_m, 0.0), axis=1)


def select_parameters(fleet: Fleet, variant: jax.Array) -> tuple[ControlParams, BodyInertia]:
    """Parameters and multibody fields of robots [...] by their variants; cruise speeds are 0."""
    selected: tuple[ControlParams, BodyInertia] = jax.tree.map(
        lambda leaf: leaf[variant], (fleet.control, fleet.body)
    )
    return selected


def laden_cruise(fleet: Fleet, worlds: World) -> jax.Array:
    """Cruise speeds [..., n_robot] of robots with their load, m/s.

    Args:
        fleet: that carries loads.
        worlds: any leading axes.
    """
    robots, kinds = fleet.log_weight.shape
    bound = fleet.cruise_mps[jnp.arange(robots), worlds.variant + kinds]
    return jnp.minimum(worlds.cruise_speed_mps, bound)


def add_parameters(fleet: Fleet, worlds: World) -> FleetWorld:
    """Return worlds [...] with the parameters that the fleet gives to their variants.

    Args:
        fleet: all variants.
        worlds: any leading axes.
    """
    control, body = select_parameters(fleet, worlds.variant)
    return FleetWorld(
        **{entry.name: getattr(worlds, entry.name) for entry in fields(World)},
        control=replace(control, cruise_speed_mps=worlds.cruise_speed_mps),
        body=body,
    )


def apply_loads(fleet: Fleet | None, world: FleetWorld, loaded: jax.Array | None) -> FleetWorld:
    """One world with the parameters of those of its robots that carry something.

    Args:
        fleet: all variants; None where nobody asked for its loads.
        world: with the parameters of robots that carry nothing.
        loaded: bool [n_robot] who does; None where nobody can.
    """
    if fleet is None or loaded is None or not fleet.can_carry:
        return world
    control, body = select_parameters(fleet, fleet.loaded_variant(world.variant, loaded))
    cruise = jnp.where(loaded, laden_cruise(fleet, world), world.cruise_speed_mps)
    return replace(world, control=replace(control, cruise_speed_mps=cruise), body=body)


def sample_variants(fleet: Fleet, key: jax.Array) -> tuple[jax.Array, ControlParams]:
    """Which variant each robot of one world is.

    A robot's number and its own chances decide, nothing else: a robot more, of whatever vehicle,
    changes nothing for those before it.

    Args:
        fleet: all variants.
        key: of this draw in this world.

    Returns:
        int32 [n_robot] variants, and the parameters of the robots, [n_robot] leading.
    """
    n_robot, n_variant = fleet.log_weight.shape
    if n_variant == 1:  # Nothing is left to chance.
        chosen = jnp.zeros(n_robot, jnp.int32)
    else:
        # Of one row at a time: the first numbers of a row are the same however long it is.
        of_robot = fold_keys(key, n_robot)
        chosen = jax.vmap(jax.random.categorical)(of_robot, fleet.log_weight).astype(jnp.int32)
    control, _ = select_parameters(fleet, chosen)
    speed = jnp.take_along_axis(fleet.cruise_mps, chosen[:, None], axis=1)[:, 0]
    return chosen, replace(control, cruise_speed_mps=speed)
