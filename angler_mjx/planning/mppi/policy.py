"""A fleet flown by path integral control: each robot among what the others meant to do last."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.control.commands import BodyTwist
from angler_mjx.control.laws import model
from angler_mjx.errors import ConfigError
from angler_mjx.planning.mppi import field as fields
from angler_mjx.planning.mppi.twist import Bodies, Weights, improve, shifted
from angler_mjx.sim.knowledge import KnownObstacles, Knows
from angler_mjx.sim.policy import Known, Policy


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Memory:
    """What it keeps of one world; [R] leads but for the time."""

    field: fields.Field
    knots: jax.Array
    """[R, K, 3]."""
    way_m: jax.Array
    """[R, H, 3] where each robot meant to be."""
    yaw_rad: jax.Array
    """[R] to hold."""
    time_s: jax.Array
    """[] of the last call."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Mppi(Policy):
    """Velocities by path integral control; the heading is held."""

    weights: Weights = field(default_factory=Weights)
    attitude_per_s: float = 2.5
    samples: int = field(default=1024, metadata={"static": True})
    horizon_s: float = field(default=3.0, metadata={"static": True})
    dt_s: float = field(default=0.05, metadata={"static": True})
    knots: int = field(default=8, metadata={"static": True})
    period: int = field(default=1, metadata={"static": True})
    knows: Knows = field(default_factory=Knows, metadata={"static": True})
    looks: int = field(default=1, metadata={"static": True})
    ahead_s: float = field(default=3.0, metadata={"static": True})

    @property
    def steps(self) -> int:
        """Of a sample."""
        return round(self.horizon_s / self.dt_s)

    def reset(self, known: Known, key: jax.Array) -> Memory:
        """See `Policy.reset`."""
        grid, floor = known.grid, known.floor_z_m
        if grid is None or floor is None:
            raise ConfigError("policy Mppi: is told no map; give it knows = Knows()")
        gap, h = fields.gap(grid, floor, None), 0.5 * grid.cell_m

        def of_robot(goal: jax.Array, radius: jax.Array) -> fields.Field:
            left = fields.way_left(gap >= radius + 0.1, goal, grid.origin_m, h)
            values = jnp.stack([gap, left], axis=-1)
            return fields.Field(values=values, origin_m=grid.origin_m, spacing_m=h)

        p = known.belief.p
        return Memory(
            field=jax.vmap(of_robot)(known.goal_m, known.params.vehicle.radius_m),
            knots=jnp.zeros((p.shape[0], self.knots, 3), p.dtype),
            way_m=jnp.repeat(p[:, None], self.steps, axis=1),
            yaw_rad=jax.vmap(quaternion.yaw)(known.belief.q),
            time_s=known.time_s,
        )

    def act(self, carry: Memory, known: Known, key: jax.Array, step: jax.Array) -> Any:
        """See `Policy.act`."""
        since = known.time_s - carry.time_s
        vehicle, believed = known.params.vehicle, known.belief
        others = jax.vmap(lambda way: shifted(way, since, self.horizon_s))(carry.way_m)
        place, reach = _obstacles(known.obstacles, self.dt_s * (jnp.arange(self.steps) + 1))
        centre = jnp.concatenate([jnp.swapaxes(others, 0, 1), jnp.swapaxes(place, 0, 1)], axis=1)
        robots = known.goal_m.shape[0]

        def one(i: jax.Array, seen: fields.Field, knots: jax.Array) -> tuple[jax.Array, jax.Array]:
            radius = vehicle.radius_m[i]
            of_robots = jnp.where(jnp.arange(robots) == i, -1e3, radius + vehicle.radius_m)
            return improve(
                self.weights,
                seen,
                Bodies(centre_m=centre, reach_m=jnp.concatenate([of_robots, radius + reach])),
                believed.p[i],
                quaternion.rotate(believed.q[i], believed.nu[i, :3]),
                shifted(knots, since, self.horizon_s),
                radius,
                known.params.cruise_speed_mps[i],
                jax.random.fold_in(key, i),
                self.samples,
                self.dt_s,
            )

        knots, way = jax.vmap(one)(jnp.arange(robots), carry.field, carry.knots)

        def command(q: jax.Array, velocity: jax.Array, yaw: jax.Array) -> jax.Array:
            turn = self.attitude_per_s * model.attitude_error(q, yaw)
            return jnp.concatenate([quaternion.rotate_inverse(q, velocity), turn])

        nu = jax.vmap(command)(believed.q, knots[:, 0], carry.yaw_rad)
        after = Memory(
            field=carry.field, knots=knots, way_m=way, yaw_rad=carry.yaw_rad, time_s=known.time_s
        )
        return after, BodyTwist(nu=nu)


def _obstacles(known: KnownObstacles | None, ahead_s: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Places [n, H, 3] from now on and bounding radii [n]; straight on where one place is told."""
    if known is None:
        return jnp.zeros((0, ahead_s.shape[0], 3)), jnp.zeros(0)
    if known.time_s.shape[0] == 1:
        place = known.p_m[:, :1] + known.velocity_mps[:, None] * ahead_s[:, None]
    else:
        axis = jax.vmap(lambda x: jnp.interp(ahead_s, known.time_s, x))
        place = jax.vmap(axis, in_axes=2, out_axes=2)(known.p_m)
    return place, jnp.where(known.exists, known.radius_m, -1e3)
