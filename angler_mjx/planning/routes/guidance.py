"""Where a robot is to fly next on its way to a place: the farthest cell of the way that it sees.

The way is walked down the field for a few cells, and the string between the robot and the last of
them is pulled: the aim is the farthest of these cells to which the straight line is clear.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world import routes as reading
from angler_mjx.world.routes import FINER, Routes

CELLS = 8
"""Of the way that are looked at: what is behind two corners need not be seen yet. A power of 2."""
_HALVINGS = tuple(CELLS >> k for k in range(CELLS.bit_length()))
"""Cells by which the aim is tried to be moved on: 8, 4, 2, 1."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Aim:
    """What one robot flies towards."""

    point_m: jax.Array
    """[3] in W."""
    at_place: jax.Array
    """bool [] whether that is the place itself."""
    exists: jax.Array
    """bool [] whether there is a way at all."""


def aim(routes: Routes, place: jax.Array, p: jax.Array) -> Aim:
    """The point to fly towards.

    Args:
        routes: of the world.
        place: int32 [] one of its places.
        p: [3] of the robot, in W.

    Returns:
        The farthest point of the way that is seen; the centre of the robot's own cell where none
        is, which lies farther from any rock than the robot does. A robot in a cell that does not
        keep the clearance is led to the next one that does.
    """
    target = routes.place_m[place]
    last = reading.cell_of(routes, target)
    here = reading.cell_of(routes, p)

    def walk(cell: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        after = reading.step_on(routes, place, cell)[0]
        ends = jnp.all(after == last)
        return after, (jnp.where(ends, target, reading.centre_m(routes, after)), ends)

    after, length = reading.step_on(routes, place, here)
    _, (points, ends) = jax.lax.scan(walk, here, length=CELLS, unroll=True)
    seen = jnp.int32(0)
    for more in _HALVINGS:
        tried = jnp.minimum(seen + more, CELLS)
        seen = jnp.where(sees(routes, p, points[tried - 1]), tried, seen)
    middle = reading.centre_m(routes, here)
    kept = reading.is_clear(routes, *middle)
    nearest = jnp.where(kept, middle, reading.centre_m(routes, after))
    # In the place's own cell the line ends there, seen or not: a place may stand near rock.
    own = jnp.all(here == last)
    point = jnp.where(own, target, jnp.where(seen > 0, points[seen - 1], nearest))
    return Aim(
        point_m=point,
        at_place=own | ((seen > 0) & ends[seen - 1]),
        exists=jnp.isfinite(length),
    )


def sees(routes: Routes, a: jax.Array, b: jax.Array) -> jax.Array:
    """Whether a robot can go straight from a [3] to b [3] in W, bool [].

    Looked up at points at most 1.08 cubes apart, for the longest line to `CELLS` cells of a way.
    """
    count = int(CELLS * 3**0.5 * FINER) + FINER
    share = (jnp.arange(count) + 1.0) / count
    x, y, z = (a[i] + share * (b[i] - a[i]) for i in range(3))
    return jnp.all(reading.is_clear(routes, x, y, z))
