"""Policy that follows routes computed before the start: there is no search in flight."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.planning.routes import guidance
from angler_mjx.planning.routes.avoidance import (
    STANDS_MPS,
    AvoidedBodies,
    choose_velocity,
    inflate_for_doubt,
    make_room,
)
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.robot.control.laws.model import wrap_angle
from angler_mjx.sim.information import Information, ObstacleInformation
from angler_mjx.sim.policy import Policy, PolicyInput
from angler_mjx.world.routes import Routes

NEAR_PER_S = 0.8
"""Velocity per metre that is left to the place, below the cruise speed."""
PATIENCE_S = 4.0
"""Time [s] after which a robot without progress is ready to take another route."""
IDLE = 0.4
"""Fraction of the cruise speed at which robots without a goal give way."""
DOUBT, DOUBT_M = 0.6, 1.0
"""Deviation of a robot since its last packet, as a fraction of its motion since then, and its limit
[m]."""
MOVES_MPS = 0.1
"""Below this velocity the heading is kept."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class RoutesMemory:
    """Memory of one world; [R] leads."""

    stay_m: jax.Array
    """[R, 3] where to stay, of robots that are to go nowhere."""
    stays: jax.Array
    """bool [R] whether they did at the last call."""
    yaw_rad: jax.Array
    """[R] heading to have."""
    held_up: jax.Array
    """[R] 0 to 1, lack of progress of late."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AlongRoutes(Policy):
    """Flies each robot to its goal along `PolicyInput.routes`, clear of moving bodies."""

    dt_s: float = 0.05
    """Control period."""
    horizon_s: float = 5.0
    """How far ahead contacts count."""
    margin_m: float = 0.2
    """Kept from bodies that move, beside the radii."""
    yaw_rate_radps: float = 0.6
    """How fast the heading follows the course."""
    routes_margin_m: float = field(default=0.1, metadata={"static": True})
    period: int = field(default=5, metadata={"static": True})
    observation_period: int = field(default=5, metadata={"static": True})
    information: Information = field(
        default=Information(obstacles="observed"), metadata={"static": True}
    )

    def reset(self, inputs: PolicyInput, key: jax.Array) -> RoutesMemory:
        """See `Policy.reset`."""
        _, goal_index = _routes_and_goals(inputs)
        return RoutesMemory(
            stay_m=inputs.belief.p,
            stays=jnp.zeros(goal_index.shape, bool),
            yaw_rad=jax.vmap(quaternion.yaw)(inputs.belief.q),
            held_up=jnp.zeros(goal_index.shape, inputs.belief.p.dtype),
        )

    def act(
        self, carry: RoutesMemory, inputs: PolicyInput, key: jax.Array, step: jax.Array
    ) -> tuple[RoutesMemory, PoseTarget]:
        """See `Policy.act`."""
        routes, goal_index = _routes_and_goals(inputs)
        p = inputs.belief.p
        v = jax.vmap(quaternion.rotate)(inputs.belief.q, inputs.belief.nu[:, :3])
        aims = jax.vmap(
            lambda goal_index, p: guidance.compute_aim(routes, jnp.maximum(goal_index, 0), p)
        )(goal_index, p)
        stays = (goal_index < 0) | ~aims.exists
        stay = jnp.where((stays & ~carry.stays)[:, None], p, carry.stay_m)
        point = jnp.where(stays[:, None], stay, aims.point_m)
        ends = stays | aims.is_at_goal
        cruise, radius = inputs.params.cruise_speed_mps, inputs.params.vehicle_model.radius_m
        offset_m = point - p
        distance_m = jnp.sqrt(jnp.sum(offset_m**2, axis=-1) + 1e-12)
        speed = jnp.where(ends, jnp.minimum(cruise, NEAR_PER_S * distance_m), cruise)
        preferred_mps = offset_m * (speed / distance_m)[:, None]
        hold_s = self.dt_s * self.period
        shortfall = jnp.clip(
            (speed - jnp.sum(v * offset_m, axis=-1) / distance_m) / cruise, 0.0, 1.0
        )
        held_up = carry.held_up + hold_s / (PATIENCE_S + hold_s) * (shortfall - carry.held_up)
        fastest = jnp.where(stays, IDLE, 1.0) * cruise
        moving_bodies = _moving_bodies(inputs.obstacles)
        robots = jnp.arange(goal_index.shape[0])

        def robots_of(i: jax.Array) -> tuple[jax.Array, jax.Array]:
            """Return positions and velocities [R, 3] of all robots, as robot i knows them."""
            if inputs.others is None:
                return p, v
            return inputs.others.extrapolate_m(inputs.time_s)[i], inputs.others.v_mps[i]

        def choose_robot_velocity(i: jax.Array) -> tuple[jax.Array, jax.Array]:
            positions_m, goes = robots_of(i)
            reach = radius[i] + radius + self.margin_m
            team = AvoidedBodies(
                p_m=positions_m,
                v_mps=goes,
                reach_m=jnp.where(robots == i, -1.0, reach),
                yields=jnp.sum(goes**2, axis=-1) > STANDS_MPS**2,
            )
            away = make_room(team, p[i])
            makes_room = stays[i] & jnp.any(away != 0.0)
            if inputs.others is not None:
                travelled_m = jnp.sqrt(jnp.sum(goes**2, axis=-1)) * (
                    inputs.time_s - inputs.others.time_s[i]
                )
                team = inflate_for_doubt(team, p[i], jnp.minimum(DOUBT * travelled_m, DOUBT_M))
            inflated_m = jnp.where(
                moving_bodies.reach_m > 0.0, radius[i] + self.margin_m + moving_bodies.reach_m, -1.0
            )
            around = jax.tree.map(
                lambda *both: jnp.concatenate(both),
                team,
                replace(moving_bodies, reach_m=inflated_m),
            )
            goal = jnp.where(makes_room, fastest[i] * away, preferred_mps[i])
            chosen = choose_velocity(
                routes, around, p[i], v[i], goal, fastest[i], self.horizon_s, held_up[i]
            )
            return chosen, makes_room

        chosen, makes_room = jax.vmap(choose_robot_velocity)(robots)
        stay = jnp.where(makes_room[:, None], p, stay)
        yaw = _turn_headings(carry.yaw_rad, chosen, self.yaw_rate_radps * hold_s)
        # The loop of position adds what is left to the point; half the time that it holds.
        command = PoseTarget(position_m=p + 0.5 * hold_s * chosen, velocity_mps=chosen, yaw_rad=yaw)
        return RoutesMemory(stay_m=stay, stays=stays, yaw_rad=yaw, held_up=held_up), command


def _routes_and_goals(inputs: PolicyInput) -> tuple[Routes, jax.Array]:
    """Return the routes of the world and the goals of the robots."""
    if inputs.routes is None or inputs.goal_index is None:
        raise ConfigError(
            "policy AlongRoutes: the worlds were drawn without routes; give it to the Simulator "
            "that draws them"
        )
    return inputs.routes, inputs.goal_index


def _turn_headings(
    yaw: jax.Array, velocity: jax.Array, max_turn_rad: jax.Array | float
) -> jax.Array:
    """Turn headings [R] towards the courses of velocities [R, 3], by ``max_turn_rad`` rad."""
    moves = velocity[:, 0] ** 2 + velocity[:, 1] ** 2 > MOVES_MPS**2
    course = jnp.arctan2(
        jnp.where(moves, velocity[:, 1], 0.0), jnp.where(moves, velocity[:, 0], 1.0)
    )
    return jnp.where(
        moves,
        wrap_angle(yaw + jnp.clip(wrap_angle(course - yaw), -max_turn_rad, max_turn_rad)),
        yaw,
    )


def _moving_bodies(information: ObstacleInformation | None) -> AvoidedBodies:
    """Return moving obstacles as bounding spheres; still ones are rock of the routes already."""
    if information is None:
        none = jnp.zeros((0, 3))
        return AvoidedBodies(p_m=none, v_mps=none, reach_m=none[:, 0], yields=jnp.zeros(0, bool))
    return AvoidedBodies(
        p_m=information.p_m[:, 0],
        v_mps=information.velocity_mps,
        reach_m=jnp.where(information.exists & information.moves, information.radius_m, -1.0),
        yields=jnp.zeros(information.exists.shape, bool),
    )
