"""What robots meet, and the search for the nearest shape among the few pairs that need it.

Of thousands of pairs of a robot and a shape a handful are near enough to matter. All pairs are
looked at for that; those that are wanted are listed, and their distances worked out a chunk at a
time. This is plain JAX's way. A kernel, whose lanes are few, does better with
`search.search_lanes`.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import lanes
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.engines.lanes import judge as lane_judge
from angler_mjx.sim.engines.lanes.layout import LaneScene, concatenate_groups
from angler_mjx.sim.engines.lanes.search import (
    CandidateBody,
    GapFunction,
    LaneIndex,
    NearestBody,
    OtherBodies,
    Seeker,
)
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.step import MovedRobots
from angler_mjx.world.obstacles import Obstacles, ObstacleState

CHUNK = 128
"""Pairs whose distances are worked out at once: few cost as much as this many."""


def gather_lanes[T](tree: T, index: LaneIndex) -> T:
    """Lanes at an index of lanes [n, W]; what is the same for all, and tables, stay as they are."""

    def gather_leaf(leaf: lanes.Elements) -> lanes.Elements:
        if isinstance(leaf, lanes.LookupTable):
            return leaf
        whole = leaf.ravel()
        items = [x.at[index].get(mode="promise_in_bounds") if np.ndim(x) == 2 else x for x in whole]
        return lanes.pack(items, leaf.shape)

    gathered: T = jax.tree.map(gather_leaf, tree)
    return gathered


def candidate_robot(
    hull: lane_judge.LaneHull, state: VehicleState, index: LaneIndex
) -> CandidateBody[lane_judge.LaneHull]:
    """Robots at an index of lanes [n, W]."""
    theirs, now = gather_lanes((hull, state), index)
    return CandidateBody(
        p=now.p,
        reach=theirs.radius_m[()],
        details=lambda: (theirs, now.q, lane_judge.centre_velocity(now.q, now.nu)),
    )


def candidate_obstacle(
    obstacles: Obstacles, reach: jax.Array, state: ObstacleState, index: LaneIndex
) -> CandidateBody[Obstacles]:
    """Obstacles, at an index of lanes [n, W]."""
    body, radius, now = gather_lanes((obstacles, lanes.pack([reach], ()), state), index)
    return CandidateBody(
        p=now.p,
        reach=radius.item(),
        details=lambda: (body, now.q, lane_judge.centre_velocity(now.q, now.nu)),
    )


def find_contact(
    scene: LaneScene, groups: Sequence[MovedRobots], obstacles: ObstacleState
) -> Contact:
    """Return the nearest thing to each robot of a scene when all have moved.

    Robots of all groups at once: code for each pair of groups would take most of the time that it
    takes to compile a step.
    """
    vehicles = [now.vehicle for now in groups]
    state, tally = (
        concatenate_groups(vehicles),
        concatenate_groups([now.tally for now in groups]),
    )
    hulls = [lane_judge.hull_of(constants.params.vehicle) for constants in scene.groups]
    hull = concatenate_groups(hulls, like=[vehicle.p[0] for vehicle in vehicles])
    robots = OtherBodies(count=scene.n_robot, load=partial(candidate_robot, hull, state))
    return lane_judge.find_contact(
        scene.shape,
        hull,
        scene.cells,
        tally,
        state,
        OtherBodies(
            count=scene.n_obstacle,
            load=partial(candidate_obstacle, scene.obstacles, scene.reach, obstacles),
        ),
        [robots] if scene.n_robot > 1 else [],
        np.arange(scene.n_robot)[:, None],
        search_listed,
    )


def search_listed[Body](
    seeker: Seeker,
    others: OtherBodies[LaneIndex, Body],
    measure_gap: GapFunction[Body],
    start: NearestBody,
    self_index: LaneIndex,
) -> NearestBody:
    """See `lane_search.Search`; the lanes of ``seeker`` are [R, W].

    ``others.load`` takes an index of lanes [n, W]: slices, or two arrays of whole numbers.
    """
    if others.count == 0:
        return start
    number = others.first + np.arange(others.count, dtype=np.int32)[:, None, None]
    wanted = seeker.is_candidate(others.load(np.s_[:, None]), number != self_index)

    def look(best: NearestBody) -> NearestBody:
        gap, shape = _find_min_gap(wanted, seeker, others, measure_gap, best.gap)
        is_found = shape >= 0
        candidate = others.load((jnp.maximum(shape, 0), np.arange(shape.shape[1], dtype=np.int32)))
        of_shape, fixed, v = measure_gap(seeker, candidate)
        return best.replace_where(
            is_found, _attach_derivative(gap, of_shape), others.first + shape, fixed, v
        )

    nearest: NearestBody = jax.lax.cond(lanes.any_lane(wanted), look, lambda best: best, start)
    return nearest


def _find_min_gap[Body](
    wanted: jax.Array,
    seeker: Seeker,
    others: OtherBodies[LaneIndex, Body],
    measure_gap: GapFunction[Body],
    gap: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """The least gap [R, W] of wanted pairs [n, R, W] below ``gap``, and its shape; -1 if none.

    Without derivatives. The first of equal gaps counts.
    """
    count = jnp.cumsum(wanted.reshape(-1), dtype=jnp.int32)

    def body(
        carry: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        done, gap, shape = carry
        nth = done + 1 + np.arange(CHUNK, dtype=np.int32)
        pair_index = jnp.searchsorted(count, nth, method="scan_unrolled").astype(jnp.int32)
        i, r, w = jnp.unravel_index(jnp.minimum(pair_index, wanted.size - 1), wanted.shape)
        pair_gap = jax.lax.stop_gradient(
            measure_gap(gather_lanes(seeker, (r, w)), others.load((i, w)))[0]
        )
        nearer = (nth <= count[-1]) & (pair_gap < gap[r, w])
        gap = gap.at[r, w].min(jnp.where(nearer, pair_gap, jnp.inf))
        # Of equals the first, also within a chunk: the old number goes, then the least stays.
        to = (jnp.where(nearer & (pair_gap == gap[r, w]), r, wanted.shape[1]), w)
        shape = shape.at[to].set(others.count, mode="drop").at[to].min(i, mode="drop")
        return done + CHUNK, gap, shape

    none = jnp.full(gap.shape, -1, jnp.int32)
    start = (jnp.int32(0), jax.lax.stop_gradient(gap), none)
    _, gap, shape = jax.lax.while_loop(lambda carry: carry[0] < count[-1], body, start)
    return gap, shape


@jax.custom_jvp
def _attach_derivative(value: jax.Array, same: jax.Array) -> jax.Array:
    """``value``, with the derivative of ``same``, which is not computed otherwise."""
    return value


@_attach_derivative.defjvp
def _attach_derivative_jvp(
    primals: tuple[jax.Array, jax.Array], tangents: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    return _attach_derivative(*primals), tangents[1]
