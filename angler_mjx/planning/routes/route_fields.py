"""Fields of `angler_mjx.world.routes`: from every cell, the shortest route to each place.

Bellman's equation on the lattice of the planner grid: routes go through centres of cells that keep
the clearance, to any of the 26 neighbours, without cutting corners (`path_search.lattice`). All
cells are relaxed at once until none changes. Lengths are whole numbers while they are summed, so a
field is exact, and the same on every device.
"""

import itertools
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from angler_kernels.clearance import capsules_obstacle
from angler_mjx._moved import renamed as _renamed
from angler_mjx.planning.path_search.batching import min_of_batch
from angler_mjx.planning.path_search.bodies import select_still
from angler_mjx.planning.path_search.lattice import EDGES, Terrain, build_terrain
from angler_mjx.world.difficulty import LENGTHS, MOVES, Move, bit_of, pad_axes, relax_moves
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import STATIC, Obstacles
from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.routes import (
    FINER,
    MAX_PARTS,
    MOVE_BITS,
    NO_PATH,
    PARTS,
    STAY,
    Routes,
)

type _Steps = tuple[jax.Array, jax.Array]
GOALS_AT_ONCE = 8
"""Places whose fields are relaxed together: 40 of 4,096 worlds would hold 2.7 GB otherwise."""
_ROUNDS = 4
"""Relaxations between two looks whether any cell still changes."""
_OUT = 2
"""Layers of cells without clearance that are led out to the free ones beside them."""
_REACH = 2
"""Cells that the clearance of cubes looks away; radii end at 1.5 cells."""


def compute_routes(environment: Environment, goal_m: jax.Array, clearance_m: jax.Array) -> Routes:
    """Compute the routes of one world to P places.

    Args:
        environment: of the world; obstacles that move are left out.
        goal_m: [P, 3] in W. No way leads to one whose cell does not keep the clearance.
        clearance_m: [] kept by centres of robots from rock, floor, faces of the cube and obstacles
            that stand: the widest robot's radius and a margin.
    """
    still = select_still(environment.obstacles)
    land = build_terrain(environment.grid, environment.floor_z_m, still)
    clear = land.gap_m >= clearance_m
    if land.cell_gap_m is not None:
        clear &= land.cell_gap_m >= clearance_m
    moves, grid = _allowed_moves(land, clear, clearance_m), environment.grid
    cell = jnp.floor((goal_m - grid.origin_m) / grid.cell_m).astype(jnp.int32)
    cell = jnp.clip(cell, 0, jnp.array(clear.shape) - 1)

    def solve_goals(cells: jax.Array) -> jax.Array:
        begin = jax.vmap(lambda at: _initial_lengths(clear, at))(cells)
        lengths = _relax_until_settled(begin, moves)
        return jax.vmap(lambda goal_lengths, at: _encode_cells(goal_lengths, moves, clear, at))(
            lengths, cells
        )

    count = goal_m.shape[0]
    n_batches = -(-count // GOALS_AT_ONCE)
    if n_batches > 1:
        # The last turn is filled up with the first places once more; they are cut off again.
        index = jnp.arange(n_batches * GOALS_AT_ONCE).reshape(n_batches, GOALS_AT_ONCE) % count
        route_codes = jax.lax.map(lambda i: solve_goals(cell[i]), index)
        route_codes = route_codes.reshape(-1, *clear.shape)[:count]
    else:
        route_codes = solve_goals(cell)
    return Routes(
        position_m=goal_m,
        words=jnp.moveaxis(route_codes, 0, -1),
        clear=_clear_cubes(environment, clearance_m),
        origin_m=grid.origin_m,
        cell_m=grid.cell_m,
    )


def _allowed_moves(land: Terrain, clear: jax.Array, clearance_m: jax.Array) -> jax.Array:
    """Return the moves that may end in each cell, bits of uint32 [nx, ny, nz]."""
    shape, allowed = clear.shape, jnp.zeros(clear.shape, jnp.uint32)
    for number, edge in enumerate(EDGES):
        size = [n - extent for n, extent in zip(shape, edge.block, strict=True)]
        corners = [
            jax.lax.slice(clear, at, [i + n for i, n in zip(at, size, strict=True)])
            for at in itertools.product(*(range(extent + 1) for extent in edge.block))
        ]
        free = jnp.all(jnp.stack(corners), axis=0)
        if land.edge_gap_m is not None:
            free &= land.edge_gap_m[number, : size[0], : size[1], : size[2]] >= clearance_m
        for begin, end in ((edge.near, edge.far), (edge.far, edge.near)):
            move = tuple(b - a for a, b in zip(begin, end, strict=True))
            rest = [(at, extent - at) for at, extent in zip(end, edge.block, strict=True)]
            allowed = allowed | jnp.where(jnp.pad(free, rest), bit_of(move), jnp.uint32(0))
    return allowed


def _initial_lengths(clear: jax.Array, cell: jax.Array) -> jax.Array:
    """Return lengths int32 [nx, ny, nz] before any step, of routes to a cell [3]."""
    nowhere = jnp.full(clear.shape, LENGTHS.none, jnp.int32)
    i, j, k = cell
    return nowhere.at[i, j, k].set(jnp.where(clear[i, j, k], 0, LENGTHS.none))


def _relax_until_settled(lengths: jax.Array, moves: jax.Array) -> jax.Array:
    """Relax lengths [P, nx, ny, nz] until no step shortens them."""

    def relax(_: int, lengths: jax.Array) -> jax.Array:
        return jax.vmap(
            lambda goal_lengths: jnp.minimum(
                goal_lengths,
                relax_moves(pad_axes(goal_lengths, (0, 1, 2)), goal_lengths.shape, moves, MOVES),
            )
        )(lengths)

    def is_changing(state: tuple[jax.Array, jax.Array]) -> jax.Array:
        slowest: jax.Array = min_of_batch(state[1])
        return slowest < 0

    def relax_several(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        after = jax.lax.fori_loop(0, _ROUNDS, relax, state[0])
        return after, jnp.where(jnp.any(after < state[0]), -1, 0)

    return jax.lax.while_loop(is_changing, relax_several, (lengths, jnp.int32(-1)))[0]


def _encode_cells(
    lengths: jax.Array, moves: jax.Array, clear: jax.Array, cell: jax.Array
) -> jax.Array:
    """Encode settled lengths to a cell [3] as words uint16 [nx, ny, nz]."""
    none, edge = LENGTHS.none, LENGTHS.of_axes[0]
    index = jnp.stack(jnp.meshgrid(*(jnp.arange(n) for n in lengths.shape), indexing="ij"))

    def off(move: Move) -> jax.Array:
        """Return the squared distance to the place from the cell before a step."""
        apart = [index[axis] - move[axis] - cell[axis] for axis in range(3)]
        return apart[0] ** 2 + apart[1] ** 2 + apart[2] ** 2

    def first_step(lengths: jax.Array, moves_of_axes: Sequence[Move], bits: jax.Array) -> _Steps:
        """Return lengths and first steps; of equal lengths the one nearer to the straight line."""
        wide, best = pad_axes(lengths, (0, 1, 2)), jnp.full(lengths.shape, none, jnp.int32)
        nearest, step = best, jnp.full(lengths.shape, STAY, jnp.int32)
        for move in moves_of_axes:
            at = [1 - m for m in move]
            source = jax.lax.slice(
                wide, at, [i + n for i, n in zip(at, lengths.shape, strict=True)]
            )
            cost = LENGTHS.of_axes[sum(map(abs, move)) - 1]
            is_possible = ((bits & bit_of(move)) != 0) & (source < none)
            total, square_off_line = jnp.where(is_possible, source + cost, none), off(move)
            better = (total < best) | (is_possible & (total == best) & (square_off_line < nearest))
            best = jnp.where(better, total, best)
            nearest = jnp.where(better, square_off_line, nearest)
            back = sum((1 - m) * s for m, s in zip(move, LENGTHS.strides, strict=True))
            step = jnp.where(better, back, step)
        return best, step

    step = jnp.where(lengths == 0, STAY, first_step(lengths, MOVES, moves)[1])
    is_led, every = clear, jnp.full(clear.shape, 2**32 - 1, jnp.uint32)
    for _ in range(_OUT):
        before, taken = jnp.where(is_led, lengths, none), is_led
        for axes in (1, 2, 3):  # the nearest free cell, not that with the shortest way
            moves_of_axes = [move for move in MOVES if sum(map(abs, move)) == axes]
            new_lengths, new_steps = first_step(before, moves_of_axes, every)
            new = ~taken & (new_lengths < none)
            lengths, step = jnp.where(new, new_lengths, lengths), jnp.where(new, new_steps, step)
            taken |= new
        is_led = taken
    parts = jnp.minimum((lengths + edge // (2 * PARTS)) // (edge // PARTS), MAX_PARTS)
    word = jnp.where(lengths < none, (parts << MOVE_BITS) | step, NO_PATH)
    return word.astype(jnp.uint16)


def _clear_cubes(environment: Environment, clearance_m: jax.Array) -> jax.Array:
    """Return words uint32 [4 nx, 4 ny, w] of the cubes whose centre keeps the clearance."""
    grid = environment.grid
    square = _fine_square(grid)
    clear = square >= (clearance_m / grid.cell_m * (2 * FINER)) ** 2
    axes = [
        grid.origin_m[i] + (jnp.arange(n) + 0.5) * (grid.cell_m / FINER)
        for i, n in enumerate(clear.shape)
    ]
    clear &= axes[2] - environment.floor_z_m >= clearance_m
    if STATIC in environment.obstacles.motions:
        at = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)
        clear &= _distance_to_bodies(environment.obstacles, at) >= clearance_m
    fill = -clear.shape[2] % 32
    bits = jnp.pad(clear, ((0, 0), (0, 0), (0, fill)))
    bits = bits.reshape(*clear.shape[:2], -1, 32)
    weight = jnp.uint32(1) << jnp.arange(32, dtype=jnp.uint32)
    return jnp.sum(jnp.where(bits, weight, jnp.uint32(0)), axis=-1, dtype=jnp.uint32)


def _fine_square(grid: Grid) -> jax.Array:
    """Return squared distances from cubes' centres to rock and faces, [4 nx, 4 ny, 4 nz] int16.

    In units of half a cube's edge, and at most that of `_REACH` cells. A square is a sum over the
    axes, so its minimum is taken one axis after the other.
    """
    cell, far = 2 * FINER, (2 * FINER * _REACH) ** 2
    solid = jnp.pad(grid.occupied, _REACH, constant_values=True)
    square = jnp.where(solid, 0, far).astype(jnp.int16)
    for axis in range(3):
        inner = square.shape[axis] - 2 * _REACH
        cubes = []
        for cube in range(FINER):
            off = 2 * cube + 1 - FINER
            parts = [
                jax.lax.slice_in_dim(square, _REACH + k, _REACH + k + inner, axis=axis)
                + max(abs(cell * k - off) - FINER, 0) ** 2
                for k in range(-_REACH, _REACH + 1)
            ]
            cubes.append(jnp.stack(parts).min(axis=0))
        shape = list(square.shape)
        shape[axis] = FINER * inner
        square = jnp.stack(cubes, axis=axis + 1).reshape(shape)
    return jnp.minimum(square, jnp.int16(far))


def _distance_to_bodies(obstacles: Obstacles, at_m: jax.Array) -> jax.Array:
    """Return the distance [...] of points [..., 3] to the still obstacles, m."""
    points = at_m.reshape(-1, 3)

    def nearest_distance(
        distance_m: jax.Array, row: tuple[jax.Array, ...]
    ) -> tuple[jax.Array, None]:
        p, q, kind, size, stands = row
        zero = jnp.zeros(1, p.dtype)

        def to_body(x: jax.Array) -> jax.Array:
            return capsules_obstacle(
                x[None], x[None], zero, p, q, kind, size, kinds=obstacles.kinds
            )

        return jnp.where(
            stands, jnp.minimum(distance_m, jax.vmap(to_body)(points)), distance_m
        ), None

    stands = obstacles.exists & (obstacles.motion == STATIC)
    rows = (obstacles.p0, obstacles.q0, obstacles.kind, obstacles.size_m, stands)
    distance_m = jnp.full(points.shape[:1], jnp.inf, at_m.dtype)
    return jax.lax.scan(nearest_distance, distance_m, rows)[0].reshape(at_m.shape[:-1])


def __getattr__(name: str) -> object:
    """Return an attribute by its name before 0.2."""
    return _renamed(__name__, name)
