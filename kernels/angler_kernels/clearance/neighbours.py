"""Distances to a regular grid of cubes, from one look-up of the cells around a point.

The 3 x 3 x 3 occupancies around every cell are packed into one integer, once for a world. A
distance then reads one integer instead of 27 flags, and works on the few cells of it that can be
nearest. All functions but `cell_neighbours` are for one body and work on scalars: no gather, no
sort, so that they can stand inside a kernel. The look-up itself is the caller's.
"""

import functools
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp

from angler_kernels.clearance.shapes import LineSegment, point_box, segment_point

type Scalars = Sequence[jax.Array]

type _PairSearch = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]
"""Remaining cells, least gap so far, its cell, its capsule, its parameter on the axis."""


def cell_neighbours(occupied: jax.Array) -> jax.Array:
    """Pack the occupancy of the cells around each cell; int32 [nx + 2, ny + 2, nz + 2].

    Entry (x, y, z) belongs to cell (x - 1, y - 1, z - 1): there is one ring of cells outside the
    grid. Its bit ``9 i + 3 j + k`` is set if cell (x + i - 2, y + j - 2, z + k - 2) is occupied.

    Args:
        occupied: bool [nx, ny, nz]; everything outside the grid is free.
    """
    packed = jnp.pad(occupied, 2)
    for axis, stride, kind in ((2, 1, jnp.uint8), (1, 3, jnp.uint16), (0, 9, jnp.int32)):
        # Each axis is packed separately in few bits: fused, every entry would read 27 flags.
        packed = jax.lax.optimization_barrier(packed).astype(kind)
        n = packed.shape[axis] - 2
        parts = [
            jax.lax.slice_in_dim(packed, i, i + n, axis=axis) << (stride * i) for i in range(3)
        ]
        packed = parts[0] | parts[1] | parts[2]
    return packed


def neighbour_window(
    p: jax.Array, origin: jax.Array, cell: jax.Array, shape: tuple[int, int, int]
) -> tuple[jax.Array, jax.Array]:
    """Return the look-up index and the window position of the cells around a point.

    A point outside the grid takes the nearest entry, which holds every cell nearer than one edge.

    Args:
        p: [3] m.
        origin: [3] lower corner of cell (0, 0, 0).
        cell: [] edge of a cell.
        shape: (nx, ny, nz) of the grid.

    Returns:
        int32 [] index into the flattened `cell_neighbours`, and the lower corner [3] of the cell
        of bit 0.
    """
    index = jnp.zeros((), jnp.int32)
    corner = []
    for i, n in enumerate(shape):
        at = jnp.floor((p[i] - origin[i]) / cell).astype(jnp.int32)
        at = jnp.clip(at, -1, n)
        index = index * (n + 2) + at + 1
        corner.append(origin[i] + cell * (at - 1).astype(p.dtype))
    return index, jnp.stack(corner)


def capsules_neighbours(
    a: jax.Array,
    b: jax.Array,
    r: jax.Array,
    centre: jax.Array,
    lo: jax.Array,
    mask: jax.Array,
    cell: jax.Array,
    below: jax.Array | float = jnp.inf,
) -> jax.Array:
    """Return the distance [] of a union of capsules to the occupied cells, as `capsules_grid`.

    Exact up to ``cell - hull radius`` and to ``below``, and never greater. The nearest cell of the
    nearest capsule is searched with gradients stopped; the gap of that pair is differentiated.

    Args:
        a: [c, 3] one end of each capsule's axis, m.
        b: [c, 3] other end.
        r: [c] radii.
        centre: [3] point of the hull that the cells were looked up with.
        lo: [3] lower corner of the cell of bit 0.
        mask: int32 [] entry of `cell_neighbours`.
        cell: [] edge of a cell.
        below: [] >= 0; greater distances are not searched.
    """
    n = a.shape[0]
    # The rest is in coordinates of the window, whose small numbers round least.
    first = [[a[k, i] - lo[i] for i in range(3)] for k in range(n)]
    second = [[b[k, i] - lo[i] for i in range(3)] for k in range(n)]
    lines = [LineSegment.from_ends(p, q) for p, q in zip(first, second, strict=True)]
    constants = jax.lax.stop_gradient((a, b, centre, r))
    reaches, depths = [], []
    for k in range(n):
        start, end, middle, radius = constants[0][k], constants[1][k], constants[2], constants[3][k]
        square = jnp.maximum(_squared_distance(start, middle), _squared_distance(end, middle))
        reaches.append(jnp.sqrt(square) + r[k])
        depths.append(segment_point(start, end, middle) - radius)
    hull_radius = functools.reduce(jnp.maximum, reaches)
    cap = jnp.minimum(cell - hull_radius, below)

    constant_inputs = jax.lax.stop_gradient((lines, [r[k] for k in range(n)], cell, cap))
    point = jax.lax.stop_gradient([centre[i] - lo[i] for i in range(3)])
    bounds = jax.lax.stop_gradient((functools.reduce(jnp.minimum, depths), hull_radius))
    near_mask = _cells_within_reach(point, mask, constant_inputs[2], constant_inputs[3], *bounds)
    bit, capsule, s = _nearest_pair(
        constant_inputs[0], constant_inputs[1], near_mask, constant_inputs[2], constant_inputs[3]
    )
    chosen: LineSegment = jax.tree.map(lambda *leaves: _select_value(capsule, leaves), *lines)
    low = _cell_corner(bit, cell)
    gap = chosen.gap_at(s, low, [x + cell for x in low]) - _select_value(
        capsule, [r[k] for k in range(n)]
    )
    return jnp.where(bit >= 0, jnp.minimum(gap, cap), cap)


def point_neighbours(
    p: jax.Array, lo: jax.Array, mask: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the distance [] of a point to the occupied cells and the direction [3] away from them.

    The same as `point_grid`: exact up to ``cell``, and ``cell`` where nothing is nearer (the
    direction, a unit vector, then means nothing). Inside a cell the distance is 0 and the direction
    points from that cell's centre to the point.

    Args:
        p: [3] m.
        lo: [3] lower corner of the cell of bit 0.
        mask: int32 [] entry of `cell_neighbours`.
        cell: [] edge of a cell.
    """
    point = [p[i] - lo[i] for i in range(3)]
    min_square, bit = jnp.full_like(cell, jnp.inf), jnp.full_like(mask, -1)
    for i, square in enumerate(
        _cell_squares(jax.lax.stop_gradient(point), jax.lax.stop_gradient(cell))
    ):
        better = (mask & (1 << i) != 0) & (square < min_square)
        min_square = jnp.where(better, square, min_square)
        bit = jnp.where(better, i, bit)
    low = _cell_corner(bit, cell)
    high = [x + cell for x in low]
    at = jnp.stack(point)
    gap = jnp.where(bit >= 0, point_box(at, jnp.stack(low), jnp.stack(high)), cell)
    distance = jnp.minimum(gap, cell)
    away = [
        point[i]
        - jnp.where(distance > 0.0, jnp.clip(point[i], low[i], high[i]), low[i] + 0.5 * cell)
        for i in range(3)
    ]
    square = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
    length = jnp.sqrt(jnp.where(square > 0.0, square, 1.0))
    up = (0.0, 0.0, 1.0)
    return distance, jnp.stack([jnp.where(square > 0.0, away[i] / length, up[i]) for i in range(3)])


def _cells_within_reach(
    point: Scalars,
    mask: jax.Array,
    cell: jax.Array,
    cap: jax.Array,
    inner: jax.Array,
    hull_radius: jax.Array,
) -> jax.Array:
    """Return bits [] of the cells that can hold the nearest point of a hull about a window point.

    A cell at distance x of the point has a gap of at least x - hull radius and at most x + inner,
    where ``inner`` is the distance of the point to the hull (negative inside). Cells farther than
    the least upper bound, or than ``cap``, are left out.
    """
    squares = list(_cell_squares(point, cell))
    far = jnp.full_like(cell, jnp.inf)
    set_squares = [jnp.where(mask & (1 << i) != 0, x, far) for i, x in enumerate(squares)]
    nearest = jnp.sqrt(functools.reduce(jnp.minimum, set_squares))
    limit = jnp.minimum(nearest + inner, cap) + hull_radius
    limit = jnp.maximum(limit, 0.0) * limit
    near = [jnp.where(x <= limit, 1 << i, 0) for i, x in enumerate(squares)]
    return mask & functools.reduce(jnp.bitwise_or, near)


def _nearest_pair(
    lines: Sequence[LineSegment], r: Scalars, mask: jax.Array, cell: jax.Array, cap: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the cell and the capsule with the least gap below ``cap``.

    Returns:
        int32 [] bit of the cell, -1 if there is none; int32 [] capsule; parameter [] on its axis.
    """

    def body(carry: _PairSearch) -> _PairSearch:
        remaining, best, bit, capsule, s = carry
        # Bodies side by side in a kernel iterate as often as the slowest of them: a body without
        # cells left
        # has to come out unchanged.
        has_cell = remaining != 0
        at = 31 - jax.lax.clz(remaining & -remaining)
        low = _cell_corner(at, cell)
        high = [x + cell for x in low]
        for k, line in enumerate(lines):
            foot = line.nearest_parameter(low, high)
            gap = line.gap_at(foot, low, high) - r[k]
            better = has_cell & (gap < best)
            best = jnp.where(better, gap, best)
            bit = jnp.where(better, at, bit)
            capsule = jnp.where(better, k, capsule)
            s = jnp.where(better, foot, s)
        return remaining & (remaining - 1), best, bit, capsule, s

    none = jnp.full_like(mask, -1)
    start = (mask, cap, none, jnp.zeros_like(mask), jnp.zeros_like(cap))
    _, _, bit, capsule, s = jax.lax.while_loop(lambda carry: carry[0] != 0, body, start)
    return bit, capsule, s


def _cell_squares(point: Scalars, cell: jax.Array) -> Iterator[jax.Array]:
    """Yield the squared distances [] of a window point to its 27 cells, in the order of bits."""
    axes = []
    for x in point:
        past = [x - jnp.clip(x, i * cell, (i + 1) * cell) for i in range(3)]
        axes.append([y * y for y in past])
    for x in axes[0]:
        for y in axes[1]:
            base = x + y
            for z in axes[2]:
                yield base + z


def _cell_corner(bit: jax.Array, cell: jax.Array) -> list[jax.Array]:
    """Return the lower corner, as three scalars, of the cell of a bit, in the window."""
    nine, three = jnp.full_like(bit, 9), jnp.full_like(bit, 3)
    i = jax.lax.div(bit, nine)
    rest = bit - nine * i
    j = jax.lax.div(rest, three)
    return [cell * x.astype(cell.dtype) for x in (i, j, rest - three * j)]


def _select_value(index: jax.Array, values: Sequence[jax.Array]) -> jax.Array:
    """Return ``values[index]`` without a gather."""
    chosen = values[0]
    for k, value in enumerate(values[1:], start=1):
        chosen = jnp.where(index == k, value, chosen)
    return chosen


def _squared_distance(u: jax.Array, v: jax.Array) -> jax.Array:
    """Return the squared distance [] of two points [3]."""
    x, y, z = (u[i] - v[i] for i in range(3))
    return x * x + y * y + z * z
