"""The search for the nearest of the shapes that robots can meet, on lanes.

Distances that cannot matter are left out: a shape whose bounding sphere is farther than the least
distance so far is not looked at.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels import lanes
from angler_mjx.sim.lane_steps import Lanes


@dataclass(frozen=True, kw_only=True)
class Met:
    """A shape that robots can meet, in every lane; what costs something is loaded when asked for.

    ``details`` gives what it is (Obstacles or VehicleParams), its attitude q [4], and its velocity
    [3] in W.
    """

    p: Lanes
    reach: Any
    """Radius of its bounding sphere; -inf where there is none."""
    details: Callable[[], tuple[Any, Lanes, Lanes]]


@dataclass(frozen=True, kw_only=True)
class Others:
    """Shapes that robots can meet, one after another."""

    count: int
    load: Callable[[Any], Met]
    """Shape i of these, for every lane; a `Search` of another kind asks in another way."""
    first: int = 0
    """Number of shape 0 among all of its kind."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Seeker:
    """A robot that looks for the nearest shape, in every lane; leaves are object arrays."""

    p: Lanes
    a: Lanes
    """[c, 3] one end of each axis of its hull, in W."""
    b: Lanes
    """[c, 3] other end."""
    r: Lanes
    """[c] radii."""
    radius_m: Lanes
    """[] of its bounding sphere."""
    running: Lanes
    """bool [] whether it looks at all."""
    limit_m: Lanes
    """[] distances from here on do not matter, unless something touches."""

    def wants(self, met: Met, not_itself: Any) -> jax.Array:
        """Whether a shape is near enough to matter."""
        apart = jnp.sqrt(sum((met.p[k] - self.p[k]) ** 2 for k in range(3)))
        bound = apart - self.radius_m[()] - met.reach
        near = (bound < self.limit_m[()]) | (bound <= 0.0)
        wanted: jax.Array = self.running[()] & not_itself & near
        return wanted


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Nearest:
    """The nearest shape so far, in every lane."""

    gap: jax.Array
    index: jax.Array
    fixed: jax.Array
    v: tuple[jax.Array, ...]


type Exact = Callable[[Seeker, Met], tuple[Any, Any, Lanes]]
"""The gap to a shape, whether it never moves, and its velocity [3]."""

type Search = Callable[[Seeker, Others, Exact, Nearest, Any], Nearest]
"""The nearest of some shapes and of one found before, if nearer than the limit or touching.

The last argument is the number of the shape that is the lane's own. The first of equals counts.
"""


def in_turn(me: Seeker, others: Others, exact: Exact, start: Nearest, myself: Any) -> Nearest:
    """See `Search`: one shape after another, left out where no lane wants it; ``load`` takes i."""
    if others.count == 0:
        return start

    def one(i: jax.Array, best: Nearest) -> Nearest:
        met, number = others.load(i), others.first + i
        wanted = me.wants(met, number != myself)

        def look(best: Nearest) -> Nearest:
            gap, fixed, v = exact(me, met)
            better = wanted & (gap < best.gap)
            return Nearest(
                gap=jnp.where(better, gap, best.gap),
                index=jnp.where(better, number, best.index),
                fixed=jnp.where(better, fixed, best.fixed),
                v=tuple(jnp.where(better, x, y) for x, y in zip(v, best.v, strict=True)),
            )

        after: Nearest = jax.lax.cond(lanes.any_lane(wanted), look, lambda best: best, best)
        return after

    nearest: Nearest = jax.lax.fori_loop(0, others.count, one, start)
    return nearest
