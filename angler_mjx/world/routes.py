"""Routes of one world to given places, precomputed: next cell and distance from any cell.

For each place there is a field over the cells of the grid: the length of the shortest free path
from the cell's centre to the place's cell, by steps to any of the 26 neighbours, and the first of
these steps. Both are stored in one word of 16 bits. A field has no local minimum except its place,
so a robot that descends it arrives. `angler_mjx.planning.routes.route_fields` computes the fields.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx._moved import renamed as _renamed

MOVE_BITS = 5
"""Bits of the step in a word: its index in a block of 3 x 3 x 3; the middle one (`STAY`) is
none."""
STAY = 13
PARTS = 8
"""Length units in a cell's edge: 0.19 m for cells of 1.5 m."""
MAX_PARTS = 2**11 - 2
"""Max stored length, 255 cell edges; longer paths have this length, with the right step."""
NO_PATH = ((MAX_PARTS + 1) << MOVE_BITS) | STAY
"""Word of a cell from which no path leads to the place."""
FINER = 4
"""Number of sub-cubes along a cell's edge in `Routes.clear`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Routes:
    """Routes to P places of one world, for any of its robots."""

    position_m: jax.Array
    """[P, 3] places, in W."""
    words: jax.Array
    """uint16 [nx, ny, nz, P] length and first step of the path from each cell; paths from one cell
    to all places, which are compared, are adjacent in memory."""
    clear: jax.Array
    """uint32 [4 nx, 4 ny, words along z] bit k of a word: the centre of cube k, a quarter of a cell
    wide, keeps the clearance from rock, floor, faces of the cube and static obstacles."""
    origin_m: jax.Array
    """[3] lower corner of the grid, in W."""
    cell_m: jax.Array
    """[] edge of a cell."""


def cell_of(routes: Routes, p: jax.Array) -> jax.Array:
    """Return the cell int32 [3] of p [3] in W; the nearest cell if p is outside the grid."""
    last = jnp.array(routes.words.shape[:3]) - 1
    cell = jnp.floor((p - routes.origin_m) / routes.cell_m).astype(jnp.int32)
    return jnp.clip(cell, 0, last)


def centre_m(routes: Routes, cell: jax.Array) -> jax.Array:
    """Return the centre [3] of a cell int32 [3], m in W."""
    return routes.origin_m + (cell + 0.5) * routes.cell_m


def step_toward(
    routes: Routes, goal_index: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return one step down the field of a place.

    Args:
        routes: routes of the world.
        goal_index: int32 [] index of a place, below P.
        cell: int32 [3].

    Returns:
        The next cell int32 [3], ``cell`` itself where there is none, and the length [] of the path
            from
        ``cell`` on in m; inf where there is none.
    """
    step, length = _read_word(routes, goal_index, cell)
    return cell + jnp.stack(step), length


def _read_word(
    routes: Routes, goal_index: jax.Array, cell: jax.Array
) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Return the step along each axis, -1, 0 or 1, and the length, as of `step_toward`."""
    return _decode_word(routes.words[cell[0], cell[1], cell[2], goal_index], routes.cell_m)


def _decode_word(word: jax.Array, cell_m: jax.Array) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Decode words [...] to the step along each axis, -1, 0 or 1, and the length."""
    word = word.astype(jnp.int32)
    move = word & (2**MOVE_BITS - 1)
    step = (move // 9 - 1, move // 3 % 3 - 1, move % 3 - 1)
    length = (word >> MOVE_BITS) * (cell_m / PARTS)
    return step, jnp.where(word == NO_PATH, jnp.inf, length)


def distance_to_goal(routes: Routes, goal_index: jax.Array, p: jax.Array) -> jax.Array:
    """Return the length [] of the free path from p [3] in W to a place int32 [], m; inf if none.

    Straight to the centre of the next cell of the path, and along the path from there; straight to
    the place where that is the next cell. Cell paths are up to 13 % longer than straight ones, and
    lengths are stored in eighths of a cell's edge.
    """
    # Computed once for all places to which a robot's paths are compared.
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
    """Return the length [...] as `distance_to_goal` does, from values already read.

    Args:
        word: uint16 [...] entry of ``Routes.words`` for the cell and the place.
        cell: int32 [...] cell of p.
        p: [...] m in W.
        position_m: [...] the place.
        origin_m: [...] lower corner of the grid.
        cell_m: [...] edge of a cell.
    """
    step, length = _decode_word(word, cell_m)
    # The word also holds the length after the step: another read would cost more.
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
    """Return whether robots are clear at x, y, z [...] m in W, bool [...]; False off the grid."""
    inside, at = jnp.ones((), bool), []
    for axis, (value, n) in enumerate(zip((x, y, z), routes.words.shape[:3], strict=True)):
        cube = jnp.floor((value - routes.origin_m[axis]) * (FINER / routes.cell_m))
        inside &= (cube >= 0) & (cube < FINER * n)
        at.append(jnp.clip(cube, 0, FINER * n - 1).astype(jnp.int32))
    word = routes.clear[at[0], at[1], at[2] >> 5]
    return inside & (((word >> (at[2] & 31).astype(jnp.uint32)) & 1) == 1)


def __getattr__(name: str) -> object:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
