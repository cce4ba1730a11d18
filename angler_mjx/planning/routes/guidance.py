"""Next aim of a robot on its route to a place: the farthest cell of the route in sight.

The route is followed down the field for a few cells: the aim is the farthest of these cells to
which the straight line is clear.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world import routes as reading
from angler_mjx.world.routes import FINER, Routes

CELLS = 8
"""Cells of the route that are checked, a power of 2; two corners ahead are enough."""
_HALVINGS = tuple(CELLS >> k for k in range(CELLS.bit_length()))
"""Cells by which the aim is tried to be moved on: 8, 4, 2, 1."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Aim:
    """Aim of one robot."""

    point_m: jax.Array
    """[3] in W."""
    is_at_goal: jax.Array
    """bool [] whether that is the place itself."""
    exists: jax.Array
    """bool [] whether there is a route."""


def compute_aim(routes: Routes, goal_index: jax.Array, p: jax.Array) -> Aim:
    """Return the point to fly towards.

    Args:
        routes: of the world.
        goal_index: int32 [] one of its places.
        p: [3] of the robot, in W.

    Returns:
        The farthest point of the route in sight; the centre of the robot's own cell where none
        is, which lies farther from any rock than the robot does. A robot in a cell that does not
        keep the clearance is led to the next one that does.
    """
    target = routes.position_m[goal_index]
    last = reading.cell_of(routes, target)
    robot_cell = reading.cell_of(routes, p)

    def walk(cell: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        after = reading.step_toward(routes, goal_index, cell)[0]
        ends = jnp.all(after == last)
        return after, (jnp.where(ends, target, reading.centre_m(routes, after)), ends)

    after, length = reading.step_toward(routes, goal_index, robot_cell)
    _, (points, ends) = jax.lax.scan(walk, robot_cell, length=CELLS, unroll=True)
    n_visible = jnp.int32(0)
    for stride in _HALVINGS:
        n_tried = jnp.minimum(n_visible + stride, CELLS)
        n_visible = jnp.where(is_line_clear(routes, p, points[n_tried - 1]), n_tried, n_visible)
    middle = reading.centre_m(routes, robot_cell)
    is_clear = reading.is_clear(routes, *middle)
    nearest = jnp.where(is_clear, middle, reading.centre_m(routes, after))
    # In the place's own cell the line ends there, seen or not: a place may stand near rock.
    is_goal_cell = jnp.all(robot_cell == last)
    point = jnp.where(
        is_goal_cell, target, jnp.where(n_visible > 0, points[n_visible - 1], nearest)
    )
    return Aim(
        point_m=point,
        is_at_goal=is_goal_cell | ((n_visible > 0) & ends[n_visible - 1]),
        exists=jnp.isfinite(length),
    )


def is_line_clear(routes: Routes, a: jax.Array, b: jax.Array) -> jax.Array:
    """Return whether a robot can go straight from a [3] to b [3] in W, bool [].

    Checked at points at most 1.08 cubes apart, on the longest line to `CELLS` cells of a route.
    """
    count = int(CELLS * 3**0.5 * FINER) + FINER
    fraction = (jnp.arange(count) + 1.0) / count
    x, y, z = (a[i] + fraction * (b[i] - a[i]) for i in range(3))
    return jnp.all(reading.is_clear(routes, x, y, z))
