"""A fleet of mixed vehicles: the variants it can hold, and which one each robot of a world is.

A variant is a vehicle with one parameter set at one voltage. A robot of the fleet names one variant
or a weighted mix; the mix is drawn anew in every world.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.control import allocation
from angler_mjx.control.cascade import CascadeParams
from angler_mjx.physics import mjx_engine
from angler_mjx.physics.mjx_engine import BodyInertia, MjxEngine
from angler_mjx.vehicles import library, mjcf, params


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One vehicle with one parameter set at one voltage."""

    vehicle: str
    """Name of a shipped vehicle, or path of a vehicle file."""
    parameter_set: str
    battery_v: float


@dataclass(frozen=True, kw_only=True)
class Member:
    """One robot of the fleet: what it can be, and how fast it goes along its path."""

    variants: tuple[Variant, ...]
    weights: tuple[float, ...]
    cruise_speed_mps: float
    """Upper bound; 60 % of the vehicle's terminal speed in surge is the other one."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Fleet:
    """All variants of a fleet, stacked, and each member's chances."""

    cascade: CascadeParams
    """[n_variant] leads, but for cruise_speed_mps: see ``cruise_mps``."""
    engine: MjxEngine
    body: BodyInertia
    """[n_variant] leads."""
    cruise_mps: jax.Array
    """[n_robot, n_variant]."""
    log_weight: jax.Array
    """[n_robot, n_variant], -inf where a robot cannot be that variant."""


CRUISE_SHARE = 0.6
"""A robot cruises at no more than this share of its terminal speed: the rest is for control."""


def variants(members: Sequence[Member]) -> list[Variant]:
    """The distinct variants of a fleet, in order of first appearance."""
    return list(dict.fromkeys(v for member in members for v in member.variants))


def build(members: Sequence[Member]) -> Fleet:
    """Compile a fleet (host side).

    Raises:
        ConfigError: unknown vehicle or set, or a file with faults.
    """
    kinds = variants(members)
    configs = [library.load(kind.vehicle) for kind in kinds]
    stacked = params.stack(
        [
            params.build(config, kind.parameter_set, kind.battery_v)
            for config, kind in zip(configs, kinds, strict=True)
        ]
    )
    models = [
        mjcf.to_spec(config, kind.parameter_set, shapes=False).compile()
        for config, kind in zip(configs, kinds, strict=True)
    ]
    surge = CRUISE_SHARE * np.asarray(stacked.terminal_speed_mps)[:, 0]
    cruise = np.array([np.minimum(member.cruise_speed_mps, surge) for member in members])
    chance = np.zeros((len(members), len(kinds)))
    for row, member in zip(chance, members, strict=True):
        for kind, weight in zip(member.variants, member.weights, strict=True):
            row[kinds.index(kind)] += weight
    with np.errstate(divide="ignore"):
        log_weight = np.log(chance)
    engine, body = mjx_engine.build(models)
    return Fleet(
        engine=engine,
        body=body,
        cascade=CascadeParams(
            vehicle=stacked,
            allocation=allocation.build(stacked),
            cruise_speed_mps=jnp.zeros(len(kinds)),
        ),
        cruise_mps=jnp.asarray(cruise, float),
        log_weight=jnp.asarray(log_weight, float),
    )


def radius_bound(fleet: Fleet) -> jax.Array:
    """[n_robot] bounding radius of the largest variant that each robot can be, m."""
    possible = jnp.isfinite(fleet.log_weight)
    return jnp.max(jnp.where(possible, fleet.cascade.vehicle.radius_m, 0.0), axis=1)


def draw(fleet: Fleet, key: jax.Array) -> tuple[jax.Array, CascadeParams, BodyInertia]:
    """Which variant each robot of one world is.

    Returns:
        int32 [n_robot] variants, and the parameters and inertias of the robots, [n_robot] leading.
    """
    chosen = jax.random.categorical(key, fleet.log_weight, axis=1).astype(jnp.int32)
    cascade: CascadeParams = jax.tree.map(lambda leaf: leaf[chosen], fleet.cascade)
    speed = jnp.take_along_axis(fleet.cruise_mps, chosen[:, None], axis=1)[:, 0]
    body: BodyInertia = jax.tree.map(lambda leaf: leaf[chosen], fleet.body)
    return (
        chosen,
        CascadeParams(
            vehicle=cascade.vehicle, allocation=cascade.allocation, cruise_speed_mps=speed
        ),
        body,
    )
