"""Observations of each robot, in parts with names, units, frames and bounds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.learning.actions import RobotMotion
from angler_mjx.sim.state import World, WorldState
from angler_mjx.world import currents
from angler_mjx.world.obstacles import bounding_radius

NUM_NEAREST = 3
"""Number of observed robots and of observed obstacles, the nearest first."""
RANGE_M = 10.0
"""Range [m] of observed robots and obstacles; farther ones are placed at this distance, ahead."""
CELL_OFFSETS = np.array(list(product((-1, 0, 1), repeat=3)), np.int32)
"""Points around a robot in F, in edges of a cell, in the order of observation."""
LAYOUT = 2
"""Version of the meaning of observations, to be stored with learned weights: parts of the same name
in another layout are other numbers."""


@dataclass(frozen=True, kw_only=True)
class ObservedState:
    """Inputs of the parts: worlds [W] at one time."""

    worlds: World
    """Bank of worlds."""
    rows: jax.Array
    """int32 [W] index in the bank."""
    state: WorldState
    estimate: RobotMotion
    """[W, R] estimated motion of the robots; ``p``, ``q`` and ``nu`` are used."""
    flow: jax.Array
    """[W, R, 3] estimated current, m/s, in W."""
    aim_m: jax.Array
    """[W, R, 3] position of the aim in W."""
    aim_yaw_rad: jax.Array
    """[W, R] heading of the aim."""
    action: jax.Array
    """[W, R, size] last action, from -1 to 1."""

    def to_body_frame(self, vector: jax.Array) -> jax.Array:
        """Rotate vectors [W, R, ..., 3] of W into F."""
        q = self.estimate.q.reshape(*self.estimate.q.shape[:2], *(1,) * (vector.ndim - 3), 4)
        turn = jnp.vectorize(quaternion.rotate_inverse, signature="(4),(3)->(3)")
        turned: jax.Array = turn(q, vector)
        return turned

    def to_world_frame(self, offsets: jax.Array) -> jax.Array:
        """Return offsets [n, 3] from each robot in F, along the axes of W, [W, R, n, 3]."""
        turn = jax.vmap(quaternion.rotate, (None, 0))
        turned: jax.Array = jax.vmap(jax.vmap(turn, (0, None)), (0, None))(self.estimate.q, offsets)
        return turned


def observe_velocity(observed: ObservedState) -> jax.Array:
    """Return [6] estimated velocity over ground, m/s and rad/s, in F."""
    return observed.estimate.nu


def observe_upright(observed: ObservedState) -> jax.Array:
    """Return [3] the world's z axis in F: attitude without heading, 1."""
    up = jnp.zeros_like(observed.estimate.p).at[..., 2].set(1.0)
    return observed.to_body_frame(up)


def observe_goal(observed: ObservedState) -> jax.Array:
    """Return [3] the vector from the robot to its aim (goal, or the pose to hold), m, in F."""
    return observed.to_body_frame(observed.aim_m - observed.estimate.p)


def observe_heading(observed: ObservedState) -> jax.Array:
    """Return [2] cosine and sine of the aim's heading less the robot's, 1."""
    error_rad = observed.aim_yaw_rad - jax.vmap(jax.vmap(quaternion.yaw))(observed.estimate.q)
    return jnp.stack([jnp.cos(error_rad), jnp.sin(error_rad)], axis=-1)


def observe_depth(observed: ObservedState) -> jax.Array:
    """Return [1] z of the robot, m, in W: 0 at the surface, negative below."""
    return observed.estimate.p[..., 2:]


def observe_current(observed: ObservedState) -> jax.Array:
    """Return [3] the estimated velocity of the water at the robot, m/s, in F."""
    return observed.to_body_frame(observed.flow)


def observe_robots(observed: ObservedState) -> jax.Array:
    """Return [3 * `NUM_NEAREST`] vectors from the robot to the nearest others, true, m, in F."""
    positions_m, n = observed.state.vehicles.p, observed.estimate.p.shape[1]
    offset_m = positions_m[:, None, :] - observed.estimate.p[:, :, None]
    is_other = jnp.broadcast_to(~np.eye(n, dtype=bool), offset_m.shape[:-1])
    return _select_nearest(observed, offset_m, is_other)[0].reshape(*offset_m.shape[:2], -1)


def observe_obstacles(observed: ObservedState) -> jax.Array:
    """Return [4 * `NUM_NEAREST`] vectors to the nearest obstacles' centres, m, in F; radii, m."""
    body = observed.worlds.environment.obstacles
    exists = body.exists[observed.rows]
    offset_m = observed.state.obstacles.p[:, None, :] - observed.estimate.p[:, :, None]
    is_visible = jnp.broadcast_to(exists[:, None], offset_m.shape[:-1])
    offsets_m, index, is_near = _select_nearest(observed, offset_m, is_visible)
    radius = jax.vmap(jax.vmap(bounding_radius))(
        body.kind[observed.rows], body.size_m[observed.rows]
    )
    radii_m = jnp.broadcast_to(radius[:, None], offset_m.shape[:-1])
    size = jnp.take_along_axis(radii_m, index, axis=2)
    size = jnp.pad(
        jnp.where(is_near, size, 0.0), ((0, 0), (0, 0), (0, NUM_NEAREST - size.shape[2]))
    )
    return jnp.concatenate([offsets_m, size[..., None]], axis=-1).reshape(*offset_m.shape[:2], -1)


def observe_cells(observed: ObservedState) -> jax.Array:
    """Return [27] 1 at points in rock or outside: 3 x 3 x 3 points in F, edges of a cell apart."""
    grid = observed.worlds.environment.grid
    shape = np.array(grid.occupied.shape[1:])
    origin, size = grid.origin_m[observed.rows], grid.cell_m[observed.rows]
    offset = observed.to_world_frame(jnp.asarray(CELL_OFFSETS, observed.estimate.p.dtype))
    at = (observed.estimate.p - origin[:, None]) / size[:, None, None]
    at = jnp.floor(at[:, :, None] + offset).astype(jnp.int32)
    outside = jnp.any((at < 0) | (at >= shape), axis=-1)
    x, y, z = jnp.moveaxis(jnp.clip(at, 0, shape - 1), -1, 0)
    rock = grid.occupied[observed.rows[:, None, None], x, y, z]
    return (rock | outside).astype(observed.estimate.p.dtype)


def observe_action(observed: ObservedState) -> jax.Array:
    """Return [size] the last action, from -1 to 1."""
    return observed.action


def observe_joints(observed: ObservedState) -> jax.Array:
    """Return [2 J] true positions, rad or m, then speeds of the joints of the arm.

    Those of a robot without an arm are 0.
    """
    joints = observed.state.vehicles.joints
    assert joints is not None  # `select_parts` refuses the part without joints
    return jnp.concatenate([joints.position, joints.velocity], axis=-1)


def _select_nearest(
    observed: ObservedState, offset_m: jax.Array, is_visible: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return `NUM_NEAREST` of vectors [W, R, n, 3] in F, padded, their indices and visibility."""
    distance_sq = jnp.sum(offset_m * offset_m, axis=-1)
    distance_sq = jnp.where(is_visible & (distance_sq < RANGE_M**2), distance_sq, jnp.inf)
    nearest, index = jax.lax.top_k(-distance_sq, min(NUM_NEAREST, offset_m.shape[2]))
    is_near = jnp.isfinite(nearest)
    chosen = observed.to_body_frame(jnp.take_along_axis(offset_m, index[..., None], axis=2))
    out_of_range = jnp.asarray([RANGE_M, 0.0, 0.0], offset_m.dtype)
    chosen = jnp.where(is_near[..., None], chosen, out_of_range)
    missing = jnp.broadcast_to(out_of_range, (*offset_m.shape[:2], NUM_NEAREST - index.shape[2], 3))
    return jnp.concatenate([chosen, missing], axis=2), index, is_near


@dataclass(frozen=True, kw_only=True)
class ObservationPart:
    """Part of an observation."""

    name: str
    observe: Callable[[ObservedState], jax.Array]
    size: int
    unit: str
    low: float
    high: float


PARTS = {
    part.name: part
    for part in (
        ObservationPart(
            name="velocity", observe=observe_velocity, size=6, unit="m/s, rad/s", low=-5.0, high=5.0
        ),
        ObservationPart(
            name="upright", observe=observe_upright, size=3, unit="1", low=-1.0, high=1.0
        ),
        ObservationPart(
            name="goal", observe=observe_goal, size=3, unit="m", low=-100.0, high=100.0
        ),
        ObservationPart(
            name="heading", observe=observe_heading, size=2, unit="1", low=-1.0, high=1.0
        ),
        ObservationPart(
            name="depth", observe=observe_depth, size=1, unit="m", low=-1000.0, high=0.0
        ),
        ObservationPart(
            name="current", observe=observe_current, size=3, unit="m/s", low=-5.0, high=5.0
        ),
        ObservationPart(
            name="robots",
            observe=observe_robots,
            size=3 * NUM_NEAREST,
            unit="m",
            low=-RANGE_M,
            high=RANGE_M,
        ),
        ObservationPart(
            name="obstacles",
            observe=observe_obstacles,
            size=4 * NUM_NEAREST,
            unit="m",
            low=-RANGE_M,
            high=RANGE_M,
        ),
        ObservationPart(
            name="cells", observe=observe_cells, size=len(CELL_OFFSETS), unit="1", low=0.0, high=1.0
        ),
        ObservationPart(
            name="action", observe=observe_action, size=0, unit="1", low=-1.0, high=1.0
        ),
        ObservationPart(
            name="joints",
            observe=observe_joints,
            size=0,
            unit="rad, rad/s or m, m/s",
            low=-10.0,
            high=10.0,
        ),
    )
}
"""Parts by name; numbers are clipped to their bounds. ``observe_action`` has the size of the
action, ``observe_joints`` twice the number of joints."""


def select_parts(
    names: Sequence[str], action_size: int, joints: int = 0
) -> tuple[ObservationPart, ...]:
    """Return parts by their names, in their order.

    Args:
        names: of `PARTS`.
        action_size: number of values of an action.
        joints: number of joints of the fleet's arms.

    Raises:
        ConfigError: no name, a repeated name, or an unknown name; joints, and no vehicle has any.
    """
    unknown = [name for name in names if name not in PARTS]
    if unknown or not names or len(set(names)) != len(names) or isinstance(names, str):
        raise ConfigError(
            f"observe = {list(names)}: give some of {', '.join(PARTS)}, each once"
            + (f"; there is no {unknown[0]!r}" if unknown else "")
        )
    if "joints" in names and not joints:
        raise ConfigError("observe: 'joints': no vehicle of the fleet has joints; leave it out")
    sized = {"action": action_size, "joints": 2 * joints}
    return tuple(
        ObservationPart(**{**vars(PARTS[name]), "size": sized.get(name, PARTS[name].size)})
        for name in names
    )


def build_bounds(parts: Sequence[ObservationPart]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest numbers [size] of an observation of one robot."""
    low = np.concatenate([np.full(part.size, part.low, np.float32) for part in parts])
    high = np.concatenate([np.full(part.size, part.high, np.float32) for part in parts])
    return low, high


def build_observation(parts: Sequence[ObservationPart], observed: ObservedState) -> jax.Array:
    """Return observations [W, R, size], parts one after the other."""
    values = [jnp.clip(part.observe(observed), part.low, part.high) for part in parts]
    return jnp.concatenate(values, axis=-1)


def current_at(worlds: World, rows: jax.Array, p: jax.Array, t: jax.Array) -> jax.Array:
    """Return true current [W, R, 3] m/s in W at p [W, R, 3] and t [W] s, of ``rows`` of a bank."""
    current = jax.tree.map(lambda leaf: leaf[rows], worlds.environment.current)
    velocity_at = jax.vmap(jax.vmap(currents.velocity, (None, 0, None)))
    flow: jax.Array = velocity_at(current, p, t)
    return flow
