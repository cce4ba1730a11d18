"""What robots meet, and the search for the nearest shape among the few pairs that need it.

Of thousands of pairs of a robot and a shape a handful are near enough to matter. All pairs are
looked at for that; those that are wanted are listed, and their distances worked out a chunk at a
time. This is plain JAX's way. A kernel, whose lanes are few, does better with
`search.of_lanes`.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import lanes
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.engines.lanes import judge as lane_judge
from angler_mjx.sim.engines.lanes.layout import LaneScene, side_by_side
from angler_mjx.sim.engines.lanes.search import Exact, Met, NearestBody, OtherBodies, Seeker
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.world.obstacles import Obstacles, ObstacleState

CHUNK = 128
"""Pairs whose distances are worked out at once: few cost as much as this many."""


def pick(tree: Any, index: Any) -> Any:
    """Lanes at an index of lanes [n, W]; what is the same for all, and tables, stay as they are."""

    def one(leaf: Any) -> Any:
        if isinstance(leaf, lanes.LookupTable):
            return leaf
        whole = leaf.ravel()
        items = [x.at[index].get(mode="promise_in_bounds") if np.ndim(x) == 2 else x for x in whole]
        return lanes.pack(items, leaf.shape)

    return jax.tree.map(one, tree)


def met_robot(hull: lane_judge.LaneHull, state: VehicleState, index: Any) -> Met:
    """Robots at an index of lanes [n, W]."""
    theirs, now = pick((hull, state), index)
    return Met(
        p=now.p,
        reach=theirs.radius_m[()],
        details=lambda: (theirs, now.q, lane_judge.velocity(now.q, now.nu)),
    )


def met_obstacle(obstacles: Obstacles, reach: jax.Array, state: ObstacleState, index: Any) -> Met:
    """Obstacles, at an index of lanes [n, W]."""
    body, radius, now = pick((obstacles, lanes.pack([reach], ()), state), index)
    return Met(
        p=now.p,
        reach=radius[()],
        details=lambda: (body, now.q, lane_judge.velocity(now.q, now.nu)),
    )


def contact(
    scene: LaneScene, groups: Sequence[Mapping[str, Any]], obstacles: ObstacleState
) -> Contact:
    """The nearest thing to each robot of a scene when all have moved; ``groups`` are their slots.

    Robots of all groups at once: code for each pair of groups would take most of the time that it
    takes to compile a step.
    """
    vehicles = [now["vehicle"] for now in groups]
    state, tally = side_by_side(vehicles), side_by_side([now["tally"] for now in groups])
    hulls = [lane_judge.hull_of(given.params.vehicle) for given in scene.groups]
    hull = side_by_side(hulls, like=[vehicle.p[0] for vehicle in vehicles])
    robots = OtherBodies(count=scene.n_robot, load=partial(met_robot, hull, state))
    return lane_judge.contact(
        scene.shape,
        hull,
        scene.cells,
        tally,
        state,
        OtherBodies(
            count=scene.n_obstacle,
            load=partial(met_obstacle, scene.obstacles, scene.reach, obstacles),
        ),
        [robots] if scene.n_robot > 1 else [],
        np.arange(scene.n_robot)[:, None],
        among_listed,
    )


def among_listed(
    me: Seeker, others: OtherBodies, exact: Exact, start: NearestBody, myself: Any
) -> NearestBody:
    """See `lane_search.Search`; the lanes of ``me`` are [R, W].

    ``others.load`` takes an index of lanes [n, W]: slices, or two arrays of whole numbers.
    """
    if others.count == 0:
        return start
    number = others.first + np.arange(others.count, dtype=np.int32)[:, None, None]
    wanted = me.wants(others.load(np.s_[:, None]), number != myself)

    def look(best: NearestBody) -> NearestBody:
        gap, shape = _least(wanted, me, others, exact, best.gap)
        found = shape >= 0
        met = others.load((jnp.maximum(shape, 0), np.arange(shape.shape[1], dtype=np.int32)))
        of_shape, fixed, v = exact(me, met)
        return NearestBody(
            gap=jnp.where(found, _derived(gap, of_shape), best.gap),
            index=jnp.where(found, others.first + shape, best.index),
            fixed=jnp.where(found, fixed, best.fixed),
            v=tuple(jnp.where(found, x, y) for x, y in zip(v, best.v, strict=True)),
        )

    nearest: NearestBody = jax.lax.cond(lanes.any_lane(wanted), look, lambda best: best, start)
    return nearest


def _least(
    wanted: jax.Array, me: Seeker, others: OtherBodies, exact: Exact, gap: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The least gap [R, W] of wanted pairs [n, R, W] below ``gap``, and its shape; -1 if none.

    Without derivatives. The first of equal gaps counts.
    """
    count = jnp.cumsum(wanted.reshape(-1), dtype=jnp.int32)

    def body(carry: Any) -> Any:
        done, gap, shape = carry
        nth = done + 1 + np.arange(CHUNK, dtype=np.int32)
        place = jnp.searchsorted(count, nth, method="scan_unrolled").astype(jnp.int32)
        i, r, w = jnp.unravel_index(jnp.minimum(place, wanted.size - 1), wanted.shape)
        found = jax.lax.stop_gradient(exact(pick(me, (r, w)), others.load((i, w)))[0])
        nearer = (nth <= count[-1]) & (found < gap[r, w])
        gap = gap.at[r, w].min(jnp.where(nearer, found, jnp.inf))
        # Of equals the first, also within a chunk: the old number goes, then the least stays.
        to = (jnp.where(nearer & (found == gap[r, w]), r, wanted.shape[1]), w)
        shape = shape.at[to].set(others.count, mode="drop").at[to].min(i, mode="drop")
        return done + CHUNK, gap, shape

    none = jnp.full(gap.shape, -1, jnp.int32)
    start = (jnp.int32(0), jax.lax.stop_gradient(gap), none)
    _, gap, shape = jax.lax.while_loop(lambda carry: carry[0] < count[-1], body, start)
    return gap, shape


@jax.custom_jvp
def _derived(value: jax.Array, same: jax.Array) -> jax.Array:
    """``value``, with the derivative of ``same``, which is not computed otherwise."""
    return value


@_derived.defjvp
def _derived_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    return _derived(*primals), tangents[1]
