"""Ways of one world to given places, worked out once: from any cell, where to go next and how far.

For each place there is a field over the cells of the grid: the length of the shortest free way from
the cell's centre to the place's cell, by steps to any of the 26 neighbours, and the first of these
steps. Both stand in one word of 16 bits. A field has no local minimum but its place, so whoever
goes down it arrives. `angler_mjx.planning.routes.route_fields` works fields out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp

MOVE_BITS = 5
"""Of a word: the step, its place in a block of 3 x 3 x 3; the middle one (`STAY`) is none."""
STAY = 13
PARTS = 8
"""Parts of a cell's edge that lengths are counted in: 0.19 m for cells of 1.5 m."""
MAX_PARTS = 2**11 - 2
"""Longest way that is told, 255 cell edges; longer ones are told as this, with the right step."""
NO_PATH = ((MAX_PARTS + 1) << MOVE_BITS) | STAY
"""The word of a cell from which no way leads to the place."""
FINER = 4
"""Cubes that a cell's edge is divided into, where `Routes.clear` is looked up."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Routes:
    """Ways to P places of one world, for any of its robots."""

    position_m: jax.Array
    """[P, 3] in W."""
    words: jax.Array
    """uint16 [nx, ny, nz, P] length and first step of the way from each cell; ways from one cell to
    all places, which are compared, stand together."""
    clear: jax.Array
    """uint32 [4 nx, 4 ny, words along z] bit k of a word: the centre of cube k, a quarter of a cell
    wide, keeps the clearance from rock, floor, faces of the cube and obstacles that stand."""
    origin_m: jax.Array
    """[3] lower corner of the grid, in W."""
    cell_m: jax.Array
    """[] edge of a cell."""


def cell_of(routes: Routes, p: jax.Array) -> jax.Array:
    """Cell int32 [3] that holds p [3] in W; the nearest one outside the grid."""
    last = jnp.array(routes.words.shape[:3]) - 1
    cell = jnp.floor((p - routes.origin_m) / routes.cell_m).astype(jnp.int32)
    return jnp.clip(cell, 0, last)


def centre_m(routes: Routes, cell: jax.Array) -> jax.Array:
    """Centre [3] of a cell int32 [3], m in W."""
    return routes.origin_m + (cell + 0.5) * routes.cell_m


def step_toward(
    routes: Routes, goal_index: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """One step down the field of a place.

    Args:
        routes: of the world.
        goal_index: int32 [] one of P.
        cell: int32 [3].

    Returns:
        The next cell int32 [3], the same where there is none, and the length [] of the way from
        ``cell`` on in m; inf where there is none.
    """
    step, length = _read_word(routes, goal_index, cell)
    return cell + jnp.stack(step), length


def _read_word(
    routes: Routes, goal_index: jax.Array, cell: jax.Array
) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Step along each axis, -1, 0 or 1, and length, as `step_toward` gives them."""
    return _decode_word(routes.words[cell[0], cell[1], cell[2], goal_index], routes.cell_m)


def _decode_word(word: jax.Array, cell_m: jax.Array) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Step along each axis, -1, 0 or 1, and length that words [...] tell."""
    word = word.astype(jnp.int32)
    move = word & (2**MOVE_BITS - 1)
    step = (move // 9 - 1, move // 3 % 3 - 1, move % 3 - 1)
    length = (word >> MOVE_BITS) * (cell_m / PARTS)
    return step, jnp.where(word == NO_PATH, jnp.inf, length)


def distance_to_goal(routes: Routes, goal_index: jax.Array, p: jax.Array) -> jax.Array:
    """Length [] of the free way from p [3] in W to a place int32 [], m; inf where there is none.

    Straight to the centre of the next cell of the way, and along the way from there; straight to
    the place where that is the next cell. Ways of cells are up to 13 % longer than straight ones,
    and lengths are told in eighths of a cell's edge.
    """
    # Worked out once for all places that a robot's ways are compared to.
    cell = jax.lax.optimization_barrier(cell_of(routes, p))
    word = routes.words[cell[0], cell[1], cell[2], goal_index]
    to, origin = (
        tuple(x[axis] for axis in range(3))
        for x in (routes.position_m[goal_index], routes.origin_m)
    )
    return length_m(word, tuple(cell), tuple(p), to, origin, routes.cell_m)


type _Axes = Sequence[jax.Array]
"""A number [...] for each axis: vectors would be written to memory."""


def length_m(
    word: jax.Array, cell: _Axes, p: _Axes, position_m: _Axes, origin_m: _Axes, cell_m: jax.Array
) -> jax.Array:
    """As `distance_to_goal` [...], from what is read for it.

    Args:
        word: uint16 [...] of ``Routes.words``, of the cell and the place.
        cell: int32 [...] the cell that holds p.
        p: [...] m in W.
        position_m: [...] the place.
        origin_m: [...] of the grid.
        cell_m: [...] edge of a cell.
    """
    step, length = _decode_word(word, cell_m)
    # The word says what is left after the step as well: another read would cost more.
    axes = abs(step[0]) + abs(step[1]) + abs(step[2])
    rest = length - cell_m * jnp.sqrt(axes.astype(length.dtype))
    last = rest < 0.5 * cell_m
    square = jnp.zeros((), length.dtype)
    for axis, along in enumerate(step):
        centre = origin_m[axis] + (cell[axis] + along + 0.5) * cell_m
        square += (jnp.where(last, position_m[axis], centre) - p[axis]) ** 2
    whole = jnp.sqrt(square) + jnp.where(last, 0.0, rest)
    return jnp.where(jnp.isinf(length), jnp.inf, whole)


def is_clear(routes: Routes, x: jax.Array, y: jax.Array, z: jax.Array) -> jax.Array:
    """Whether a robot may be at points x, y, z [...] m in W, bool [...]; nowhere off the grid."""
    inside, at = jnp.ones((), bool), []
    for axis, (value, n) in enumerate(zip((x, y, z), routes.words.shape[:3], strict=True)):
        cube = jnp.floor((value - routes.origin_m[axis]) * (FINER / routes.cell_m))
        inside &= (cube >= 0) & (cube < FINER * n)
        at.append(jnp.clip(cube, 0, FINER * n - 1).astype(jnp.int32))
    word = routes.clear[at[0], at[1], at[2] >> 5]
    return inside & (((word >> (at[2] & 31).astype(jnp.uint32)) & 1) == 1)
