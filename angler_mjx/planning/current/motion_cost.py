"""Cost of a metre of path for one robot in moving water, and its speed over ground there.

A robot that moves along a direction d over ground in a current c has the velocity w = s d - c
through the water, where s is its speed over ground: at the speed V through the water,
s = d.c + sqrt(V^2 - |c - (d.c) d|^2) (Zermelo's triangle). Its heading is that of the path over
ground, as the guidance holds it, so that a current from the side needs sway.
"""

from dataclasses import dataclass, field
from typing import Literal

import jax
import jax.numpy as jnp

type Objective = Literal["energy", "time"]
"""Objective of a path."""

NO_PATH_COST = 1e4
"""Cost of a metre, in metres of still water, against a current that cannot be overcome."""

_SPEED_RATIOS = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
"""Speeds through the water that are tried, over the cruise speed."""

_MIN_SPEED_RATIO = 0.1
"""Least speed over ground as a fraction of the cruise speed; slower progress counts as none."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PowerModel:
    """Propulsion power of one robot: p_0 + k_i v_i^n_i along each axis of its body alone."""

    cruise_mps: jax.Array
    """[] through the water."""
    limit_mps: jax.Array
    """[3] highest speed through the water along surge, sway, heave alone."""
    rest_w: jax.Array
    """[] p_0: power of lying still."""
    factor: jax.Array
    """[3] k_i, in W (s/m)^n_i."""
    exponent: jax.Array
    """[3] n_i."""
    time_weight_w: jax.Array
    """[] worth of a second, W: with it the cruise speed is the one that costs least in still
    water."""
    objective: Objective = field(metadata={"static": True})
    limits_ground_speed: bool = field(default=False, metadata={"static": True})
    """Whether no speed over ground exceeds the cruise speed."""


def power_model(
    cruise_mps: jax.Array,
    terminal_mps: jax.Array,
    power_w: jax.Array,
    max_speed_fraction: float,
    objective: Objective,
    limits_ground_speed: bool = False,
) -> PowerModel:
    """Fit the power model of a robot to its powers.

    Args:
        cruise_mps: [] cruise speed.
        terminal_mps: [3] terminal speeds in still water; 0 without thrust that way.
        power_w: [3, n] power at constant speeds of 0 to the terminal ones, in equal steps.
        max_speed_fraction: of the terminal speeds that may be swum; the rest is left to the
            controllers.
        objective: of the path.
        limits_ground_speed: whether no speed over ground exceeds the cruise speed.
    """
    steps = power_w.shape[-1] - 1
    rest_w = power_w[0, 0]
    can_move = terminal_mps > 0.0
    safe_speed_mps = jnp.where(can_move, terminal_mps, 1.0)

    def above_rest(speed: jax.Array) -> jax.Array:
        at = jnp.clip(speed / safe_speed_mps * steps, 0.0, steps)
        low = jnp.minimum(at.astype(jnp.int32), steps - 1)
        rows = jnp.arange(3)
        value = power_w[rows, low]
        value += (power_w[rows, low + 1] - value) * (at - low)
        return jnp.maximum(value - rest_w, 1e-3)

    # Through the curve at the cruise speed and at half as much again.
    low_speed_mps = jnp.minimum(cruise_mps, safe_speed_mps / 1.5)
    power_low_w, power_high_w = above_rest(low_speed_mps), above_rest(1.5 * low_speed_mps)
    exponent = jnp.clip(jnp.log(power_high_w / power_low_w) / jnp.log(1.5), 1.0, 4.0)
    factor = power_low_w / low_speed_mps**exponent
    cruise_power_w = factor[0] * cruise_mps ** exponent[0]
    return PowerModel(
        cruise_mps=cruise_mps,
        limit_mps=jnp.where(can_move, max_speed_fraction * terminal_mps, 1e-3),
        rest_w=rest_w,
        factor=factor,
        exponent=exponent,
        time_weight_w=jnp.maximum((exponent[0] - 1.0) * cruise_power_w - rest_w, 0.0),
        objective=objective,
        limits_ground_speed=limits_ground_speed,
    )


def cost_and_speed(
    robot: PowerModel, direction: jax.Array, flow: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the cost of a metre, and the speed over ground of least cost.

    Args:
        robot: one.
        direction: [..., 3] unit, W.
        flow: [..., 3] velocity of the water there, m/s, W.

    Returns:
        Cost [...] in metres of still water that take as much (of energy and hurry, or of time), at
        most `NO_PATH_COST`; and speed [...] m/s, over ground, positive, the lowest where there is
        no way.
    """
    # Axis by axis and speed by speed, so that a GPU keeps all of it in registers.
    cruise = robot.cruise_mps
    x, y, z = (direction[..., axis] for axis in range(3))
    stream = [flow[..., axis] for axis in range(3)]
    along = x * stream[0] + y * stream[1] + z * stream[2]
    square_of_flow = stream[0] ** 2 + stream[1] ** 2 + stream[2] ** 2
    across = jnp.maximum(square_of_flow - along * along, 0.0)
    if robot.objective == "time":
        square = cruise * cruise - across
        speed = along + jnp.sqrt(jnp.maximum(square, 1e-9))
        is_possible = (square > 0.0) & (speed > _MIN_SPEED_RATIO * cruise)
        speed = _limit_ground_speed(robot, speed)
        return jnp.where(is_possible, cruise / speed, NO_PATH_COST), speed
    still_power_w = (
        robot.rest_w + robot.factor[0] * cruise ** robot.exponent[0] + robot.time_weight_w
    )
    level = jnp.sqrt(x * x + y * y + 1e-12)
    ahead = (x / level, y / level)
    best_cost = jnp.full_like(along, NO_PATH_COST)
    # Where there is no way nobody counts on being fast.
    best_speed = jnp.full_like(along, 1.0) * (_MIN_SPEED_RATIO * cruise)
    for ratio in _SPEED_RATIOS:
        square = (ratio * cruise) ** 2 - across
        speed = along + jnp.sqrt(jnp.maximum(square, 1e-9))
        ground_speed = _limit_ground_speed(robot, speed)
        water_velocity = [ground_speed * d - c for d, c in zip((x, y, z), stream, strict=True)]
        surge = water_velocity[0] * ahead[0] + water_velocity[1] * ahead[1]
        sway = water_velocity[1] * ahead[0] - water_velocity[0] * ahead[1]
        axes = (surge, sway, water_velocity[2])
        effort = sum((v / robot.limit_mps[n]) ** 2 for n, v in enumerate(axes))
        cost = (
            (_body_power(robot, axes) + robot.time_weight_w)
            * cruise
            / (still_power_w * ground_speed)
        )
        is_possible = (square > 0.0) & (speed > _MIN_SPEED_RATIO * cruise) & (effort <= 1.0)
        better = is_possible & (cost < best_cost)
        best_cost, best_speed = (
            jnp.where(better, cost, best_cost),
            jnp.where(better, ground_speed, best_speed),
        )
    return best_cost, best_speed


def _limit_ground_speed(robot: PowerModel, speed_mps: jax.Array) -> jax.Array:
    """Return speeds over ground, at least the lowest, and at most the cruise speed if it limits."""
    speed_mps = jnp.maximum(speed_mps, _MIN_SPEED_RATIO * robot.cruise_mps)
    return jnp.minimum(speed_mps, robot.cruise_mps) if robot.limits_ground_speed else speed_mps


def _body_power(robot: PowerModel, axes: tuple[jax.Array, ...]) -> jax.Array:
    """Return the power [...] at speeds [...] along the three axes of the body.

    Thrusters' power goes with about the 1.5th power of their thrust. Thrusts for two axes add up in
    half of the thrusters and cancel in the others; their squares add up on the whole.
    """
    # By logarithms: powers to any exponent take several times as long on a GPU.
    thrust_sum = sum(
        jnp.exp(4.0 / 3.0 * (jnp.log(factor) + exponent * jnp.log(jnp.abs(speed) + 1e-6)))
        for factor, exponent, speed in zip(robot.factor, robot.exponent, axes, strict=True)
    )
    return robot.rest_w + jnp.exp(0.75 * jnp.log(thrust_sum))
