"""Path integral control of a fleet: each robot among the last plans of the others.

With acoustics each robot extrapolates the others from their last packets.
"""

from dataclasses import dataclass, field
from typing import Literal

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.planning.mppi import distance_field as fields
from angler_mjx.planning.mppi import drag, forecast, outputs
from angler_mjx.planning.mppi.costs import CostBodies, Weights
from angler_mjx.planning.mppi.models import ForceModel, ThrusterLag
from angler_mjx.planning.mppi.sampling import RolloutScene, improve_mean, shift_knots
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, Estimate
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy, PolicyInput

type Output = Literal["twist", "wrench"]
"""Types of command."""

PATH_MARGIN_M = 0.1
"""Distance [m] beyond a robot's radius in the field of remaining path."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class MppiMemory:
    """Memory of one world; [R] leads but for the time."""

    field: fields.DistanceField
    knots: jax.Array
    """[R, K, 3]."""
    path_m: jax.Array
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
    information: Information = field(default_factory=Information, metadata={"static": True})
    observation_period: int = field(default=1, metadata={"static": True})
    ahead_s: float = field(default=3.0, metadata={"static": True})

    @property
    def steps(self) -> int:
        """Number of steps of a sample."""
        return round(self.horizon_s / self.dt_s)

    def reset(self, inputs: PolicyInput, key: jax.Array) -> MppiMemory:
        """See `Policy.reset`."""
        grid, floor = inputs.grid, inputs.floor_z_m
        if grid is None or floor is None:
            raise ConfigError("policy Mppi: has no map; give it information = Information()")
        gap, h = fields.obstacle_distance(grid, floor), 0.5 * grid.cell_m

        def of_robot(goal: jax.Array, radius: jax.Array) -> fields.DistanceField:
            path_length_m = fields.path_length_to_goal(
                gap >= radius + PATH_MARGIN_M, goal, grid.origin_m, h
            )
            values = jnp.stack([gap, path_length_m], axis=-1)
            return fields.DistanceField(values=values, origin_m=grid.origin_m, spacing_m=h)

        p = inputs.belief.p
        return MppiMemory(
            field=jax.vmap(of_robot)(inputs.goal_m, inputs.params.vehicle_model.radius_m),
            knots=jnp.zeros((p.shape[0], self.knots, 3), p.dtype),
            path_m=jnp.repeat(p[:, None], self.steps, axis=1),
            yaw_rad=jax.vmap(quaternion.yaw)(inputs.belief.q),
            time_s=inputs.time_s,
        )

    def act(
        self, carry: MppiMemory, inputs: PolicyInput, key: jax.Array, step: jax.Array
    ) -> tuple[MppiMemory, BodyTwist | BodyWrench]:
        """See `Policy.act`."""
        elapsed_s, estimate = inputs.time_s - carry.time_s, inputs.belief
        others = jax.vmap(
            lambda path_m: shift_knots(path_m, elapsed_s, self.horizon_s - self.dt_s)
        )(carry.path_m)
        ahead_s = self.dt_s * (jnp.arange(self.steps) + 1)
        position_m, reach = forecast.extrapolate_obstacles(inputs.obstacles, ahead_s)
        moving = jnp.swapaxes(position_m, 0, 1)
        centre = jnp.concatenate([jnp.swapaxes(others, 0, 1), moving], axis=1)
        robots, radii = jnp.arange(inputs.goal_m.shape[0]), inputs.params.vehicle_model.radius_m

        def bodies_around(i: jax.Array) -> jax.Array:
            """Return [H, n, 3] robots and obstacles, as far as robot i knows them."""
            if inputs.others is None:
                return centre
            heard = forecast.extrapolate_robots(inputs.others, inputs.time_s, ahead_s, i)
            return jnp.concatenate([heard, moving], axis=1)

        def plan_robot(
            i: jax.Array, params: ControlParams, seen: fields.DistanceField, knots: jax.Array
        ) -> tuple[jax.Array, jax.Array, jax.Array]:
            radius, q = params.vehicle_model.radius_m, estimate.q[i]
            of_robots = jnp.where(robots == i, forecast.ABSENT_REACH_M, radius + radii)
            scene = RolloutScene(
                field=seen,
                bodies=CostBodies(
                    centre_m=bodies_around(i), reach_m=jnp.concatenate([of_robots, radius + reach])
                ),
                flow_mps=forecast.current_along(inputs.current, others[i], ahead_s),
                goal_m=inputs.goal_m[i],
                radius_m=radius,
                limit_mps=params.cruise_speed_mps,
            )
            hull = drag.build_drag_hull(
                params, quaternion.yaw(q), self.density_kgpm3, self.gravity_mps2
            )
            model_class = ThrusterLag if self.output == "twist" else ForceModel
            v = quaternion.rotate(q, estimate.nu[i, :3])
            knots, path_m = improve_mean(
                self.weights,
                model_class(hull=hull, response_s=self.weights.response_s),
                scene,
                estimate.p[i],
                v,
                shift_knots(knots, elapsed_s, self.horizon_s),
                jax.random.fold_in(key, i),
                self.samples,
                self.dt_s,
            )
            return knots, path_m, scene.flow_mps[0]

        knots, path_m, flow = jax.vmap(plan_robot)(robots, inputs.params, carry.field, carry.knots)
        next_memory = MppiMemory(
            field=carry.field,
            knots=knots,
            path_m=path_m,
            yaw_rad=carry.yaw_rad,
            time_s=inputs.time_s,
        )
        return next_memory, self._build_commands(inputs, knots[:, 0], flow, carry.yaw_rad)

    def _build_commands(
        self, inputs: PolicyInput, target_mps: jax.Array, flow: jax.Array, yaw: jax.Array
    ) -> BodyTwist | BodyWrench:
        """Build commands of all robots for velocities over ground [R, 3] in currents [R, 3]."""

        def build_command(
            vehicle: VehicleParams, *robot_inputs: jax.Array
        ) -> BodyTwist | BodyWrench:
            p, q, nu, target_mps, flow, yaw = robot_inputs
            estimate = Estimate(p=p, q=q, nu=nu, flow=flow)
            if self.output == "twist":
                return outputs.build_twist(vehicle, estimate, target_mps, yaw, self.attitude_per_s)
            return outputs.build_wrench(
                vehicle,
                estimate,
                target_mps,
                yaw,
                self.attitude_per_s,
                self.weights.response_s,
                self.density_kgpm3,
                self.gravity_mps2,
            )

        belief = inputs.belief
        return jax.vmap(build_command)(
            inputs.params.vehicle_model, belief.p, belief.q, belief.nu, target_mps, flow, yaw
        )
