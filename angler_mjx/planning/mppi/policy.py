"""A fleet flown by path integral control: each robot among what the others meant to do last.

Where robots talk by acoustics, each is among what it has heard of them, going straight on.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.planning.mppi import ahead, drag, outputs
from angler_mjx.planning.mppi import field as fields
from angler_mjx.planning.mppi.costs import CostBodies, Weights
from angler_mjx.planning.mppi.models import Forces, ThrusterLag
from angler_mjx.planning.mppi.sampling import RolloutScene, improve, shifted
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, Estimate
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy, PolicyInput

type Output = Literal["twist", "wrench"]
"""What robots are commanded by."""

ROOM_M = 0.1
"""Beside a robot's radius, for the way that is left."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class MppiMemory:
    """What it keeps of one world; [R] leads but for the time."""

    field: fields.DistanceField
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
    """Velocities, or wrenches, by path integral control; the heading is held."""

    weights: Weights = field(default_factory=Weights)
    attitude_per_s: float = 2.5
    density_kgpm3: float = 1000.0
    gravity_mps2: float = GRAVITY_MPS2
    output: Output = field(default="twist", metadata={"static": True})
    samples: int = field(default=512, metadata={"static": True})
    horizon_s: float = field(default=3.0, metadata={"static": True})
    dt_s: float = field(default=0.1, metadata={"static": True})
    knots: int = field(default=8, metadata={"static": True})
    period: int = field(default=1, metadata={"static": True})
    knows: Information = field(default_factory=Information, metadata={"static": True})
    looks: int = field(default=1, metadata={"static": True})
    ahead_s: float = field(default=3.0, metadata={"static": True})

    @property
    def steps(self) -> int:
        """Of a sample."""
        return round(self.horizon_s / self.dt_s)

    def reset(self, known: PolicyInput, key: jax.Array) -> MppiMemory:
        """See `Policy.reset`."""
        grid, floor = known.grid, known.floor_z_m
        if grid is None or floor is None:
            raise ConfigError("policy Mppi: is told no map; give it knows = Knows()")
        gap, h = fields.gap(grid, floor), 0.5 * grid.cell_m

        def of_robot(goal: jax.Array, radius: jax.Array) -> fields.DistanceField:
            left = fields.way_left(gap >= radius + ROOM_M, goal, grid.origin_m, h)
            values = jnp.stack([gap, left], axis=-1)
            return fields.DistanceField(values=values, origin_m=grid.origin_m, spacing_m=h)

        p = known.belief.p
        return MppiMemory(
            field=jax.vmap(of_robot)(known.goal_m, known.params.known.radius_m),
            knots=jnp.zeros((p.shape[0], self.knots, 3), p.dtype),
            way_m=jnp.repeat(p[:, None], self.steps, axis=1),
            yaw_rad=jax.vmap(quaternion.yaw)(known.belief.q),
            time_s=known.time_s,
        )

    def act(self, carry: MppiMemory, known: PolicyInput, key: jax.Array, step: jax.Array) -> Any:
        """See `Policy.act`."""
        since, believed = known.time_s - carry.time_s, known.belief
        others = jax.vmap(lambda way: shifted(way, since, self.horizon_s - self.dt_s))(carry.way_m)
        ahead_s = self.dt_s * (jnp.arange(self.steps) + 1)
        place, reach = ahead.obstacles(known.obstacles, ahead_s)
        moving = jnp.swapaxes(place, 0, 1)
        centre = jnp.concatenate([jnp.swapaxes(others, 0, 1), moving], axis=1)
        robots, radii = jnp.arange(known.goal_m.shape[0]), known.params.known.radius_m

        def about(i: jax.Array) -> jax.Array:
            """[H, n, 3] robots and obstacles, as far as robot i knows."""
            if known.others is None:
                return centre
            heard = ahead.straight(known.others, known.time_s, ahead_s, i)
            return jnp.concatenate([heard, moving], axis=1)

        def one(
            i: jax.Array, params: ControlParams, seen: fields.DistanceField, knots: jax.Array
        ) -> tuple[jax.Array, jax.Array, jax.Array]:
            radius, q = params.known.radius_m, believed.q[i]
            of_robots = jnp.where(robots == i, ahead.NOBODY_M, radius + radii)
            scene = RolloutScene(
                field=seen,
                bodies=CostBodies(
                    centre_m=about(i), reach_m=jnp.concatenate([of_robots, radius + reach])
                ),
                flow_mps=ahead.flow(known.current, others[i], ahead_s),
                goal_m=known.goal_m[i],
                radius_m=radius,
                limit_mps=params.cruise_speed_mps,
            )
            hull = drag.hull(params, quaternion.yaw(q), self.density_kgpm3, self.gravity_mps2)
            kind = ThrusterLag if self.output == "twist" else Forces
            v = quaternion.rotate(q, believed.nu[i, :3])
            knots, way = improve(
                self.weights,
                kind(hull=hull, response_s=self.weights.response_s),
                scene,
                believed.p[i],
                v,
                shifted(knots, since, self.horizon_s),
                jax.random.fold_in(key, i),
                self.samples,
                self.dt_s,
            )
            return knots, way, scene.flow_mps[0]

        knots, way, flow = jax.vmap(one)(robots, known.params, carry.field, carry.knots)
        after = MppiMemory(
            field=carry.field, knots=knots, way_m=way, yaw_rad=carry.yaw_rad, time_s=known.time_s
        )
        return after, self._commands(known, knots[:, 0], flow, carry.yaw_rad)

    def _commands(
        self, known: PolicyInput, asked: jax.Array, flow: jax.Array, yaw: jax.Array
    ) -> BodyTwist | BodyWrench:
        """Of all robots, for velocities over ground [R, 3] in the currents [R, 3] there."""

        def one(vehicle: VehicleParams, *told: jax.Array) -> BodyTwist | BodyWrench:
            p, q, nu, asked, flow, yaw = told
            estimate = Estimate(p=p, q=q, nu=nu, flow=flow)
            if self.output == "twist":
                return outputs.twist(vehicle, estimate, asked, yaw, self.attitude_per_s)
            return outputs.wrench(
                vehicle,
                estimate,
                asked,
                yaw,
                self.attitude_per_s,
                self.weights.response_s,
                self.density_kgpm3,
                self.gravity_mps2,
            )

        believed = known.belief
        commands: BodyTwist | BodyWrench = jax.vmap(one)(
            known.params.known, believed.p, believed.q, believed.nu, asked, flow, yaw
        )
        return commands
