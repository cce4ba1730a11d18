"""What a metre of way costs one robot in moving water, and how fast it goes there.

A robot that is to move along a direction d over ground in a current c has to swim w = s d - c
through the water, where s is its speed over ground: at the speed V through the water,
s = d.c + sqrt(V^2 - |c - (d.c) d|^2) (Zermelo's triangle). Its heading is that of the way over
ground, as the guidance holds it, so that a current from the side is met with the side.
"""

from dataclasses import dataclass, field
from typing import Literal

import jax
import jax.numpy as jnp

type Objective = Literal["energy", "time"]
"""What is to be least."""

NO_WAY = 1e4
"""Cost of a metre, in metres of still water, against a current that cannot be overcome."""

_SPEEDS = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
"""Speeds through the water that are tried, over the cruise speed."""

_SLOWEST = 0.1
"""Over ground, over the cruise speed: who comes on no faster stands in a current for ever."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Swimmer:
    """What swimming takes one robot: p_0 + k_i v_i^n_i along each axis of its body alone."""

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
    hurry_w: jax.Array
    """[] worth of a second, W: with it the cruise speed is the one that costs least in still
    water."""
    objective: Objective = field(metadata={"static": True})


def swimmer(
    cruise_mps: jax.Array,
    terminal_mps: jax.Array,
    power_w: jax.Array,
    share: float,
    objective: Objective,
) -> Swimmer:
    """The robot of a row of powers.

    Args:
        cruise_mps: [] cruise speed.
        terminal_mps: [3] terminal speeds in still water; 0 for a way that it cannot push.
        power_w: [3, n] power at constant speeds of 0 to the terminal ones, in equal steps.
        share: of the terminal speeds that may be swum; the rest is left to the controllers.
        objective: what is to be least.
    """
    steps = power_w.shape[-1] - 1
    rest = power_w[0, 0]
    can = terminal_mps > 0.0
    safe = jnp.where(can, terminal_mps, 1.0)

    def above_rest(speed: jax.Array) -> jax.Array:
        at = jnp.clip(speed / safe * steps, 0.0, steps)
        low = jnp.minimum(at.astype(jnp.int32), steps - 1)
        rows = jnp.arange(3)
        value = power_w[rows, low]
        value += (power_w[rows, low + 1] - value) * (at - low)
        return jnp.maximum(value - rest, 1e-3)

    # Through the curve at the cruise speed and at half as much again.
    first = jnp.minimum(cruise_mps, safe / 1.5)
    one, two = above_rest(first), above_rest(1.5 * first)
    exponent = jnp.clip(jnp.log(two / one) / jnp.log(1.5), 1.0, 4.0)
    factor = one / first**exponent
    ahead = factor[0] * cruise_mps ** exponent[0]
    return Swimmer(
        cruise_mps=cruise_mps,
        limit_mps=jnp.where(can, share * terminal_mps, 1e-3),
        rest_w=rest,
        factor=factor,
        exponent=exponent,
        hurry_w=jnp.maximum((exponent[0] - 1.0) * ahead - rest, 0.0),
        objective=objective,
    )


def pace(robot: Swimmer, direction: jax.Array, flow: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Cost of a metre, and the speed over ground at which it costs least.

    Args:
        robot: one.
        direction: [..., 3] unit, W.
        flow: [..., 3] velocity of the water there, m/s, W.

    Returns:
        Cost [...] in metres of still water that take as much (of energy and hurry, or of time), at
        most `NO_WAY`; and speed [...] m/s, over ground, positive, the lowest where there is no way.
    """
    cruise = robot.cruise_mps
    along = jnp.sum(direction * flow, axis=-1)
    across = jnp.maximum(jnp.sum(flow * flow, axis=-1) - along * along, 0.0)
    level = jnp.sqrt(direction[..., 0] ** 2 + direction[..., 1] ** 2 + 1e-12)
    ahead = jnp.stack([direction[..., 0] / level, direction[..., 1] / level], axis=-1)
    if robot.objective == "time":
        square = cruise * cruise - across
        speed = along + jnp.sqrt(jnp.maximum(square, 1e-9))
        goes = (square > 0.0) & (speed > _SLOWEST * cruise)
        speed = jnp.maximum(speed, _SLOWEST * cruise)
        return jnp.where(goes, cruise / speed, NO_WAY), speed
    still = robot.rest_w + robot.factor[0] * cruise ** robot.exponent[0] + robot.hurry_w
    tried = jnp.array(_SPEEDS, along.dtype) * cruise
    square = tried**2 - across[..., None]
    speed = along[..., None] + jnp.sqrt(jnp.maximum(square, 1e-9))
    slow = jnp.maximum(speed, _SLOWEST * cruise)
    swum = slow[..., None] * direction[..., None, :] - flow[..., None, :]
    ahead = ahead[..., None, :]
    surge = swum[..., 0] * ahead[..., 0] + swum[..., 1] * ahead[..., 1]
    sway = swum[..., 1] * ahead[..., 0] - swum[..., 0] * ahead[..., 1]
    axes = jnp.stack([surge, sway, swum[..., 2]], axis=-1)
    effort = jnp.sum((axes / robot.limit_mps) ** 2, axis=-1)
    cost = (_power(robot, axes) + robot.hurry_w) * cruise / (still * slow)
    goes = (square > 0.0) & (speed > _SLOWEST * cruise) & (effort <= 1.0)
    cost = jnp.where(goes, cost, NO_WAY)
    least = jnp.min(cost, axis=-1)
    best = jnp.argmin(cost, axis=-1)
    chosen = jnp.take_along_axis(slow, best[..., None], axis=-1)[..., 0]
    # Where there is no way nobody counts on being fast.
    return least, jnp.where(least < NO_WAY, chosen, _SLOWEST * cruise)


def _power(robot: Swimmer, axes: jax.Array) -> jax.Array:
    """Power [...] at speeds [..., 3] along the body's axes.

    Thrusters' power goes with about the 1.5th power of their thrust. Thrusts for two axes add up in
    half of the thrusters and cancel in the others; their squares add up on the whole.
    """
    alone = robot.factor * (jnp.abs(axes) + 1e-6) ** robot.exponent
    return robot.rest_w + jnp.sum(alone ** (4.0 / 3.0), axis=-1) ** 0.75
