"""Contact detection: exact distances from every hull to everything it can touch.

The first touch ends the episode of a robot, unless the simulation has contact as physics
(`angler_mjx.sim.contact_motion`), where distances are recorded alone. All distances are
those of the hull's capsules, which docs/explanation/validation.md compares with coal. Links of arms
belong to the hull, in their present posture; a robot's own links do not meet its hull.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import clearance, neighbour_search, quaternion
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.posture import bounding_radii, hull_capsules
from angler_mjx.sim.state import Touched
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import STATIC, ObstacleState

ALL_PAIRS_UP_TO = 24
"""Robots of a world up to which every pair of hulls is worked out, however far apart.

On the CPU the search costs less above about 12 robots, on few robots it costs more to compile. At
24 all pairs bring detection to 1.9 times the price of a robot alone.
"""

SEPARATION_RADIUS_M = 1.0
"""Hulls further apart than this are not looked for, two lengths of a hull: separations are exact up
to it, and it is their value where no other hull is nearer."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Contact:
    """The nearest thing to each robot; [R] leads."""

    clearance_m: jax.Array
    """[R] to cells, floor and obstacles; negative where the hull overlaps."""
    separation_m: jax.Array
    """[R] to the nearest other hull, at most `SEPARATION_RADIUS_M`; inf in a fleet of one."""
    nearest: jax.Array
    """int32 [R] a `Touched`: what is nearest; CELL where nothing is within the exact radius."""
    nearest_index: jax.Array
    """int32 [R] which obstacle or robot; -1 otherwise."""
    nearest_is_static: jax.Array
    """bool [R] cell, floor, or an obstacle that never moves."""
    closing_speed_mps: jax.Array
    """[R] relative speed of the centres."""


def detect_contacts(
    environment: Environment,
    vehicles: VehicleParams,
    state: VehicleState,
    obstacles: ObstacleState,
) -> Contact:
    """Nearest thing to each robot of one world.

    Args:
        environment: of the world.
        vehicles: [R] leads.
        state: [R] leads.
        obstacles: now.
    """
    to_world = jax.vmap(jax.vmap(_transform_point, (None, None, 0)))
    joints = state.joints
    hull = hull_capsules(vehicles, None if joints is None else joints.position)
    radius, r = bounding_radii(vehicles, hull), hull[2]
    a, b = to_world(state.p, state.q, hull[0]), to_world(state.p, state.q, hull[1])
    v = jax.vmap(quaternion.rotate)(state.q, state.nu[:, :3])
    grid = environment.grid
    to_cells = jax.vmap(clearance.capsules_grid, (0, 0, 0, 0, None, None, None))(
        a, b, r, state.p, grid.occupied, grid.origin_m, grid.cell_m
    )
    lowest = jnp.min(jnp.minimum(a[..., 2], b[..., 2]) - r, axis=1)
    to_floor = lowest - environment.floor_z_m
    to_obstacle, obstacle = _nearest_obstacle(environment, a, b, r, obstacles)
    to_robot, robot = _nearest_robot(state.p, radius, (a, b, r))

    # A separation that only says that no robot is near must not pass for the nearest thing.
    to_named_robot = jnp.where(robot >= 0, to_robot, jnp.inf)
    distances = jnp.stack([to_cells, to_floor, to_obstacle, to_named_robot])
    which = jnp.argmin(distances, axis=0)
    nearest = jnp.array([Touched.CELL, Touched.FLOOR, Touched.OBSTACLE, Touched.ROBOT])[which]
    obstacle_v = jax.vmap(quaternion.rotate)(obstacles.q, obstacles.nu[:, :3])
    other_v = jnp.where(
        (nearest == Touched.ROBOT)[:, None],
        v[robot],
        jnp.where((nearest == Touched.OBSTACLE)[:, None], _take_rows(obstacle_v, obstacle), 0.0),
    )
    stands = _take_rows(environment.obstacles.motion == STATIC, obstacle)
    return Contact(
        clearance_m=jnp.min(distances[:3], axis=0),
        separation_m=to_robot,
        nearest=nearest,
        nearest_index=jnp.where(
            nearest == Touched.ROBOT, robot, jnp.where(nearest == Touched.OBSTACLE, obstacle, -1)
        ),
        nearest_is_static=(nearest != Touched.ROBOT) & ((nearest != Touched.OBSTACLE) | stands),
        closing_speed_mps=jnp.sqrt(jnp.sum((v - other_v) ** 2, axis=1)),
    )


def compute_distances(
    environment: Environment,
    vehicles: VehicleParams,
    p: jax.Array,
    q: jax.Array,
    obstacles: ObstacleState,
    joint_position: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Distances [R] of the hulls of one world to rock and floor, to obstacles, and to other hulls.

    As exact as those of `detect_contacts`, each as far as it is on its own.

    Args:
        environment: of the world.
        vehicles: [R] leads.
        p: [R, 3] m in W.
        q: [R, 4].
        obstacles: now.
        joint_position: [R, J] rad or m; None where no robot has joints.
    """
    to_world = jax.vmap(jax.vmap(_transform_point, (None, None, 0)))
    hull, grid = hull_capsules(vehicles, joint_position), environment.grid
    a, b, r = to_world(p, q, hull[0]), to_world(p, q, hull[1]), hull[2]
    to_cells = jax.vmap(clearance.capsules_grid, (0, 0, 0, 0, None, None, None))(
        a, b, r, p, grid.occupied, grid.origin_m, grid.cell_m
    )
    lowest = jnp.min(jnp.minimum(a[..., 2], b[..., 2]) - r, axis=1)
    to_rock = jnp.minimum(to_cells, lowest - environment.floor_z_m)
    to_obstacle, _ = _nearest_obstacle(environment, a, b, r, obstacles)
    to_robot, _ = _nearest_robot(p, bounding_radii(vehicles, hull), (a, b, r))
    return to_rock, to_obstacle, to_robot


def _transform_point(p: jax.Array, q: jax.Array, point: jax.Array) -> jax.Array:
    """Point [3] of a body at p [3], q [4], in W."""
    return p + quaternion.rotate(q, point)


def _nearest_obstacle(
    environment: Environment, a: jax.Array, b: jax.Array, r: jax.Array, now: ObstacleState
) -> tuple[jax.Array, jax.Array]:
    """Distance [R] to the nearest obstacle and its row [R]; inf and 0 where there is none."""
    obstacles = environment.obstacles
    n_robot, n_obstacle = a.shape[0], obstacles.kind.shape[0]
    if n_obstacle == 0:
        return jnp.full(n_robot, jnp.inf, a.dtype), jnp.zeros(n_robot, jnp.int32)

    def hull_gap(a: jax.Array, b: jax.Array, r: jax.Array, row: tuple[jax.Array, ...]) -> jax.Array:
        p, q, kind, size, exists = row
        gap = clearance.capsules_obstacle(a, b, r, p, q, kind, size, obstacles.kinds)
        return jnp.where(exists, gap, jnp.inf)

    rows = (now.p, now.q, obstacles.kind, obstacles.size_m, obstacles.exists)
    gaps = jax.vmap(jax.vmap(hull_gap, (None, None, None, 0)), (0, 0, 0, None))(a, b, r, rows)
    return jnp.min(gaps, axis=1), jnp.argmin(gaps, axis=1).astype(jnp.int32)


def _nearest_robot(
    p: jax.Array, radius: jax.Array, hulls: tuple[jax.Array, jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """Distance [R] to the nearest other hull and its robot [R].

    A fleet of one has inf and 0. Where no other hull is nearer than `SEPARATION_RADIUS_M` that is
    the distance, and the index is -1.
    """
    n = p.shape[0]
    if n == 1:
        return jnp.full(1, jnp.inf, p.dtype), jnp.zeros(1, jnp.int32)
    if n <= ALL_PAIRS_UP_TO:
        return _nearest_of_all(*hulls)
    return neighbour_search.find_nearest(
        p,
        radius,
        hulls,
        lambda hull, other: clearance.capsules_capsules(*hull, *other),
        SEPARATION_RADIUS_M,
    )


def _nearest_of_all(a: jax.Array, b: jax.Array, r: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Distance [R] to the nearest other hull and its robot [R], from all pairs."""
    n = a.shape[0]
    first, second = np.triu_indices(n, k=1)
    gap = jax.vmap(clearance.capsules_capsules)(
        a[first], b[first], r[first], a[second], b[second], r[second]
    )
    pair = np.zeros((n, n), np.int32)
    pair[first, second] = pair[second, first] = np.arange(first.size)
    gaps = jnp.where(np.eye(n, dtype=bool), jnp.inf, gap[pair])
    min_gap = jnp.min(gaps, axis=1)
    index = jnp.where(min_gap < SEPARATION_RADIUS_M, jnp.argmin(gaps, axis=1), -1)
    return jnp.minimum(min_gap, SEPARATION_RADIUS_M), index.astype(jnp.int32)


def _take_rows(values: jax.Array, index: jax.Array) -> jax.Array:
    """``values[index]``, or zeros where there are no rows at all."""
    if values.shape[0] == 0:
        return jnp.zeros((*index.shape, *values.shape[1:]), values.dtype)
    return values[index]
