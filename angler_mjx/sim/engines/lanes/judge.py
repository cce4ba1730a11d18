"""Detection on lanes: how robots, obstacles and cells meet.

Distances that cannot matter are left out: a robot's tally keeps its least clearance, so a shape
whose bounding sphere is farther than the least clearance so far is not looked at, nor is a cell.
The tally that results is the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import clearance, lanes, quaternion
from angler_kernels.table import take_row
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.detection import SEPARATION_RADIUS_M, Contact
from angler_mjx.sim.engines.lanes.search import (
    CandidateBody,
    LaneIndex,
    NearestBody,
    OtherBodies,
    SearchFunction,
    Seeker,
)
from angler_mjx.sim.engines.lanes.steps import Cells, GridShape, Lanes
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import Outcome, Tally, Touched
from angler_mjx.world.obstacles import Obstacles
from angler_mjx.world.obstacles.types import STATIC, bounding_radius


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LaneHull:
    """What can touch of robots: the part of `VehicleParams` that is so called there, as lanes."""

    capsule_a_m: jax.Array
    capsule_b_m: jax.Array
    capsule_r_m: jax.Array
    radius_m: jax.Array


def hull_of(vehicle: VehicleParams) -> LaneHull:
    """The hull of vehicles whose leaves are lanes."""
    return LaneHull(
        capsule_a_m=vehicle.capsule_a_m,
        capsule_b_m=vehicle.capsule_b_m,
        capsule_r_m=vehicle.capsule_r_m,
        radius_m=vehicle.radius_m,
    )


def find_contact[Index](
    shape: GridShape,
    hull: LaneHull,
    cells: Cells,
    tally: Tally,
    state: VehicleState,
    obstacles: OtherBodies[Index, Obstacles],
    robots: Sequence[OtherBodies[Index, LaneHull]],
    row: LaneIndex,
    search: SearchFunction[Index],
) -> Contact:
    """The nearest thing to each robot, as far as it can matter to its tally.

    Args:
        shape: of the grid.
        hull: of the robots.
        cells: of their worlds.
        tally: so far.
        state: of the robots after the step.
        obstacles: of the same world, after the step.
        robots: all robots of the same world after the step; none if there is but one.
        row: which of its world's robots each lane is.
        search: how the nearest shape is found.
    """
    a, b = lanes.apply(_capsule_ends, hull, state.p, state.q)
    v = lanes.apply(_rotate_velocity, state.q, state.nu)
    running = tally.outcome[()] == Outcome.RUNNING
    below = jnp.where(running, jnp.maximum(tally.min_clearance_m[()], 0.0), 0.0)
    to_cells, to_floor = lanes.apply(
        partial(_to_ground, shape), hull.capsule_r_m, a, b, state.p, cells, lanes.pack([below], ())
    )
    zero = jnp.zeros_like(state.p[0])
    start = NearestBody(
        gap=jnp.full_like(zero, jnp.inf),
        index=jnp.full_like(tally.outcome[()], -1),
        fixed=running & False,
        v=(zero, zero, zero),
    )
    pack_lane = partial(lanes.pack, shape=())
    seeker = Seeker(
        p=state.p,
        a=a,
        b=b,
        r=hull.capsule_r_m,
        radius_m=hull.radius_m,
        running=pack_lane([running]),
        limit_m=tally.min_clearance_m,
    )
    obstacle = search(seeker, obstacles, _to_obstacle, start, -1)
    other = start
    if robots:
        other = replace(start, gap=jnp.full_like(zero, SEPARATION_RADIUS_M))
    limit = jnp.minimum(tally.min_separation_m[()], SEPARATION_RADIUS_M)
    for bodies in robots:
        other = search(replace(seeker, limit_m=pack_lane([limit])), bodies, _to_robot, other, row)
    return lanes.apply(
        _select_contact, to_cells, to_floor, *_pack_nearest(obstacle), *_pack_nearest(other), v
    )


def _to_obstacle(
    seeker: Seeker, candidate: CandidateBody[Obstacles]
) -> tuple[jax.Array, jax.Array, Lanes]:
    body, q, body_v = candidate.details()
    gap = lanes.apply(_obstacle_gap, body, candidate.p, q, seeker.a, seeker.b, seeker.r)
    return gap[()], body.motion[()] == STATIC, body_v


def _to_robot(
    seeker: Seeker, candidate: CandidateBody[LaneHull]
) -> tuple[jax.Array, np.bool_, Lanes]:
    other, q, body_v = candidate.details()
    other_ends = lanes.apply(_capsule_ends, other, candidate.p, q)
    gap = lanes.apply(
        clearance.capsules_capsules, seeker.a, seeker.b, seeker.r, *other_ends, other.capsule_r_m
    )
    return gap[()], np.bool_(False), body_v


def centre_velocity(q: Lanes, nu: Lanes) -> jax.Array:
    """Velocity [3] of centres, in W."""
    return lanes.apply(_rotate_velocity, q, nu)


def bounding_reach(body: Obstacles) -> jax.Array:
    """Radius of the bounding spheres of obstacles; -inf for rows that are padding."""
    radius = lanes.apply(bounding_radius, body.kind, body.size_m)[()]
    return jnp.where(body.exists[()], radius, -jnp.inf)


def _pack_nearest(nearest: NearestBody) -> tuple[Lanes, Lanes, Lanes, Lanes]:
    """A `NearestBody` as arguments of `lanes.apply`."""
    gap, index, fixed = (lanes.pack([x], ()) for x in (nearest.gap, nearest.index, nearest.fixed))
    return gap, index, fixed, lanes.pack(nearest.v, (3,))


def _capsule_ends(hull: LaneHull, p: jax.Array, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Ends [c, 3] of the axes of one robot's capsules, in W."""
    turn = quaternion.to_matrix(q)

    def to_world(points: jax.Array) -> jax.Array:
        return p + jnp.sum(turn[None, :, :] * points[:, None, :], axis=2)

    return to_world(hull.capsule_a_m), to_world(hull.capsule_b_m)


def _obstacle_gap(
    body: Obstacles, p: jax.Array, q: jax.Array, a: jax.Array, b: jax.Array, r: jax.Array
) -> jax.Array:
    """Distance [] of one hull to one obstacle."""
    return clearance.capsules_obstacle(a, b, r, p, q, body.kind, body.size_m, body.kinds)


def _rotate_velocity(q: jax.Array, nu: jax.Array) -> jax.Array:
    """Velocity [3] of a centre, in W."""
    return quaternion.rotate(q, nu[:3])


def _to_ground(
    shape: GridShape,
    r: jax.Array,
    a: jax.Array,
    b: jax.Array,
    p: jax.Array,
    cells: Cells,
    below: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Distance [] of one hull to the cells, if less than ``below`` [], and to the floor."""
    index, lo = clearance.neighbour_window(p, cells.origin_m, cells.cell_m, shape)
    mask = take_row(cells.neighbours, index)
    gap = clearance.capsules_neighbours(a, b, r, p, lo, mask, cells.cell_m, below)
    lowest = jnp.min(jnp.minimum(a[:, 2], b[:, 2]) - r)
    return gap, lowest - cells.floor_z_m


def _select_contact(
    to_cells: jax.Array,
    to_floor: jax.Array,
    obstacle_gap: jax.Array,
    obstacle: jax.Array,
    obstacle_fixed: jax.Array,
    obstacle_v: jax.Array,
    robot_gap: jax.Array,
    other: jax.Array,
    robot_fixed: jax.Array,
    robot_v: jax.Array,
    v: jax.Array,
) -> Contact:
    """The nearest of the four kinds, of one robot; the first of equals."""
    static = jnp.minimum(to_cells, to_floor)
    ground = jnp.where(to_cells <= to_floor, Touched.CELL, Touched.FLOOR)
    is_obstacle = obstacle_gap < static
    clear = jnp.minimum(static, obstacle_gap)
    is_robot = (robot_gap < clear) & (other >= 0)
    nearest = jnp.where(is_robot, Touched.ROBOT, jnp.where(is_obstacle, Touched.OBSTACLE, ground))
    other_v = jnp.where(is_robot, robot_v, jnp.where(is_obstacle, obstacle_v, 0.0))
    return Contact(
        clearance_m=clear,
        separation_m=robot_gap,
        nearest=nearest,
        nearest_index=jnp.where(is_robot, other, jnp.where(is_obstacle, obstacle, -1)),
        nearest_is_static=~is_robot & (~is_obstacle | obstacle_fixed),
        closing_speed_mps=jnp.sqrt(jnp.sum((v - other_v) ** 2)),
    )
