"""What an agent is told of each robot, in parts that have names, units, frames and bounds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import World, WorldState
from angler_mjx.world import currents
from angler_mjx.world.obstacles import bounding_radius

NEAREST = 3
"""Robots and obstacles that are told, the nearest first."""
REACH_M = 10.0
"""How far robots and obstacles are seen; who is farther stands at this distance, ahead."""
WINDOW = np.array(list(product((-1, 0, 1), repeat=3)), np.int32)
"""Points around a robot in F, edges of a cell, in the order in which they are told."""
LAYOUT = 2
"""Version of the meaning of observations, to be stored with learned weights: parts of the same name
in another layout are other numbers."""


@dataclass(frozen=True, kw_only=True)
class ObservedState:
    """What parts are made of: worlds [W] at one time."""

    worlds: World
    """A bank."""
    rows: jax.Array
    """int32 [W] which of them."""
    state: WorldState
    told: VehicleState
    """[W, R] the robots' motion as they are told it; ``p``, ``q`` and ``nu`` are looked at."""
    flow: jax.Array
    """[W, R, 3] current as they are told it, m/s, in W."""
    aim_m: jax.Array
    """[W, R, 3] in W."""
    aim_yaw_rad: jax.Array
    """[W, R]."""
    action: jax.Array
    """[W, R, size] the last one, from -1 to 1."""

    def turned(self, vector: jax.Array) -> jax.Array:
        """Vectors [W, R, ..., 3] of W in F."""
        q = self.told.q.reshape(*self.told.q.shape[:2], *(1,) * (vector.ndim - 3), 4)
        turn = jnp.vectorize(quaternion.rotate_inverse, signature="(4),(3)->(3)")
        turned: jax.Array = turn(q, vector)
        return turned

    def in_world(self, offsets: jax.Array) -> jax.Array:
        """Return offsets [n, 3] from each robot in F, along the axes of W, [W, R, n, 3]."""
        turn = jax.vmap(quaternion.rotate, (None, 0))
        turned: jax.Array = jax.vmap(jax.vmap(turn, (0, None)), (0, None))(self.told.q, offsets)
        return turned


def velocity(sight: ObservedState) -> jax.Array:
    """[6] velocity over ground as told, m/s and rad/s, in F."""
    return sight.told.nu


def upright(sight: ObservedState) -> jax.Array:
    """[3] the world's z axis in F: attitude without heading, 1."""
    up = jnp.zeros_like(sight.told.p).at[..., 2].set(1.0)
    return sight.turned(up)


def goal(sight: ObservedState) -> jax.Array:
    """[3] from the robot to its aim (goal, or the pose to hold), m, in F."""
    return sight.turned(sight.aim_m - sight.told.p)


def heading(sight: ObservedState) -> jax.Array:
    """[2] cosine and sine of the aim's heading less the robot's, 1."""
    off = sight.aim_yaw_rad - jax.vmap(jax.vmap(quaternion.yaw))(sight.told.q)
    return jnp.stack([jnp.cos(off), jnp.sin(off)], axis=-1)


def depth(sight: ObservedState) -> jax.Array:
    """[1] z of the robot, m, in W: 0 at the surface, negative below."""
    return sight.told.p[..., 2:]


def current(sight: ObservedState) -> jax.Array:
    """[3] velocity of the water at the robot as told, m/s, in F."""
    return sight.turned(sight.flow)


def robots(sight: ObservedState) -> jax.Array:
    """[3 * `NEAREST`] from the robot to the nearest others, as they are, m, in F."""
    there, n = sight.state.vehicles.p, sight.told.p.shape[1]
    to = there[:, None, :] - sight.told.p[:, :, None]
    seen = jnp.broadcast_to(~np.eye(n, dtype=bool), to.shape[:-1])
    return _nearest(sight, to, seen)[0].reshape(*to.shape[:2], -1)


def obstacles(sight: ObservedState) -> jax.Array:
    """[4 * `NEAREST`] from the robot to the nearest obstacles' centres, m, in F; radii, m."""
    body = sight.worlds.environment.obstacles
    exists = body.exists[sight.rows]
    to = sight.state.obstacles.p[:, None, :] - sight.told.p[:, :, None]
    seen = jnp.broadcast_to(exists[:, None], to.shape[:-1])
    at, index, near = _nearest(sight, to, seen)
    radius = jax.vmap(jax.vmap(bounding_radius))(body.kind[sight.rows], body.size_m[sight.rows])
    spread = jnp.broadcast_to(radius[:, None], to.shape[:-1])
    size = jnp.take_along_axis(spread, index, axis=2)
    size = jnp.pad(jnp.where(near, size, 0.0), ((0, 0), (0, 0), (0, NEAREST - size.shape[2])))
    return jnp.concatenate([at, size[..., None]], axis=-1).reshape(*to.shape[:2], -1)


def cells(sight: ObservedState) -> jax.Array:
    """[27] 1 where a point is in rock or outside: 3 x 3 x 3 points in F, edges of a cell apart."""
    grid = sight.worlds.environment.grid
    shape = np.array(grid.occupied.shape[1:])
    origin, size = grid.origin_m[sight.rows], grid.cell_m[sight.rows]
    offset = sight.in_world(jnp.asarray(WINDOW, sight.told.p.dtype))
    at = (sight.told.p - origin[:, None]) / size[:, None, None]
    at = jnp.floor(at[:, :, None] + offset).astype(jnp.int32)
    outside = jnp.any((at < 0) | (at >= shape), axis=-1)
    x, y, z = jnp.moveaxis(jnp.clip(at, 0, shape - 1), -1, 0)
    rock = grid.occupied[sight.rows[:, None, None], x, y, z]
    return (rock | outside).astype(sight.told.p.dtype)


def action(sight: ObservedState) -> jax.Array:
    """[size] the last action, from -1 to 1."""
    return sight.action


def _nearest(
    sight: ObservedState, to: jax.Array, seen: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The `NEAREST` of vectors [W, R, n, 3] in F, filled up, their places, if they are seen."""
    far = jnp.sum(to * to, axis=-1)
    far = jnp.where(seen & (far < REACH_M**2), far, jnp.inf)
    least, index = jax.lax.top_k(-far, min(NEAREST, to.shape[2]))
    near = jnp.isfinite(least)
    chosen = sight.turned(jnp.take_along_axis(to, index[..., None], axis=2))
    ahead = jnp.asarray([REACH_M, 0.0, 0.0], to.dtype)
    chosen = jnp.where(near[..., None], chosen, ahead)
    missing = jnp.broadcast_to(ahead, (*to.shape[:2], NEAREST - index.shape[2], 3))
    return jnp.concatenate([chosen, missing], axis=2), index, near


@dataclass(frozen=True, kw_only=True)
class ObservationPart:
    """A part of an observation."""

    name: str
    see: Callable[[ObservedState], jax.Array]
    size: int
    unit: str
    low: float
    high: float


PARTS = {
    part.name: part
    for part in (
        ObservationPart(
            name="velocity", see=velocity, size=6, unit="m/s, rad/s", low=-5.0, high=5.0
        ),
        ObservationPart(name="upright", see=upright, size=3, unit="1", low=-1.0, high=1.0),
        ObservationPart(name="goal", see=goal, size=3, unit="m", low=-100.0, high=100.0),
        ObservationPart(name="heading", see=heading, size=2, unit="1", low=-1.0, high=1.0),
        ObservationPart(name="depth", see=depth, size=1, unit="m", low=-1000.0, high=0.0),
        ObservationPart(name="current", see=current, size=3, unit="m/s", low=-5.0, high=5.0),
        ObservationPart(
            name="robots", see=robots, size=3 * NEAREST, unit="m", low=-REACH_M, high=REACH_M
        ),
        ObservationPart(
            name="obstacles", see=obstacles, size=4 * NEAREST, unit="m", low=-REACH_M, high=REACH_M
        ),
        ObservationPart(name="cells", see=cells, size=len(WINDOW), unit="1", low=0.0, high=1.0),
        ObservationPart(name="action", see=action, size=0, unit="1", low=-1.0, high=1.0),
    )
}
"""By name; numbers are clipped to their bounds. ``action`` has as many as the action."""


def chosen(names: Sequence[str], action_size: int) -> tuple[ObservationPart, ...]:
    """Parts by their names, in their order.

    Raises:
        ConfigError: none is named, or one twice, or one that does not exist.
    """
    wrong = [name for name in names if name not in PARTS]
    if wrong or not names or len(set(names)) != len(names) or isinstance(names, str):
        raise ConfigError(
            f"observe = {list(names)}: give some of {', '.join(PARTS)}, each once"
            + (f"; there is no {wrong[0]!r}" if wrong else "")
        )
    sized = {"action": action_size}
    return tuple(
        ObservationPart(**{**vars(PARTS[name]), "size": sized.get(name, PARTS[name].size)})
        for name in names
    )


def bounds(parts: Sequence[ObservationPart]) -> tuple[Any, Any]:
    """Lowest and highest numbers [size] of an observation of one robot."""
    low = np.concatenate([np.full(part.size, part.low, np.float32) for part in parts])
    high = np.concatenate([np.full(part.size, part.high, np.float32) for part in parts])
    return low, high


def see(parts: Sequence[ObservationPart], sight: ObservedState) -> jax.Array:
    """Observations [W, R, size], parts one after the other."""
    seen = [jnp.clip(part.see(sight), part.low, part.high) for part in parts]
    return jnp.concatenate(seen, axis=-1)


def flow_at(worlds: World, rows: jax.Array, p: jax.Array, t: jax.Array) -> jax.Array:
    """True current [W, R, 3] m/s in W at p [W, R, 3] and t [W] s, of ``rows`` of a bank."""
    here = jax.tree.map(lambda leaf: leaf[rows], worlds.environment.current)
    at = jax.vmap(jax.vmap(currents.velocity, (None, 0, None)))
    flow: jax.Array = at(here, p, t)
    return flow
